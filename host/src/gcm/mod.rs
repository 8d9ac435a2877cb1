//! The Global Component Manager: owns the system graph, carries out plans, knows the processes.
//!
//! Invariant: only [`Gcm`] changes the graph; no lock that Stop needs is held while an LCM is asked. A file
//! uses its own floor and those below: data, the manager, what drives a change, the verbs and followers.

// Data, which knows no GCM.
mod answer;
mod changes;
mod claims;
mod guest_lcm;
mod history;
mod holds;
mod ids;
mod isolation;
mod journal;
mod lead;
mod ledger;
mod lines;
mod on_return;
mod past;
mod requests;
mod sessions;
mod text;
mod weight;

// The manager, which owns the data.
mod manager;

// The drivers of a change.
mod carrying;
mod heard;
mod observed;
mod one_change;
mod recording;
mod remote;

// Verbs and followers.
mod audit;
mod awaiting_event;
mod awaiting_state;
mod away;
mod execute;
mod fate;
mod follow;
mod generated;
mod guests;
mod holding;
mod isolated;
mod lanes;
mod late;
mod phases;
mod reconcile;
mod register;
mod relink;
mod restore;
mod start;
mod stop;
mod system;

#[cfg(test)]
pub(crate) mod fake;
#[cfg(test)]
mod tests;

pub use answer::{Answer, ExecuteOptions, Executed};
pub use awaiting_event::Listening;
pub(crate) use awaiting_state::given_ns;
pub(crate) use changes::{id_of, is_so};
pub use fate::{Fate, Told};
pub use guests::{Guest, Joined, Requirement};
pub(crate) use history::History;
pub use holding::Held;
pub use isolated::{Supervising, Supervisor};
pub use isolation::{Isolated, Orders};
pub use journal::{Asked, Loaded, Record, Remembered, Snapshot, Store, StoreError, Unusable};
pub use lead::Lead;
pub use ledger::Standing;
pub use lines::Lines;
pub use manager::Gcm;
pub(crate) use observed::observe;
pub use recording::Recording;
pub use sessions::{Registered, Registration, Slice};
pub use start::{GcmConfig, StartError};
pub(crate) use text::asked;
pub use text::lines as plan_lines;
