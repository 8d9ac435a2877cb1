//! Runs seeds until so many events have happened, each in a process of its own: `simulation [--seed N]
//! [--events N]`, or tells all that happens in one: `simulation --tell SEED`.

use std::collections::BTreeMap;
use std::process::{Command, ExitCode};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Begins a line that says how often something has happened.
const COUNT: &str = "  ";

/// Events of one seed, about: it ends at the next rest.
const OF_SEED: u64 = 20_000;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |name: &str, default: Option<u64>| {
        let at = words.iter().position(|word| word == name);
        let said = at.and_then(|at| words.get(at + 1)).map(|text| text.replace('_', ""));
        said.map_or(default, |text| text.parse::<f64>().ok().map(|number| number as u64))
    };
    if let Some(seed) = number("--of", None) {
        return one(seed, false);
    }
    if let Some(seed) = number("--tell", None) {
        return one(seed, true);
    }
    let known = ["--seed", "--events"];
    let (Some(first), Some(events), true) = (
        number("--seed", Some(1)),
        number("--events", Some(10_000_000)),
        words.iter().step_by(2).all(|word| known.contains(&word.as_str())),
    ) else {
        eprintln!("usage: simulation [--seed N] [--events N], or simulation --tell SEED");
        return ExitCode::from(2);
    };
    many(first, events)
}

/// Runs one seed and says how it ended.
fn one(seed: u64, is_told: bool) -> ExitCode {
    let ended = trocar_simulation::run(seed, OF_SEED, is_told);
    println!("{} {:016x}", ended.events, ended.hash);
    ended.counts.iter().for_each(|(kind, number)| println!("{COUNT}{number} {kind}"));
    let Some(violation) = ended.violation else { return ExitCode::SUCCESS };
    println!("seed {seed}, event {}: {violation}", ended.events);
    ExitCode::FAILURE
}

/// Runs seeds on every processor. What libraries count for a whole process would make a seed depend on those
/// before it.
fn many(first: u64, events: u64) -> ExitCode {
    let (next, done, failed) = (AtomicU64::new(first), AtomicU64::new(0), Mutex::new(None));
    let counts = Mutex::new(BTreeMap::new());
    let began = Instant::now();
    let lanes = std::thread::available_parallelism().map_or(1, usize::from);
    let lane = || {
        while done.load(Ordering::Relaxed) < events && failed.lock().is_ok_and(|failed| failed.is_none()) {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            let said = std::env::current_exe()
                .and_then(|program| Command::new(program).args(["--of", &seed.to_string()]).output());
            let failure = match said {
                Ok(said) => {
                    let text = String::from_utf8_lossy(&said.stdout).into_owned();
                    let events = text.split(' ').next().and_then(|events| events.parse().ok()).unwrap_or(0);
                    done.fetch_add(events, Ordering::Relaxed);
                    if let Ok(mut counts) = counts.lock() {
                        add(&mut counts, &text);
                    }
                    let why = text + &String::from_utf8_lossy(&said.stderr);
                    (!said.status.success()).then(|| format!("{why}seed {seed}: {}", said.status))
                }
                Err(e) => Some(format!("seed {seed} cannot be run: {e}")),
            };
            if let (Some(failure), Ok(mut failed)) = (failure, failed.lock()) {
                failed.get_or_insert(failure);
            }
        }
    };
    std::thread::scope(|scope| (0..lanes).for_each(|_| _ = scope.spawn(lane)));
    let (events, s) = (done.into_inner(), began.elapsed().as_secs_f64());
    println!("{events} events, seeds {first}..{}, {s:.1} s", next.into_inner());
    let counts = counts.into_inner().unwrap_or_default();
    counts.iter().for_each(|(kind, number)| println!("{COUNT}{number} {kind}"));
    let failed = failed.into_inner().ok().flatten();
    if let Some(failure) = failed {
        println!("{failure}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

/// Adds what a seed says of how often things have happened in it.
fn add(counts: &mut BTreeMap<String, u64>, said: &str) {
    for line in said.lines().filter_map(|line| line.strip_prefix(COUNT)) {
        if let Some((number, kind)) = line.split_once(' ') {
            *counts.entry(kind.to_owned()).or_default() += number.parse::<u64>().unwrap_or_default();
        }
    }
}
