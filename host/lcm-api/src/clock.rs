//! The clock by which deadlines are measured.
//!
//! Invariant: it is the monotonic clock of the machine, unless a simulation has set that of its runtime.

use std::time::{Duration, Instant};

/// Returns the time now. Within a tokio runtime whose clock stands still it is that clock's time.
pub fn now() -> Instant {
    tokio::time::Instant::now().into_std()
}

/// Returns the time that has passed since then.
pub fn since(then: Instant) -> Duration {
    now().saturating_duration_since(then)
}
