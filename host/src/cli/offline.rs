//! The processes of a system file as they would be, found out without starting one: their classes, by their
//! plugin directories.
//!
//! Invariant: no byte of a plugin runs, and nothing is kept.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use trocar_model::{Process, ProcessState, SystemGraph, Warnings};

use super::failure::Failure;
use super::hosting;
use crate::lcm;
use crate::loader::{self, AllowList, PluginEntry, Trust};
use crate::system_file::{ProcessSpec, SystemFile, TrustSpec};

/// Processes without components, and the plugin files that would be refused, with why.
pub(super) struct Offline {
    pub(super) graph: SystemGraph,
    pub(super) refused: Vec<String>,
}

impl Offline {
    /// The processes of `file`; relative paths are relative to `base`, `given` are plugin directories instead
    /// of the file's.
    ///
    /// # Errors
    /// A plugin directory, or a list of hashes, that cannot be read.
    pub(super) fn of(file: &SystemFile, base: &Path, given: &[PathBuf]) -> Result<Offline, Failure> {
        let mut offline = Offline {
            graph: SystemGraph { next_connection: 1, ..SystemGraph::default() },
            refused: Vec::new(),
        };
        let mut looked: HashMap<Vec<PathBuf>, Arc<Vec<PluginEntry>>> = HashMap::new();
        for spec in &file.processes {
            let dirs = hosting::plugins_of(spec, base, given.to_vec());
            let plugins = match (looked.get(&dirs), &spec.trust) {
                (Some(known), TrustSpec::Dev) => known.clone(),
                _ => {
                    let trust = trust(spec, base)?;
                    let found = loader::look(&dirs, &trust).map_err(crate::host::HostError::Store)?;
                    offline.refused.extend(found.iter().filter_map(refused));
                    let found = Arc::new(found);
                    if matches!(trust, Trust::Dev) {
                        looked.insert(dirs, found.clone());
                    }
                    found
                }
            };
            let process = process(lcm::offered(&plugins, spec.allow_exec));
            offline.graph.processes.insert(spec.name.clone(), process);
        }
        offline.refused.sort();
        offline.refused.dedup();
        Ok(offline)
    }
}

pub(super) fn trust(spec: &ProcessSpec, base: &Path) -> Result<Trust, Failure> {
    Ok(match &spec.trust {
        TrustSpec::Dev => Trust::Dev,
        TrustSpec::AllowList(list) => {
            let list = AllowList::read(&base.join(list)).map_err(crate::host::HostError::Store)?;
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
