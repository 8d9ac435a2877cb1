//! The Global Component Manager: owns the system graph, carries out plans, knows the processes.
//!
//! Invariant: only [`Gcm`] changes the graph; no lock that Stop needs is held while an LCM is asked.

mod apart;
mod audit;
mod awaiting;
mod away;
mod claims;
mod execute;
mod far;
mod fate;
mod generated;
mod guests;
mod holds;
mod ids;
mod lines;
mod manager;
mod observed;
mod phases;
mod requests;
mod restore;
mod sessions;
mod stop;
mod system;
mod text;
mod wanted;

#[cfg(test)]
pub(crate) mod fake;
#[cfg(test)]
mod tests;

pub use apart::{Apart, Supervising, Supervisor, Wanted};
pub use awaiting::Listening;
pub use execute::{ExecuteOptions, Executed};
pub use fate::{Fate, Told};
pub use guests::{Guest, Joined, Requirement};
pub use holds::Held;
pub use ids::IdsError;
pub use lines::Lines;
pub(crate) use manager::given_ns;
pub use manager::{Gcm, GcmConfig};
pub(crate) use observed::observe;
pub use sessions::{Registered, Registration, Slice};
pub(crate) use text::{asked, lines as plan_lines};
