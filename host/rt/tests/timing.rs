//! The grid never drifts and accounts for every period; the statistics say what happened.
#![allow(clippy::unwrap_used)]

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use proptest::prelude::*;
use trocar_rt::timing::{CycleStats, Grid, Histogram};

#[test]
fn deadlines_lie_on_the_grid_of_start_phase_and_period() {
    let mut grid = Grid::new(1_000, 100, 30);
    assert_eq!(grid.deadline(), 1_030);
    assert_eq!(grid.advance(1_035), 0);
    assert_eq!((grid.deadline(), grid.cycle()), (1_130, 1));
}

#[test]
fn a_cycle_that_is_late_but_not_over_is_executed() {
    let mut grid = Grid::new(0, 100, 0);
    assert_eq!(grid.advance(199), 0);
    assert_eq!(grid.deadline(), 100);
}

#[test]
fn cycles_that_are_wholly_over_are_skipped() {
    let mut grid = Grid::new(0, 100, 0);
    assert_eq!(grid.advance(350), 2);
    assert_eq!(grid.deadline(), 300);
}

#[test]
fn catching_up_executes_some_of_the_missed_cycles() {
    let mut grid = Grid::new(0, 100, 0);
    assert_eq!(grid.advance_catching_up(1_050, 3), 6);
    assert_eq!(grid.deadline(), 700);
    assert_eq!(grid.advance_catching_up(1_051, 3), 0);
    assert_eq!(grid.deadline(), 800);
}

proptest! {
    #[test]
    fn executed_and_skipped_cycles_add_up_to_the_elapsed_periods(
        start in 0..1u64 << 60,
        period in 1..10_000_000u64,
        phase in 0..10_000_000u64,
        catch_up in 0..4u64,
        steps in prop::collection::vec(0..40_000_000u64, 1..50),
    ) {
        let mut grid = Grid::new(start, period, phase);
        let mut now = start;
        let (mut executed, mut skipped) = (0, 0);
        for step in steps {
            now = now.max(grid.deadline()) + step;
            executed += 1;
            skipped += grid.advance_catching_up(now, catch_up);
            prop_assert_eq!(grid.cycle(), executed + skipped);
            prop_assert_eq!(grid.deadline(), start + phase + (executed + skipped) * period, "drift");
            let behind = now.saturating_sub(grid.deadline()) / period;
            prop_assert!(behind <= catch_up, "{} periods behind", behind);
        }
    }

    #[test]
    fn a_percentile_is_right_within_one_bucket(mut values in prop::collection::vec(0..1u64 << 41, 1..200), q in 0.0..1.0f64) {
        let histogram = Histogram::new();
        values.iter().for_each(|&v| histogram.record(v));
        values.sort_unstable();
        let rank = ((values.len() as f64 * q).ceil() as usize).max(1);
        let exact = values[rank - 1];
        let got = histogram.percentile(q);
        prop_assert!(got >= exact && got <= exact + exact / 31 + 1, "{} instead of {}", got, exact);
        prop_assert_eq!(histogram.percentile(1.0), *values.last().unwrap());
    }
}

#[test]
fn an_empty_histogram_answers_zero() {
    let histogram = Histogram::new();
    assert_eq!((histogram.percentile(0.99), histogram.max(), histogram.count()), (0, 0, 0));
}

#[test]
fn durations_beyond_the_last_bucket_are_counted() {
    let histogram = Histogram::new();
    histogram.record(u64::MAX);
    assert_eq!((histogram.count(), histogram.max()), (1, u64::MAX));
}

#[test]
fn statistics_of_known_cycles_are_exact() {
    let stats = CycleStats::new(1_000);
    for (start, compute, lateness) in [(0, 200, 0), (1_000, 400, 10), (2_200, 900, 200)] {
        stats.record(start, start + compute, lateness);
    }
    stats.record_skipped(2);
    let s = stats.snapshot();
    assert_eq!((s.executed, s.skipped, s.overruns), (3, 2, 1));
    assert_eq!((s.period.avg_ns, s.period.min_ns, s.period.max_ns), (1_100.0, 1_000, 1_200));
    assert!((s.period.std_ns - 141.421).abs() < 0.001, "{}", s.period.std_ns);
    assert_eq!((s.compute.avg_ns, s.compute.min_ns, s.compute.max_ns), (500.0, 200, 900));
    assert_eq!(s.lateness_max_ns, 200);
    assert!((s.load - 500.0 / 1_100.0).abs() < 1e-12);
}

#[test]
fn a_pause_is_not_a_period() {
    let stats = CycleStats::new(1_000);
    stats.record(0, 1, 0);
    stats.pause();
    stats.record(50_000, 50_001, 0);
    stats.record(51_000, 51_001, 0);
    assert_eq!(stats.snapshot().period.max_ns, 1_000);
}

#[test]
fn statistics_before_the_first_cycle_are_zero() {
    let s = CycleStats::new(0).snapshot();
    assert_eq!((s.executed, s.load, s.period.avg_ns), (0, 0.0, 0.0));
}

#[test]
fn a_snapshot_beside_a_running_executor_is_of_one_moment() {
    let stats = CycleStats::new(10);
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(Ordering::Relaxed) {
                let s = stats.snapshot();
                // Every cycle is an overrun and starts 20 ns after the last one.
                assert_eq!(s.executed, s.overruns, "{s:?}");
                assert!(s.executed < 2 || (s.period.min_ns, s.period.max_ns) == (20, 20), "{s:?}");
            }
        });
        (0..100_000).for_each(|n| stats.record(n * 20, n * 20 + 15, 0));
        stop.store(true, Ordering::Relaxed);
    });
    assert_eq!(stats.snapshot().executed, 100_000);
}
