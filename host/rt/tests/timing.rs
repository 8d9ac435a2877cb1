//! The grid never drifts and accounts for every period; the statistics say what happened.
#![allow(clippy::unwrap_used)]

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use proptest::prelude::*;
use trocar_rt::timing::{CycleStats, Due, Grid, Histogram};

fn due(cycle: u64, deadline_ns: u64, skipped: u64) -> Option<Due> {
    Some(Due { cycle, deadline_ns, skipped })
}

#[test]
fn deadlines_lie_on_the_grid_of_start_phase_and_period() {
    let mut grid = Grid::new(1_000, 100, 30);
    assert_eq!(grid.begin(1_029, 0), None, "not due yet");
    assert_eq!(grid.begin(1_035, 0), due(0, 1_030, 0));
    assert_eq!((grid.deadline(), grid.cycle()), (1_130, 1));
}

#[test]
fn a_cycle_that_is_late_but_not_over_is_executed() {
    let mut grid = Grid::new(0, 100, 0);
    assert_eq!(grid.begin(99, 0), due(0, 0, 0));
    assert_eq!(grid.begin(199, 0), due(1, 100, 0));
}

#[test]
fn cycles_that_are_wholly_over_are_skipped() {
    let mut grid = Grid::new(0, 100, 0);
    assert_eq!(grid.begin(0, 0), due(0, 0, 0));
    assert_eq!(grid.begin(350, 0), due(3, 300, 2));
    assert_eq!(grid.deadline(), 400);
}

#[test]
fn catching_up_executes_some_of_the_missed_cycles() {
    let mut grid = Grid::new(0, 100, 0);
    assert_eq!(grid.begin(1_050, 3), due(7, 700, 7));
    assert_eq!(grid.begin(1_051, 3), due(8, 800, 0));
    assert_eq!(grid.deadline(), 900);
}

#[test]
fn a_grid_on_the_clock_begins_at_the_next_multiple_plus_phase() {
    for (now, phase, first) in
        [(0, 0, 0), (1, 0, 100), (100, 0, 100), (101, 230, 130), (5, 30, 30), (31, 30, 130)]
    {
        assert_eq!(Grid::on_clock(now, 100, phase).deadline(), first, "from {now} with phase {phase}");
    }
}

proptest! {
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

#[test]
fn a_reset_leaves_only_what_comes_after_it() {
    let stats = CycleStats::new(1_000);
    for start in [0, 5_000, 90_000] {
        stats.record(start, start + 3_000, 700);
    }
    stats.record_skipped(9);
    stats.reset(50);
    assert_eq!(stats.snapshot(), CycleStats::new(0).snapshot(), "as if new");
    stats.record(200_000, 200_040, 0);
    stats.record(200_050, 200_110, 2);
    let s = stats.snapshot();
    assert_eq!((s.executed, s.skipped, s.overruns, s.lateness_max_ns), (2, 0, 1, 2));
    assert_eq!((s.period.min_ns, s.period.max_ns), (50, 50), "the time before the reset is no period");
}

#[test]
fn resets_beside_a_reader_never_show_a_mixture_of_sums() {
    let stats = CycleStats::new(10);
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(Ordering::Relaxed) {
                let s = stats.snapshot();
                assert_eq!(s.executed, s.overruns, "{s:?}");
                assert!(s.executed <= 100, "{s:?}");
            }
        });
        for n in 0..50_000u64 {
            if n % 100 == 0 {
                stats.reset(10);
            }
            stats.record(n * 20, n * 20 + 15, 0);
        }
        stop.store(true, Ordering::Relaxed);
    });
}
