//! A problem of a system file: where it is, what it is, and what to do.
//!
//! Invariant: every problem names a place a person can jump to (file:line:column) and a place a program can
//! (JSON pointer).

use std::fmt;

/// One problem of one system file.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// The file as it was named by the caller.
    pub file: String,
    /// From 1; 0 = the file as a whole.
    pub line: usize,
    /// From 1, in characters.
    pub column: usize,
    /// RFC 6901; "" is the whole document.
    pub pointer: String,
    pub what: String,
    pub help: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.line == 0 {
            return write!(f, "{}: {}", self.file, self.what);
        }
        write!(f, "{}:{}:{}: ", self.file, self.line, self.column)?;
        if !self.pointer.is_empty() {
            // `~1` is for programs.
            write!(f, "{}: ", self.pointer.replace("~1", "/").replace("~0", "~"))?;
        }
        f.write_str(&self.what)
    }
}

impl std::error::Error for Problem {}

/// `base/part`, with `part` escaped as RFC 6901 wants it.
pub(super) fn join(base: &str, part: &str) -> String {
    format!("{base}/{}", part.replace('~', "~0").replace('/', "~1"))
}
