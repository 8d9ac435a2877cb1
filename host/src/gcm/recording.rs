//! The thread that brings records to the store.
//!
//! Invariant: the store is used by one thread at a time and never under a lock. A store that is full, read-
//! only or gone is tried again; one that may have lost what it said it had is not used any more.

use std::io;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Weak};
use std::thread;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use trocar_model::Entry;
use trocar_rt::house;

use super::Gcm;
use super::journal::{Asked, Store, Unusable};
use super::ledger::Standing;
use super::manager::Inner;
use super::past::Past;

/// Records of one write, and about as many bytes of them.
const BATCH: (usize, usize) = (256, 8 << 20);
/// Pause before a store that cannot be written is tried again.
const AGAIN: Duration = Duration::from_secs(1);
/// Longest wait for what waits to be written, at the end.
const AT_THE_END: Duration = Duration::from_secs(1);

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
    /// Returns how the journal stands, now and later.
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
