//! Waiting for something to become true, under a watchdog.
//!
//! Invariant: the only place of the outer tests that sleeps; the limit is a watchdog for a hung test, never a claim about
//! speed.

use std::fmt::Display;
use std::thread;
use std::time::{Duration, Instant};

const WATCHDOG: Duration = Duration::from_secs(60);
/// Pauses between two looks: the first, and the longest.
const POLL: (Duration, Duration) = (Duration::from_micros(200), Duration::from_millis(10));

/// Asks `probe` until it answers `Ok`.
///
/// # Panics
/// After a minute, with what was awaited and the last reason `probe` gave.
pub fn eventually<T, E: Display>(what: &str, mut probe: impl FnMut() -> Result<T, E>) -> T {
    let began = Instant::now();
    let mut pause = POLL.0;
    loop {
        match probe() {
            Ok(value) => return value,
            Err(last) if began.elapsed() > WATCHDOG => {
                panic!("waited {WATCHDOG:?} in vain for: {what}\nlast seen: {last}")
            }
            Err(_) => thread::sleep(pause),
        }
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
