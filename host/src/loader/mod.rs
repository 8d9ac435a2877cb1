//! The plugin directory → vetted, cached, loaded classes.
//!
//! Invariant: check, then run. No byte of a plugin executes in this process before its file was read once, judged, described
//! by its manifest, and survived in a child process; and nothing but the cache is ever given to the dynamic linker.

mod beside;
mod cache;
mod catalog;
mod child;
mod closing;
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
mod manifest;
mod resident;
mod scan;
mod store;
mod table;
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
#[cfg(test)]
pub(crate) use load::Loading;
pub use load::{LoadedClass, LoadedPlugin};
pub(crate) use load::{Moment, has_loaded_since, moment};
pub(crate) use store::check_dir;
pub use store::{PluginStore, PluginStoreConfig, look};
pub use trust::{AllowList, Trust};
pub use vet::{VET_ARG, try_file};
pub use watch::WatchHandle;

#[cfg(test)]
mod tests;
