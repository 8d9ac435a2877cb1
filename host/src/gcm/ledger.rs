//! The wanted part of the system, in memory, and the records that are on their way to the store.
//!
//! Invariant: what is wanted changes by entries alone, and each entry is a record of its own, in the order in
//! which they are entered. A store that cannot be written holds nobody up for long: that it is behind can be
//! seen, and it is tried again.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::watch;
use trocar_lcm_api::clock;
use trocar_model::{Entry, Refusal, Wanted};
use trocar_rt::os::now_ns;

use super::answer::Answer;
use super::journal::{Asked, Record};
use super::lead::Lead;
use super::weight::weight;

/// Most records that wait for a store, and most bytes of them, about; of more the oldest go, and are counted.
const PENDING: (usize, usize) = (4096, 64 << 20);
/// Time after which a record that is not durable is no more waited for.
const PATIENCE: Duration = Duration::from_secs(1);
/// The same where another GCM could lead: longer than a cluster needs to elect a leader of its own.
const SHARED: Duration = Duration::from_secs(4);

/// Rings when a record waits for the store; nothing more comes when it is dropped.
pub(super) type Bell = Box<dyn Fn() + Send + Sync>;

/// State of the journal.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// There is none: this GCM leaves nothing behind.
    #[default]
    None,
    /// Everything that was answered is on record.
    Written,
    /// Later decisions are in memory alone.
    Behind { why: String },
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
    /// Present where another GCM could lead: then only what is on record was decided.
    lead: Option<Lead>,
    held: Mutex<Held>,
    /// Number of the last record that is durable.
    durable: watch::Sender<u64>,
    /// Last revision that is durable.
    revision: AtomicU64,
    standing: watch::Sender<Standing>,
    /// The store has refused records that wait since.
    refused: AtomicBool,
    /// Nobody waits for the store, which refuses records or does not confirm them.
    is_stuck: AtomicBool,
    /// Number of the last record that was not waited for.
    owed: AtomicU64,
    /// Present while there is a store.
    bell: Mutex<Option<Bell>>,
    /// True: nothing is written to the store any more.
    ended: watch::Sender<bool>,
}

#[derive(Default)]
struct Held {
    wanted: Wanted,
    /// With their numbers.
    pending: VecDeque<(u64, Record)>,
    /// About as many bytes as these have.
    weight: usize,
    /// Number of the last record.
    last: u64,
    /// Number of the last record that changes what is wanted.
    changed: u64,
    /// Number of records that had to go before a store took them, since it last took some.
    dropped: u64,
}

/// Records for a store.
pub(super) struct Batch {
    pub(super) records: Vec<Record>,
    /// Number of the last of them.
    pub(super) last: u64,
    /// The last revision that they lead to.
    pub(super) revision: u64,
    /// Number of records before them that had to go, and what is wanted after them: what the store has counts
    /// no more.
    pub(super) anew: Option<(u64, Wanted)>,
}

/// Returns the time at which something was, as far as the clocks tell.
pub(super) fn at(wall_ns: u64) -> Instant {
    let (now, was) = (SystemTime::now(), UNIX_EPOCH + Duration::from_nanos(wall_ns));
    let ago = now.duration_since(was).unwrap_or_default();
    clock::now().checked_sub(ago).unwrap_or_else(clock::now)
}

/// Returns the time of day, ns since 1970 (UTC).
pub(super) fn wall_ns() -> u64 {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(wall.as_nanos()).unwrap_or(u64::MAX)
}

impl Ledger {
    /// A ledger that begins with this; with a bell there is a store, with a lead others may use that, too.
    pub(super) fn new(term: u64, wanted: Wanted, bell: Option<Bell>, lead: Option<Lead>) -> Ledger {
        let standing = if bell.is_some() { Standing::Written } else { Standing::None };
        Ledger {
            term,
            lead,
            revision: AtomicU64::new(wanted.revision),
            held: Mutex::new(Held { wanted, ..Held::default() }),
            durable: watch::Sender::new(0),
            standing: watch::Sender::new(standing),
            refused: AtomicBool::new(false),
            is_stuck: AtomicBool::new(false),
            owed: AtomicU64::new(0),
            ended: watch::Sender::new(bell.is_none()),
            bell: Mutex::new(bell),
        }
    }

    /// Enters one more thing that was decided. `decide` makes it while nobody else enters anything; returns
    /// its number.
    pub(super) fn enter(&self, decide: impl FnOnce(&Wanted) -> (Entry, Option<(Asked, Answer)>)) -> u64 {
        let mut held = self.held.lock();
        let (entry, request) = decide(&held.wanted);
        held.wanted.on(&entry);
        held.wanted.term = self.term;
        held.last += 1;
        if entry != Entry::Noted {
            held.changed = held.last;
        }
        let bell = self.bell.lock();
        let Some(bell) = &*bell else { return held.last };
        let (asked, answer) = request.unzip();
        let (term, wall_ns, monotonic_ns) = (self.term, wall_ns(), now_ns());
        held.put(Record { wall_ns, monotonic_ns, term, entry, asked, answer });
        bell();
        held.last
    }

    /// Returns the wanted part of the system as it is now.
    pub(super) fn wanted(&self) -> impl std::ops::Deref<Target = Wanted> + '_ {
        MutexGuard::map(self.held.lock(), |held| &mut held.wanted)
    }

    /// Returns the last revision that a GCM after this one will know: processes are told no later one. While
    /// the store is behind, they are to know more than it.
    pub(super) fn revision(&self) -> u64 {
        match *self.standing.borrow() {
            // Another GCM could lead: a decision is one that is on record.
            _ if self.is_shared() => self.revision.load(Ordering::Relaxed),
            // A disk that is slow may have it by the time at which somebody asks.
            Standing::Written => self.revision.load(Ordering::Relaxed),
            Standing::Behind { .. } if !self.refused.load(Ordering::Relaxed) => {
                self.revision.load(Ordering::Relaxed)
            }
            Standing::None | Standing::Behind { .. } => self.wanted().revision,
        }
    }

    /// Returns the number of the last record.
    pub(super) fn last(&self) -> u64 {
        self.held.lock().last
    }

    /// Returns the number of the last record that an answer may rest on: what it changes can be seen before
    /// it is durable.
    pub(super) fn last_change(&self) -> u64 {
        self.held.lock().changed
    }

    /// Returns how the journal stands, now and later.
    pub(super) fn standing(&self) -> watch::Receiver<Standing> {
        self.standing.subscribe()
    }

    /// Tells whether this GCM may decide, and can put on record what it decides.
    ///
    /// # Errors
    /// Another GCM could lead, and this one does not, or cannot write.
    pub(super) fn accepts(&self) -> Result<(), Refusal> {
        let Some(lead) = &self.lead else { return Ok(()) };
        lead.holds()?;
        match &*self.standing.borrow() {
            Standing::Behind { why } => {
                Err(Refusal::JournalUnavailable { carried_out: false, why: why.clone() })
            }
            Standing::None | Standing::Written => Ok(()),
        }
    }

    /// # Errors
    /// NOT_LEADER: another GCM could lead, and may.
    pub(super) fn leads(&self) -> Result<(), Refusal> {
        self.lead.as_ref().map_or(Ok(()), Lead::holds)
    }

    /// Waits until nothing is written any more.
    pub(super) async fn over(&self) {
        // The sender lives as long as this.
        let _ = self.ended.subscribe().wait_for(|ended| *ended).await;
    }

    /// Waits until a record is durable; a GCM that has its store to itself, no longer than until everybody
    /// can see that records are not.
    ///
    /// # Errors
    /// It is not durable, and another GCM could lead, which then does not know it.
    pub(super) async fn durable(&self, record: u64) -> Result<(), Refusal> {
        let Some(lead) = &self.lead else {
            self.durable_or_behind(record).await;
            return Ok(());
        };
        let (mut durable, mut ended) = (self.durable.subscribe(), self.ended.subscribe());
        // The senders live as long as this.
        let seen = async {
            tokio::select! {
                biased;
                _ = durable.wait_for(|last| *last >= record) => Ok(()),
                why = lead.lost() => Err(why),
                _ = ended.wait_for(|ended| *ended) => Err("the journal is not written any more".to_owned()),
            }
        };
        let late = || match &*self.standing.borrow() {
            Standing::Behind { why } => why.clone(),
            _ => format!("it was not confirmed within {} s", SHARED.as_secs()),
        };
        let seen = tokio::time::timeout(SHARED, seen).await.unwrap_or_else(|_| Err(late()));
        seen.map_err(|why| Refusal::JournalUnavailable { carried_out: true, why })
    }

    /// Tells whether a GCM that is started after this one knows of a record, or of nothing at all.
    pub(super) fn is_on_record(&self, record: u64) -> bool {
        *self.durable.borrow() >= record || *self.standing.borrow() == Standing::None
    }

    /// Tells whether another GCM may lead by now.
    pub(super) fn is_doubted(&self) -> bool {
        self.lead.as_ref().is_some_and(|lead| lead.holds().is_err())
    }

    /// Tells whether another GCM could lead.
    pub(super) fn is_shared(&self) -> bool {
        self.lead.is_some()
    }

    async fn durable_or_behind(&self, record: u64) {
        let (mut durable, mut standing) = (self.durable.subscribe(), self.standing.subscribe());
        if *standing.borrow() == Standing::None {
            return;
        }
        let is_stuck = |_: &Standing| self.is_stuck.load(Ordering::Relaxed);
        // The senders live as long as this.
        let seen = async {
            tokio::select! {
                biased;
                _ = durable.wait_for(|last| *last >= record) => {}
                _ = standing.wait_for(is_stuck) => {}
            }
        };
        let is_late = tokio::time::timeout(PATIENCE, seen).await.is_err();
        if *self.durable.borrow() >= record {
            return;
        }
        self.owed.fetch_max(record, Ordering::Relaxed);
        if is_late {
            self.is_behind("the disk has not confirmed a record within 1 s".into());
        }
    }

    /// Takes records that wait, at most so many and so many bytes. `anew`, and where others had to go: all of
    /// them, and what is wanted after them.
    pub(super) fn take(&self, (most, most_bytes): (usize, usize), anew: bool) -> Batch {
        let mut held = self.held.lock();
        let anew = (anew || held.dropped > 0) && !held.pending.is_empty();
        let anew = anew.then(|| (held.dropped, held.wanted.clone()));
        let (mut records, mut bytes, mut last) = (Vec::new(), 0, 0);
        while let Some(first) = held.pending.front() {
            let is_full = records.len() >= most || bytes >= most_bytes;
            if anew.is_none() && is_full {
                break;
            }
            bytes += weight(&first.1);
            let (number, record) = first.clone();
            held.pending.pop_front();
            last = number;
            records.push(record);
        }
        held.weight = held.weight.saturating_sub(bytes);
        let revision = match held.pending.is_empty() {
            true => held.wanted.revision,
            false => records.iter().filter_map(|record| record.entry.revision()).max().unwrap_or_default(),
        };
        Batch { records, last, revision, anew }
    }

    /// Notes that the store has them.
    pub(super) fn written(&self, batch: &Batch) {
        if let Some((dropped, _)) = &batch.anew {
            self.held.lock().dropped -= dropped;
        }
        self.refused.store(false, Ordering::Relaxed);
        self.is_stuck.store(false, Ordering::Relaxed);
        self.revision.fetch_max(batch.revision, Ordering::Relaxed);
        // First, since whoever has waited for a record may ask for something else at once.
        self.keeps_up(batch.last);
        self.durable.send_replace(batch.last);
        // Somebody may have lost patience in between.
        self.keeps_up(batch.last);
    }

    /// Says so where everything is durable that was answered.
    fn keeps_up(&self, last: u64) {
        if self.bell.lock().is_some() && self.owed.load(Ordering::Relaxed) <= last {
            self.stands(Standing::Written);
        }
    }

    /// Gives them back: the store has none of them.
    pub(super) fn not_written(&self, batch: Batch, why: String) {
        let mut held = self.held.lock();
        for (at, record) in batch.records.into_iter().rev().enumerate() {
            held.weight += weight(&record);
            held.pending.push_front((batch.last.saturating_sub(at as u64), record));
        }
        held.bound();
        drop(held);
        self.refused.store(true, Ordering::Relaxed);
        self.is_behind(why);
    }

    pub(super) fn is_behind(&self, why: String) {
        self.is_stuck.store(true, Ordering::Relaxed);
        if self.stands(Standing::Behind { why: why.clone() }) {
            log::error!("the journal is behind: {why}; what is decided meanwhile is in memory alone");
        }
    }

    fn stands(&self, now: Standing) -> bool {
        self.standing.send_if_modified(|standing| {
            let is_news = *standing != now;
            *standing = now;
            is_news
        })
    }

    /// Ends the way to the store; what waits is written first, if that can be done soon.
    pub(super) async fn close(&self) {
        if self.bell.lock().take().is_some() {
            self.is_stuck.store(true, Ordering::Relaxed);
            self.stands(Standing::Behind { why: "it is closed, since this GCM ends".into() });
        }
        self.over().await;
    }

    /// Notes that nothing is written any more.
    pub(super) fn ended(&self) {
        let is_early = self.bell.lock().take().is_some();
        if is_early && !matches!(*self.standing.borrow(), Standing::Behind { .. }) {
            self.is_behind("it is not written any more: start the GCM again".into());
        }
        self.ended.send_replace(true);
    }
}

impl Held {
    fn put(&mut self, record: Record) {
        self.weight += weight(&record);
        self.pending.push_back((self.last, record));
        self.bound();
    }

    fn bound(&mut self) {
        let (most, most_bytes) = PENDING;
        while self.pending.len() > most || self.weight > most_bytes && self.pending.len() > 1 {
            let oldest = self.pending.pop_front();
            self.weight = self.weight.saturating_sub(oldest.as_ref().map_or(0, |(_, record)| weight(record)));
            self.dropped += 1;
        }
    }
}
