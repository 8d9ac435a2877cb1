//! The cases, by what they are about.
//!
//! Invariant: each takes a way and nothing else, and owns its lab.

pub mod changing;
pub mod commands;
pub mod configuring;
pub mod events;
pub mod frames;
pub mod lifecycle;
pub mod loss;
pub mod outcomes;
pub mod payloads;
pub mod rows;
pub mod streams;
pub mod taps;
pub mod untyped;

use trocar::model::{Execution, ExecutionModel};

/// A thread of its own, for components beside client and server.
pub(super) fn own_thread() -> Execution {
    Execution { model: Some(ExecutionModel::OnSignal), ..Execution::default() }
}

/// The head of a stream.
fn stream() -> Execution {
    Execution { model: Some(ExecutionModel::Stream), ..Execution::default() }
}
