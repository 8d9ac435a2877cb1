//! Waiting for something to become true, under a watchdog that measures progress.
//!
//! Invariant: the only place of the outer tests that sleeps; the watchdog is for a hung test, never a claim
//! about speed.

use std::fmt::Display;
use std::thread;
use std::time::Duration;

use crate::watchdog::Watchdog;

/// Pauses between two looks: the first, and the longest.
const POLL: (Duration, Duration) = (Duration::from_micros(200), Duration::from_millis(10));

/// Asks `probe` until it answers `Ok`. Each reason that was never given before is progress, so a reason says
/// how far it has come.
///
/// # Panics
/// After a minute without progress, or after five in any case, with what was awaited and the last reason
/// `probe` gave.
#[track_caller]
pub fn eventually<T, E: Display>(what: &str, mut probe: impl FnMut() -> Result<T, E>) -> T {
    let mut watchdog = Watchdog::of(what);
    let mut pause = POLL.0;
    loop {
        match probe() {
            Ok(value) => return value,
            Err(last) => watchdog.saw(last),
        }
        thread::sleep(pause);
        pause = (pause * 2).min(POLL.1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn asks_again_until_the_answer_is_there() {
        let mut left = 3;
        let seen = eventually("three refusals", || {
            left -= 1;
            if left == 0 { Ok("done") } else { Err(format!("{left} left")) }
        });
        assert_eq!(seen, "done");
    }
}
