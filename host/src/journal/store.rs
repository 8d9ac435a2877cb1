//! The store of a GCM in one file.
//!
//! Invariant: one append is one commit, so its records are there all or not at all; after an error the file
//! is opened anew, and goes on only where it is the same journal with the same head.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use redb::WriteTransaction;

use super::contents::{self, Bounds, Frame, Head, Identity};
use super::fault::{Bad, Res};
use super::opening::{Open, Opener};
use super::{FILE, codec};
use crate::gcm::{Loaded, Record, Snapshot, Store, StoreError, Unusable};

/// What the audit keeps: 100 000 records, 64 MiB.
const KEPT: Bounds = Bounds { records: 100_000, bytes: 64 << 20 };

/// A journal in the file [`FILE`] of a directory. Nothing is opened or made before it is used.
pub struct RedbStore {
    file: PathBuf,
    opener: Opener,
    bounds: Bounds,
    open: Option<Open>,
    /// The journal as the last success left it; `None`: it was not loaded.
    known: Option<Known>,
    /// A sync failed: nobody knows what is on the disk, and no later success would tell.
    lost: bool,
}

#[derive(Clone, Copy)]
struct Known {
    identity: Identity,
    head: Head,
}

impl RedbStore {
    /// A journal in that directory, which has to be there when it is loaded.
    pub fn new(dir: &Path) -> RedbStore {
        RedbStore {
            file: dir.join(FILE),
            opener: Opener::default(),
            bounds: KEPT,
            open: None,
            known: None,
            lost: false,
        }
    }

    /// Returns the identity of the journal; `None`: it was not loaded.
    pub fn identity(&self) -> Option<Identity> {
        self.known.map(|known| known.identity)
    }

    #[cfg(test)]
    pub(super) fn with(self, opener: Opener, bounds: Bounds) -> RedbStore {
        RedbStore { opener, bounds, ..self }
    }

    fn read(&mut self) -> Res<Loaded> {
        self.open = None;
        let is_there = self.file.try_exists().map_err(|e| Bad::of_disk(&e))?;
        if !is_there {
            self.opener.create(&self.file, &new_identity()?)?;
        }
        let (open, (known, loaded)) = self.opener.open(&self.file, |copy, frame| {
            let loaded = copy.look(|txn| contents::load(txn, frame))?;
            Ok((Known { identity: frame.identity, head: frame.head }, loaded))
        })?;
        (self.open, self.known) = (Some(open), Some(known));
        Ok(loaded)
    }

    /// Opens the file again after an error, if it is still the journal that was loaded.
    fn again(&self, known: &Known) -> Res<Open> {
        let other = |frame: &Frame| frame.identity != known.identity;
        let (open, ()) = self.opener.open(&self.file, |copy, frame| {
            if other(frame) {
                return Err(Bad::damaged("another journal was put in its place"));
            }
            let hash = copy.look(|txn| contents::hash_of(txn, known.head.number, frame))?;
            if hash != Some(known.head.hash) {
                let why = format!("it has not the same record {} any more", known.head.number);
                return Err(Bad::damaged(why).in_record(known.head.number));
            }
            Ok(())
        })?;
        Ok(open)
    }

    /// Commits one change of the tables, which leads from one head to another.
    fn commit(&mut self, change: impl FnOnce(&WriteTransaction, &Head) -> Res<Head>) -> Res<()> {
        if self.lost {
            return Err(Bad::not_synced());
        }
        if self.known.is_none() {
            let loaded = self.read()?;
            let is_empty = loaded.records.is_empty() && self.known.is_some_and(|it| it.head.number == 0);
            if !is_empty {
                self.known = None;
                return Err(Bad::now("what it has was not loaded: load it before anything is added"));
            }
        }
        let known = self.known.ok_or_else(|| Bad::now("it was not loaded"))?;
        let open = match self.open.take() {
            Some(open) => open,
            None => self.again(&known)?,
        };
        open.is_there(&self.file)?;
        let head = put(&open, &known.head, change).map_err(|bad| open.judged(bad))?;
        // Kept only after success: after an error the database is of no use any more.
        (self.open, self.known) = (Some(open), Some(Known { head, ..known }));
        Ok(())
    }

    fn said<T>(&mut self, result: Res<T>) -> Result<T, StoreError> {
        result.map_err(|bad| {
            self.lost |= bad.unusable == Unusable::NotSynced;
            bad.of(&self.file).error
        })
    }
}

/// One sync for each commit: pages, checksums and the new root are written, then synced together. After a
/// crash the database checks each checksum and goes back to the root before where one does not fit, and the
/// chain of hashes shows any part that is not as it was written.
fn put(open: &Open, head: &Head, change: impl FnOnce(&WriteTransaction, &Head) -> Res<Head>) -> Res<Head> {
    let txn = open.database.begin_write()?;
    contents::cut_behind(&txn, head)?;
    let head = change(&txn, head)?;
    txn.commit()?;
    Ok(head)
}

fn new_identity() -> Res<Identity> {
    let mut id = [0; 16];
    rustix::rand::getrandom(&mut id, rustix::rand::GetRandomFlags::empty())
        .map_err(|e| Bad::now(format!("no random numbers for its id: {e}")))?;
    let created = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Ok(Identity { id: u128::from_be_bytes(id), created_ns: created.as_nanos() as u64 })
}

impl Store for RedbStore {
    fn load(&mut self) -> Result<Loaded, StoreError> {
        let loaded = if self.lost { Err(Bad::not_synced()) } else { self.read() };
        self.said(loaded)
    }

    fn append(&mut self, records: &[Record]) -> Result<(), StoreError> {
        if records.is_empty() {
            return Ok(());
        }
        let added = self.commit(|txn, head| {
            contents::add(txn, head, records.len(), |at, number, before| {
                codec::record(&records[at], number, before)
            })
        });
        self.said(added)
    }

    fn keep(&mut self, snapshot: &Snapshot) -> Result<(), StoreError> {
        let bounds = self.bounds;
        let kept = self.commit(|txn, head| {
            let bytes = codec::snapshot(snapshot, head.number, &head.hash);
            contents::fold(txn, head, &bytes, bounds)
        });
        self.said(kept)
    }
}
