//! The virtual clock and the steps on it.
//!
//! Invariant: time passes only when a test says so; the grid of deadlines is exact with any lateness.

use super::bench::{Bench, Done};
use crate::class::Class;
use crate::values::Stamp;
use std::sync::atomic::Ordering;
use trocar_plugin_api::abi;

/// Period of a class that names none, ns.
const DEFAULT_PERIOD_NS: u64 = 1_000_000;

impl<C: Class> Bench<C> {
    /// Runs `cycles` steps, each one period of virtual time after the other.
    #[track_caller]
    pub fn step(&mut self, cycles: u64) {
        for _ in 0..cycles {
            if let Err(e) = self.try_step() {
                let history = self.history.text(&self.shape);
                panic!("step {} failed: {e}{history}", self.cycle);
            }
        }
    }

    /// One step at its deadline.
    ///
    /// # Errors
    /// The component's sentence; as in a host, it was made safe and is in FAULT now. Or the component is not
    /// ACTIVE: then no time passes, and nothing is stepped.
    #[track_caller]
    pub fn try_step(&mut self) -> Done {
        self.late_step(0)
    }

    /// One step that begins `late_ns` after its deadline. The next deadline is where it would have been.
    ///
    /// # Errors
    /// As `try_step`.
    #[track_caller]
    pub fn late_step(&mut self, late_ns: u64) -> Done {
        self.allow_active("step")?;
        let period_ns = self.grid_ns();
        let deadline_ns = self.host.deadline_ns.fetch_add(period_ns, Ordering::Relaxed) + period_ns;
        let now_ns = self.host.now_ns.load(Ordering::Relaxed).max(deadline_ns) + late_ns;
        let deadline_ns = if C::DESC.period_ns > 0 { deadline_ns } else { now_ns };
        self.step_at(now_ns, deadline_ns, C::DESC.period_ns, period_ns)
    }

    /// Steps without a grid, `ns` after the step before, as a signal, a callback or its own stream wakes a
    /// component: there is no period, and in the first step no time has passed.
    ///
    /// # Errors
    /// As `try_step`.
    #[track_caller]
    pub fn step_after(&mut self, ns: u64) -> Done {
        self.allow_active("step")?;
        self.advance(ns);
        let now_ns = self.host.now_ns.load(Ordering::Relaxed);
        self.step_at(now_ns, now_ns, 0, 0)
    }

    /// `first_ns`: what counts as elapsed in the first step.
    #[track_caller]
    fn step_at(&mut self, now_ns: u64, deadline_ns: u64, period_ns: u64, first_ns: u64) -> Done {
        self.host.now_ns.store(now_ns, Ordering::Relaxed);
        let before = self.host.stepped_ns.swap(now_ns, Ordering::Relaxed);
        let tick = abi::Tick {
            struct_size: size_of::<abi::Tick>() as u32,
            flags: 0,
            cycle: self.cycle,
            now_ns,
            deadline_ns,
            period_ns,
            elapsed_ns: if self.cycle == 0 { first_ns } else { now_ns - before.min(now_ns) },
        };
        self.cycle += 1;
        let f = self.table.step;
        self.history.note(now_ns, format!("step {}", self.cycle));
        self.host.in_step.store(true, Ordering::Relaxed);
        // SAFETY: a live instance; the tick lives through the call.
        let done = self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, &tick, err) }));
        self.host.in_step.store(false, Ordering::Relaxed);
        let done = done.map_err(|e| self.failed("step", e));
        self.reply_all();
        done
    }

    /// Leaves out `cycles` deadlines, as a host does after an overrun: they are counted and not stepped.
    pub fn skip(&mut self, cycles: u64) {
        let ns = cycles * self.grid_ns();
        self.cycle += cycles;
        let deadline_ns = self.host.deadline_ns.fetch_add(ns, Ordering::Relaxed) + ns;
        self.host.now_ns.fetch_max(deadline_ns, Ordering::Relaxed);
    }

    fn grid_ns(&self) -> u64 {
        if C::DESC.period_ns > 0 { C::DESC.period_ns } else { DEFAULT_PERIOD_NS }
    }

    /// Now on the virtual clock.
    pub fn now(&self) -> Stamp {
        Stamp::from_ns(self.host.now_ns.load(Ordering::Relaxed))
    }

    /// Lets `ns` of virtual time pass without a step. Deadlines that pass meanwhile are moved, not missed.
    pub fn advance(&mut self, ns: u64) {
        let now_ns = self.host.now_ns.fetch_add(ns, Ordering::Relaxed) + ns;
        self.host.deadline_ns.fetch_max(now_ns, Ordering::Relaxed);
    }
}
