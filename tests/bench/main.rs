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
mod rebinding;
mod steps;
mod table;

use table::Table;

/// Length of the 1 kHz run unless told otherwise, s.
const SECONDS: u64 = 60;
const SUBJECTS: [&str; 7] = ["inline", "queued", "steps", "frames", "rebinding", "grid", "spine"];

fn main() {
    let (mut seconds, mut wanted) = (SECONDS, Vec::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        if arg == "--seconds" {
            seconds =
                args.next().and_then(|n| n.parse().ok()).unwrap_or_else(|| wrong("--seconds wants a number"));
        } else if SUBJECTS.contains(&arg.as_str()) {
            wanted.push(arg);
        } else {
            wrong(&format!("there is no subject {arg}; there are {}", SUBJECTS.join(", ")));
        }
    }
    for subject in SUBJECTS.into_iter().filter(|s| wanted.is_empty() || wanted.iter().any(|w| w == s)) {
        let mut table = Table::default();
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
            _ => {
                loading::measure(&mut table);
                grpc::measure(&mut table);
            }
        }
        print!("{}", table.text);
    }
}

fn wrong(why: &str) -> ! {
    eprintln!("bench: {why}");
    std::process::exit(2)
}
