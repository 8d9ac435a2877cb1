//! The error of an entry and its result.
//!
//! Invariant: an error is one value with its causes; the wall around the entries makes one sentence of them.

/// Any error, made with `?` or from text: `Err("no light".into())`.
pub type Error = Box<dyn std::error::Error + Send + Sync>;
/// The result of every entry. An error from `step`, `start` or `configure` puts the component in FAULT.
pub type Result<T = (), E = Error> = std::result::Result<T, E>;
