//! Connections to components of other processes, of this machine and of others.
//!
//! One end of such a connection is a [`Half`]: it exists as long as the GCM wants the connection, and is
//! linked to the other one while both processes live. Invariant: halves are changed by one thread,
//! `trocar-remote`; any thread that notices the loss of a process notes it at once, and `trocar-remote` does
//! the rest.

mod asks;
mod client;
mod face;
mod half;
mod lines;
mod linking;
mod manager;
mod medium;
mod memory;
mod missed;
mod near;
mod pools;
mod same_class;
mod server;
mod serving;
mod stand_in;
mod terms;
mod todo;
mod words;

pub(super) use half::Half;
pub use lines::Afar;
pub(super) use lines::NAME as NET;
pub(super) use manager::Remote;
pub(super) use memory::NAME;
pub(super) use near::Near;
