//! Lets the processes of one machine find each other, make sure of each other, and notice that the other one
//! is gone.
//!
//! A session is a socket and a page of memory between two processes. What is said over it (and the memory
//! passed along) is the business of its user; data never goes over the socket. Invariant: a session that was
//! given up stays given up; a process that comes back, or goes on after it was thought dead, gets a new one.

#![forbid(unsafe_code)]

mod address;
mod asked;
mod card;
mod door;
mod greeting;
mod handler;
mod links;
mod live;
mod plain;
mod serve;
mod session;
mod socket;
mod steps;
#[cfg(test)]
mod tests;
mod watch;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;

pub use address::is_gone;
pub use card::{Card, LAYOUT, Unreachable};
pub use door::Seldom;
pub use handler::Handler;
pub use links::Links;
pub use session::{Lost, Message, Peer, SendError, Session};
pub use socket::{MOST_BYTES, MOST_FDS};
