//! A class whose code is mapped into this process.
//!
//! Invariant: table and code live as long as the `LoadedClass` that is kept beside each instance.

use std::any::Any;
use std::sync::Arc;

use trocar_plugin_api::abi::ClassTable;

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

    pub(crate) fn table(&self) -> *const ClassTable {
        self.table
    }
}

/// A class of the loader as the LCM keeps it.
pub(crate) fn loaded_class(class: trocar_loader::LoadedClass) -> LoadedClass {
    let table = std::ptr::from_ref(class.table);
    // SAFETY: the loader checked the table; the plugin, kept beside it, stays mapped for the life of the
    // process.
    unsafe { LoadedClass::new(table, class.plugin) }
}

/// A class of a plugin linked into this program, by its position in the manifest.
pub(crate) fn linked_class(
    plugin: &std::sync::Arc<trocar_loader::LinkedPlugin>,
    index: usize,
) -> Option<LoadedClass> {
    let table = std::ptr::from_ref(plugin.table(index)?);
    // SAFETY: the loader checked the table, a static of this program.
    Some(unsafe { LoadedClass::new(table, plugin.clone()) })
}
