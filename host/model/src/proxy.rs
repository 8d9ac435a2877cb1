//! A connection between two processes as each of them keeps it: its end there, with a stand-in for the other
//! end.
//!
//! Invariant: proxies are what the LCMs last told; nothing is decided by them alone, and one without a
//! connection is not shown.

use crate::Name;

/// One half of a connection between two processes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proxy {
    /// The process whose LCM has it.
    pub process: Name,
    /// Number of the link to the other half: another one each time they are linked; 0 = they are not.
    pub epoch: u64,
    /// Why they are not linked; empty when they are.
    pub why: String,
    /// Carrier of the data, "memfd" or "net".
    pub carrier: String,
    /// Instance of the other process for which it was made, as its card says; empty where nobody told.
    pub peer: String,
}

impl Proxy {
    pub fn is_linked(&self) -> bool {
        self.epoch > 0
    }
}
