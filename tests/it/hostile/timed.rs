//! The time that `trocar stop` takes beside callers that connect and say nothing.
//!
//! Promise: 50 ms at most for 99 of 100, the program's own start included, beside more callers than the host
//! may have files. Only `./tests/run --times` runs this test.

use std::time::{Duration, Instant};

use trocar_tests::{HostProcess, Trocar, World, skip};

use super::silent::{CALLERS, Crowd};

/// Stops of each kind, in rounds: a caller that says nothing is let go after ten seconds.
const ROUNDS: usize = 10;
const STOPS: usize = 30;
const MOST: Duration = Duration::from_millis(50);

#[test]
fn ninety_nine_of_a_hundred_stops_get_through_in_50_ms_beside_a_thousand_silent_callers() {
    let Some((world, host)) = super::silent::few_files() else {
        skip("this machine lets a program open too few files to play so many callers");
        return;
    };
    let alone = times(&world, &host);
    let mut crowded = Vec::new();
    for _ in 0..ROUNDS {
        let _crowd = Crowd::at(&host);
        crowded.extend(times(&world, &host));
    }
    let (alone, crowded) = (p99(alone), p99(crowded));
    println!("figure: p99 of trocar stop: {alone:.1?} alone, {crowded:.1?} beside {CALLERS} silent callers");
    assert!(crowded <= MOST, "{crowded:.1?} at p99, {alone:.1?} alone");
}

/// The times of so many stops of a running component.
fn times(world: &World, host: &HostProcess) -> Vec<Duration> {
    let trocar = Trocar::at(world, host.address());
    trocar.run(&["stop", "host/server"]).ends_with(0);
    (0..STOPS)
        .map(|_| {
            trocar.run(&["start", "host/server"]).ends_with(0);
            let begin = Instant::now();
            trocar.run(&["stop", "host/server"]).ends_with(0);
            begin.elapsed()
        })
        .collect()
}

fn p99(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() * 99 / 100]
}
