//! A team runs every slice exactly once, is done when `run` returns, and answers the first failure.
#![allow(clippy::unwrap_used)]

use std::collections::HashSet;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, Mutex};
use std::thread;

use trocar_rt::team::{MAX_THREADS, PANICKED, Team};

fn team(threads: usize) -> Team {
    Team::new(threads, |_| {}).unwrap()
}

#[test]
fn every_slice_runs_exactly_once_whatever_the_numbers() {
    for threads in [0, 1, 2, 3, 5] {
        let team = team(threads);
        assert_eq!(team.threads(), threads.max(1));
        for slices in [0, 1, 2, 7, 64] {
            let runs: Vec<_> = (0..slices).map(|_| AtomicU32::new(0)).collect();
            let status = team.run(slices, &|slice| {
                runs[slice as usize].fetch_add(1, Ordering::Relaxed);
                slice as i32
            });
            assert_eq!(status, 0, "only failures are answered");
            assert!(runs.iter().all(|r| r.load(Ordering::Relaxed) == 1), "{threads} threads: {runs:?}");
        }
    }
}

#[test]
fn what_the_slices_wrote_is_there_when_run_returns_job_after_job() {
    let team = team(3);
    for job in 0..20_000u32 {
        // On the stack: a helper that came late would write into the next turn's.
        let written: [AtomicU32; 4] = [const { AtomicU32::new(0) }; 4];
        let status = team.run(4, &|slice| {
            written[slice as usize].store(job + slice + 1, Ordering::Relaxed);
            0
        });
        assert_eq!(status, 0);
        for (slice, value) in (0..).zip(&written) {
            assert_eq!(value.load(Ordering::Relaxed), job + slice + 1, "slice {slice} of job {job}");
        }
    }
}

#[test]
fn slices_run_on_several_threads_at_once() {
    let team = team(3);
    let together = Barrier::new(3);
    let threads = Mutex::new(HashSet::new());
    team.run(3, &|_| {
        // Passes only when three slices are inside at the same time.
        together.wait();
        threads.lock().unwrap().insert(thread::current().id());
        0
    });
    let threads = threads.into_inner().unwrap();
    assert_eq!(threads.len(), 3);
    assert!(threads.contains(&thread::current().id()), "the caller works too");
}

#[test]
fn the_first_failure_is_answered_and_the_other_slices_run_all_the_same() {
    for threads in [1, 3] {
        let team = team(threads);
        let runs = AtomicU32::new(0);
        let status = team.run(9, &|slice| {
            runs.fetch_add(1, Ordering::Relaxed);
            if slice == 4 { -7 } else { 3 }
        });
        assert_eq!((status, runs.into_inner()), (-7, 9), "{threads} threads");
        assert_eq!(team.run(2, &|_| 0), 0, "a failure belongs to its job");
    }
    assert_eq!(team(1).run(5, &|slice| -1 - slice as i32), -1, "alone, the lowest slice fails first");
}

#[test]
fn a_slice_that_panics_is_a_failure_and_the_team_goes_on() {
    for threads in [1, 2, 4] {
        let team = team(threads);
        let runs = AtomicU32::new(0);
        let status = team.run(8, &|slice| {
            runs.fetch_add(1, Ordering::Relaxed);
            assert_ne!(slice, 3, "on purpose");
            0
        });
        assert_eq!((status, runs.into_inner()), (PANICKED, 8));
        assert_eq!(team.run(8, &|_| 0), 0);
    }
}

#[test]
fn a_run_inside_a_slice_stays_in_its_thread() {
    let team = team(2);
    let runs = AtomicU32::new(0);
    let status = team.run(3, &|_| {
        let outer = thread::current().id();
        team.run(4, &|_| {
            runs.fetch_add(1, Ordering::Relaxed);
            if thread::current().id() == outer { 0 } else { -1 }
        })
    });
    assert_eq!((status, runs.into_inner()), (0, 12));
}

#[test]
fn two_callers_at_once_get_their_own_work_done() {
    let team = team(2);
    thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                for _ in 0..2_000 {
                    let mine = AtomicU32::new(0);
                    team.run(3, &|slice| {
                        mine.fetch_add(1 << (8 * slice), Ordering::Relaxed);
                        0
                    });
                    assert_eq!(mine.into_inner(), 0x01_01_01);
                }
            });
        }
    });
}

#[test]
fn every_helper_is_set_up_once_and_all_end_with_the_team() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let alive = Arc::new(AtomicUsize::new(0));
    let (noted, counted) = (Arc::clone(&seen), Arc::clone(&alive));
    let team = Team::new(4, move |helper| {
        let _keeps = Arc::clone(&counted);
        noted.lock().unwrap().push(helper);
    })
    .unwrap();
    team.run(16, &|_| 0);
    drop(team);
    let mut seen = seen.lock().unwrap().clone();
    seen.sort_unstable();
    assert_eq!(seen, [1, 2, 3]);
    assert_eq!(Arc::strong_count(&alive), 1, "a helper outlived its team");
}

#[test]
fn helpers_that_end_in_their_setup_leave_the_work_to_the_others() {
    let team = Team::new(3, |helper| assert_ne!(helper, 1, "on purpose")).unwrap();
    for _ in 0..100 {
        assert_eq!(team.run(4, &|_| 0), 0);
    }
}

#[test]
fn an_absurd_number_of_threads_is_refused_with_the_limit() {
    let error = Team::new(usize::MAX, |_| {}).err().unwrap().to_string();
    assert!(error.contains(&MAX_THREADS.to_string()), "{error}");
}
