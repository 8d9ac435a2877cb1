//! The time of a command: a command that waited too long is not carried out.
//!
//! Invariant: stamp 0 (CRTK: invalid) says that the client gives none, and is in time; nothing here reads a
//! clock.

use crate::values::Stamp;
use core::fmt;

/// Checks the age of a motion command that is only good when it is new, `servo_*` above all: `stamp` is the
/// command's, `now` the host's clock, `most_s` the largest age that is taken, s.
///
/// ```
/// use trocar_sdk::{crtk::require_in_time, prelude::Stamp};
/// let (now, sent) = (Stamp::from_ns(5_300_000_000), Stamp::from_ns(5_000_000_000));
/// assert!(require_in_time(sent, now, 0.5).is_ok());
/// assert!(require_in_time(Stamp::INVALID, now, 0.5).is_ok());
/// let refused = require_in_time(sent, now, 0.1).unwrap_err().to_string();
/// assert!(
///     refused.starts_with("the command is 0.300 s old by its stamp, at most 0.100 s are taken"),
///     "{refused}"
/// );
/// ```
///
/// # Errors
/// Older than `most_s`, or ahead of `now` by more than that: the stamp is of another clock.
pub fn require_in_time(stamp: Stamp, now: Stamp, most_s: f64) -> Result<(), OutOfTime> {
    let age_s = now.seconds_since(stamp);
    if !stamp.is_valid() || age_s.abs() <= most_s { Ok(()) } else { Err(OutOfTime { age_s, most_s }) }
}

/// Why a command was not in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfTime {
    /// Age by the stamp, s; negative when the stamp is ahead.
    pub age_s: f64,
    /// Largest age that is taken, s.
    pub most_s: f64,
}

impl fmt::Display for OutOfTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let OutOfTime { age_s, most_s } = *self;
        if age_s > 0.0 {
            write!(
                f,
                "the command is {age_s:.3} s old by its stamp, at most {most_s:.3} s are taken: it lay in wait; send a new one, or stamp \
                 0, which is taken as now"
            )
        } else {
            write!(
                f,
                "the command's stamp is {:.3} s ahead of this host's clock: stamp commands with the host's monotonic clock, or \
                 with 0, which is taken as now",
                -age_s
            )
        }
    }
}

impl core::error::Error for OutOfTime {}
