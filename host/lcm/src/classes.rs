//! Sources of component classes: plugin files, or classes linked into the executable.
//!
//! Invariant: the loaded file is the listed one, by its hash.

use std::sync::Arc;

use trocar_lcm_api::PluginInfo;
use trocar_model::{ClassInfo, Refusal};

use super::boundary::LoadedClass;

/// A source of classes.
pub trait Classes: Send + Sync {
    /// Every class that can be created now.
    fn catalog(&self) -> Vec<Arc<ClassInfo>>;

    /// Makes the class's code callable. Blocks; never on a real-time thread.
    ///
    /// # Errors
    /// PluginAbi, PluginUntrusted, PluginBadFile; ClassNotFound when the file has gone or changed since it
    /// was listed.
    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal>;

    /// The class `plugin/class` of the file with this hash, if its code is in this process already; loads
    /// nothing.
    fn present(&self, _name: &str, _hash: &str) -> Option<(Arc<ClassInfo>, LoadedClass)> {
        None
    }

    /// Looks again at the files of this plugin or file name (empty: at all files), as if nothing was known of
    /// them. Blocks for as long as trying them takes; loaded classes stay.
    fn recheck(&self, _name: &str) {}

    /// The files behind the classes, refused ones too.
    fn plugins(&self) -> Vec<PluginInfo>;
}
