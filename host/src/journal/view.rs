//! A journal that is only looked at, also while a GCM writes it.
//!
//! Invariant: the file is read, never locked and never written: it is copied and the copy is looked at.
//!
//! A copy of a file that is being written may hold parts of two commits. Its checksums show that, and it is
//! copied again; a damage that two copies have alike is in the file.

use std::path::{Path, PathBuf};

use super::contents;
use super::copy::{self, Copy};
use super::fault::{Bad, Fault, Res};
use super::frame::{Frame, Identity, Kept};
use super::{FILE, Hash};

/// A journal as it was at one moment.
pub struct View {
    file: PathBuf,
    copy: Copy,
    frame: Frame,
}

/// A journal of which every kept record is whole and follows the one before it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verified {
    pub identity: Identity,
    /// Kept records.
    pub records: u64,
    /// Numbers of the oldest and of the newest record; 0 without any.
    pub first: u64,
    pub last: u64,
    /// Revisions that the oldest and the newest record with a revision lead to.
    pub first_revision: Option<u64>,
    pub last_revision: Option<u64>,
    /// Number of the last record that the snapshot folds; `None`: there is no snapshot.
    pub snapshot: Option<u64>,
    /// Hash of the newest record, which stands for the whole chain.
    pub head: Hash,
}

impl View {
    /// Looks at the journal of that directory.
    ///
    /// # Errors
    /// There is none, it cannot be read, is damaged, or a later release wrote it.
    pub fn open(dir: &Path) -> Result<View, Fault> {
        let file = dir.join(FILE);
        match copy::unlocked(&file) {
            Ok((copy, frame)) => Ok(View { file, copy, frame }),
            Err(bad) => Err(bad.of(&file)),
        }
    }

    /// Returns the file that is looked at.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Returns the number of the newest record; 0 without any.
    pub fn last(&self) -> u64 {
        self.frame.head.number
    }

    /// Visits records from that number on, in order, until `each` says false.
    ///
    /// # Errors
    /// A record is damaged, or of a later release; those before it were visited.
    pub fn records(&self, from: u64, each: &mut dyn FnMut(Kept) -> bool) -> Result<(), Fault> {
        let walked = self.copy.look(|txn| contents::walk(txn, &self.frame, None, from, each));
        walked.map_err(|bad| bad.of(&self.file))
    }

    /// Checks every kept record, the snapshot and the head.
    ///
    /// # Errors
    /// With the first bad record.
    pub fn verify(&self) -> Result<Verified, Fault> {
        self.copy.look(|txn| verified(txn, &self.frame)).map_err(|bad| bad.of(&self.file))
    }
}

fn verified(txn: &redb::ReadTransaction, frame: &Frame) -> Res<Verified> {
    let folded = contents::folded(txn)?;
    let (first, records) = contents::kept(txn)?;
    let (mut first_revision, mut last_revision, mut wrong) = (None, None, None);
    contents::walk(txn, frame, None, 0, &mut |kept| {
        let revision = kept.record.entry.revision();
        first_revision = first_revision.or(revision);
        last_revision = revision.or(last_revision);
        let folded_here = folded.as_ref().filter(|folded| folded.number == kept.number);
        if folded_here.is_some_and(|folded| folded.hash != kept.hash) {
            wrong = Some(kept.number);
        }
        true
    })?;
    if let Some(number) = wrong {
        return Err(Bad::damaged("the snapshot was made of another record").in_record(number));
    }
    Ok(Verified {
        identity: frame.identity,
        records,
        first,
        last: frame.head.number,
        first_revision,
        last_revision,
        snapshot: folded.map(|folded| folded.number),
        head: frame.head.hash,
    })
}
