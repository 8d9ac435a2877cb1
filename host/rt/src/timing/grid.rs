//! The grid of absolute deadlines of a periodic executor.
//!
//! Deadline `k` is `base + phase + k * period`, computed from `k` each time, so it never drifts; and every
//! period is either executed or counted as skipped. A new phase moves the deadlines and not the numbers, so
//! that no cycle is left out for it or run twice.

/// The phase moves in each cycle by this part of a period at most, so that two steps keep nearly their
/// distance.
const SLEW: u64 = 16;

/// Position of a periodic executor on its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    base_ns: u64,
    phase_ns: u64,
    /// The phase it is moving to.
    aim_ns: u64,
    period_ns: u64,
    /// The next cycle's number: executed plus skipped cycles before it.
    at: u64,
}

/// A cycle that is to run now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due {
    /// Number of the cycle on its grid, from 0; skipped ones are counted.
    pub cycle: u64,
    /// When it was due, ns of the monotonic clock.
    pub deadline_ns: u64,
    /// Cycles right before it that are left out for good.
    pub skipped: u64,
}

impl Grid {
    /// The first deadline is `start_ns + phase_ns`; a period of 0 counts as 1 ns.
    pub fn new(start_ns: u64, period_ns: u64, phase_ns: u64) -> Self {
        Self { base_ns: start_ns, phase_ns, aim_ns: phase_ns, period_ns: period_ns.max(1), at: 0 }
    }

    /// The grid of all times that are `phase_ns` after a multiple of the period on the monotonic clock, from
    /// `now_ns` on: two grids keep the distance of their phases, whenever each of them began.
    pub fn on_clock(now_ns: u64, period_ns: u64, phase_ns: u64) -> Self {
        let period_ns = period_ns.max(1);
        let phase_ns = phase_ns % period_ns;
        let into_period = now_ns.saturating_sub(phase_ns) % period_ns;
        let first = match into_period {
            _ if now_ns < phase_ns => phase_ns,
            0 => now_ns,
            into => now_ns.saturating_add(period_ns - into),
        };
        Self { base_ns: first - phase_ns, phase_ns, aim_ns: phase_ns, period_ns, at: 0 }
    }

    /// Moves the deadlines to this phase, taken modulo the period, from now on by a sixteenth of a period in
    /// each cycle. Cycle `k` stays within its own period of the clock, so executed + skipped = elapsed
    /// periods all the way. For grids made by [`Grid::on_clock`].
    pub fn move_to(&mut self, phase_ns: u64) {
        self.aim_ns = phase_ns % self.period_ns;
    }

    /// The phase as it is now.
    pub fn phase(&self) -> u64 {
        self.phase_ns
    }

    /// When the next cycle is due, ns of the monotonic clock.
    pub fn deadline(&self) -> u64 {
        self.origin().saturating_add(self.at.saturating_mul(self.period_ns))
    }

    fn origin(&self) -> u64 {
        self.base_ns.saturating_add(self.phase_ns)
    }

    fn slew(&mut self) {
        let most = (self.period_ns / SLEW).max(1);
        let aim_ns = self.aim_ns;
        self.phase_ns = aim_ns.clamp(self.phase_ns.saturating_sub(most), self.phase_ns.saturating_add(most));
    }

    /// The next cycle's number: executed plus skipped cycles before it.
    pub fn cycle(&self) -> u64 {
        self.at
    }

    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The cycle to run at `now_ns`, or `None` before the next deadline. Cycles whose whole period is over
    /// are missed: the last `catch_up` of them are still run, one with each call, those before are skipped. A
    /// cycle that is due but whose period still runs is never skipped.
    pub fn begin(&mut self, now_ns: u64, catch_up: u64) -> Option<Due> {
        let newest = now_ns.checked_sub(self.origin())? / self.period_ns;
        if newest < self.at {
            return None;
        }
        let cycle = newest.saturating_sub(catch_up).max(self.at);
        let skipped = cycle - self.at;
        self.at = cycle;
        let deadline_ns = self.deadline();
        self.at = cycle + 1;
        self.slew();
        Some(Due { cycle, deadline_ns, skipped })
    }
}
