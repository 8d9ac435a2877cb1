//! Seeds shared out among processes, which play at the same time.
//!
//! Invariant: each is the very test that shares them out, played on its part: threads, files and memory are
//! counted for a process as a whole, so what plays at the same time has processes of its own.

use std::env;
use std::process::{Command, Output, Stdio};
use std::thread;

/// Which part a process plays, as `1/2`: the second of two.
const PART: &str = "TROCAR_SEED_PART";
/// More processes than this wait for each other.
const MOST: usize = 4;

/// The part this process is to play; `None` where nobody has shared out yet.
pub(super) fn part() -> Option<(u64, u64)> {
    let text = env::var(PART).ok()?;
    let numbers = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    match numbers {
        Some((k, n)) if k < n => Some((k, n)),
        _ => panic!("{PART}={text}: it is a part and how many there are, as 0/2"),
    }
}

/// Plays each part of `test`, by its full name, in a process of its own, and says what those that failed
/// said.
///
/// # Panics
/// One of them failed.
pub(super) fn share_out(test: &str) {
    let parts = thread::available_parallelism().map_or(2, usize::from).min(MOST);
    let ends: Vec<Output> = thread::scope(|scope| {
        let played: Vec<_> = (0..parts).map(|k| scope.spawn(move || play(test, k, parts))).collect();
        played.into_iter().map(|one| one.join().expect("whoever waits for a part comes back")).collect()
    });
    let mut failed = Vec::new();
    for (k, end) in ends.iter().enumerate() {
        let said = String::from_utf8_lossy(&end.stdout);
        // A name that fits no test would be played without a failure.
        if end.status.success() && said.contains("1 passed") {
            // What is printed in a test stands behind libtest's own words.
            let figures = said.lines().filter(|line| line.contains(" seeds, "));
            figures.for_each(|line| println!("{}", line.rsplit(" ... ").next().unwrap_or_default()));
            continue;
        }
        failed.push(format!("part {k}/{parts}: {}", end.status));
        eprintln!("-- part {k}/{parts} of {test}\n{said}{}", String::from_utf8_lossy(&end.stderr));
    }
    assert!(failed.is_empty(), "{test}: {}", failed.join(", "));
}

fn play(test: &str, k: usize, parts: usize) -> Output {
    let own = env::current_exe().expect("a running test has a file");
    let mut command = Command::new(own);
    command.args([test, "--exact", "--nocapture", "--test-threads=1"]);
    let child = command.env(PART, format!("{k}/{parts}")).stdin(Stdio::null()).output();
    child.unwrap_or_else(|e| panic!("part {k}/{parts} of {test} cannot be started: {e}"))
}
