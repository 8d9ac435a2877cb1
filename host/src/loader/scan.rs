//! Looks at the plugin directories and reads what is new in them.
//!
//! Invariant: a file whose signature did not change is not opened again, but for a library that was missing
//! then, and a file that is still being written (young, and not seen closed) is not opened yet: it keeps its
//! last outcome, or stays invisible. What the process has no files or memory left to look at stays as it was.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::catalog::Finding;
use super::file::{PluginDir, Signature, is_shortage};
use super::{Fault, ListedPlugin, Trust, inspect, libraries};

/// A file without a close event counts once its size and mtime did not change for this long.
pub(crate) const SETTLE: Duration = Duration::from_millis(200);
/// The same for a file somebody was seen to write to and not yet to close: a copy may pause.
const SETTLE_WHILE_WRITTEN: Duration = Duration::from_secs(10);

/// What is remembered of each file between two looks.
#[derive(Default)]
pub(crate) struct Scanner {
    seen: BTreeMap<PathBuf, Seen>,
    /// Directories that could not be read at the last look; said once.
    lost: BTreeSet<PathBuf>,
}

struct Seen {
    signature: Signature,
    since: Instant,
    outcome: Option<Result<Arc<ListedPlugin>, Fault>>,
    /// The outcome belongs to this signature.
    current: bool,
}

/// One look at all directories.
pub(crate) struct Scan {
    pub(crate) findings: Vec<Finding>,
    /// Files still being written: look again after [`SETTLE`].
    pub(crate) unsettled: bool,
}

impl Scanner {
    /// `closed` names files whose writer was seen to close them or to rename them into place, `writing` those whose
    /// writer was not.
    pub(crate) fn scan(
        &mut self,
        dirs: &[PathBuf],
        trust: &Trust,
        closed: &BTreeSet<PathBuf>,
        writing: &BTreeSet<PathBuf>,
    ) -> Scan {
        let mut scan = Scan { findings: Vec::new(), unsettled: false };
        let mut present = BTreeSet::new();
        for path in dirs {
            let listing = PluginDir::open(path).and_then(|dir| Ok((dir.names()?, dir)));
            let (names, dir) = match listing {
                Ok(found) => found,
                Err(error) => {
                    if self.lost.insert(path.clone()) {
                        log::warn!("plugin directory {} cannot be read: {error}", path.display());
                    }
                    if is_shortage(&error) {
                        // The process is short of it, which says nothing about what lies there.
                        scan.unsettled = true;
                        for (file, seen) in self.seen.iter().filter(|(file, _)| file.parent() == Some(path)) {
                            present.insert(file.clone());
                            let finding = seen.outcome.clone();
                            let finding = finding.map(|outcome| Finding { file: file.clone(), outcome });
                            scan.findings.extend(finding);
                        }
                    }
                    continue;
                }
            };
            self.lost.remove(path);
            for name in names {
                let file = path.join(&name);
                let read = |warn: &dyn Fn(&str)| look_into(&dir, &name, &file, trust, warn);
                let settle = match () {
                    () if closed.contains(&file) => Duration::ZERO,
                    () if writing.contains(&file) => SETTLE_WHILE_WRITTEN,
                    () => SETTLE,
                };
                match self.look(&file, settle, read) {
                    Look::Outcome(outcome) => {
                        scan.findings.push(Finding { file: file.clone(), outcome });
                    }
                    Look::Unsettled(previous) => {
                        scan.unsettled = true;
                        let finding = previous.map(|outcome| Finding { file: file.clone(), outcome });
                        scan.findings.extend(finding);
                    }
                    Look::Gone => continue,
                }
                present.insert(file);
            }
        }
        self.seen.retain(|file, _| present.contains(file));
        scan
    }

    fn look(&mut self, file: &Path, settle: Duration, read: impl FnOnce(&dyn Fn(&str)) -> Outcome) -> Look {
        // A link whose target cannot be reached still gets its sentence: ask the link itself then.
        let Ok(meta) = std::fs::metadata(file).or_else(|_| std::fs::symlink_metadata(file)) else {
            return Look::Gone;
        };
        let signature = Signature::of(&meta);
        let seen = self.seen.entry(file.to_path_buf()).or_insert_with(|| Seen {
            signature,
            since: Instant::now(),
            outcome: None,
            current: false,
        });
        if seen.signature != signature {
            *seen = Seen { signature, since: Instant::now(), current: false, outcome: seen.outcome.take() };
        }
        // The thing it was refused for may be there now, without a change of the file.
        let is_mended = matches!(&seen.outcome, Some(Err(Fault::MissingLibrary { name })) if libraries::is_available(name));
        if let (true, false, Some(outcome)) = (seen.current, is_mended, &seen.outcome) {
            return Look::Outcome(outcome.clone());
        }
        let settled = !meta.is_file() || age(&signature) >= settle || seen.since.elapsed() >= settle;
        if !settled {
            return Look::Unsettled(seen.outcome.clone());
        }
        let mut outcome = read(&|warning| log::warn!("plugin {}: {warning}", file.display()));
        if matches!(outcome, Err(Fault::ChangedWhileRead | Fault::Shortage { .. })) {
            seen.since = Instant::now();
            return Look::Unsettled(seen.outcome.clone());
        }
        if let (Ok(new), Some(Ok(old))) = (&outcome, &seen.outcome)
            && new.hash == old.hash
            && new.warnings == old.warnings
        {
            outcome = Ok(old.clone());
        }
        seen.outcome = Some(outcome.clone());
        seen.current = true;
        Look::Outcome(outcome)
    }
}

type Outcome = Result<Arc<ListedPlugin>, Fault>;

enum Look {
    Outcome(Outcome),
    Unsettled(Option<Outcome>),
    Gone,
}

fn look_into(
    dir: &PluginDir,
    name: &std::ffi::OsStr,
    file: &Path,
    trust: &Trust,
    warn: &dyn Fn(&str),
) -> Outcome {
    let read = dir.read(name, trust)?;
    let facts = inspect::inspect_bytes(&read.bytes)?;
    let mut warnings = read.warnings;
    warnings.extend(facts.warnings);
    warnings.iter().for_each(|w| warn(w));
    Ok(Arc::new(ListedPlugin::new(facts.manifest, file, read.hash, read.bytes, warnings)))
}

/// Time since the last write by the clock of this machine; zero when that lies in the future.
fn age(signature: &Signature) -> Duration {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as i128);
    Duration::from_nanos(u64::try_from(now - signature.modified_ns).unwrap_or(0))
}
