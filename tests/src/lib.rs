//! The harness of the outer tests: built hosts as child processes, real grpcurl, a world of its own for each
//! test.
//!
//! Invariant: a test owns all it touches (port 0, temporary directories, children killed by their handle) and
//! waits only through [`eventually`].
#![forbid(unsafe_code)]

mod advice;
mod built;
mod cli;
pub mod conformance;
mod cycles;
mod damage;
mod etcd;
mod eventually;
mod grpcurl;
mod host;
mod identity;
mod skip;
mod system;
mod watchdog;
mod world;

pub use advice::Told;
pub use built::{Built, repository};
pub use cli::{Output, Trocar};
pub use cycles::Bystander;
pub use damage::{flip_bit, replace_in};
pub use etcd::EtcdCluster;
pub use eventually::eventually;
pub use grpcurl::{Failure, Grpcurl, Stream};
pub use host::HostProcess;
pub use identity::issue_host;
pub use skip::skip;
pub use system::number;
pub use watchdog::Watchdog;
pub use world::World;
