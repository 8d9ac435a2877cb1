//! Looks at the plugin directories and reads what is new in them.
//!
//! Invariant: a file is opened again only when its signature changed, or that of a library beside it which it
//! needs, or when such a library is there that was missing. A file that is still being written (young, and
//! not seen closed) is not opened yet: it keeps its last outcome, or stays invisible. A file the process has
//! no descriptors or memory left to look at stays as it was.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::catalog::Finding;
use super::file::{PluginDir, SIZE_LIMIT, Signature, is_shortage};
use super::{Fault, ListedPlugin, Trust, inspect, libraries};

/// A file without a close event counts once its size and mtime did not change for this long.
pub(crate) const SETTLE: Duration = Duration::from_millis(200);
/// The same for a file that was seen to be written to and not yet closed: a copy may pause.
const SETTLE_WHILE_WRITTEN: Duration = Duration::from_secs(10);

/// State of each file, kept between two looks.
#[derive(Default)]
pub(crate) struct Scanner {
    seen: BTreeMap<PathBuf, Seen>,
    /// Directories that could not be read at the last look; said once.
    lost: BTreeSet<PathBuf>,
}

struct Seen {
    signature: Signature,
    /// Files that were looked for in its directory when it was read, and found.
    beside: Beside,
    since: Instant,
    outcome: Option<Outcome>,
    /// The outcome belongs to this signature.
    current: bool,
}

/// Files, and their signatures; none where there was no file.
type Beside = Vec<(PathBuf, Option<Signature>)>;

/// One look at all directories.
pub(crate) struct Scan {
    pub findings: Vec<Finding>,
    /// Files still being written: look again after [`SETTLE`].
    pub unsettled: bool,
}

impl Scanner {
    /// Looks at all directories once. `closed` names files whose writer was seen to close them or to rename
    /// them into place, `writing` those whose writer was not.
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
                        // The process is short of files or memory, which says nothing about the directory.
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
                let read = |beside: &mut Beside| look_into(&dir, &name, &file, trust, beside);
                let settle = |file: &Path| match () {
                    () if closed.contains(file) => Duration::ZERO,
                    () if writing.contains(file) => SETTLE_WHILE_WRITTEN,
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
        leave_out_brought(&mut scan.findings);
        scan
    }

    /// Files of this name, or whose plugin has it, are read again at the next look; all where it is empty.
    pub(crate) fn forget(&mut self, name: &str) {
        for (file, seen) in &mut self.seen {
            let plugin = seen.outcome.as_ref().and_then(|outcome| outcome.as_ref().ok());
            if is_called(name, file, plugin.map(|plugin| plugin.name())) {
                seen.current = false;
            }
        }
    }

    fn look(
        &mut self,
        file: &Path,
        settle: impl Fn(&Path) -> Duration,
        read: impl FnOnce(&mut Beside) -> Outcome,
    ) -> Look {
        // A link whose target cannot be reached still gets its sentence: ask the link itself then.
        let Ok(meta) = std::fs::metadata(file).or_else(|_| std::fs::symlink_metadata(file)) else {
            return Look::Gone;
        };
        let signature = Signature::of(&meta);
        let seen = self.seen.entry(file.to_path_buf()).or_insert_with(|| Seen::new(signature));
        seen.compare(signature);
        if let Some(outcome) = seen.known() {
            return Look::Outcome(outcome.clone());
        }
        if meta.is_file() && !seen.is_settled(file, settle) {
            return Look::Unsettled(seen.outcome.clone());
        }
        seen.read(read)
    }
}

impl Seen {
    fn new(signature: Signature) -> Seen {
        Seen { signature, beside: Vec::new(), since: Instant::now(), outcome: None, current: false }
    }

    /// Compares the file and those beside it with what is known of them; after a change the outcome is an
    /// earlier one.
    fn compare(&mut self, signature: Signature) {
        let beside: Beside =
            self.beside.iter().map(|(file, _)| (file.clone(), Signature::at(file))).collect();
        if self.signature != signature || self.beside != beside {
            let outcome = self.outcome.take();
            *self = Seen { beside, outcome, ..Seen::new(signature) };
        }
    }

    /// Returns the outcome, where it still holds.
    fn known(&self) -> Option<&Outcome> {
        let outcome = self.outcome.as_ref().filter(|_| self.current)?;
        // The thing it was refused for may be there now, without a change of the file.
        let is_mended = match outcome {
            Err(fault) => {
                matches!(fault.root(), Fault::MissingLibrary { name } if libraries::is_available(name))
            }
            Ok(_) => false,
        };
        (!is_mended).then_some(outcome)
    }

    /// Tells whether neither the file nor one beside it is still being written.
    fn is_settled(&self, file: &Path, settle: impl Fn(&Path) -> Duration) -> bool {
        let is_settled = |file: &Path, signature: &Signature| {
            let settle = settle(file);
            age(signature) >= settle || self.since.elapsed() >= settle
        };
        let mut others = self.beside.iter().filter_map(|(file, signature)| Some((file, signature.as_ref()?)));
        is_settled(file, &self.signature) && others.all(|(file, signature)| is_settled(file, signature))
    }

    /// Reads the file and keeps the outcome: the former one where nothing of the plugin changed.
    fn read(&mut self, read: impl FnOnce(&mut Beside) -> Outcome) -> Look {
        let mut beside = Vec::new();
        let mut outcome = read(&mut beside);
        if let Err(fault) = &outcome
            && matches!(fault.root(), Fault::ChangedWhileRead | Fault::Shortage { .. })
        {
            self.since = Instant::now();
            return Look::Unsettled(self.outcome.clone());
        }
        self.beside = beside;
        if let (Ok(new), Some(Ok(old))) = (&outcome, &self.outcome)
            && new.hash == old.hash
            && new.warnings == old.warnings
        {
            outcome = Ok(old.clone());
        }
        self.outcome = Some(outcome.clone());
        self.current = true;
        Look::Outcome(outcome)
    }
}

/// Tells whether a name means a file or its plugin; an empty name means every one.
pub(crate) fn is_called(name: &str, file: &Path, plugin: Option<&str>) -> bool {
    name.is_empty() || plugin == Some(name) || file.file_name().is_some_and(|own| own == name)
}

type Outcome = Result<Arc<ListedPlugin>, Fault>;

enum Look {
    Outcome(Outcome),
    Unsettled(Option<Outcome>),
    Gone,
}

fn look_into(dir: &PluginDir, name: &OsStr, file: &Path, trust: &Trust, looked_for: &mut Beside) -> Outcome {
    let read = dir.read(name, trust, SIZE_LIMIT)?;
    let mut beside = |name: &str, room| {
        let library = file.with_file_name(name);
        let signature = Signature::at(&library);
        looked_for.push((library, signature));
        dir.read(name.as_ref(), trust, room)
    };
    let facts = inspect::inspect_bytes(&read.bytes, &mut beside)?;
    let plugin = ListedPlugin::new(file, read, facts);
    plugin.warnings.iter().for_each(|warning| log::warn!("plugin {}: {warning}", file.display()));
    Ok(Arc::new(plugin))
}

/// Leaves out the libraries that plugins bring: they are no plugins themselves.
fn leave_out_brought(findings: &mut Vec<Finding>) {
    let plugins = findings.iter().filter_map(|finding| finding.outcome.as_ref().ok());
    let brought = |plugin: &Arc<ListedPlugin>| -> Vec<PathBuf> {
        plugin.brought.iter().map(|name| plugin.file.with_file_name(name)).collect()
    };
    let brought: BTreeSet<PathBuf> = plugins.flat_map(brought).collect();
    findings.retain(|f| !(matches!(f.outcome, Err(Fault::NoNote)) && brought.contains(&f.file)));
}

/// Time since the last write by the clock of this machine; zero when that lies in the future.
fn age(signature: &Signature) -> Duration {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as i128);
    Duration::from_nanos(u64::try_from(now - signature.modified_ns).unwrap_or(0))
}
