//! The grid of absolute deadlines of a periodic executor.
//!
//! Deadline `k` is `start + phase + k * period`, computed from `k` each time, so it never drifts; and every
//! period is either executed or counted as skipped.

/// Where a periodic executor stands on its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    origin_ns: u64,
    period_ns: u64,
    at: u64,
}

impl Grid {
    /// The first deadline is `start_ns + phase_ns`; a period of 0 counts as 1 ns.
    pub fn new(start_ns: u64, period_ns: u64, phase_ns: u64) -> Self {
        Self { origin_ns: start_ns.saturating_add(phase_ns), period_ns: period_ns.max(1), at: 0 }
    }

    /// When the current cycle is due, ns of the monotonic clock.
    pub fn deadline(&self) -> u64 {
        self.origin_ns.saturating_add(self.at.saturating_mul(self.period_ns))
    }

    /// The current cycle's number: executed plus skipped cycles before it.
    pub fn cycle(&self) -> u64 {
        self.at
    }

    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Goes on after the current cycle was executed; how many cycles are skipped: those whose whole period
    /// is over at `now_ns`. A cycle that is due but whose period still runs is executed late.
    pub fn advance(&mut self, now_ns: u64) -> u64 {
        self.advance_catching_up(now_ns, 0)
    }

    /// As [`Grid::advance`], but up to `limit` cycles whose period is over are still executed, back to back.
    pub fn advance_catching_up(&mut self, now_ns: u64, limit: u64) -> u64 {
        let next = self.at + 1;
        let running = now_ns.saturating_sub(self.origin_ns) / self.period_ns;
        self.at = running.saturating_sub(limit).max(next);
        self.at - next
    }
}
