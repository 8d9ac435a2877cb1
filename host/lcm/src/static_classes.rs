//! Classes linked into the program, alone or together with those of plugin files.
//!
//! Invariant: a linked class has the hash ""; a file that offers a plugin of the same name as a linked one is
//! shown as refused, so a name never means two things.

use std::sync::Arc;

use trocar_lcm_api::PluginInfo;
use trocar_loader::LinkedPlugin;
use trocar_loader::convert;
use trocar_model::{ClassInfo, Name, Refusal};
use trocar_plugin_api::abi::StaticPlugin;

use super::boundary::{self, LoadedClass};
use super::classes::Classes;

/// Stands in place of the path of a plugin's file.
pub const LINKED_IN: &str = "(linked in)";

/// Plugins linked into this program as a source of classes.
pub struct StaticClasses {
    process: Name,
    plugins: Vec<Linked>,
}

struct Linked {
    plugin: Arc<LinkedPlugin>,
    classes: Vec<Arc<ClassInfo>>,
}

impl StaticClasses {
    /// Checks every plugin and calls its `init`.
    ///
    /// # Errors
    /// A sentence that names the plugin and what is wrong with it.
    pub fn new(process: Name, plugins: &[StaticPlugin]) -> Result<StaticClasses, String> {
        let mut linked: Vec<Linked> = Vec::with_capacity(plugins.len());
        for (i, plugin) in plugins.iter().enumerate() {
            let plugin = LinkedPlugin::link(plugin, super::plugin_log)
                .map_err(|fault| format!("plugin {} of those linked in: {fault}", i + 1))?;
            let name = &plugin.manifest.name;
            if linked.iter().any(|other| other.plugin.manifest.name == *name) {
                return Err(format!("plugin {name} is linked in twice: name it once"));
            }
            let classes = convert::classes(&plugin.manifest, "")
                .map_err(|e| format!("plugin {name}: its manifest contradicts itself: {e}"))?;
            linked.push(Linked { plugin, classes });
        }
        Ok(StaticClasses { process, plugins: linked })
    }

    /// Adds the classes of files whose plugin has another name.
    pub fn and(self, files: Arc<dyn Classes>) -> Arc<dyn Classes> {
        Arc::new(Both { linked: self, files })
    }

    fn has(&self, plugin: &str) -> bool {
        self.plugins.iter().any(|l| l.plugin.manifest.name == plugin)
    }

    fn info(&self, linked: &Linked) -> PluginInfo {
        let manifest = &linked.plugin.manifest;
        PluginInfo {
            process: self.process.to_string(),
            file: LINKED_IN.into(),
            name: manifest.name.clone(),
            version: manifest.version.clone(),
            abi: format!("{}.{}", manifest.abi[0], manifest.abi[1]),
            built_with: manifest.built_with.clone(),
            doc: manifest.doc.clone(),
            classes: manifest.classes.iter().map(|c| c.name.clone()).collect(),
            loaded: true,
            ..PluginInfo::default()
        }
    }
}

impl Classes for StaticClasses {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        self.plugins.iter().flat_map(|l| l.classes.iter().cloned()).collect()
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        let plugin = self.plugins.iter().find(|l| l.plugin.manifest.name == class.plugin);
        let found = plugin.and_then(|l| {
            let index = l.classes.iter().position(|c| c.name == class.name)?;
            boundary::linked_class(&l.plugin, index)
        });
        found.ok_or_else(|| Refusal::ClassNotFound {
            process: self.process.clone(),
            class: class.full_name(),
            known: self.catalog().iter().map(|c| c.full_name()).collect(),
            elsewhere: Vec::new(),
            ambiguous: Vec::new(),
        })
    }

    fn present(&self, name: &str, hash: &str) -> Option<(Arc<ClassInfo>, LoadedClass)> {
        let classes = self.plugins.iter().flat_map(|linked| &linked.classes);
        let class = classes.into_iter().find(|class| hash.is_empty() && class.full_name() == name)?;
        Some((class.clone(), self.load(class).ok()?))
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        self.plugins.iter().map(|l| self.info(l)).collect()
    }
}

/// Linked classes before those of files.
struct Both {
    linked: StaticClasses,
    files: Arc<dyn Classes>,
}

impl Classes for Both {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        let mut all = self.linked.catalog();
        all.extend(self.files.catalog().into_iter().filter(|c| !self.linked.has(&c.plugin)));
        all
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        if class.hash.is_empty() { self.linked.load(class) } else { self.files.load(class) }
    }

    fn present(&self, name: &str, hash: &str) -> Option<(Arc<ClassInfo>, LoadedClass)> {
        if hash.is_empty() { self.linked.present(name, hash) } else { self.files.present(name, hash) }
    }

    fn recheck(&self, name: &str) {
        self.files.recheck(name);
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        let mut all = self.linked.plugins();
        all.extend(self.files.plugins().into_iter().map(|mut info| {
            if info.refused.is_empty() && self.linked.has(&info.name) {
                info.refused_reason = "PLUGIN_BAD_FILE".into();
                info.refused = format!(
                    "{}: plugin {} is linked into the program already: take the file out of the directory",
                    info.file, info.name
                );
            }
            info
        }));
        all
    }
}
