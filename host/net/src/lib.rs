//! Machines and people of one system know each other by this: a system's own authority, the certificates it
//! issues, what each of them stands for, and connections on which both sides have shown theirs.
//!
//! Everything here is TLS 1.3 with certificates of one authority on both sides. Invariant: a connection
//! exists only with a peer whose certificate that authority has issued, that is valid now and was not
//! revoked; what the peer is, its certificate alone says.

#![forbid(unsafe_code)]

mod authority;
mod files;
mod holder;
mod identity;
pub mod line;
mod revoked;
mod role;
#[cfg(test)]
mod tests;
mod tls;

pub use authority::{Authority, AuthorityError, Issued, Wish};
pub use holder::Holder;
pub use identity::{Identity, IdentityError};
pub use revoked::Revoked;
pub use role::Role;
pub use tls::{Client, Server, said};
