//! The Local Component Manager: the only owner of this process's components.
//!
//! Invariant: it never runs component code on its own threads and shares no lock with one that does.

mod api;
mod boundary;
mod classes;
mod connect;
mod context;
pub mod convert;
mod executor;
mod external;
mod gate;
mod hub;
mod inbox;
mod instance;
mod lifecycle;
mod local;
mod logs;
mod order;
mod store;
mod system;

pub use api::*;
pub use boundary::{LoadedClass, plugin_log};
pub use classes::Classes;
pub use local::{LcmConfig, LocalLcm};
pub use store::StoreClasses;
