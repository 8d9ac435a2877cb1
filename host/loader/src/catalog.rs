//! Turns the findings of the directories into the list, and tells the changes since the last look.
//!
//! Invariant: pure. Equal findings give equal entries and no change, however often files were touched; of two
//! files with one plugin name the one listed before stays.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::Arc;

use super::{Fault, ListedPlugin, PluginError};

/// One plugin file, usable or not.
#[derive(Clone, Debug)]
pub enum PluginEntry {
    Listed(Arc<ListedPlugin>),
    Refused {
        file: PathBuf,
        reason: PluginError,
        /// The plugin name, when the manifest could be read.
        plugin: Option<String>,
    },
}

/// News for the GCM and its watchers.
#[derive(Clone, Debug)]
pub enum CatalogChange {
    /// Its classes are available now.
    Added(Arc<ListedPlugin>),
    /// A new version of the same plugin is available; running instances keep the old one.
    Updated { old: Arc<ListedPlugin>, new: Arc<ListedPlugin> },
    /// Its classes are no longer available; running instances are not touched.
    Removed(Arc<ListedPlugin>),
    /// A file is refused, or refused for another reason than before.
    Refused { file: PathBuf, reason: PluginError },
}

/// One file and its outcome.
#[derive(Clone, Debug)]
pub(crate) struct Finding {
    pub file: PathBuf,
    pub outcome: Result<Arc<ListedPlugin>, Fault>,
}

impl PluginEntry {
    pub fn file(&self) -> &PathBuf {
        match self {
            PluginEntry::Listed(plugin) => &plugin.file,
            PluginEntry::Refused { file, .. } => file,
        }
    }

    pub fn listed(&self) -> Option<&Arc<ListedPlugin>> {
        match self {
            PluginEntry::Listed(plugin) => Some(plugin),
            PluginEntry::Refused { .. } => None,
        }
    }
}

/// Entries in the order of `found`; `before` decides which of two files with one name is the newcomer.
pub(crate) fn assemble(before: &[PluginEntry], found: Vec<Finding>) -> Vec<PluginEntry> {
    let incumbents: HashMap<&str, &PathBuf> =
        before.iter().filter_map(PluginEntry::listed).map(|p| (p.name(), &p.file)).collect();
    let mut holders: HashMap<String, PathBuf> = HashMap::new();
    for finding in &found {
        let Ok(plugin) = &finding.outcome else { continue };
        let holder = holders.entry(plugin.name().to_string()).or_insert_with(|| finding.file.clone());
        if incumbents.get(plugin.name()) == Some(&&finding.file) {
            holder.clone_from(&finding.file);
        }
    }
    let entry = |Finding { file, outcome }| match outcome {
        Ok(plugin) if holders.get(plugin.name()) == Some(&file) => PluginEntry::Listed(plugin),
        Ok(plugin) => {
            let name = plugin.name().to_string();
            let other = holders.get(&name).cloned().unwrap_or_default();
            let fault = Fault::SameName { plugin: name.clone(), other };
            refused(file, fault, Some(name))
        }
        Err(fault) => refused(file, fault, None),
    };
    found.into_iter().map(entry).collect()
}

fn refused(file: PathBuf, fault: Fault, plugin: Option<String>) -> PluginEntry {
    PluginEntry::Refused { file: file.clone(), reason: PluginError::Refused { file, fault }, plugin }
}

/// Returns the changes a watcher of `before` needs to know `after`: removals first, then the rest in file
/// order.
pub(crate) fn changes(before: &[PluginEntry], after: &[PluginEntry]) -> Vec<CatalogChange> {
    let by_name = |entries: &[PluginEntry]| -> BTreeMap<String, Arc<ListedPlugin>> {
        entries.iter().filter_map(PluginEntry::listed).map(|p| (p.name().to_string(), p.clone())).collect()
    };
    let (old, new) = (by_name(before), by_name(after));
    let mut out: Vec<_> = old
        .iter()
        .filter(|(name, _)| !new.contains_key(*name))
        .map(|(_, plugin)| CatalogChange::Removed(plugin.clone()))
        .collect();
    for entry in after {
        match entry {
            PluginEntry::Listed(plugin) => match old.get(plugin.name()) {
                None => out.push(CatalogChange::Added(plugin.clone())),
                Some(was) if was.hash != plugin.hash => {
                    out.push(CatalogChange::Updated { old: was.clone(), new: plugin.clone() });
                }
                Some(_) => {}
            },
            PluginEntry::Refused { file, reason, .. } => {
                let known = before.iter().any(|e| match e {
                    PluginEntry::Refused { file: f, reason: r, .. } => f == file && r == reason,
                    PluginEntry::Listed(_) => false,
                });
                if !known {
                    out.push(CatalogChange::Refused { file: file.clone(), reason: reason.clone() });
                }
            }
        }
    }
    out
}

#[cfg(test)]
#[path = "catalog_tests.rs"]
mod tests;
