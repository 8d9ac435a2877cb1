//! Sources of component classes: plugin files, or classes linked into the executable.
//!
//! Invariant: the code that is given has the hash that was asked for: it is the listed file's, or was in the
//! process before.

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
    /// PluginAbi, PluginUntrusted; PluginBadFile, also when the file changed since it was listed, and
    /// ClassNotFound when it is gone, unless the code is in the process already.
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
