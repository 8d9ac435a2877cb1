//! The store of a GCM in one file.
//!
//! Invariant: one append is one commit, so its records are there all or not at all; after an error the file
//! is opened anew, and goes on only where it is the same journal with the same head. Only a snapshot begins
//! another journal, since it has all that was decided.

use std::path::{Path, PathBuf};

use redb::WriteTransaction;
use trocar_model::Wanted;

use super::contents;
use super::fault::{Bad, Res};
use super::frame::{Bounds, Head, Identity};
use super::opening::{Open, Opener, is_free, make_folder};
use super::{FILE, codec};
use crate::gcm::{Loaded, Record, Snapshot, Store, StoreError, Unusable};

/// Bounds of the audit: 100 000 records, 64 MiB. Pages take up to twice the bytes of their records, and the
/// file grows to twice its length: all of them have to fit in [`super::copy::MOST`].
const KEPT: Bounds = Bounds { records: 100_000, bytes: 64 << 20, unfolded: 384 << 20 };

/// A journal in the file [`FILE`] of a directory. Nothing is opened or made before it is used.
pub struct RedbStore {
    file: PathBuf,
    opener: Opener,
    bounds: Bounds,
    open: Option<Open>,
    /// The journal as the last success left it; `None`: it was not loaded.
    known: Option<Known>,
    /// A commit failed after it was begun: it may be there nevertheless.
    doubts: bool,
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
            doubts: false,
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
        (self.open, self.known) = (None, None);
        if !self.is_there()? {
            let identity = Identity::new()?;
            self.opener.create(&self.file, false, |txn| contents::lay(txn, &identity))?;
        }
        let (open, (known, loaded)) = self.opener.load(&self.file, |copy, frame| {
            let loaded = copy.look(|txn| contents::load(txn, frame))?;
            Ok((Known { identity: frame.identity, head: frame.head }, loaded))
        })?;
        (self.open, self.known, self.doubts) = (open, Some(known), false);
        Ok(loaded)
    }

    fn is_there(&self) -> Res<bool> {
        self.file.try_exists().map_err(|e| Bad::of_disk(&e))
    }

    /// Opens the file again after an error, if it is still the journal that was loaded, and returns its head.
    fn again(&self, known: &Known) -> Res<(Open, Head)> {
        let Known { identity, head } = known;
        let (open, found) = self.opener.open(&self.file, |copy, frame| {
            if frame.identity != *identity {
                return Err(Bad::damaged("another journal was put in its place"));
            }
            if frame.head == *head {
                return Ok(*head);
            }
            if !self.doubts {
                return Err(Bad::damaged(format!(
                    "another process wrote it: its newest record is {}, and not {} as it was",
                    frame.head.number, head.number
                )));
            }
            if copy.look(|txn| contents::hash_of(txn, head.number, frame))? != Some(head.hash) {
                let why = format!("it has not the same record {} any more", head.number);
                return Err(Bad::damaged(why).in_record(head.number));
            }
            // With the same record it was a snapshot, which is not taken back.
            Ok(if frame.head.number == head.number { frame.head } else { *head })
        })?;
        Ok((open, found))
    }

    /// Commits one change of the tables, which leads from one head to another.
    fn commit(&mut self, change: impl FnOnce(&WriteTransaction, &Head) -> Res<Head>) -> Res<()> {
        let unloaded = || Bad::now("what it has was not loaded: load it before anything is added");
        let known = self.known.ok_or_else(unloaded)?;
        let (open, head) = match self.open.take() {
            Some(open) => (open, known.head),
            None => self.again(&known)?,
        };
        open.is_there(&self.file)?;
        self.doubts = true;
        let head = open.write(|txn| {
            contents::cut_behind(txn, &head)?;
            change(txn, &head)
        })?;
        // Kept only after success: after an error the database is of no use any more.
        (self.open, self.known, self.doubts) = (Some(open), Some(Known { head, ..known }), false);
        Ok(())
    }

    fn add(&mut self, records: &[Record]) -> Res<()> {
        let most = self.bounds.unfolded;
        self.commit(|txn, head| {
            contents::add(txn, head, records.len(), most, |at, number, before| {
                codec::record(&records[at], number, before)
            })
        })
    }

    fn fold(&mut self, snapshot: &Snapshot) -> Res<()> {
        let is_there = self.is_there()?;
        if !is_there || (self.known.is_none() && self.has_more()?) {
            return self.begin(snapshot, is_there);
        }
        let bounds = self.bounds;
        self.commit(|txn, head| contents::fold(txn, head, snapshot, bounds))
    }

    /// Tells whether there is anything that was not loaded. If not, it counts as loaded.
    fn has_more(&mut self) -> Res<bool> {
        let looked = self.opener.look(&self.file, |copy, frame| {
            let Loaded { snapshot, records } = copy.look(|txn| contents::load(txn, frame))?;
            let is_empty = records.is_empty()
                && frame.head.number == 0
                && snapshot.answers.is_empty()
                && snapshot.wanted == Wanted::default();
            Ok((!is_empty, Known { identity: frame.identity, head: frame.head }))
        });
        match looked {
            Ok((true, _)) => Ok(true),
            Ok((false, known)) => {
                (self.known, self.doubts) = (Some(known), false);
                Ok(false)
            }
            Err(bad) if bad.unusable == Unusable::Now => is_free(&self.file).map(|()| true),
            Err(bad) => Err(bad),
        }
    }

    /// Begins another journal with that snapshot; one that is there is put aside.
    fn begin(&mut self, snapshot: &Snapshot, is_there: bool) -> Res<()> {
        self.open = None;
        let (identity, bounds) = (Identity::new()?, self.bounds);
        make_folder(&self.file)?;
        let head = self.opener.create(&self.file, is_there, |txn| {
            let head = contents::lay(txn, &identity)?;
            contents::fold(txn, &head, snapshot, bounds)
        })?;
        let head = head.ok_or_else(|| Bad::now("another process began one in its place"))?;
        let known = Known { identity, head };
        (self.known, self.doubts) = (Some(known), false);
        self.open = Some(self.again(&known)?.0);
        Ok(())
    }

    /// Uses the journal, unless a sync failed before.
    fn used<T>(&mut self, run: impl FnOnce(&mut RedbStore) -> Res<T>) -> Result<T, StoreError> {
        let result = if self.lost { Err(Bad::not_synced()) } else { run(self) };
        result.map_err(|bad| {
            self.lost |= bad.unusable == Unusable::NotSynced;
            bad.of(&self.file).error
        })
    }
}

impl Store for RedbStore {
    fn load(&mut self) -> Result<Loaded, StoreError> {
        self.used(RedbStore::read)
    }

    fn append(&mut self, records: &[Record]) -> Result<(), StoreError> {
        if records.is_empty() {
            return Ok(());
        }
        self.used(|store| store.add(records))
    }

    fn keep(&mut self, snapshot: &Snapshot) -> Result<(), StoreError> {
        self.used(|store| store.fold(snapshot))
    }
}
