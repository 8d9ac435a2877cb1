//! Teams: done means done, for their owner and for a caller that comes in between.

use std::sync::Arc;

use loom::thread;

use super::{Plain, model_within};
use crate::team::Team;

/// Jobs after each other whose data live on the owner's stack: a helper that comes late must not touch the
/// next job with the last one's, and the owner must see what every slice wrote.
fn a_team_is_done_when_it_says_so(preemptions: usize, threads: usize, jobs: u64) {
    model_within(preemptions, move || {
        let team = Team::new(threads, |_| {}).unwrap();
        for job in 1..=jobs {
            let slices = [Plain::new(), Plain::new()];
            let status = team.run(2, &|slice| {
                let mine = &slices[slice as usize];
                mine.set(mine.get() + job);
                if slice == 1 { -3 } else { 0 }
            });
            assert_eq!(status, -3);
            assert!(slices.iter().all(|s| s.get() == job), "each slice runs once");
        }
    });
}

#[test]
fn loom_a_team_of_two_is_done_when_it_says_so() {
    a_team_is_done_when_it_says_so(3, 2, 2);
}

#[test]
fn loom_a_team_of_three_is_done_when_it_says_so() {
    a_team_is_done_when_it_says_so(1, 3, 1);
}

/// A caller that comes while a job is at work runs alone; one that comes after it finds the team as if it
/// were new.
#[test]
fn loom_two_callers_of_a_team_keep_out_of_each_others_way() {
    model_within(1, || {
        let team = Arc::new(Team::new(2, |_| {}).unwrap());
        let run = |team: &Team| {
            let slices = [Plain::new(), Plain::new()];
            let status = team.run(2, &|slice| {
                slices[slice as usize].set(slices[slice as usize].get() + 1);
                0
            });
            assert_eq!(status, 0);
            assert!(slices.iter().all(|s| s.get() == 1), "each slice runs once");
        };
        let other = Arc::clone(&team);
        let thread = thread::spawn(move || run(&other));
        run(&team);
        thread.join().unwrap();
    });
}
