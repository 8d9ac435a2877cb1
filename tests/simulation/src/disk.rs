//! A disk with a journal, which outlives the managers that write it, and may be full or fail at each commit.
//!
//! Invariant: a manager that was killed, or replaced, writes nothing any more. A commit is there whole or not
//! at all, and is there once it was confirmed to somebody who lives.

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::{Notify, watch};
use trocar::gcm::{Loaded, Record, Snapshot, Standing, Store, StoreError, Unusable};
use trocar_model::Wanted;

use crate::chance::Chance;
use crate::truth::{Kind, Truth};

/// One of so many commits meets a failure.
const FAILS: usize = 400;

#[derive(Clone)]
pub(crate) struct Disk {
    content: Arc<Mutex<Content>>,
    /// Rings when a commit has ended its manager, or its journal.
    rings: Arc<Notify>,
    chance: Chance,
    truth: Truth,
}

/// Failure that a commit meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Failure {
    /// The manager is killed before it is there, or torn: it is not there.
    KilledBefore,
    /// The manager is killed as soon as it is there.
    KilledAfter,
    /// The disk refuses it, and takes it later.
    Refused,
    /// It is there, or not, and the disk does not say which.
    NotSynced { is_there: bool },
}

/// End of a manager by its disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Struck {
    /// It was killed in the middle of a commit. `is_behind`: more was answered than is there, with a warning.
    Killed { is_behind: bool },
    /// It lives, and its journal is not written any more.
    Broken,
}

#[derive(Default)]
struct Content {
    snapshot: Snapshot,
    records: Vec<Record>,
    /// Number of the manager that may write.
    owner: u64,
    is_full: bool,
    /// No commit fails.
    is_calm: bool,
    struck: Option<Struck>,
    /// State of the journal, as its manager tells everybody.
    standing: Option<watch::Receiver<Standing>>,
}

impl Disk {
    pub(crate) fn new(chance: Chance, truth: Truth) -> Disk {
        Disk { content: Arc::default(), rings: Arc::default(), chance, truth }
    }

    /// Lets no commit fail, or some.
    pub(crate) fn calm(&self, is_calm: bool) {
        self.content.lock().is_calm = is_calm;
    }

    /// Takes the state of the journal from its manager.
    pub(crate) fn stands(&self, standing: watch::Receiver<Standing>) {
        self.content.lock().standing = Some(standing);
    }

    /// Waits until a commit has ended its manager, or its journal.
    pub(crate) async fn strikes(&self) -> Struck {
        loop {
            if let Some(struck) = self.content.lock().struck.take() {
                return struck;
            }
            self.rings.notified().await;
        }
    }

    /// Tells whether a commit has killed the manager, which does not know it yet.
    pub(crate) fn has_killed(&self) -> bool {
        matches!(self.content.lock().struck, Some(Struck::Killed { .. }))
    }

    /// Returns a store for the next manager; the one before writes nothing any more.
    pub(crate) fn opened(&self) -> Opened {
        let mut content = self.content.lock();
        content.owner += 1;
        (content.struck, content.standing) = (None, None);
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
    /// Writes, if the disk can be written. A failure is met before or after that.
    fn writes(&self, write: impl FnOnce(&mut Content)) -> Result<(), StoreError> {
        let error = |unusable, why: &str| StoreError { file: "disk".into(), unusable, why: why.into() };
        let mut content = self.disk.content.lock();
        if content.owner != self.owner {
            return Err(error(Unusable::NotSynced, "this manager was killed"));
        }
        if content.is_full {
            return Err(error(Unusable::Now, "the disk is full"));
        }
        let failure = if content.is_calm { None } else { self.disk.failure() };
        if let Some(failure) = failure {
            self.disk.truth.event(Kind::Fails, || format!("a commit: {failure:?}"));
            self.disk.truth.counts(format!("a commit: {failure:?}"));
        }
        let strike = |content: &mut Content, struck| {
            content.struck = Some(struck);
            self.disk.rings.notify_one();
        };
        let is_behind = content.standing.as_ref().is_some_and(|now| *now.borrow() != Standing::Written);
        match failure {
            None => write(&mut content),
            // Nobody hears what the manager says from here on.
            Some(Failure::KilledBefore) => {
                content.owner += 1;
                strike(&mut content, Struck::Killed { is_behind });
            }
            Some(Failure::KilledAfter) => {
                write(&mut content);
                content.owner += 1;
                strike(&mut content, Struck::Killed { is_behind });
            }
            Some(Failure::Refused) => return Err(error(Unusable::Now, "the disk does not take it")),
            Some(Failure::NotSynced { is_there }) => {
                if is_there {
                    write(&mut content);
                }
                content.owner += 1;
                strike(&mut content, Struck::Broken);
                return Err(error(Unusable::NotSynced, "the disk did not say whether it has it"));
            }
        }
        Ok(())
    }
}

impl Disk {
    fn failure(&self) -> Option<Failure> {
        self.chance.once_in(FAILS).then(|| match self.chance.below(12) {
            0 => Failure::NotSynced { is_there: self.chance.once_in(2) },
            1 | 2 => Failure::Refused,
            3..7 => Failure::KilledBefore,
            _ => Failure::KilledAfter,
        })
    }

    fn on_record(&self, records: &[Record]) {
        for record in records {
            self.truth.event(Kind::Written, || format!("record {:?}", brief(record)));
            self.truth.on_record(record);
        }
    }
}

impl Store for Opened {
    fn load(&mut self) -> Result<Loaded, StoreError> {
        let content = self.disk.content.lock();
        let mut snapshot = content.snapshot.clone();
        // Terms are counted in a file of their own, and none is given twice.
        snapshot.wanted.term = snapshot.wanted.term.max(content.owner);
        Ok(Loaded { snapshot, records: content.records.clone() })
    }

    fn append(&mut self, records: &[Record]) -> Result<(), StoreError> {
        self.writes(|content| {
            content.records.extend_from_slice(records);
            self.disk.on_record(records);
        })
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
