//! Classes from plugin files: the loader's store in the model's words.
//!
//! Invariant: a class is created only from the very file content that was reported to the graph (same hash):
//! the listed file, or code that is in the process still after another file took its place.

use std::collections::HashMap;
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_lcm_api::PluginInfo;
use trocar_loader::convert;
use trocar_loader::{Hash, ListedPlugin, PluginEntry, PluginError, PluginStore};
use trocar_model::{ClassInfo, Name, Programs, Refusal};
use trocar_plugin_api::manifest::Manifest;

use super::boundary;
use super::boundary::LoadedClass;
use super::classes::Classes;

/// Classes of one file, or the reason why they cannot be used.
type Converted = Result<Vec<Arc<ClassInfo>>, String>;

/// A plugin store as a source of classes.
pub struct StoreClasses {
    process: Name,
    store: Arc<PluginStore>,
    converted: Mutex<HashMap<Hash, Arc<Converted>>>,
}

impl StoreClasses {
    pub fn new(process: Name, store: Arc<PluginStore>) -> Arc<StoreClasses> {
        Arc::new(StoreClasses { process, store, converted: Mutex::new(HashMap::new()) })
    }

    fn converted(&self, hash: Hash, manifest: &Manifest) -> Arc<Converted> {
        let mut known = self.converted.lock();
        let converted = || Arc::new(convert::classes(manifest, &hash.to_string()));
        known.entry(hash).or_insert_with(converted).clone()
    }

    fn classes_of(&self, plugin: &ListedPlugin) -> Arc<Converted> {
        self.converted(plugin.hash, &plugin.manifest)
    }

    fn info(&self, entry: &PluginEntry) -> PluginInfo {
        let mut info = PluginInfo {
            process: self.process.to_string(),
            file: entry.file().display().to_string(),
            ..Default::default()
        };
        match entry {
            PluginEntry::Refused { reason, .. } => {
                info.refused_reason = reason.reason().into();
                info.refused = reason.to_string();
            }
            PluginEntry::Listed(plugin) => {
                let manifest = &plugin.manifest;
                info.name = manifest.name.clone();
                info.version = manifest.version.clone();
                info.hash = plugin.hash.to_string();
                info.abi = format!("{}.{}", manifest.abi[0], manifest.abi[1]);
                info.built_with = manifest.built_with.clone();
                info.doc = manifest.doc.clone();
                info.classes = manifest.classes.iter().map(|c| c.name.clone()).collect();
                info.warnings = plugin.warnings.clone();
                info.loaded = self.store.is_loaded(&plugin.hash);
                if let Some(error) = self.store.failure(plugin) {
                    (info.refused_reason, info.refused) = (error.reason().into(), error.to_string());
                }
                if let Err(contradiction) = &*self.classes_of(plugin) {
                    info.refused_reason = "PLUGIN_BAD_FILE".into();
                    info.refused = format!("{}: its manifest contradicts itself: {contradiction}", info.file);
                }
            }
        }
        info
    }
}

impl Classes for StoreClasses {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        let entries = self.store.list();
        let plugins = entries.iter().filter_map(PluginEntry::listed);
        plugins.filter_map(|p| self.classes_of(p).as_ref().clone().ok()).flatten().collect()
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        let full_name = class.full_name();
        let listed = self.store.class(&full_name);
        if let Ok(found) = &listed
            && found.plugin.hash.to_string() == class.hash
        {
            return Ok(boundary::loaded_class(self.store.load(found).map_err(refusal)?));
        }
        let resident = Hash::parse(&class.hash).and_then(|hash| self.store.resident(&full_name, &hash));
        match (resident, listed) {
            (Some(loaded), _) => Ok(boundary::loaded_class(loaded)),
            (None, Err(error)) => Err(refusal(error)),
            (None, Ok(other)) => Err(Refusal::PluginBadFile {
                file: other.plugin.file.display().to_string(),
                text: format!("{full_name} changed on disk while it was being created: ask again"),
            }),
        }
    }

    fn present(&self, name: &str, hash: &str) -> Option<(Arc<ClassInfo>, LoadedClass)> {
        // A look: a link must not wait until a plugin is tried and loaded.
        let hash = Hash::parse(hash).filter(|hash| self.store.is_loaded(hash))?;
        let loaded = self.store.resident(name, &hash)?;
        let classes = self.converted(hash, &loaded.plugin.manifest).as_ref().clone().ok()?;
        let class = classes.into_iter().find(|class| class.full_name() == name)?;
        Some((class, boundary::loaded_class(loaded)))
    }

    fn recheck(&self, name: &str) {
        self.store.recheck(name);
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        self.store.list().iter().map(|entry| self.info(entry)).collect()
    }
}

/// The classes that a process with these plugins would offer.
pub fn offered(plugins: &[PluginEntry], allow_exec: bool) -> Vec<Arc<ClassInfo>> {
    let listed = plugins.iter().filter_map(PluginEntry::listed);
    let classes = |plugin: &Arc<ListedPlugin>| {
        convert::classes(&plugin.manifest, &plugin.hash.to_string()).unwrap_or_default()
    };
    listed.flat_map(classes).map(|class| governed(class, allow_exec)).collect()
}

/// The class as a process offers it that lets its components start programs, or does not.
pub(super) fn governed(class: Arc<ClassInfo>, allow_exec: bool) -> Arc<ClassInfo> {
    match class.programs {
        Programs::Allowed if !allow_exec => {
            Arc::new(ClassInfo { programs: Programs::Refused, ..(*class).clone() })
        }
        _ => class,
    }
}

fn refusal(error: PluginError) -> Refusal {
    let file = error.file().map_or_else(String::new, |f| f.display().to_string());
    let text = error.to_string();
    match error.reason() {
        "PLUGIN_ABI" => Refusal::PluginAbi { file, text },
        "PLUGIN_UNTRUSTED" => Refusal::PluginUntrusted { file, text },
        _ => Refusal::PluginBadFile { file, text },
    }
}
