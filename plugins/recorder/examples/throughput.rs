//! Throughput of a recorder's writer beside the crate `mcap` alone, a JSON object for each length of a
//! message: `cargo run --release -p trocar-recorder --example throughput -- DIRECTORY`. Ends as libtest does,
//! since `tests/run recorder_times` counts by that.
//!
//! Invariant: both take turns on one machine in one run, and the least time of each counts.

use std::path::PathBuf;
use std::process::ExitCode;

use trocar_recorder::bench::{bare, ours};

const TURNS: u32 = 5;
/// Least rate, as a share of what the crate alone writes in the same time.
const RATIO: f64 = 0.9;

fn main() -> std::io::Result<ExitCode> {
    let (mut passed, mut failed) = (0, 0);
    let directory = std::env::args_os().nth(1).map_or_else(std::env::temp_dir, PathBuf::from);
    let path = directory.join(format!("throughput-{}.mcap", std::process::id()));
    for (n, len) in [(1_000_000u64, 64usize), (100_000, 4096), (400, 1024 * 768 * 3)] {
        let mut least = [f64::INFINITY; 2];
        for _ in 0..TURNS {
            for (least, side) in least.iter_mut().zip([ours, bare]) {
                *least = least.min(side(&path, n, len)?);
                std::fs::remove_file(&path)?;
            }
        }
        let megabytes = n as f64 * len as f64 * 1e-6;
        let ratio = least[1] / least[0];
        println!(
            "{{\"bytes\": {len}, \"recorder_mb_s\": {:.0}, \"bare_mb_s\": {:.0}, \"ratio\": {ratio:.2}}}",
            megabytes / least[0],
            megabytes / least[1],
        );
        if ratio >= RATIO {
            passed += 1;
        } else {
            failed += 1;
            println!(
                "test messages of {len} bytes: {ratio:.2} of what the crate alone writes, at least {RATIO} wanted ... FAILED"
            );
        }
    }
    let word = if failed == 0 { "ok" } else { "FAILED" };
    println!("test result: {word}. {passed} passed; {failed} failed; 0 ignored");
    Ok(ExitCode::from(u8::from(failed > 0)))
}
