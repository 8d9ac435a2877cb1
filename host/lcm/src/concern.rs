//! The warnings of a process about itself.
//!
//! Invariant: there is at most one of each concern, and the order of concerns is the order in which they are told.

use std::collections::BTreeMap;

use trocar_model::Warnings;

/// A process can be warned of these about itself; in the order in which that is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Concern {
    Memory,
    /// The machine gives none.
    Threads,
    /// Makes it unfit, as the next one does.
    Files,
    /// Some that it listens at, or watches files with, were closed.
    Descriptors,
    /// A thread of the host broke down.
    Broken,
}

/// As it is told.
pub(super) fn told(of: &BTreeMap<Concern, String>) -> Warnings {
    Warnings { sentences: of.values().cloned().collect(), unfit: of.keys().any(|of| *of >= Concern::Files) }
}
