//! Throughput of a recorder's writer beside the crate `mcap` alone, one JSON object: `cargo run --release -p trocar-recorder
//! --example throughput -- DIRECTORY`.
//!
//! Invariant: both take turns on one machine in one run, and the least time of each counts.

use std::path::PathBuf;

use trocar_recorder::bench::{bare, ours};

const TURNS: u32 = 5;

fn main() -> std::io::Result<()> {
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
        println!(
            "{{\"bytes\": {len}, \"recorder_mb_s\": {:.0}, \"bare_mb_s\": {:.0}, \"ratio\": {:.2}}}",
            megabytes / least[0],
            megabytes / least[1],
            least[1] / least[0],
        );
    }
    Ok(())
}
