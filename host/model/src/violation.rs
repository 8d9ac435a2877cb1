//! A fault of a configuration: its place and its sentence.

/// One thing that is wrong with a configuration.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Violation {
    /// JSON pointer into the configuration.
    pub pointer: String,
    /// "cutoff_hz: 1000 Hz is above 400 Hz".
    pub message: String,
}
