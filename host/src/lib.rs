//! The trocar host as a library: everything that does I/O.
//!
//! Invariant: calls go downward only, `cli → control → gcm → lcm → loader → rt`; answers are return values, news are events.

pub mod cli;
pub mod control;
pub mod gcm;
pub mod host;
pub mod lcm;
pub mod loader;
pub mod system_file;
