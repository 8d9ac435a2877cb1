//! Naming a test that cannot run on this machine.
//!
//! Invariant: a skipped test leaves a line that `./tests/run` shows and counts.

use std::env;
use std::fs::OpenOptions;
use std::io::Write;

/// Records that the calling test was skipped and why; the test returns right after it.
pub fn skip(why: &str) {
    let name = std::thread::current().name().unwrap_or("a test").to_owned();
    eprintln!("skipped: {name}: {why}");
    let Some(path) = env::var_os("TROCAR_SKIPS") else { return };
    let written = OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .and_then(|mut file| file.write_all(format!("{name}: {why}\n").as_bytes()));
    assert!(written.is_ok(), "the list of skipped tests cannot be written: {written:?}");
}
