//! Where the messages of an export go, and what is counted on the way.
//!
//! Invariant: a sink makes new files only, with names that lead out of no directory.

use std::fs::{File, OpenOptions};
use std::path::Path;

use mcap::records::MessageHeader;
use serde::Serialize;

use super::columns::{Cell, Reader};
use super::read::Channel;
use crate::cli::failure::Failure;

/// One message, and what it takes to read it.
pub(super) struct Message<'a> {
    pub(super) channel: &'a Channel,
    pub(super) reader: &'a Reader,
    pub(super) header: &'a MessageHeader,
    pub(super) data: &'a [u8],
}

impl Message<'_> {
    /// Its values; one that has none, and values that are too many, are counted.
    pub(super) fn row(&self, view: &mut ExportView) -> Option<Vec<(String, Cell)>> {
        let values = self.reader.values(self.channel, self.data);
        view.unreadable += u64::from(values.is_none());
        let values = values?;
        view.unplaced += values.left_out;
        Some(values.row)
    }
}

/// Where messages go.
pub(super) trait Sink {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure>;
    /// How many files there are.
    fn finish(self: Box<Self>, output: &Path, view: &mut ExportView) -> Result<u64, Failure>;
}

/// What was written.
#[derive(Debug, Default, Serialize)]
pub(super) struct ExportView {
    pub(super) output: String,
    pub(super) files: u64,
    pub(super) messages: u64,
    /// Messages that are not what their channel says.
    pub(super) unreadable: u64,
    /// Values that the first message of a topic has no column for, and frames that are of another shape than the first.
    pub(super) unplaced: u64,
    /// Pictures: `--png` writes them, arrays do not hold them.
    pub(super) pictures: u64,
    /// Words: `--csv` writes them, arrays do not hold them.
    pub(super) texts: u64,
    /// Messages that the recorder told of itself: written where `--topic` names them.
    pub(super) recorders: u64,
    /// Why the recording was not read to its end.
    pub(super) wrong: String,
}

/// A topic as the name of a file: no way out of its directory.
pub(super) fn file_name(topic: &str) -> String {
    let good = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '_' | '-') { c } else { '_' };
    let name: String = topic.trim_matches('/').chars().map(good).take(200).collect();
    if name.is_empty() { "topic".to_owned() } else { name }
}

/// The name of a topic's file or directory, where two topics may come to the same one: the first that is not taken.
pub(super) fn free_name(topic: &str, taken: impl Fn(&str) -> bool) -> String {
    let name = file_name(topic);
    let others = (2u64..).map(|n| format!("{name}_{n}"));
    std::iter::once(name.clone()).chain(others).find(|name| !taken(name)).unwrap_or(name)
}

pub(super) fn wrote(path: &Path, why: &dyn std::fmt::Display) -> Failure {
    Failure::local(
        "IO",
        format!("{} cannot be written: {why}", path.display()),
        "choose another place: -o PATH",
    )
}

pub(super) fn new_file(path: &Path) -> Result<File, Failure> {
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).map_err(|e| wrote(parent, &e))?;
    }
    OpenOptions::new().write(true).create_new(true).open(path).map_err(|e| wrote(path, &e))
}
