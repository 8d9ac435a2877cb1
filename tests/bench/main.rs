//! Costs of trocar, as ratios measured in one run: `bench [--seconds N] [SUBJECT…]`; and whether a surgical
//! system holds its gates under its full load: `bench [--seconds N] [--kills N] eyesaw`.
//!
//! Invariant: every figure stands beside a baseline of the same run on the same machine; only what is called
//! `eyesaw` passes or fails, and runs only when it is named.

mod baseline;
mod calls;
mod eyesaw;
mod frames;
mod grid;
mod grpc;
mod lab;
mod loading;
mod machines;
mod processes;
mod rebinding;
mod steps;
mod table;

use std::process::ExitCode;

use eyesaw::{Amount, Verdicts};
use processes::{allocations, bare};
use table::Table;

/// Length of the 1 kHz run unless told otherwise, s.
const SECONDS: u64 = 60;
/// Processes killed unless told otherwise.
const KILLS: usize = 50;
const SUBJECTS: [&str; 20] = [
    "inline",
    "queued",
    "steps",
    "frames",
    "rebinding",
    "grid",
    "spine",
    "processes/samples",
    "processes/calls",
    "processes/links",
    "processes/crash",
    "processes/allocations",
    "machines/samples",
    "machines/beside",
    "eyesaw/load",
    "eyesaw/spectra",
    "eyesaw/scan",
    "eyesaw/depth",
    "eyesaw/stop",
    "eyesaw/recording",
];

fn main() -> ExitCode {
    let (mut seconds, mut kills, mut wanted) = (SECONDS, KILLS, Vec::new());
    let mut args = std::env::args().skip(1).peekable();
    if args.next_if(|first| first == bare::OTHER_END).is_some() {
        bare::run_other_end(&args.collect::<Vec<_>>());
        return ExitCode::SUCCESS;
    }
    if args.next_if(|first| first == machines::bare::OTHER_END).is_some() {
        machines::bare::run_other_end(&args.collect::<Vec<_>>());
        return ExitCode::SUCCESS;
    }
    if args.next_if(|first| first == machines::INSIDE).is_some() {
        machines::run_inside();
        return ExitCode::SUCCESS;
    }
    if args.next_if(|first| first == allocations::HOST).is_some() {
        allocations::run_host(&args.collect::<Vec<_>>());
        return ExitCode::SUCCESS;
    }
    while let Some(arg) = args.next() {
        if arg == "--seconds" {
            seconds = number(&mut args, "--seconds wants a number");
        } else if arg == "--kills" {
            kills = number(&mut args, "--kills wants a number") as usize;
        } else if SUBJECTS.iter().any(|subject| is_of(subject, &arg)) {
            wanted.push(arg);
        } else {
            wrong(&format!("there is no subject {arg}; there are {}", SUBJECTS.join(", ")));
        }
    }
    if seconds == 0 || kills == 0 {
        wrong("--seconds and --kills are at least 1");
    }
    let mut table = Table;
    let mut judged = None;
    let named = |subject: &str| wanted.iter().any(|w| is_of(subject, w));
    let chosen = |subject: &&str| named(subject) || (wanted.is_empty() && !is_of(subject, "eyesaw"));
    for subject in SUBJECTS.into_iter().filter(chosen) {
        match subject {
            subject if is_of(subject, "eyesaw") => {
                let verdicts = judged.get_or_insert_with(Verdicts::default);
                eyesaw::measure(subject, verdicts, Amount { seconds, kills });
            }
            "inline" => {
                calls::inline(&mut table);
                calls::chain(&mut table);
            }
            "queued" => calls::queued(&mut table),
            "steps" => steps::measure(&mut table),
            "frames" => frames::measure(&mut table),
            "rebinding" => rebinding::measure(&mut table),
            "grid" => grid::measure(&mut table, seconds),
            "spine" => {
                loading::measure(&mut table);
                grpc::measure(&mut table);
            }
            subject if is_of(subject, "machines") => machines::measure(subject, &mut table),
            _ => processes::measure(subject, &mut table),
        }
    }
    if judged.is_none_or(Verdicts::end) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn number(args: &mut impl Iterator<Item = String>, otherwise: &str) -> u64 {
    args.next().and_then(|n| n.parse().ok()).unwrap_or_else(|| wrong(otherwise))
}

/// A subject, or all of a name before its `/`.
fn is_of(subject: &str, wanted: &str) -> bool {
    subject == wanted || subject.strip_prefix(wanted).is_some_and(|rest| rest.starts_with('/'))
}

fn wrong(why: &str) -> ! {
    eprintln!("bench: {why}");
    std::process::exit(2)
}
