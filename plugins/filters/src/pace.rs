//! The rate of the samples a filter works on, by their stamps.
//!
//! Invariant: a silence is no slow source: it belongs to no look.

/// Intervals after which the rate is told, first soon, then surely.
const LOOKS: [u64; 2] = [4, 16];
/// Intervals of a look from then on.
const LONG: u64 = 64;
/// Another rate is one that differs by more than this part.
const OTHER: f64 = 0.02;
/// So many times the usual interval without a sample are a silence.
const SILENCE: f64 = 8.0;

/// Measures the rate of samples.
#[derive(Default)]
pub(crate) struct Pace {
    /// Stamp of the sample before, ns.
    last_ns: Option<u64>,
    /// The interval before was a silence: another one like it is the source's rate.
    silent: bool,
    /// Stamp of the one the present look began with, ns, and the intervals since then.
    began_ns: u64,
    intervals: u64,
    looks: usize,
    hz: f64,
}

impl Pace {
    /// The stamps have told a rate.
    pub(crate) fn is_known(&self) -> bool {
        self.hz > 0.0
    }

    /// Takes note of a sample; returns the rate, Hz, if it changes.
    pub(crate) fn note(&mut self, stamp_ns: u64) -> Option<f64> {
        let last_ns = self.last_ns.replace(stamp_ns);
        let gap_ns = last_ns.and_then(|last_ns| stamp_ns.checked_sub(last_ns));
        let silent = gap_ns.is_some_and(|gap_ns| gap_ns as f64 * self.hz > SILENCE * 1e9);
        let begins = silent && !self.silent;
        self.silent = silent;
        // The first one, another clock, or after a silence: a look begins.
        if gap_ns.is_none() || begins {
            (self.began_ns, self.intervals) = (stamp_ns, 0);
            return None;
        }
        self.intervals += 1;
        let lasted_ns = stamp_ns - self.began_ns;
        // Stamps that stand still say nothing.
        if self.intervals < LOOKS.get(self.looks).copied().unwrap_or(LONG) || lasted_ns == 0 {
            return None;
        }
        let hz = self.intervals as f64 * 1e9 / lasted_ns as f64;
        self.looks += usize::from(self.looks < LOOKS.len());
        if self.looks == LOOKS.len() {
            (self.began_ns, self.intervals) = (stamp_ns, 0);
        }
        if (hz - self.hz).abs() <= OTHER * self.hz {
            return None;
        }
        self.hz = hz;
        Some(hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rates told for samples with these stamps, ns.
    fn told(stamps: impl Iterator<Item = u64>) -> Vec<f64> {
        let mut pace = Pace::default();
        stamps.filter_map(|stamp| pace.note(stamp)).collect()
    }

    #[test]
    fn the_rate_is_told_once_and_again_when_it_changes() {
        assert_eq!(told((0..1000).map(|n| n * 5_000_000)), [200.0]);
        let faster = (0..1000).map(|n| n * 5_000_000).chain((1..1000).map(|n| 4_995_000_000 + n * 1_000_000));
        let rates = told(faster);
        assert_eq!((rates.first(), rates.last()), (Some(&200.0), Some(&1000.0)), "{rates:?}");
    }

    #[test]
    fn a_silence_is_no_slow_source() {
        let pauses = (0..1000).filter(|n| !(100..170).contains(n) && !(500..900).contains(n));
        assert_eq!(told(pauses.map(|n| n * 1_000_000)), [1000.0]);
    }

    #[test]
    fn a_slow_source_is_no_silence() {
        let rates =
            told((0..100).map(|n| n * 1_000_000).chain((1..100).map(|n| 99_000_000 + n * 100_000_000)));
        assert_eq!((rates.first(), rates.last()), (Some(&1000.0), Some(&10.0)), "{rates:?}");
    }

    #[test]
    fn jitter_is_no_other_rate() {
        let jitter = |n: u64| 300_000 * (n.wrapping_mul(2_654_435_761) % 2);
        let rates = told((0..10_000).map(|n| n * 1_000_000 + jitter(n)));
        assert!(rates.len() <= 3, "{rates:?}");
        assert!(rates.last().is_some_and(|hz| (hz - 1000.0).abs() < 20.0), "{rates:?}");
    }

    #[test]
    fn stamps_that_stand_still_or_go_back_say_nothing() {
        assert!(told((0..1000).map(|_| 7)).is_empty());
        assert!(told((0..1000).rev()).is_empty());
    }
}
