//! A disk with a journal, which outlives the managers that write it and may be full.
//!
//! Invariant: a manager that was killed, or replaced, writes nothing any more.

use std::sync::Arc;

use parking_lot::Mutex;
use trocar::gcm::{Loaded, Record, Snapshot, Store, StoreError, Unusable};
use trocar_model::Wanted;

use crate::truth::{Kind, Truth};

#[derive(Clone)]
pub(crate) struct Disk {
    content: Arc<Mutex<Content>>,
    truth: Truth,
}

#[derive(Default)]
struct Content {
    snapshot: Snapshot,
    records: Vec<Record>,
    /// Number of the manager that may write.
    owner: u64,
    is_full: bool,
}

impl Disk {
    pub(crate) fn new(truth: Truth) -> Disk {
        Disk { content: Arc::default(), truth }
    }

    /// Returns a store for the next manager; the one before writes nothing any more.
    pub(crate) fn opened(&self) -> Opened {
        let mut content = self.content.lock();
        content.owner += 1;
        Opened { disk: self.clone(), owner: content.owner }
    }

    /// Lets nobody write any more: the manager was killed.
    pub(crate) fn closed(&self) {
        self.content.lock().owner += 1;
    }

    pub(crate) fn fill(&self, is_full: bool) {
        self.content.lock().is_full = is_full;
    }

    /// Returns what a manager would go on from that began now.
    pub(crate) fn wanted(&self) -> Wanted {
        let content = self.content.lock();
        let mut wanted = content.snapshot.wanted.clone();
        content.records.iter().for_each(|record| wanted.on(&record.entry));
        wanted
    }
}

/// The journal in the hand of one manager.
pub(crate) struct Opened {
    disk: Disk,
    owner: u64,
}

impl Opened {
    fn writes<R>(&self, write: impl FnOnce(&mut Content) -> R) -> Result<R, StoreError> {
        let error = |unusable, why: &str| StoreError { file: "disk".into(), unusable, why: why.into() };
        let mut content = self.disk.content.lock();
        if content.owner != self.owner {
            return Err(error(Unusable::NotSynced, "this manager was killed"));
        }
        if content.is_full {
            return Err(error(Unusable::Now, "the disk is full"));
        }
        Ok(write(&mut content))
    }
}

impl Store for Opened {
    fn load(&mut self) -> Result<Loaded, StoreError> {
        let content = self.disk.content.lock();
        Ok(Loaded { snapshot: content.snapshot.clone(), records: content.records.clone() })
    }

    fn append(&mut self, records: &[Record]) -> Result<(), StoreError> {
        self.writes(|content| content.records.extend_from_slice(records))?;
        for record in records {
            self.disk.truth.event(Kind::Written, || format!("record {:?}", brief(record)));
            self.disk.truth.on_record(record);
        }
        Ok(())
    }

    fn keep(&mut self, snapshot: &Snapshot) -> Result<(), StoreError> {
        self.writes(|content| {
            content.snapshot = snapshot.clone();
            content.records.clear();
        })
    }
}

fn brief(record: &Record) -> String {
    let mut text = format!("{:?}", record.entry);
    text.truncate(text.floor_char_boundary(160));
    text
}
