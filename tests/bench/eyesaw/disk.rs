//! Which processor the disk interrupts: each of its answers takes whoever runs there some 20 µs.
//!
//! Invariant: found by writing, for names of devices and their settings differ from machine to machine.

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

/// Written and waited for so often, bytes.
const WRITES: usize = 64;
const BYTES: usize = 64 << 10;

/// The processor that took most of the interrupts of the device that had most of them while a file was
/// written there; 0 where none had any.
pub(super) fn interrupted_processor(directory: &Path) -> usize {
    let path = directory.join("interrupts");
    let before = counts();
    let mut file = File::create_new(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    for _ in 0..WRITES {
        file.write_all(&[7; BYTES]).and_then(|()| file.sync_data()).expect("room on the disk");
    }
    let after = counts();
    fs::remove_file(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let grown = after.iter().filter_map(|(device, now)| {
        let then = before.iter().find(|(name, _)| name == device).map(|(_, counts)| counts)?;
        let by: Vec<u64> = now.iter().zip(then).map(|(now, then)| now.saturating_sub(*then)).collect();
        Some(by)
    });
    let most = grown.max_by_key(|by| by.iter().sum::<u64>()).unwrap_or_default();
    let processor = most.iter().enumerate().max_by_key(|(_, count)| **count);
    processor.filter(|(_, count)| **count > 0).map_or(0, |(processor, _)| processor)
}

/// Interrupts so far by device and processor; those that processors send themselves and one another have
/// names, not numbers.
fn counts() -> Vec<(String, Vec<u64>)> {
    let all = fs::read_to_string("/proc/interrupts").expect("interrupts are counted");
    let processors = all.lines().next().map_or(0, |head| head.split_whitespace().count());
    all.lines()
        .filter_map(|line| {
            let (device, rest) = line.trim_start().split_once(':')?;
            device.parse::<u32>().ok()?;
            let counts = rest.split_whitespace().take(processors).map_while(|count| count.parse().ok());
            Some((device.to_owned(), counts.collect()))
        })
        .collect()
}
