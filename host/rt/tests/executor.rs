//! An executor's cycles lie on an exact grid, every period is run or counted, and a wake never moves a cycle.
#![allow(clippy::unwrap_used)]

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use proptest::prelude::*;
use trocar_rt::executor::{Clock, Cycle, Pace, Pacer};
use trocar_rt::now_ns;
use trocar_rt::wake::Waker;

/// A clock that is moved by hand: a sleep ends at its deadline, plus the lateness of the machine, or at a
/// wake.
#[derive(Default)]
struct ManualClock {
    now_ns: Cell<u64>,
    late_ns: Cell<u64>,
    /// Delays of the next wakes after falling asleep, ns, last first.
    wakes: RefCell<Vec<u64>>,
    sleeps: Cell<u64>,
}

impl ManualClock {
    fn at(now_ns: u64) -> Self {
        Self { now_ns: Cell::new(now_ns), ..Self::default() }
    }

    fn pass(&self, ns: u64) {
        self.now_ns.set(self.now_ns.get() + ns);
    }
}

impl Clock for ManualClock {
    fn now_ns(&self) -> u64 {
        self.now_ns.get()
    }

    fn wait(&self, deadline_ns: Option<u64>) -> bool {
        self.sleeps.set(self.sleeps.get() + 1);
        let now = self.now_ns.get();
        let wake = self.wakes.borrow().last().map(|after| now + after);
        if let Some(at) = wake.filter(|at| deadline_ns.is_none_or(|deadline| *at < deadline)) {
            self.wakes.borrow_mut().pop();
            self.now_ns.set(at);
            return true;
        }
        let deadline = deadline_ns.expect("a sleep without a deadline and without a wake never ends");
        self.now_ns.set(now.max(deadline) + self.late_ns.get());
        false
    }
}

fn grid(period_ns: u64, phase_ns: u64, catch_up: u32) -> Pacer {
    Pacer::new(Pace::Grid { period_ns, phase_ns, catch_up })
}

fn next(pacer: &mut Pacer, clock: &ManualClock) -> Option<Cycle> {
    pacer.next(clock, || panic!("a grid needs no signal"))
}

#[test]
fn cycles_lie_at_multiples_of_the_period_plus_the_phase() {
    let clock = ManualClock::at(1_234);
    let mut pacer = grid(100, 30, 0);
    for expected in [1_330, 1_430, 1_530] {
        let cycle = next(&mut pacer, &clock).unwrap();
        let on_time = Cycle { begin_ns: expected, deadline_ns: expected, period_ns: 100, skipped: 0 };
        assert_eq!(cycle, on_time);
        clock.pass(70);
    }
}

#[test]
fn two_grids_keep_the_distance_of_their_phases_whenever_they_begin() {
    for (start, period, phase) in [(0, 100, 0), (7, 100, 30), (29, 100, 30), (30, 100, 30), (31, 100, 130)] {
        let cycle = next(&mut grid(period, phase, 0), &ManualClock::at(start)).unwrap();
        assert_eq!(cycle.deadline_ns % period, phase % period, "{cycle:?}");
        assert!((start..start + period).contains(&cycle.deadline_ns), "{cycle:?} from {start}");
    }
}

#[test]
fn a_new_phase_is_reached_by_sixteenths_of_a_period_and_no_cycle_is_left_out_or_doubled() {
    let clock = ManualClock::at(1);
    let mut pacer = grid(1_600, 0, 0);
    assert_eq!(next(&mut pacer, &clock).unwrap().deadline_ns, 1_600);
    pacer.set_phase(250);
    // The next deadline is known already.
    let deadlines: Vec<u64> = (0..4).map(|_| next(&mut pacer, &clock).unwrap().deadline_ns).collect();
    assert_eq!(deadlines, [3_200, 4_900, 6_600, 8_250]);
    pacer.set_phase(0);
    let back: Vec<u64> = (0..4).map(|_| next(&mut pacer, &clock).unwrap().deadline_ns).collect();
    assert_eq!(back, [9_850, 11_350, 12_850, 14_400]);
}

#[test]
fn a_grid_that_begins_after_a_rest_begins_at_the_new_phase() {
    let clock = ManualClock::at(1);
    let mut pacer = grid(100, 0, 0);
    next(&mut pacer, &clock).unwrap();
    pacer.set_phase(30);
    clock.wakes.replace(vec![5]);
    pacer.rest(&clock);
    assert_eq!(next(&mut pacer, &clock).unwrap().deadline_ns, 130);
}

proptest! {
    /// Cycle `k` of a grid has its deadline in period `k` of the clock, whatever its phase was and becomes.
    #[test]
    fn executed_and_skipped_are_the_elapsed_periods_while_the_phase_changes(
        period in 16..5_000_u64,
        steps in prop::collection::vec((0..12_000_u64, 0..3_000_u64, prop::option::of(0..10_000_u64)), 1..200),
        catch_up in 0..3_u32,
    ) {
        let clock = ManualClock::at(12_345);
        let mut pacer = grid(period, 0, catch_up);
        let (mut counted, mut first, mut last) = (0_u64, None, 0);
        for (busy, late, phase) in steps {
            if let Some(phase) = phase {
                pacer.set_phase(phase);
            }
            clock.late_ns.set(late);
            if let Some(cycle) = next(&mut pacer, &clock) {
                prop_assert!(cycle.deadline_ns <= cycle.begin_ns);
                last = cycle.deadline_ns / period;
                counted += 1 + if first.is_some() { cycle.skipped } else { 0 };
                prop_assert_eq!(counted, last - *first.get_or_insert(last) + 1);
            }
            clock.pass(busy);
        }
        prop_assert!(counted > 0 && last > 0);
    }
}

#[test]
fn a_late_machine_moves_no_deadline() {
    let clock = ManualClock::at(0);
    clock.late_ns.set(40);
    let mut pacer = grid(100, 0, 0);
    let cycles: Vec<_> = (0..1_000).map(|_| next(&mut pacer, &clock).unwrap()).collect();
    assert_eq!(cycles[0].deadline_ns, 0);
    assert_eq!(cycles[999].deadline_ns, 99_900);
    assert!(cycles[1..].iter().all(|c| c.begin_ns - c.deadline_ns == 40 && c.skipped == 0));
}

#[test]
fn a_wake_before_the_deadline_serves_jobs_only() {
    let clock = ManualClock::at(1);
    clock.wakes.replace(vec![20, 10]);
    let mut pacer = grid(100, 0, 0);
    assert_eq!(next(&mut pacer, &clock), None);
    assert_eq!(next(&mut pacer, &clock), None);
    assert_eq!(clock.now_ns(), 31);
    assert_eq!(next(&mut pacer, &clock).unwrap().begin_ns, 100);
}

#[test]
fn a_job_that_outlasts_the_deadline_only_makes_the_cycle_late() {
    let clock = ManualClock::at(1);
    clock.wakes.replace(vec![10]);
    let mut pacer = grid(100, 0, 0);
    assert_eq!(next(&mut pacer, &clock), None);
    clock.pass(150);
    let cycle = next(&mut pacer, &clock).unwrap();
    assert_eq!((cycle.begin_ns, cycle.deadline_ns, cycle.skipped), (161, 100, 0));
}

#[test]
fn missed_periods_are_skipped_and_counted() {
    let clock = ManualClock::at(0);
    let mut pacer = grid(100, 0, 0);
    next(&mut pacer, &clock).unwrap();
    clock.pass(350);
    let late = next(&mut pacer, &clock).unwrap();
    assert_eq!((late.begin_ns, late.deadline_ns, late.skipped), (350, 300, 2));
    assert_eq!(clock.sleeps.get(), 0, "what is due is run without a sleep");
    assert_eq!(next(&mut pacer, &clock).unwrap().begin_ns, 400);
}

#[test]
fn missed_periods_are_caught_up_back_to_back_up_to_the_limit() {
    let clock = ManualClock::at(0);
    let mut pacer = grid(100, 0, 2);
    next(&mut pacer, &clock).unwrap();
    clock.pass(550);
    let run: Vec<_> = (0..4).map(|_| next(&mut pacer, &clock).unwrap()).collect();
    assert_eq!(run.iter().map(|c| c.deadline_ns).collect::<Vec<_>>(), [300, 400, 500, 600]);
    assert_eq!(run.iter().map(|c| c.skipped).collect::<Vec<_>>(), [2, 0, 0, 0]);
    assert_eq!(run.iter().map(|c| c.begin_ns).collect::<Vec<_>>(), [550, 550, 550, 600]);
}

#[test]
fn periods_of_a_rest_are_neither_run_nor_skipped() {
    let clock = ManualClock::at(0);
    let mut pacer = grid(100, 0, 5);
    next(&mut pacer, &clock).unwrap();
    clock.wakes.replace(vec![10_050]);
    pacer.rest(&clock);
    let cycle = next(&mut pacer, &clock).unwrap();
    assert_eq!((cycle.deadline_ns, cycle.skipped), (10_100, 0));
}

#[test]
fn absurd_periods_neither_panic_nor_hang() {
    for (period, phase) in [(0, 0), (0, u64::MAX), (1, 5), (u64::MAX, 0), (u64::MAX, u64::MAX), (u64::MAX, 1)]
    {
        let clock = ManualClock::at(u64::MAX / 2);
        let mut pacer = grid(period, phase, u32::MAX);
        for _ in 0..3 {
            let _ = next(&mut pacer, &clock);
            if clock.now_ns() > u64::MAX / 2 + 10 {
                break;
            }
            clock.pass(1);
        }
    }
}

#[test]
fn a_free_thread_never_sleeps() {
    let clock = ManualClock::at(5);
    let mut pacer = Pacer::new(Pace::Free);
    let cycle = pacer.next(&clock, || false).unwrap();
    assert_eq!(cycle, Cycle { begin_ns: 5, deadline_ns: 5, period_ns: 0, skipped: 0 });
    assert_eq!(clock.sleeps.get(), 0);
}

#[test]
fn a_signalled_thread_runs_for_what_is_there_and_sleeps_otherwise() {
    let clock = ManualClock::at(5);
    let mut pacer = Pacer::new(Pace::Signal);
    assert_eq!(pacer.next(&clock, || true).unwrap().begin_ns, 5);
    assert_eq!(clock.sleeps.get(), 0);
    clock.wakes.replace(vec![3]);
    assert_eq!(pacer.next(&clock, || false), None, "a wake for a job");
    clock.wakes.replace(vec![3]);
    let awake = || clock.now_ns() == 11;
    assert_eq!(pacer.next(&clock, awake).unwrap().begin_ns, 11);
}

#[test]
fn a_passive_thread_serves_jobs_only() {
    let clock = ManualClock::at(5);
    clock.wakes.replace(vec![3]);
    assert_eq!(Pacer::new(Pace::Never).next(&clock, || true), None);
}

#[test]
fn the_machines_clock_is_never_early_and_misses_are_accounted_for() {
    const PERIOD_NS: u64 = 200_000;
    let waker = Arc::new(Waker::new());
    let mut pacer = grid(PERIOD_NS, 0, 0);
    let first = pacer.next(&*waker, || false).unwrap().deadline_ns;
    let mut skipped = 0;
    for executed in 1..=20 {
        let cycle = pacer.next(&*waker, || false).unwrap();
        assert!(cycle.begin_ns >= cycle.deadline_ns && now_ns() >= cycle.begin_ns, "{cycle:?}");
        skipped += cycle.skipped;
        assert_eq!(cycle.deadline_ns, first + (executed + skipped) * PERIOD_NS);
    }
    waker.notify();
    pacer.rest(&*waker);
}

proptest! {
    #[test]
    fn executed_and_skipped_cycles_add_up_to_the_elapsed_periods(
        start in 0..1u64 << 60,
        period in 1..10_000_000u64,
        phase in 0..20_000_000u64,
        catch_up in 0..5u32,
        cycles in prop::collection::vec((0..40_000_000u64, 0..5_000_000u64, prop::option::of(0..10_000_000u64)), 1..60),
    ) {
        let clock = ManualClock::at(start);
        let mut pacer = grid(period, phase, catch_up);
        let (mut executed, mut skipped, mut first) = (0, 0, None);
        for (compute, late, wake) in cycles {
            clock.late_ns.set(late);
            clock.wakes.borrow_mut().extend(wake);
            let cycle = loop {
                let asleep_since = clock.now_ns();
                match next(&mut pacer, &clock) {
                    Some(cycle) => break cycle,
                    None => prop_assert!(clock.now_ns() - asleep_since < period, "slept past a deadline"),
                }
            };
            executed += 1;
            skipped += cycle.skipped;
            let first = *first.get_or_insert(cycle.deadline_ns - cycle.skipped * period);
            prop_assert_eq!(first % period, phase % period);
            prop_assert_eq!(cycle.deadline_ns, first + (executed + skipped - 1) * period, "drift");
            prop_assert!(cycle.begin_ns >= cycle.deadline_ns, "early");
            prop_assert_eq!(cycle.begin_ns, clock.now_ns());
            let behind = (cycle.begin_ns - cycle.deadline_ns) / period;
            prop_assert!(behind <= u64::from(catch_up), "{} periods behind", behind);
            prop_assert!(cycle.skipped == 0 || behind == u64::from(catch_up), "skipped what was to be caught up");
            clock.pass(compute);
        }
    }
}
