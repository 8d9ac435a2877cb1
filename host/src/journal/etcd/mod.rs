//! The journal of a GCM in etcd, and the lead of one GCM among several: for systems that outlive a machine.
//!
//! Invariant: whatever is written is one transaction that compares the leader's key, so that a GCM that has
//! lost the lead writes nothing. Consensus is etcd's alone.

mod campaign;
mod client;
mod keys;
mod place;
mod reading;
mod store;
mod tenure;
mod writing;

#[cfg(test)]
#[path = "../../../../tests/src/etcd.rs"]
#[allow(unreachable_pub, dead_code, reason = "it is the outer tests', and public there")]
mod server;
#[cfg(test)]
pub(super) mod tests;

pub use campaign::{Campaign, Candidate, Leader, Won};
pub use place::{EtcdPlace, PlaceError, host_and_port};
pub use store::EtcdStore;
pub use tenure::Tenure;
