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
