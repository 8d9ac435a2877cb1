//! Rights that this machine gives a real-time process, and how to allow more.
//!
//! Invariant: `probe` only looks and tries, on threads of its own that end, and changes nothing;
//! `judge` only decides.

mod judge;
mod limits;
mod probe;
mod wake;

pub use judge::{Finding, Verdict, judge};
pub use limits::{Limit, Limits};
pub use probe::{Facts, Figures, probe};
