//! Recordings: made by a recorder component, read here.
//!
//! Invariant: what a file says is a stranger's word: lengths, names and numbers in it are checked before they are used.

pub(super) mod columns;
pub(super) mod export;
pub(super) mod info;
mod npz;
mod pictures;
mod planes;
mod read;
pub(super) mod record;
mod records;
mod select;

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};

use super::style;

/// Names that are shown of more.
const SHOWN: usize = 40;

/// That a topic has gaps that no counter of losses knows.
fn interrupted(topic: &str, times: u64) -> String {
    let times = if times > 1 { format!(", {times} times") } else { String::new() };
    format!("{topic}: its connection or the process of its source went away{times}")
}

/// How far a recording has been read, in bytes, where somebody looks.
fn reading_bar(file: &Path, json: bool) -> ProgressBar {
    if json || !style::interactive() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(file.metadata().map_or(0, |m| m.len()));
    match ProgressStyle::with_template("{bar:40} {percent:>3} % {bytes}/{total_bytes} {eta}") {
        Ok(shown) => bar.with_style(shown),
        Err(_) => bar,
    }
}
