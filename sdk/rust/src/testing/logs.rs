//! Log lines of the component, kept for the test.
//!
//! Invariant: a line is kept by the thread that is inside an entry of a bench, and costs the component no
//! allocation.

use super::alloc;
use std::cell::RefCell;

/// A line the component logged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// The level it was logged at.
    pub level: log::Level,
    /// The Rust module, unless the line names another.
    pub target: String,
    /// The text, cut at 512 bytes as a host's log cuts it.
    pub message: String,
}

thread_local! {
    static LINES: RefCell<Option<Vec<LogLine>>> = const { RefCell::new(None) };
}

/// Keeps a line when this thread is inside an entry.
pub(crate) fn keep(level: log::Level, target: &str, message: &str) {
    let _quiet = alloc::pause();
    LINES.with(|lines| {
        if let Ok(mut lines) = lines.try_borrow_mut()
            && let Some(lines) = lines.as_mut()
        {
            lines.push(LogLine { level, target: target.to_string(), message: message.to_string() });
        }
    });
}

/// Lines of one entry; holds the lines that an entry of another bench around it kept before.
pub(crate) struct Entry(Option<Vec<LogLine>>);

/// An entry begins.
pub(crate) fn begin() -> Entry {
    Entry(LINES.replace(Some(Vec::new())))
}

impl Entry {
    /// Ends the entry and returns what was logged in it.
    pub(crate) fn end(self) -> Vec<LogLine> {
        LINES.replace(self.0).unwrap_or_default()
    }
}
