//! Recordings: made by a recorder component, read here.
//!
//! Invariant: a file is not trusted: lengths, names and numbers in it are checked before they are used.

mod arrays;
pub(super) mod columns;
mod ends;
pub(super) mod export;
mod fields;
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
mod types;

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use trocar_model::nearest;

use self::read::{Takes, Whole};
use super::failure::Failure;
use super::{style, units};

#[cfg(test)]
mod corpus_tests;

/// Names that are shown of more.
const SHOWN: usize = 40;
/// Characters that are shown of a name.
const NAME: usize = 120;

/// The process, component or output that is nearest to one of these words; empty where nothing is.
fn meant<'a>(words: impl IntoIterator<Item = &'a str>, names: &[&str]) -> String {
    let parts = || names.iter().flat_map(|name| name.match_indices('/').map(move |(at, _)| &name[..at]));
    let close = words.into_iter().find_map(|word| nearest(word, names.iter().copied().chain(parts())));
    close.map(|name| format!("did you mean {}? ", units::cut(name, NAME))).unwrap_or_default()
}

/// A name in a sentence.
fn shown(name: &str) -> String {
    units::cut(name, NAME)
}

/// Names in one line, the first ones of many.
fn listed(names: &[&str]) -> String {
    let shown: Vec<String> = names.iter().take(SHOWN).map(|name| shown(name)).collect();
    let more = names.len() - shown.len();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", shown.join(", "))
}

/// Says that a topic has gaps that no counter of losses knows.
fn interrupted(topic: &str, times: u64) -> String {
    let times = if times > 1 { format!(", {times} times") } else { String::new() };
    format!("{}: its connection or the process of its source went away{times}", shown(topic))
}

/// Reads a recording: a fault of ours in it is told as a sentence, too.
fn read_safely(file: &Path, takes: &mut dyn Takes) -> Result<Whole, Failure> {
    types::unless_it_panics(|| read::read(file, takes)).unwrap_or_else(|| {
        Err(Failure::local(
            "UNREADABLE",
            format!("{}: the reader met something in it that it does not expect, and ended", file.display()),
            "this is a fault of trocar: please report it with the recording, or with its first megabyte",
        ))
    })
}

/// Shows on a terminal how far a recording has been read, in bytes.
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

#[cfg(test)]
mod tests {
    use super::meant;

    #[test]
    fn a_misspelt_process_component_or_output_is_answered_by_the_one_that_was_meant() {
        let names = ["host/camera/image", "host/robot/tip", "left/sine/value"];
        for (word, answer) in [
            ("host/rob", "did you mean host/robot? "),
            ("lef", "did you mean left? "),
            ("host/robot/tipp", "did you mean host/robot/tip? "),
            ("nothing/alike/at-all", ""),
        ] {
            assert_eq!(meant([word], &names), answer);
        }
    }
}
