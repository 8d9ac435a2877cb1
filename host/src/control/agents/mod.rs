//! Agents of other machines: their service, and the way to it.
//!
//! Invariant: a process is started on another machine by its settings alone, never by a command line.

mod edge;
mod reach;
mod wire;

pub(super) use self::edge::AgentEdge;
pub use self::reach::{Reach, Seen, ToKeep};
