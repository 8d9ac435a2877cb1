//! A limit of samples per second: it decides which samples of a faster source are kept.
//!
//! Invariant: the samples that are kept lie on a grid that does not move with them, so that the rate asked
//! for is the rate kept. A gap counted from the last sample would keep every second one of 30 Hz where 20 Hz
//! are asked for.

/// Keeps the samples nearest to the points of a grid.
///
/// A sample is kept when the next one would be farther from the point; the interval to the previous sample
/// predicts the time of the next one. The jitter of a source that is as fast as the grid loses nothing, and
/// samples kept of a much faster one are a gap apart. A slower source is kept whole. Pure: times come from
/// the caller, ns of one clock, and a clock that goes back begins a new grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RateLimit {
    /// Between two points of the grid, ns; 0 = everything is kept.
    gap_ns: u64,
    /// The next point, ns; 0 = none was kept yet.
    due_ns: u64,
    /// The sample before, ns.
    last_ns: u64,
}

impl RateLimit {
    /// Keeps everything.
    pub const UNLIMITED: RateLimit = RateLimit::every(0);

    /// Keeps at most `rate_hz` samples a second, Hz; a value that is no positive number keeps everything.
    #[must_use]
    pub fn new(rate_hz: f64) -> RateLimit {
        if rate_hz > 0.0 { RateLimit::every((1e9 / rate_hz) as u64) } else { RateLimit::UNLIMITED }
    }

    /// Keeps at most one sample in `gap_ns`, ns; 0 keeps everything.
    #[must_use]
    pub const fn every(gap_ns: u64) -> RateLimit {
        RateLimit { gap_ns, due_ns: 0, last_ns: 0 }
    }

    /// This limit at that rate from now on, Hz, as in [`RateLimit::new`]; another rate begins a new grid.
    pub fn at(&mut self, rate_hz: f64) -> &mut RateLimit {
        let wanted = RateLimit::new(rate_hz);
        if wanted.gap_ns != self.gap_ns {
            *self = wanted;
        }
        self
    }

    /// Tells whether a sample of this time is kept; called for each sample.
    #[must_use]
    pub fn is_due(&mut self, now_ns: u64) -> bool {
        let interval_ns = now_ns.saturating_sub(self.last_ns);
        self.last_ns = now_ns;
        let early_ns = interval_ns.min(self.gap_ns) / 2;
        self.is_new(now_ns) || now_ns.saturating_add(early_ns) >= self.due_ns
    }

    /// A sample of this time was kept.
    pub fn keep(&mut self, now_ns: u64) {
        let next_ns = self.due_ns.saturating_add(self.gap_ns);
        // After a silence the grid begins anew: missing samples are not made up for.
        let anew = self.is_new(now_ns) || now_ns >= next_ns;
        self.due_ns = if anew { now_ns.saturating_add(self.gap_ns).max(1) } else { next_ns };
    }

    /// The grid begins anew with the next sample.
    pub fn restart(&mut self) {
        self.due_ns = 0;
    }

    /// Between two points of the grid, ns; 0 = everything is kept.
    #[must_use]
    pub fn gap_ns(&self) -> u64 {
        self.gap_ns
    }

    /// When the next one is due, ns; 0 = at once.
    #[must_use]
    pub fn due_ns(&self) -> u64 {
        self.due_ns
    }

    /// Tells whether nothing was kept yet, or the time is before that of the last kept sample: another clock.
    fn is_new(&self, now_ns: u64) -> bool {
        self.gap_ns == 0 || self.due_ns == 0 || now_ns.saturating_add(2 * self.gap_ns) < self.due_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts the samples that are kept; with the least time between two, ns.
    fn kept(mut limit: RateLimit, stamps: impl Iterator<Item = u64>) -> (u64, u64) {
        let (mut count, mut least, mut last) = (0, u64::MAX, None);
        for stamp in stamps.filter(|stamp| {
            let due = limit.is_due(*stamp);
            if due {
                limit.keep(*stamp);
            }
            due
        }) {
            count += 1;
            least = last.map_or(least, |last| least.min(stamp - last));
            last = Some(stamp);
        }
        (count, least)
    }

    /// So many seconds of a source with a jitter of up to `part` of its period.
    fn source(rate_hz: f64, seconds: f64, part: f64) -> impl Iterator<Item = u64> {
        let period = 1e9 / rate_hz;
        (0..(rate_hz * seconds) as u64).map(move |i| {
            let jitter = ((i.wrapping_mul(2_654_435_761) % 1000) as f64 / 1000.0 - 0.5) * 2.0 * part;
            (1e9 + (i as f64 + jitter) * period) as u64
        })
    }

    #[test]
    fn the_rate_that_is_asked_for_is_kept_whatever_the_source_gives() {
        for source_hz in [3.0, 19.0, 24.0, 30.0, 33.3, 60.0, 100.0, 999.0, 1000.0, 8000.0] {
            for asked_hz in [0.5, 1.0, 7.0, 20.0, 25.0, 30.0, 50.0, 90.0, 100.0, 300.0, 1000.0] {
                for jitter in [0.0, 0.05, 0.12] {
                    let seconds = 40.0;
                    let (count, least) = kept(RateLimit::new(asked_hz), source(source_hz, seconds, jitter));
                    let want = seconds * f64::min(source_hz, asked_hz);
                    let what = format!("{asked_hz} Hz of {source_hz} Hz, jitter {jitter}: {count} of {want}");
                    assert!((count as f64 - want).abs() <= 2.0 + want / 500.0, "{what}");
                    // A sample is half a period of the source early or late at most, and its jitter.
                    let apart = 1e9 / asked_hz - 1.5e9 / source_hz;
                    assert!(least as f64 >= apart, "{what}: two within {least} ns");
                }
            }
        }
    }

    #[test]
    fn a_silence_is_not_made_up_for() {
        let stamps = (0..100).chain(1_000_000..1_000_100).map(|i| 1_000 + i * 10);
        // One in 100: ten before, ten after.
        assert_eq!(kept(RateLimit::every(100), stamps), (20, 100));
    }

    #[test]
    fn a_clock_that_goes_back_begins_a_new_grid() {
        let mut limit = RateLimit::every(100);
        limit.keep(1_000_000);
        assert!(!limit.is_due(1_000_010));
        assert!(limit.is_due(5));
        limit.keep(5);
        assert_eq!(limit.due_ns(), 105);
        limit.restart();
        assert!(limit.is_due(6));
    }

    #[test]
    fn without_a_rate_everything_is_kept() {
        for rate in [0.0, -1.0, f64::NAN] {
            assert_eq!(kept(RateLimit::new(rate), (0..1000).map(|i| i * 3)).0, 1000);
        }
        assert_eq!(RateLimit::new(0.0), RateLimit::UNLIMITED);
    }

    #[test]
    fn another_rate_holds_at_once_and_the_same_one_keeps_its_grid() {
        let mut limit = RateLimit::UNLIMITED;
        let mut kept = |rate_hz: f64, second: u64| {
            let stamps = (0..30).map(|n| second * 1_000_000_000 + n * 33_333_333);
            let kept = stamps.filter(|now_ns| {
                let due = limit.at(rate_hz).is_due(*now_ns);
                if due {
                    limit.keep(*now_ns);
                }
                due
            });
            kept.count()
        };
        assert_eq!(
            [kept(20.0, 1), kept(25.0, 2), kept(60.0, 3), kept(15.0, 4), kept(0.0, 5)],
            [20, 25, 30, 15, 30]
        );
    }
}
