//! The processes of a system file as they would be, found out without starting one: their classes, by their
//! plugin directories.
//!
//! Invariant: no byte of a plugin runs, and nothing is kept.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use trocar_loader::{self as loader, AllowList, PluginEntry, Trust};
use trocar_model::{Process, ProcessState, SystemGraph, Warnings};

use super::failure::Failure;
use super::hosting;
use trocar::host::HostError;
use trocar::lcm;
use trocar::system_file::{Draft, ProcessSpec, TrustSpec};

/// Processes without components, and the plugin files that would be refused, with why.
pub(super) struct Offline {
    pub(super) graph: SystemGraph,
    pub(super) refused: Vec<String>,
}

impl Offline {
    /// The processes of `draft`; relative paths are relative to `base`, `given` are plugin directories
    /// instead of the file's. A directory of the file, or a list of hashes, that cannot be read is
    /// noted in the draft.
    ///
    /// # Errors
    /// A plugin directory that is not the file's cannot be read.
    pub(super) fn of(draft: &mut Draft, base: &Path, given: &[PathBuf]) -> Result<Offline, Failure> {
        let mut offline = Offline {
            graph: SystemGraph { next_connection: 1, ..SystemGraph::default() },
            refused: Vec::new(),
        };
        let mut looked: HashMap<Vec<PathBuf>, Arc<Vec<PluginEntry>>> = HashMap::new();
        for spec in draft.file().processes.clone() {
            let Some((dirs, trust)) = sources(draft, &spec, base, given) else {
                offline.graph.processes.insert(spec.name, process(Vec::new()));
                continue;
            };
            let plugins = match (looked.get(&dirs), &trust) {
                (Some(known), Trust::Dev) => known.clone(),
                _ => {
                    let found = loader::look(&dirs, &trust).map_err(HostError::Store)?;
                    offline.refused.extend(found.iter().filter_map(refused));
                    let found = Arc::new(found);
                    if matches!(trust, Trust::Dev) {
                        looked.insert(dirs, found.clone());
                    }
                    found
                }
            };
            let process = process(lcm::offered(&plugins, spec.allow_exec));
            offline.graph.processes.insert(spec.name, process);
        }
        offline.refused.sort();
        offline.refused.dedup();
        Ok(offline)
    }
}

/// The directories that the classes of a process come from, as far as they are there, and which files are
/// taken; `None` where the file does not say it.
fn sources(
    draft: &mut Draft,
    spec: &ProcessSpec,
    base: &Path,
    given: &[PathBuf],
) -> Option<(Vec<PathBuf>, Trust)> {
    if draft.has_no_classes(&spec.name) {
        return None;
    }
    let mut note = |part: &str, failure: Failure| {
        draft.without_classes(&spec.name, part, failure.message, failure.help);
    };
    let mut dirs = hosting::plugins_of(spec, base, given.to_vec());
    if given.is_empty() && !spec.plugins.is_empty() {
        let mut number = 0..;
        dirs.retain(|dir| {
            let number = number.next().unwrap_or_default();
            let looked = loader::check_dir(dir).map_err(HostError::Store);
            looked.map_err(|e| note(&format!("plugins/{number}"), e.into())).is_ok()
        });
    }
    let trust = trust(spec, base).map_err(|failure| note("trust", failure)).ok()?;
    Some((dirs, trust))
}

pub(super) fn trust(spec: &ProcessSpec, base: &Path) -> Result<Trust, Failure> {
    Ok(match &spec.trust {
        TrustSpec::Dev => Trust::Dev,
        TrustSpec::AllowList(list) => {
            let list = AllowList::read(&base.join(list)).map_err(HostError::Store)?;
            Trust::AllowList(list)
        }
    })
}

fn refused(entry: &PluginEntry) -> Option<String> {
    match entry {
        PluginEntry::Refused { reason, .. } => Some(reason.to_string()),
        PluginEntry::Listed(_) => None,
    }
}

fn process(classes: Vec<Arc<trocar_model::ClassInfo>>) -> Process {
    Process {
        epoch: 1,
        state: ProcessState::Attached,
        endpoint: String::new(),
        pid: 0,
        classes,
        last_exit: String::new(),
        restarts: 0,
        warnings: Warnings::default(),
        guest: String::new(),
    }
}
