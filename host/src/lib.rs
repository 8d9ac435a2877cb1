//! The trocar host as a library: everything that does I/O.
//!
//! Invariant: calls go downward only, `cli → control → gcm → lcm → loader → rt`; answers are return values, news are events.
#![deny(unsafe_code)]

pub mod cli;
pub mod control;
pub mod doctor;
pub mod gcm;
pub mod host;
pub mod lcm;
pub mod processes;
mod runtime_dir;
pub mod system_file;
#[cfg(test)]
#[path = "../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;

/// Plugin files, for programs that look into one without a host.
pub use trocar_loader as loader;
/// Names, states, requests and refusals: what the methods of [`Host`] take and answer.
pub use trocar_model as model;
pub use trocar_plugin_api::abi::StaticPlugin;

pub use host::{Host, HostBuilder, MemoryBounds};
