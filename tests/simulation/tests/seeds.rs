//! The seeds of the gate: a fixed choice. Others are played by hand (`--seed`, `--events`).

use std::process::{Command, Output};

/// Events of the gate, some hundred seeds.
const EVENTS: &str = "10_000_000";

fn simulation(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_simulation")).args(words).output().expect("the simulation runs")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn nothing_that_must_not_happen_does_among_millions_of_events() {
    let run = simulation(&["--seed", "1", "--events", EVENTS]);
    println!("{}", said(&run));
    assert!(run.status.success(), "{}", said(&run));
}

#[test]
fn a_seed_is_the_same_run_each_time() {
    let (once, again) = (simulation(&["--of", "1"]), simulation(&["--of", "1"]));
    assert!(once.status.success(), "{}", said(&once));
    assert_eq!(said(&once), said(&again));
    assert_ne!(said(&once), said(&simulation(&["--of", "2"])));
}

#[test]
fn words_that_it_does_not_know_are_refused() {
    let run = simulation(&["--evnts", "5"]);
    assert_eq!((run.status.code(), said(&run).starts_with("usage")), (Some(2), true));
}
