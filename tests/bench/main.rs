//! What trocar costs, as ratios measured in one run: `bench [--seconds N] [SUBJECT…]`.
//!
//! Invariant: every figure stands beside a baseline of the same run on the same machine; nothing here passes or fails.

mod baseline;
mod calls;
mod frames;
mod grid;
mod grpc;
mod lab;
mod loading;
mod processes;
mod rebinding;
mod steps;
mod table;

use processes::{allocations, bare};
use table::Table;

/// Length of the 1 kHz run unless told otherwise, s.
const SECONDS: u64 = 60;
const SUBJECTS: [&str; 12] = [
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
];

fn main() {
    let (mut seconds, mut wanted) = (SECONDS, Vec::new());
    let mut args = std::env::args().skip(1).peekable();
    if args.next_if(|first| first == bare::OTHER_END).is_some() {
        return bare::run_other_end(&args.collect::<Vec<_>>());
    }
    if args.next_if(|first| first == allocations::HOST).is_some() {
        return allocations::run_host(&args.collect::<Vec<_>>());
    }
    while let Some(arg) = args.next() {
        if arg == "--seconds" {
            seconds =
                args.next().and_then(|n| n.parse().ok()).unwrap_or_else(|| wrong("--seconds wants a number"));
        } else if SUBJECTS.iter().any(|subject| is_of(subject, &arg)) {
            wanted.push(arg);
        } else {
            wrong(&format!("there is no subject {arg}; there are {}", SUBJECTS.join(", ")));
        }
    }
    let mut table = Table;
    for subject in SUBJECTS.into_iter().filter(|s| wanted.is_empty() || wanted.iter().any(|w| is_of(s, w))) {
        match subject {
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
            _ => processes::measure(subject, &mut table),
        }
    }
}

/// A subject, or all of a name before its `/`.
fn is_of(subject: &str, wanted: &str) -> bool {
    subject == wanted || subject.strip_prefix(wanted).is_some_and(|rest| rest.starts_with('/'))
}

fn wrong(why: &str) -> ! {
    eprintln!("bench: {why}");
    std::process::exit(2)
}
