//! The journal of a GCM, in one file or in etcd: what was decided, by whom, and what became of it.
//!
//! Invariant: the store alone says what was decided: each record holds the hash of the one before it, and
//! what cannot be read whole is refused as it is, never guessed.

mod aside;
mod chain;
mod codec;
mod contents;
mod copy;
mod disk;
mod etcd;
mod fault;
mod frame;
mod json;
mod lines;
mod opening;
mod store;
mod view;

#[cfg(test)]
mod tests;

pub use aside::{is_aside, put_aside};
pub use chain::Hash;
pub use etcd::{Campaign, Candidate, EtcdPlace, EtcdStore, Leader, PlaceError, Tenure, Won, host_and_port};
pub use fault::Fault;
pub use frame::{Identity, Kept};
pub use json::json;
pub use lines::{lines, time};
pub use store::RedbStore;
pub use view::{Verified, View};

/// Name of the file in the directory of a journal.
pub const FILE: &str = "journal.redb";
/// Schema of the records and snapshots that this release writes, and the greatest it reads.
pub const SCHEMA: u32 = 1;
