//! Lateness of the GCM's messages, which was lost on the way or while this process stood still.
//!
//! Invariant: no common clock is needed. The quickest message of the last seconds counts as one that took no
//! time, so that clocks may drift, and a way may become longer.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use trocar_lcm_api::clock;

/// Seconds among whose messages the quickest counts.
const AMONG: usize = 10;

pub(super) struct Lateness {
    began: Instant,
    /// Term of the GCM whose clock the stamps are of.
    term: u64,
    /// By how much this process's clock is ahead of the stamp of the quickest message, ns, for each of the
    /// last seconds that had any.
    ahead: VecDeque<(u64, i128)>,
}

impl Default for Lateness {
    fn default() -> Self {
        Lateness { began: clock::now(), term: 0, ahead: VecDeque::new() }
    }
}

impl Lateness {
    /// A session begins with a message of that stamp, of the GCM of that term: what was learnt of its clock
    /// in the sessions before counts on.
    pub(super) fn begin(&mut self, term: u64, sent_ns: u64) {
        if self.term != term {
            *self = Lateness { term, ..Lateness::default() };
        }
        self.of(sent_ns);
    }

    /// Returns how late a message is that arrives now. `sent_ns`: its stamp; 0 without one.
    pub(super) fn of(&mut self, sent_ns: u64) -> Duration {
        if sent_ns == 0 {
            return Duration::ZERO;
        }
        let now = clock::since(self.began);
        let ahead = i128::try_from(now.as_nanos()).unwrap_or(i128::MAX) - i128::from(sent_ns);
        match self.ahead.back_mut() {
            Some((second, quickest)) if *second == now.as_secs() => *quickest = ahead.min(*quickest),
            _ => self.ahead.push_back((now.as_secs(), ahead)),
        }
        if self.ahead.len() > AMONG {
            self.ahead.pop_front();
        }
        let quickest = self.ahead.iter().map(|(_, quickest)| *quickest).min().unwrap_or(ahead);
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
        let (began, mut lateness) = (tokio::time::Instant::now(), Lateness::default());
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
    async fn a_burst_after_a_stall_is_late_to_its_end() {
        let (began, mut lateness) = (tokio::time::Instant::now(), Lateness::default());
        assert_eq!(lateness.of(stamp(began)), Duration::ZERO);
        let mut sent = Vec::new();
        for _ in 0..100 {
            sent.push(stamp(began));
            tokio::time::advance(Duration::from_millis(4)).await;
        }
        for (at, sent) in (0..100_u64).zip(sent) {
            assert_eq!(lateness.of(sent), Duration::from_millis(400 - 4 * at));
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_clock_that_drifts_makes_nothing_late_for_long() {
        let (began, mut lateness) = (tokio::time::Instant::now(), Lateness::default());
        for beat in 0..36_000_u64 {
            // A GCM's clock that loses 100 ppm.
            let late = lateness.of(stamp(began) - beat * 10_000);
            assert!(late < Duration::from_millis(1), "{late:?} after {beat} beats");
            tokio::time::advance(BEAT).await;
        }
    }
}
