//! What is wanted, in memory, and the records that are on their way to the store.
//!
//! Invariant: what is wanted changes by entries alone, and each entry is a record of its own, in that order. A
//! store that cannot be written holds nobody up: that it is behind can be seen, and it is tried again.

use std::collections::VecDeque;
use std::sync::mpsc;
use std::time::{SystemTime, UNIX_EPOCH};

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::watch;
use trocar_model::{Entry, Wanted};
use trocar_rt::os::now_ns;

use super::answer::Answer;
use super::journal::{Asked, Record};

/// Most records that wait for a store; of more the oldest go, and are counted.
const PENDING: usize = 4096;

/// Rung when a record waits for the store.
pub(super) type Bell = mpsc::SyncSender<()>;

/// How the journal stands.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// There is none: this GCM leaves nothing behind.
    #[default]
    None,
    /// What was answered is on record.
    Written,
    /// What was decided since is in memory alone.
    Behind { why: String },
}

/// Returns the time of day, ns since 1970 (UTC).
pub(super) fn wall_ns() -> u64 {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(wall.as_nanos()).unwrap_or(u64::MAX)
}

impl Standing {
    /// Returns what those should know who change the system.
    pub fn warning(&self) -> Option<String> {
        match self {
            Standing::None | Standing::Written => None,
            Standing::Behind { why } => Some(format!(
                "the journal is behind: {why}; what is decided is in memory alone until it can be written, and a GCM that is started again before would not know it"
            )),
        }
    }
}

pub(super) struct Ledger {
    term: u64,
    held: Mutex<Held>,
    /// Number of the last record that is durable.
    durable: watch::Sender<u64>,
    standing: watch::Sender<Standing>,
    /// Rung when a record waits; present when there is a store.
    bell: Option<Bell>,
}

#[derive(Default)]
struct Held {
    wanted: Wanted,
    pending: VecDeque<Record>,
    /// Number of the last record.
    last: u64,
    /// Number of records that had to go before a store took them, since it last took some.
    dropped: u64,
}

/// Records for a store.
pub(super) struct Batch {
    pub(super) records: Vec<Record>,
    /// Number of the last of them.
    pub(super) last: u64,
    /// Records before them that had to go.
    pub(super) dropped: u64,
}

impl Ledger {
    /// A ledger that begins with this; with a bell there is a store.
    pub(super) fn new(term: u64, wanted: Wanted, bell: Option<Bell>) -> Ledger {
        let standing = if bell.is_some() { Standing::Written } else { Standing::None };
        Ledger {
            term,
            held: Mutex::new(Held { wanted, ..Held::default() }),
            durable: watch::Sender::new(0),
            standing: watch::Sender::new(standing),
            bell,
        }
    }

    /// Enters one more thing that was decided. `decide` makes it while nobody else enters anything; returns its
    /// number.
    pub(super) fn enter(&self, decide: impl FnOnce(&Wanted) -> (Entry, Option<(Asked, Answer)>)) -> u64 {
        let mut held = self.held.lock();
        let (entry, request) = decide(&held.wanted);
        held.wanted.on(&entry);
        held.last += 1;
        let Some(bell) = &self.bell else { return held.last };
        let (asked, answer) = request.unzip();
        held.pending.push_back(Record {
            wall_ns: wall_ns(),
            monotonic_ns: now_ns(),
            term: self.term,
            entry,
            asked,
            answer,
        });
        if held.pending.len() > PENDING {
            held.pending.pop_front();
            held.dropped += 1;
        }
        // A bell that is full rings already.
        let _ = bell.try_send(());
        held.last
    }

    /// What is wanted now.
    pub(super) fn wanted(&self) -> impl std::ops::Deref<Target = Wanted> + '_ {
        MutexGuard::map(self.held.lock(), |held| &mut held.wanted)
    }

    /// Returns the number of the last record.
    pub(super) fn last(&self) -> u64 {
        self.held.lock().last
    }

    /// Returns how the journal stands, now and later.
    pub(super) fn standing(&self) -> watch::Receiver<Standing> {
        self.standing.subscribe()
    }

    /// Waits until a record is durable, or until everybody can see that records are not.
    pub(super) async fn durable(&self, record: u64) {
        if self.bell.is_none() {
            return;
        }
        let (mut durable, mut standing) = (self.durable.subscribe(), self.standing.subscribe());
        // The senders live as long as this.
        tokio::select! {
            biased;
            _ = durable.wait_for(|last| *last >= record) => {}
            _ = standing.wait_for(|standing| matches!(standing, Standing::Behind { .. })) => {}
        }
    }

    /// Takes the records that wait, at most so many.
    pub(super) fn take(&self, most: usize) -> Batch {
        let mut held = self.held.lock();
        let some = most.min(held.pending.len());
        let records: Vec<Record> = held.pending.drain(..some).collect();
        Batch { records, last: held.last - held.pending.len() as u64, dropped: held.dropped }
    }

    /// Notes that the store has them.
    pub(super) fn written(&self, batch: &Batch) {
        let mut held = self.held.lock();
        held.dropped -= batch.dropped;
        drop(held);
        self.durable.send_replace(batch.last);
        self.standing.send_if_modified(|standing| {
            let back = *standing != Standing::Written;
            *standing = Standing::Written;
            back
        });
    }

    /// Gives them back: the store has none of them.
    pub(super) fn not_written(&self, batch: Batch, why: String) {
        let mut held = self.held.lock();
        for record in batch.records.into_iter().rev() {
            held.pending.push_front(record);
        }
        while held.pending.len() > PENDING {
            held.pending.pop_front();
            held.dropped += 1;
        }
        drop(held);
        let behind = Standing::Behind { why };
        self.standing.send_if_modified(|standing| {
            let news = *standing != behind;
            *standing = behind;
            news
        });
    }
}
