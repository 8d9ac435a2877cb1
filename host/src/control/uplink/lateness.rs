//! Lateness of the GCM's messages, which was lost on the way or while this process stood still.
//!
//! Invariant: no common clock is needed. The quickest of the last messages counts as one that took no time,
//! so that clocks may drift, and a way may become longer.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use trocar_lcm_api::clock;

/// Messages among which the quickest counts: of a GCM that orders nothing, some seconds.
const AMONG: usize = 64;

pub(super) struct Lateness {
    began: Instant,
    /// By how much this process's clock is ahead of the stamp of each of the last messages, ns.
    ahead: VecDeque<i128>,
}

impl Lateness {
    pub(super) fn new() -> Lateness {
        Lateness { began: clock::now(), ahead: VecDeque::new() }
    }

    /// Returns how late a message is that arrives now. `sent_ns`: its stamp; 0 without one.
    pub(super) fn of(&mut self, sent_ns: u64) -> Duration {
        if sent_ns == 0 {
            return Duration::ZERO;
        }
        let now = i128::try_from(clock::since(self.began).as_nanos()).unwrap_or(i128::MAX);
        let ahead = now - i128::from(sent_ns);
        self.ahead.push_back(ahead);
        if self.ahead.len() > AMONG {
            self.ahead.pop_front();
        }
        let quickest = self.ahead.iter().min().copied().unwrap_or(ahead);
        Duration::from_nanos(u64::try_from(ahead - quickest).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEAT: Duration = Duration::from_millis(100);

    /// Stamp of a clock that is far ahead.
    fn stamp(since: tokio::time::Instant) -> u64 {
        1_000_000_000_000 + u64::try_from(since.elapsed().as_nanos()).unwrap_or_default()
    }

    #[tokio::test(start_paused = true)]
    async fn what_takes_longer_than_the_others_is_late_by_the_difference() {
        let (began, mut lateness) = (tokio::time::Instant::now(), Lateness::new());
        for _ in 0..10 {
            let sent = stamp(began);
            tokio::time::advance(Duration::from_millis(2)).await;
            assert_eq!(lateness.of(sent), Duration::ZERO);
            tokio::time::advance(BEAT).await;
        }
        let sent = stamp(began);
        tokio::time::advance(Duration::from_millis(302)).await;
        assert_eq!(lateness.of(sent), Duration::from_millis(300));
        assert_eq!(lateness.of(0), Duration::ZERO, "a GCM that puts no stamp on it");
    }

    #[tokio::test(start_paused = true)]
    async fn a_clock_that_drifts_makes_nothing_late_for_long() {
        let (began, mut lateness) = (tokio::time::Instant::now(), Lateness::new());
        for beat in 0..36_000_u64 {
            // A GCM's clock that loses 100 ppm.
            let late = lateness.of(stamp(began) - beat * 10_000);
            assert!(late < Duration::from_millis(1), "{late:?} after {beat} beats");
            tokio::time::advance(BEAT).await;
        }
    }
}
