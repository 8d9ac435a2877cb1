//! Recordings: made by a recorder component, read here.
//!
//! Invariant: what a file says is a stranger's word: lengths, names and numbers in it are checked before they are used.

pub(super) mod columns;
mod ends;
pub(super) mod export;
pub(super) mod info;
mod npz;
mod patience;
mod pictures;
mod planes;
mod read;
pub(super) mod record;
mod records;
mod select;
mod sink;
mod tables;

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use trocar_model::nearest;

use super::style;

/// Names that are shown of more.
const SHOWN: usize = 40;

/// What is nearest to one of these words; empty where nothing is.
fn meant<'a>(words: impl IntoIterator<Item = &'a str>, names: &[&str]) -> String {
    let close = words.into_iter().find_map(|word| nearest(word, names.iter().copied()));
    close.map(|name| format!("did you mean {name}? ")).unwrap_or_default()
}

/// Names in one line, the first ones of many.
fn listed(names: &[&str]) -> String {
    let shown = &names[..names.len().min(SHOWN)];
    let more = names.len() - shown.len();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", shown.join(", "))
}

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
