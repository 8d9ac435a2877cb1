//! Where component classes come from: plugin files, or classes linked into the executable.
//!
//! Invariant: a loaded class's table and code live as long as the `LoadedClass` that is kept beside each instance.

use std::any::Any;
use std::sync::Arc;

use trocar_model::{ClassInfo, Refusal};
use trocar_plugin_api::abi::ClassTable;

use super::api::PluginInfo;

/// A source of classes.
pub trait Classes: Send + Sync {
    /// Every class that can be created now.
    fn catalog(&self) -> Vec<Arc<ClassInfo>>;

    /// Makes the class's code callable. Blocks; never on a real-time thread.
    ///
    /// # Errors
    /// PluginAbi, PluginUntrusted, PluginBadFile; ClassNotFound when the file has gone or changed since it was listed.
    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal>;

    /// The files behind the classes, refused ones too.
    fn plugins(&self) -> Vec<PluginInfo>;
}

/// A class whose code is mapped.
#[derive(Clone)]
pub struct LoadedClass {
    table: *const ClassTable,
    _keep: Arc<dyn Any + Send + Sync>,
}

// SAFETY: the table is immutable data of a mapped library (or a static), kept mapped by `_keep`.
unsafe impl Send for LoadedClass {}
// SAFETY: as above.
unsafe impl Sync for LoadedClass {}

impl LoadedClass {
    /// # Safety
    /// `table` is a class table of this ABI major, valid and immutable as long as `keep` lives.
    pub unsafe fn new(table: *const ClassTable, keep: Arc<dyn Any + Send + Sync>) -> Self {
        LoadedClass { table, _keep: keep }
    }

    pub(super) fn table(&self) -> *const ClassTable {
        self.table
    }
}
