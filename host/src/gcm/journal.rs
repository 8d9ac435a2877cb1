//! The journal: what was decided, by whom, and what became of it, outlives the GCM.
//!
//! Invariant: records are in the order in which they were decided, and a request is answered only after its
//! record is durable, or after everybody can see that records are not.

use std::fmt;
use std::path::PathBuf;

use trocar_model::{Entry, Wanted};

use super::answer::Answer;

/// A record.
#[derive(Clone, Debug)]
pub struct Record {
    /// Time of day, ns since 1970 (UTC).
    pub wall_ns: u64,
    /// Monotonic clock of the machine, ns.
    pub monotonic_ns: u64,
    /// Incarnation of the GCM.
    pub term: u64,
    pub entry: Entry,
    /// Request behind it; `None`: nobody asked for it.
    pub asked: Option<Asked>,
    /// Answer to that request.
    pub answer: Option<Answer>,
}

/// A request as it came.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Asked {
    /// Caller, as the audit names it.
    pub identity: String,
    /// Empty: none.
    pub request_id: String,
    /// Hash of the request; all zero without a request id.
    pub hash: [u8; 32],
    /// The request in its own JSON, cut where it is long.
    pub text: String,
}

/// All that a GCM has to know when it begins.
#[derive(Clone, Debug, Default)]
pub struct Snapshot {
    pub wanted: Wanted,
    /// Answers to requests with an id that may still be asked for again.
    pub answers: Vec<Remembered>,
}

/// An answer that is kept by the id of its request.
#[derive(Clone, Debug)]
pub struct Remembered {
    /// Time of day at which it was given, ns since 1970 (UTC).
    pub wall_ns: u64,
    pub asked: Asked,
    pub answer: Answer,
}

/// Content of a store: the newest snapshot, and the records after it.
#[derive(Clone, Debug, Default)]
pub struct Loaded {
    pub snapshot: Snapshot,
    pub records: Vec<Record>,
}

/// Why a store cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unusable {
    /// It cannot be written now: full, read-only, gone. It may be later.
    Now,
    /// Its content is damaged, or not a journal, or of another system.
    Damaged,
    /// A later release wrote it.
    Newer,
    /// Another process has it.
    InUse,
    /// Records may be lost although the system said that they were written.
    NotSynced,
    /// Another GCM may use it: this one has lost the lead of its system.
    NotLeading,
}

/// A failure of a store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoreError {
    /// Its file, or its place elsewhere: `etcd://...`.
    pub file: PathBuf,
    pub unusable: Unusable,
    /// One sentence: what is wrong, at which record and where.
    pub why: String,
}

impl StoreError {
    /// Tells whether it is no file of this machine.
    pub fn is_remote(&self) -> bool {
        self.file.starts_with("etcd:")
    }
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} cannot be used: {}", self.file.display(), self.why)
    }
}

impl std::error::Error for StoreError {}

/// A place for records that outlives the process. It blocks: it is used on a thread of its own.
pub trait Store: Send {
    /// Returns all that is there, also where it can be read and not written; records are then added as soon
    /// as it can be.
    ///
    /// # Errors
    /// It cannot be read, or not understood. What is there stays as it is.
    fn load(&mut self) -> Result<Loaded, StoreError>;

    /// Makes records durable: all of them, or none.
    ///
    /// # Errors
    /// They cannot be written. After `Unusable::Now` the same can be tried again; where the journal was
    /// removed or never loaded, or has as many records as it takes, only after a [`Store::keep`].
    fn append(&mut self, records: &[Record]) -> Result<(), StoreError>;

    /// Keeps the fold of all records so far, so that later loads are short; older records may go, beyond what
    /// the audit keeps.
    ///
    /// It begins another journal where the one before cannot be gone on with: the file or its directory was
    /// removed, or the store was never loaded. A file that was never loaded is put aside, unless it is
    /// damaged, of a later release, or in use. The snapshot is all that the other journal has.
    ///
    /// # Errors
    /// As [`Store::append`].
    fn keep(&mut self, snapshot: &Snapshot) -> Result<(), StoreError>;
}
