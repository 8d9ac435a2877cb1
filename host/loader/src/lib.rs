//! The plugin directory → vetted, cached, loaded classes.
//!
//! Invariant: check, then run. No byte of a plugin executes in this process before its file was read once,
//! judged, described by its manifest, and survived in a child process; and nothing but the cache is ever
//! given to the dynamic linker.

mod beside;
mod cache;
mod catalog;
mod child;
mod closing;
#[forbid(unsafe_code)]
pub mod convert;
mod elf;
mod error;
mod file;
mod hash;
mod host_table;
mod inspect;
mod keys;
mod libraries;
mod linked;
mod listed;
mod load;
mod load_fault;
mod manifest;
mod other_threads;
mod resident;
mod scan;
mod store;
#[forbid(unsafe_code)]
pub mod system;
mod table;
#[forbid(unsafe_code)]
pub mod taps;
mod trust;
mod vet;
mod watch;

pub use catalog::{CatalogChange, PluginEntry};
pub use child::vet_main;
pub use error::{Fault, PluginError, Stage, StoreError};
pub use hash::Hash;
pub use host_table::{LogFn, log_to_crate};
pub use inspect::{Inspection, inspect_file};
pub use linked::LinkedPlugin;
pub use listed::{ClassRef, ListedPlugin};
pub use load::{LoadedClass, LoadedPlugin, Loading, Moment, has_loaded_since, moment};
pub use store::{PluginStore, PluginStoreConfig, check_dir, look};
pub use trust::{AllowList, Trust};
pub use vet::{VET_ARG, try_file};
pub use watch::WatchHandle;

#[cfg(test)]
mod tests;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;
