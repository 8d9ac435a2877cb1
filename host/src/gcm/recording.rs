//! The thread that brings records to the store, and the GCM back to where the last one was.
//!
//! Invariant: the store is used by one thread at a time and never under a lock. A snapshot is the fold of
//! exactly the records that the store has. A store that is full, read-only or gone is tried again; one that
//! may have lost what it said it had is not used any more.

use std::io;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Weak};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tokio::sync::watch;
use trocar_model::{Entry, Wanted};
use trocar_rt::house;

use super::Gcm;
use super::journal::{Asked, Loaded, Record, Remembered, Snapshot, Store, StoreError, Unusable};
use super::ledger::{Batch, Standing};
use super::manager::Inner;
use super::requests::Answers;
use super::weight::weight;

/// Records of one write, and about as many bytes of them.
const BATCH: (usize, usize) = (256, 8 << 20);
/// Records after which the fold of all is kept, and bytes: a load reads hardly more than these.
const KEEP: (usize, usize) = (1024, 16 << 20);
/// Pause before a store that cannot be written is tried again.
const AGAIN: Duration = Duration::from_secs(1);
/// Longest wait for what waits to be written, at the end.
const AT_THE_END: Duration = Duration::from_secs(1);

/// The fold of all records that a store has.
#[derive(Default)]
pub(super) struct Past {
    pub(super) wanted: Wanted,
    pub(super) answers: Answers,
    /// Records beside the snapshot of the store, and their bytes.
    beside: (usize, usize),
    /// False: what the store has is not known.
    is_loaded: bool,
}

impl Past {
    /// Folds what a store has.
    pub(super) fn of(Loaded { snapshot, records }: Loaded) -> Past {
        let Snapshot { wanted, answers } = snapshot;
        let mut past = Past { wanted, is_loaded: true, ..Past::default() };
        answers.into_iter().for_each(|answer| past.answers.put(answer));
        past.on(&records);
        past
    }

    fn on(&mut self, records: &[Record]) {
        for record in records {
            self.wanted.on(&record.entry);
            self.wanted.term = self.wanted.term.max(record.term);
            self.beside.0 += 1;
            self.beside.1 += weight(record);
            let (Some(asked), Some(answer)) = (&record.asked, &record.answer) else { continue };
            // A Stop is never answered from memory.
            if !asked.request_id.is_empty() && !matches!(record.entry, Entry::Stopped { .. }) {
                let (wall_ns, asked, answer) = (record.wall_ns, asked.clone(), answer.clone());
                self.answers.put(Remembered { wall_ns, asked, answer });
            }
        }
    }

    fn is_long(&self) -> bool {
        self.beside.0 >= KEEP.0 || self.beside.1 >= KEEP.1
    }

    fn snapshot(&self) -> Snapshot {
        Snapshot { wanted: self.wanted.clone(), answers: self.answers.remembered() }
    }

    /// Brings records to the store.
    fn put(&mut self, store: &mut dyn Store, batch: &Batch) -> Result<(), StoreError> {
        let Some((_, wanted)) = &batch.anew else {
            store.append(&batch.records)?;
            self.on(&batch.records);
            if self.is_long() {
                // The records are there all the same.
                match store.keep(&self.snapshot()) {
                    Ok(()) => self.beside = (0, 0),
                    Err(e) => log::warn!("the journal is not folded yet: {e}"),
                }
            }
            return Ok(());
        };
        // What is wanted then is known, although not how it came to be. The records behind that lead to the
        // same once more.
        let whole = Snapshot { wanted: wanted.clone(), answers: self.answers.remembered() };
        store.keep(&whole)?;
        self.beside = (0, 0);
        store.append(&batch.records)?;
        self.on(&batch.records);
        self.wanted.clone_from(wanted);
        // To this, whatever the records would lead to.
        store.keep(&self.snapshot())?;
        self.beside = (0, 0);
        Ok(())
    }
}

/// Returns the time at which something was, as far as the clocks tell.
pub(super) fn at(wall_ns: u64) -> Instant {
    let (now, was) = (SystemTime::now(), UNIX_EPOCH + Duration::from_nanos(wall_ns));
    let ago = now.duration_since(was).unwrap_or_default();
    Instant::now().checked_sub(ago).unwrap_or_else(Instant::now)
}

/// Says so when nothing is written any more, also after a panic.
struct Writing(Weak<Inner>);

impl Drop for Writing {
    fn drop(&mut self) {
        if let Some(inner) = self.0.upgrade() {
            inner.ledger.ended();
        }
    }
}

/// Writes what waits each time the bell rings, until the GCM is gone.
fn write(writing: &Writing, store: &mut dyn Store, bell: &mpsc::Receiver<()>, mut past: Past) {
    let (mut again, mut anew) = (None, !past.is_loaded);
    loop {
        let is_last = !rung(bell, again.take());
        loop {
            let Some(inner) = writing.0.upgrade() else { return };
            let batch = inner.ledger.take(BATCH, anew);
            if batch.records.is_empty() {
                break;
            }
            match past.put(store, &batch) {
                Ok(()) => {
                    anew = false;
                    inner.ledger.written(&batch);
                    if let Some((number @ 1.., _)) = batch.anew {
                        let text =
                            format!("{number} records before this one are lost: the journal was behind");
                        let asked = Asked { text, ..Asked::default() };
                        inner.ledger.enter(|_| (Entry::Noted, Some((asked, Ok(Default::default())))));
                    }
                }
                Err(e) => {
                    let why = e.to_string();
                    inner.ledger.not_written(batch, why);
                    if e.unusable != Unusable::Now {
                        return;
                    }
                    // The store may have been removed, or filled in the middle.
                    anew = true;
                    again = Some(Instant::now() + AGAIN);
                    break;
                }
            }
        }
        if is_last {
            return;
        }
    }
}

/// Waits until something is to be written, and, after a failure, until it may be tried again: more records do
/// not make room in a store. False: nothing more comes.
fn rung(bell: &mpsc::Receiver<()>, again: Option<Instant>) -> bool {
    let Some(again) = again else { return bell.recv().is_ok() };
    loop {
        match bell.recv_timeout(again.saturating_duration_since(Instant::now())) {
            Ok(()) => {}
            Err(RecvTimeoutError::Timeout) => return true,
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
}

impl Gcm {
    /// How the journal stands, now and later.
    pub fn journal(&self) -> watch::Receiver<Standing> {
        self.inner.ledger.standing()
    }

    /// Returns the last revision that a GCM after this one will know, for processes to compare it with.
    pub(crate) fn revision_on_record(&self) -> u64 {
        self.inner.ledger.revision()
    }

    /// Waits until everything that was decided is on record, or until it is known not to be.
    pub async fn flush(&self) {
        self.inner.ledger.durable(self.inner.ledger.last()).await;
    }

    /// Ends the way to the store, which then is another GCM's to use.
    pub(crate) async fn close_journal(&self) {
        // A disk that hangs keeps nobody.
        let _ = tokio::time::timeout(AT_THE_END, self.inner.ledger.close()).await;
    }
}

/// Has a store written by a thread of its own.
///
/// # Errors
/// The machine gives no more threads.
pub(super) fn keep_writing(
    inner: &Arc<Inner>,
    mut store: Box<dyn Store>,
    bell: mpsc::Receiver<()>,
    past: Past,
) -> io::Result<()> {
    let writing = Writing(Arc::downgrade(inner));
    let work = move || {
        write(&writing, &mut *store, &bell, past);
        // Whoever waits for the end may use it at once.
        drop(store);
        drop(writing);
    };
    house::spawn(thread::Builder::new().name("trocar-journal".into()), work).map(|_| ())
}
