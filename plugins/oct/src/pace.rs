//! Lines that a detector has taken by now, and those of them that were not fetched in time.
//!
//! Invariant: every line has one number and one time, whether or not it was fetched.

use trocar_sdk::Stamp;

/// A detector that takes line after line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Pace {
    begin_ns: u64,
    period_ns: f64,
    next: u64,
}

/// Lines to fetch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Batch {
    pub(crate) first: u64,
    pub(crate) lines: u64,
    /// Lines before `first` that were not fetched in time.
    pub(crate) lost: u64,
}

impl Pace {
    /// Line 0 begins at `begin`.
    pub(crate) fn new(begin: Stamp, line_rate_hz: f64) -> Pace {
        Pace { begin_ns: begin.ns(), period_ns: 1e9 / line_rate_hz, next: 0 }
    }

    /// Lines taken up to `now` and not fetched yet, the newest `most` of them.
    pub(crate) fn take(&mut self, now: Stamp, most: u64) -> Batch {
        let elapsed_ns = now.ns().saturating_sub(self.begin_ns) as f64;
        // A line that ends within a millionth of a period is over.
        let taken = (elapsed_ns / self.period_ns + 1e-6) as u64;
        let waiting = taken.saturating_sub(self.next);
        let lines = waiting.min(most);
        let lost = waiting - lines;
        let first = self.next + lost;
        self.next += waiting;
        Batch { first, lines, lost }
    }

    /// Takes `lines` at a trigger: they end now, and none was taken since the trigger before.
    pub(crate) fn fire(&mut self, now: Stamp, lines: u64) -> Batch {
        let first = self.next;
        self.next += lines;
        self.begin_ns = now.ns().saturating_sub((self.next as f64 * self.period_ns) as u64);
        Batch { first, lines, lost: 0 }
    }

    /// Middle of the exposure of a line.
    pub(crate) fn middle(&self, line: u64) -> Stamp {
        Stamp::from_ns(self.begin_ns + ((line as f64 + 0.5) * self.period_ns) as u64)
    }

    /// From one line to the next, s.
    pub(crate) fn period_s(&self) -> f64 {
        self.period_ns * 1e-9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_is_fetched_once_and_late_ones_are_told() {
        let mut pace = Pace::new(Stamp::from_ns(1_000), 4000.0);
        let at = |ms: u64| Stamp::from_ns(1_000 + 1_000_000 * ms);
        assert_eq!(pace.take(at(0), 64), Batch { first: 0, lines: 0, lost: 0 });
        assert_eq!(pace.take(at(1), 64), Batch { first: 0, lines: 4, lost: 0 });
        assert_eq!(pace.take(at(3), 64), Batch { first: 4, lines: 8, lost: 0 });
        assert_eq!(pace.take(at(23), 64), Batch { first: 28, lines: 64, lost: 16 });
        assert_eq!(pace.take(at(22), 64), Batch { first: 92, lines: 0, lost: 0 });
        assert_eq!(pace.middle(4).ns(), 1_000 + 1_125_000);
    }
}
