//! Targets of the messages of an export, and the counts on the way.
//!
//! Invariant: a sink makes new files only, with names that lead out of no directory.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::path::Path;

use mcap::records::MessageHeader;
use serde::Serialize;

use super::columns::{Cell, Reader};
use super::info::size;
use super::read::Channel;
use crate::failure::Failure;

/// One message, and the means to read it.
pub(super) struct Message<'a> {
    pub(super) channel: &'a Channel,
    pub(super) reader: &'a Reader,
    pub(super) header: &'a MessageHeader,
    pub(super) data: &'a [u8],
}

impl Message<'_> {
    /// Returns its values. A message that has none, and values that are too many, are counted.
    pub(super) fn row(&self, view: &mut ExportView) -> Option<Vec<(String, Cell)>> {
        let Some(values) = self.reader.values(self.channel, self.data) else {
            view.unreadable(self);
            return None;
        };
        view.unplaced += values.left_out;
        view.steps = view.steps.saturating_add(values.steps);
        Some(values.row)
    }
}

/// Target of messages.
pub(super) trait Sink {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure>;
    /// Finishes the export; returns the number of files.
    fn finish(self: Box<Self>, output: &Path, view: &mut ExportView) -> Result<u64, Failure>;
}

/// Result of an export.
#[derive(Debug, Default, Serialize)]
pub(super) struct ExportView {
    pub(super) output: String,
    pub(super) files: u64,
    pub(super) messages: u64,
    /// Messages that are not what their channel says.
    pub(super) unreadable: u64,
    /// Reason why the first of those could not be read, where that is known.
    pub(super) why: String,
    /// Values that the first message of a topic has no column for, and frames of another shape
    /// than the first.
    pub(super) unplaced: u64,
    /// Pictures: `--png` writes them, arrays do not hold them.
    pub(super) pictures: u64,
    /// Words: `--csv` writes them, arrays do not hold them.
    pub(super) texts: u64,
    /// Messages that the recorder told of itself: written where `--topic` names them.
    pub(super) recorders: u64,
    /// Reason why not all of the recording was read.
    pub(super) wrong: String,
    #[serde(skip)]
    pub(super) remains: &'static str,
    /// Fields that were looked at.
    #[serde(skip)]
    pub(super) steps: u64,
}

impl ExportView {
    /// Counts a message that is not what its channel says.
    pub(super) fn unreadable(&mut self, message: &Message<'_>) {
        self.unreadable += 1;
        if self.why.is_empty() && !message.reader.wrong.is_empty() {
            self.why = format!("{}: {}", super::shown(&message.channel.topic), message.reader.wrong);
        }
    }
}

/// The most that an export may cost. It grows with the file, with room for zeros, which take none in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    file: u64,
}

impl Bounds {
    /// Makes the bounds for a file of so many bytes.
    pub(super) fn of(file: u64) -> Bounds {
        Bounds { file }
    }

    fn most(self, base: u64, each: u64) -> u64 {
        self.file.saturating_mul(each).saturating_add(base)
    }

    fn too_large(what: &str, most: &str) -> Failure {
        let help = "take less of it: --topic, --from, --to";
        Failure::local(
            "TOO_LARGE",
            format!("{what} are over the limit for a file of this size, {most}"),
            help,
        )
    }

    /// Checks an amount of memory, and returns it.
    ///
    /// # Errors
    /// TOO_LARGE: the sum is over the limit.
    pub(super) fn memory(self, bytes: usize) -> Result<usize, Failure> {
        let most = self.most(256 << 20, 32).min(4 << 30);
        if bytes as u64 <= most { Ok(bytes) } else { Err(Self::too_large("numbers and names", &size(most))) }
    }

    /// Checks a number of written bytes, and returns it.
    ///
    /// # Errors
    /// TOO_LARGE: the sum is over the limit.
    pub(super) fn written(self, bytes: u64) -> Result<u64, Failure> {
        let most = self.most(256 << 20, 32);
        if bytes <= most { Ok(bytes) } else { Err(Self::too_large("tables", &size(most))) }
    }

    /// Checks a number of fields that are looked at.
    ///
    /// # Errors
    /// TOO_LARGE: the sum is over the limit.
    pub(super) fn steps(self, steps: u64) -> Result<(), Failure> {
        let most = self.most(8_000_000, 8);
        if steps <= most { Ok(()) } else { Err(Self::too_large("fields of its types", &most.to_string())) }
    }
}

/// A topic as the name of a file: no way out of its directory.
pub(super) fn file_name(topic: &str) -> String {
    let good = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '_' | '-') { c } else { '_' };
    let name: String = topic.trim_matches('/').chars().map(good).take(200).collect();
    if name.is_empty() { "topic".to_owned() } else { name }
}

/// The names of files or directories of topics. Two topics may come to the same name.
#[derive(Default)]
pub(super) struct Names {
    taken: BTreeSet<String>,
    /// Number that the next topic tries, by the name that several come to.
    next: BTreeMap<String, u64>,
}

impl Names {
    /// Returns the name for a topic: the first one that is not taken.
    pub(super) fn free(&mut self, topic: &str) -> String {
        let name = file_name(topic);
        let mut free = name.clone();
        while self.taken.contains(&free) {
            let next = self.next.entry(name.clone()).or_insert(1);
            *next += 1;
            free = format!("{name}_{next}");
        }
        self.taken.insert(free.clone());
        free
    }
}

pub(super) fn wrote(path: &Path, why: &dyn std::fmt::Display) -> Failure {
    Failure::local(
        "IO",
        format!("{} cannot be written: {why}", path.display()),
        "choose another place: -o PATH",
    )
}

/// The failure, and what there is of the export all the same.
pub(super) fn incomplete(failure: Failure, output: &Path) -> Failure {
    if !output.exists() {
        return failure;
    }
    let message = format!("{}; {} has what was written before that", failure.message, output.display());
    let help = format!("{}; remove {} before you export to it again", failure.help, output.display());
    Failure { message, help, ..failure }
}

pub(super) fn new_file(path: &Path) -> Result<File, Failure> {
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).map_err(|e| wrote(parent, &e))?;
    }
    OpenOptions::new().write(true).create_new(true).open(path).map_err(|e| wrote(path, &e))
}
