//! The warnings of a process about itself.
//!
//! Invariant: there is at most one of each concern, and the order of concerns is the order in which they are
//! reported.

use std::collections::BTreeMap;

use trocar_model::Warnings;

/// Warnings of a process about itself, in the order in which they are reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Concern {
    Memory,
    /// The machine gives no more threads.
    Threads,
    /// Makes the process unfit, as the next ones do.
    Files,
    /// Descriptors at which the process listens, or watches files, were closed.
    Descriptors,
    /// A thread of the host broke down.
    Broken,
}

/// The warnings as they are reported.
pub(super) fn told(of: &BTreeMap<Concern, String>) -> Warnings {
    Warnings { sentences: of.values().cloned().collect(), unfit: of.keys().any(|of| *of >= Concern::Files) }
}
