//! A host process as a value: state directory, plugins, LCM, GCM (or the way to one), and the gRPC port.
//!
//! Invariant: what starts last stops first, except that devices are made safe before anything else ends.

mod agent;
pub mod announce;
mod builder;
mod candidacy;
mod client;
mod config;
mod ending;
mod error;
mod files;
mod machines;
mod memory;
mod process;
mod signals;
mod sources;
mod state_dir;
mod takeover;
mod threads;

pub use agent::AgentHost;
pub use builder::HostBuilder;
pub use candidacy::Among;
pub use config::HostConfig;
pub use error::HostError;
pub use machines::Machines;
pub use memory::MemoryBounds;
pub use process::Host;
pub use signals::{StopRequest, say_to_keeper};
pub use state_dir::{StateChoice, StateDir};
pub use takeover::Predecessor;

pub use crate::runtime_dir::state_home;

pub use crate::control::{PortRules, Viewer};
