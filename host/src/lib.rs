//! The trocar host as a library: all I/O but that of the components of one process. The program is the crate
//! `trocar-cli`.
//!
//! Invariant: calls go downward only, `control → gcm → lcm → loader → rt`; answers are return values,
//! news are events.
#![forbid(unsafe_code)]

pub mod agent;
pub mod control;
pub mod doctor;
pub mod gcm;
pub mod host;
pub mod journal;
pub mod processes;
pub mod runtime_dir;
pub mod system_file;
#[cfg(test)]
#[path = "../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;

/// Components of one process, and what can be asked of the manager that owns them.
pub use trocar_lcm as lcm;
/// Plugin files, for programs that look into one without a host.
pub use trocar_loader as loader;
/// Names, states, requests and refusals: what the methods of [`Host`] take and answer.
pub use trocar_model as model;
pub use trocar_plugin_api::abi::StaticPlugin;

pub use host::{Host, HostBuilder, MemoryBounds};
