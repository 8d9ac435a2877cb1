//! The thread that brings records to the store, and the GCM back to where the last one was.
//!
//! Invariant: the store is used by one thread at a time and never under a lock. A store that is full, read-only
//! or gone is tried again; one that may have lost what it said it had is not used any more.

use std::io;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Weak};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use trocar_model::Entry;
use trocar_rt::house;

use super::Gcm;
use super::journal::{Loaded, Remembered, Snapshot, Store, StoreError, Unusable};
use super::ledger::{Batch, Standing};
use super::manager::Inner;

/// Records of one write.
const BATCH: usize = 256;
/// Records after which the fold of all is kept: a load reads no more than these.
const KEEP: usize = 1024;
/// Pause before a store that cannot be written is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// State in which the GCM before this one ended.
pub(super) struct Past {
    pub(super) snapshot: Snapshot,
    /// Records that the store has beside its snapshot.
    pub(super) beside: usize,
}

/// Folds what a store has.
pub(super) fn fold(Loaded { mut snapshot, records }: Loaded) -> Past {
    let beside = records.len();
    for record in records {
        snapshot.wanted.on(&record.entry);
        let (Some(asked), Some(answer)) = (record.asked, record.answer) else { continue };
        // A Stop is never answered from memory.
        if !asked.request_id.is_empty() && !matches!(record.entry, Entry::Stopped { .. }) {
            snapshot.answers.push(Remembered { wall_ns: record.wall_ns, asked, answer });
        }
    }
    Past { snapshot, beside }
}

/// Returns the time at which something was, as far as the clocks tell.
pub(super) fn at(wall_ns: u64) -> Instant {
    let (now, was) = (SystemTime::now(), UNIX_EPOCH + Duration::from_nanos(wall_ns));
    let ago = now.duration_since(was).unwrap_or_default();
    Instant::now().checked_sub(ago).unwrap_or_else(Instant::now)
}

/// Writes what waits each time the bell rings, until the GCM is gone.
fn write(gcm: &Weak<Inner>, store: &mut dyn Store, bell: &mpsc::Receiver<()>, mut beside: usize) {
    let mut again = None;
    loop {
        match again.take() {
            None if bell.recv().is_err() => return,
            None => {}
            Some(pause) => match bell.recv_timeout(pause) {
                // More records do not make room in a store.
                Ok(()) => thread::sleep(pause),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            },
        }
        loop {
            let Some(inner) = gcm.upgrade() else { return };
            let batch = inner.ledger.take(BATCH);
            if batch.records.is_empty() {
                break;
            }
            // Records that had to go are in the fold.
            let fold = (beside >= KEEP || batch.dropped > 0).then(|| Gcm { inner: inner.clone() }.snapshot());
            beside = if fold.is_some() { 0 } else { beside };
            match put(store, fold, &batch) {
                Ok(()) => {
                    beside += batch.records.len();
                    inner.ledger.written(&batch);
                }
                Err(e) => {
                    log::error!("{e}; what is decided meanwhile is in memory alone");
                    inner.ledger.not_written(batch, e.to_string());
                    if e.unusable != Unusable::Now {
                        return log::error!("the journal is not written any more: start the GCM again");
                    }
                    again = Some(AGAIN);
                    break;
                }
            }
        }
    }
}

fn put(store: &mut dyn Store, fold: Option<Snapshot>, batch: &Batch) -> Result<(), StoreError> {
    if let Some(fold) = fold {
        store.keep(&fold)?;
    }
    store.append(&batch.records)
}

impl Gcm {
    /// All that a GCM after this one has to know.
    fn snapshot(&self) -> Snapshot {
        let wanted = self.inner.ledger.wanted().clone();
        Snapshot { wanted, answers: self.inner.answers.lock().remembered() }
    }

    /// How the journal stands, now and later.
    pub fn journal(&self) -> tokio::sync::watch::Receiver<Standing> {
        self.inner.ledger.standing()
    }

    /// Waits until everything that was decided is on record, or until it is known not to be.
    pub async fn flush(&self) {
        self.inner.ledger.durable(self.inner.ledger.last()).await;
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
    beside: usize,
) -> io::Result<()> {
    let gcm = Arc::downgrade(inner);
    let work = move || write(&gcm, &mut *store, &bell, beside);
    house::spawn(thread::Builder::new().name("trocar-journal".into()), work).map(|_| ())
}
