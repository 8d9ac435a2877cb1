//! Questions to a GCM, as plain values: subcommands ask them, and `session` puts them on the wire.

use clap::ValueEnum;
use serde_json::Value;

/// A row of a state table.
#[derive(Clone, Copy, Debug)]
pub(super) enum Row {
    /// Ns of the host's monotonic clock.
    At(u64),
    /// Ns of the host's monotonic clock.
    Nearest(u64),
    Tick(u64),
    /// Rows before the newest.
    Delayed(u64),
}

/// A state to wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "SCREAMING_SNAKE_CASE")]
pub(super) enum Awaited {
    /// Made, its configuration not complete.
    Created,
    /// Configured, not running.
    Ready,
    /// Running.
    Active,
    /// Standing still, for whatever reason.
    Stopped,
    /// Failed.
    Fault,
}

/// A question to the GCM.
pub(super) struct Waiting {
    pub(super) path: String,
    pub(super) deadline_ns: u64,
    pub(super) what: For,
}

pub(super) enum For {
    /// None means ACTIVE.
    States(Vec<Awaited>),
    /// With the command to call and its argument.
    Event(Option<(String, Option<Value>)>),
}
