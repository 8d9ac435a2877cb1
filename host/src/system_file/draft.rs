//! A system file as far as it could be read, beside all that is wrong with it.
//!
//! Invariant: a draft is only judged. A [`SystemFile`], which is carried out, is a draft without a problem.

use std::collections::BTreeSet;

use trocar_model::{ComponentId, Name};

use super::cursor::MOST;
use super::problem::{Problem, join};
use super::{BadSet, SystemFile};

/// A system file that may be wrong.
#[derive(Clone, Debug)]
pub struct Draft {
    pub(super) file: SystemFile,
    pub(super) problems: Vec<Problem>,
    pub(super) doubts: Doubts,
}

/// Parts of a draft that may say something else than was meant, since a piece of them could not be read. A
/// refusal that follows from that is no mistake of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Doubts {
    /// Processes whose classes are not known, or not all.
    pub(super) processes: BTreeSet<Name>,
    /// Components, as written, without a class, or of no process.
    pub(super) components: BTreeSet<ComponentId>,
    /// Components, as written, that are judged with their class's execution.
    pub(super) executions: BTreeSet<ComponentId>,
    /// Connections, by their place among those that were read.
    pub(super) connections: BTreeSet<usize>,
    /// True: a connection has no client, so it is not known which component misses one.
    pub(super) is_one_lost: bool,
}

impl Draft {
    /// The file, where nothing is wrong with it.
    pub(super) fn finished(self) -> Result<SystemFile, Vec<Problem>> {
        if self.problems.is_empty() { Ok(self.file) } else { Err(self.problems) }
    }

    /// The file, as far as it could be read.
    pub fn file(&self) -> &SystemFile {
        &self.file
    }

    /// As [`SystemFile::set`].
    ///
    /// # Errors
    /// Malformed, or names a component that the file does not have. Where the file has problems of its own
    /// this is not told: the component may be one that could not be read.
    pub fn set(&mut self, assignment: &str) -> Result<(), BadSet> {
        let set = self.file.set(assignment);
        if self.problems.is_empty() { set } else { Ok(()) }
    }

    /// Notes that `part` of a process (`plugins/0`, `trust`) leads to no classes.
    pub fn without_classes(&mut self, process: &Name, part: &str, what: String, help: String) {
        let pointer = join("/processes", process.as_str()) + "/" + part;
        let at = self.file.document.root.nearest_to(&pointer).at;
        if self.problems.len() < MOST {
            self.problems.push(self.file.document.problem(at, &pointer, what, help));
        }
        self.doubts.processes.insert(process.clone());
    }

    /// The plugin directories and hashes of a process could not be read from the file.
    pub fn has_no_classes(&self, process: &Name) -> bool {
        self.doubts.processes.contains(process)
    }
}
