//! Sources of a host's classes: plugins linked into the program, plugin files, or both.
//!
//! Invariant: a host that watches no directory touches no plugin file. One that watches a directory knows,
//! before it starts, the program that tries the files out.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use trocar_loader::{PluginStore, PluginStoreConfig};

use super::{HostConfig, HostError, StateDir};
use crate::lcm::{Classes, StaticClasses, StoreClasses};

/// A host's classes, and the store behind those of files.
pub(super) struct Sources {
    /// `None`: it has no class at all.
    pub(super) classes: Option<Arc<dyn Classes>>,
    pub(super) store: Option<Arc<PluginStore>>,
}

pub(super) fn open(config: &HostConfig, state: &StateDir) -> Result<Sources, HostError> {
    let linked = StaticClasses::new(config.name.clone(), &config.linked)
        .map_err(|because| HostError::Linked { because })?;
    if config.plugins.is_empty() {
        let classes = (!config.linked.is_empty()).then(|| Arc::new(linked) as Arc<dyn Classes>);
        return Ok(Sources { classes, store: None });
    }
    let store = open_store(config, state)?;
    let files = StoreClasses::new(config.name.clone(), store.clone());
    let classes = if config.linked.is_empty() { files } else { linked.and(files) };
    Ok(Sources { classes: Some(classes), store: Some(store) })
}

fn open_store(config: &HostConfig, state: &StateDir) -> Result<Arc<PluginStore>, HostError> {
    let program = vetting_program(config.vet_with.as_deref())?;
    // Absolute paths: a reader of them, such as that of a saved system, may be elsewhere.
    let whole = |dir: &PathBuf| std::path::absolute(dir).unwrap_or_else(|_| dir.clone());
    let dirs = config.plugins.iter().map(whole).collect();
    let mut store = PluginStoreConfig::new(dirs, state.path().to_owned(), program);
    store.trust = config.trust.clone();
    store.log = crate::lcm::plugin_log;
    Ok(PluginStore::open(store)?)
}

/// Returns the program that knows how to try out a plugin file. A program that embeds a host does not: it
/// would be started anew.
fn vetting_program(asked: Option<&Path>) -> Result<PathBuf, HostError> {
    if let Some(program) = asked {
        return match program.is_file() || program.as_os_str().as_encoded_bytes().ends_with(b" (deleted)") {
            true => Ok(program.to_owned()),
            false => Err(HostError::NoVetting { tried: vec![program.to_owned()] }),
        };
    }
    let own = std::env::current_exe().map_err(|e| HostError::Threads { because: e.to_string() })?;
    if own.file_name().is_some_and(|name| name == PROGRAM) {
        return Ok(own);
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    let beside = own.parent().map(Path::to_owned);
    let tried: Vec<PathBuf> =
        beside.into_iter().chain(std::env::split_paths(&path)).map(|dir| dir.join(PROGRAM)).collect();
    match tried.iter().find(|program| program.is_file()) {
        Some(found) => Ok(found.clone()),
        None => Err(HostError::NoVetting { tried }),
    }
}

const PROGRAM: &str = "trocar";

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_vetting_program_that_is_not_there_is_named() {
        let refused = vetting_program(Some(Path::new("/nowhere/trocar"))).unwrap_err();
        assert_eq!(refused.reason(), "NO_VETTING");
        assert!(refused.to_string().contains("/nowhere/trocar"), "{refused}");
    }

    #[test]
    fn a_vetting_program_that_was_named_is_taken() {
        let own = std::env::current_exe().unwrap();
        assert_eq!(vetting_program(Some(&own)).unwrap(), own);
    }
}
