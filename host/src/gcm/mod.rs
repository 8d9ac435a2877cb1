//! The Global Component Manager: owns the system graph, carries out plans, knows the processes.
//!
//! Invariant: only [`Gcm`] changes the graph; no lock that Stop needs is held while an LCM is asked.

mod ids;
mod manager;
mod requests;

pub use ids::IdsError;
pub use manager::{ExecuteOptions, Executed, Gcm, GcmConfig, Registered, Registration};
