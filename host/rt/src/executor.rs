//! When a thread runs its next cycle: the pace of an executor, decided over a small clock.
//!
//! A deadline is absolute and comes from its number, never from the last cycle, so a grid cannot drift; every
//! period is run or counted as skipped; and a wake before the deadline serves jobs without moving the cycle.

use std::sync::Arc;

use crate::os;
use crate::timing::Grid;
use crate::wake::{self, Waker};

/// Rule by which a thread finds its next cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// At every multiple of the period on the monotonic clock, plus the phase.
    Grid {
        /// 0 counts as 1 ns.
        period_ns: u64,
        /// Taken modulo the period.
        phase_ns: u64,
        /// Missed periods that are still run, back to back, at most; those before them are skipped.
        catch_up: u32,
    },
    /// Without pause.
    Free,
    /// When something is there.
    Signal,
    /// Never: the thread serves jobs only.
    Never,
}

/// One cycle that is to run now. All times are ns of the monotonic clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cycle {
    /// When it really begins.
    pub begin_ns: u64,
    /// When it was due; off a grid that is when it begins.
    pub deadline_ns: u64,
    /// 0 off a grid.
    pub period_ns: u64,
    /// Periods right before it that are left out for good.
    pub skipped: u64,
}

/// Time, and how to sleep through it.
pub trait Clock {
    /// Ns of the monotonic clock.
    fn now_ns(&self) -> u64;

    /// Sleeps until a wake (`true`, which uses it up) or until the deadline (`false`), never shorter.
    fn wait(&self, deadline_ns: Option<u64>) -> bool;
}

/// The machine's clock, for the owner of the waker.
impl Clock for Waker {
    fn now_ns(&self) -> u64 {
        os::now_ns()
    }

    fn wait(&self, deadline_ns: Option<u64>) -> bool {
        Waker::wait(self, deadline_ns)
    }
}

/// The machine's clock for the owner of a waker and of bells that other processes ring.
pub struct Bells<'a> {
    pub own: &'a Waker,
    pub bells: &'a [Arc<Waker>],
}

impl Clock for Bells<'_> {
    fn now_ns(&self) -> u64 {
        os::now_ns()
    }

    fn wait(&self, deadline_ns: Option<u64>) -> bool {
        wake::wait_any(self.own, self.bells, deadline_ns)
    }
}

/// Decides the cycles of one thread.
#[derive(Debug)]
pub struct Pacer {
    pace: Pace,
    /// Made by the first wait for a cycle, forgotten by `rest`.
    grid: Option<Grid>,
}

impl Pacer {
    pub const fn new(pace: Pace) -> Self {
        Self { pace, grid: None }
    }

    pub fn pace(&self) -> Pace {
        self.pace
    }

    /// Moves its grid to another phase, bit by bit, see [`Grid::move_to`]; a grid that begins later begins
    /// there.
    pub fn set_phase(&mut self, to_ns: u64) {
        if let Pace::Grid { phase_ns, .. } = &mut self.pace {
            *phase_ns = to_ns;
            if let Some(grid) = &mut self.grid {
                grid.move_to(to_ns);
            }
        }
    }

    /// Sleeps until a wake while nobody needs cycles. Periods in between are neither run nor skipped: the
    /// grid begins anew with the next [`Pacer::next`].
    pub fn rest(&mut self, clock: &impl Clock) {
        self.grid = None;
        clock.wait(None);
    }

    /// Sleeps until the next cycle and answers it; or `None` after a wake without one: then serve jobs and
    /// call again. `signalled` says whether something is there to run for (`Pace::Signal` asks it only).
    /// Sleeps at most once; no allocation, no lock.
    pub fn next(&mut self, clock: &impl Clock, signalled: impl Fn() -> bool) -> Option<Cycle> {
        match self.pace {
            Pace::Grid { period_ns, phase_ns, catch_up } => {
                let mut now = clock.now_ns();
                let grid = self.grid.get_or_insert_with(|| Grid::on_clock(now, period_ns, phase_ns));
                if now < grid.deadline() {
                    clock.wait(Some(grid.deadline()));
                    now = clock.now_ns();
                }
                let due = grid.begin(now, u64::from(catch_up))?;
                let (deadline_ns, period_ns) = (due.deadline_ns, grid.period_ns());
                Some(Cycle { begin_ns: now, deadline_ns, period_ns, skipped: due.skipped })
            }
            Pace::Free => Some(unplanned(clock)),
            Pace::Signal => {
                if !signalled() {
                    clock.wait(None);
                }
                signalled().then(|| unplanned(clock))
            }
            Pace::Never => {
                clock.wait(None);
                None
            }
        }
    }
}

fn unplanned(clock: &impl Clock) -> Cycle {
    let now = clock.now_ns();
    Cycle { begin_ns: now, deadline_ns: now, period_ns: 0, skipped: 0 }
}
