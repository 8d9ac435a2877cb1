//! Plugins that are linked into the program: a manifest and an entry, no file.
//!
//! Invariant: the same checks of manifest and entry as for a file, in the same order; the only difference is
//! that nothing is opened, so there is nothing to trust, to cache or to try out in a child process first.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_plugin_api::abi::{ClassTable, HOST_LINKED, StaticPlugin};
use trocar_plugin_api::manifest::Manifest;

use super::host_table::LogFn;
use super::load::settle_in;
use super::table::check_table;
use super::{Fault, manifest};

/// A plugin of this very program, ready to use.
pub struct LinkedPlugin {
    pub manifest: Manifest,
    classes: Vec<&'static ClassTable>,
}

// SAFETY: the tables are immutable statics of the program, and their entries may be called from any thread
// under the rules of the contract, which the LCM keeps.
unsafe impl Send for LinkedPlugin {}
// SAFETY: as above.
unsafe impl Sync for LinkedPlugin {}

impl std::fmt::Debug for LinkedPlugin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {} (linked in)", self.manifest.name, self.manifest.version)
    }
}

/// Plugins linked already, by the address of their table: several hosts may live in one program, and `init`
/// is called once.
static LINKED: Mutex<BTreeMap<usize, Arc<LinkedPlugin>>> = Mutex::new(BTreeMap::new());

impl LinkedPlugin {
    /// Checks manifest and entry and calls the plugin's `init`, once in the life of the program.
    ///
    /// # Errors
    /// The manifest is not understood, contradicts the entry, or `init` failed.
    pub fn link(plugin: &StaticPlugin, log: LogFn) -> Result<Arc<LinkedPlugin>, Fault> {
        let manifest = manifest::read(plugin.manifest.as_bytes())?;
        // SAFETY: an entry takes nothing and returns a table that lives as long as the program.
        let table = unsafe { (plugin.entry)() };
        // SAFETY: what the entry returned is a table or null, and is checked before it is read.
        let classes =
            unsafe { check_table(table, &manifest) }.map_err(|what| Fault::EntryDiffers { what })?;
        let mut linked = LINKED.lock();
        if let Some(known) = linked.get(&table.addr()) {
            return Ok(known.clone());
        }
        // SAFETY: just checked; statics of the program; guarded by `LINKED` against a second call.
        let classes = unsafe { settle_in(table, &classes, &manifest.name, log, HOST_LINKED) }?;
        let new = Arc::new(LinkedPlugin { manifest, classes });
        linked.insert(table.addr(), new.clone());
        Ok(new)
    }

    /// The table of a class, by its position in the manifest.
    pub fn table(&self, index: usize) -> Option<&'static ClassTable> {
        self.classes.get(index).copied()
    }
}
