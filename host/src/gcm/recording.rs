//! Brings records to the store, on a thread of its own.
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
use super::ledger::{Bell, Standing};
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

/// Place where records are brought to the store.
pub enum Recording {
    /// A thread of its own: the store may block.
    Thread,
    /// A task of the runtime that starts the GCM, for a store that never blocks. Each write takes as long as
    /// this says.
    Task(Box<dyn FnMut() -> Duration + Send>),
}

/// Brings what waits to the store. Its parts are dropped in this order: whoever waits for the end may use the
/// store at once.
struct Writer {
    store: Box<dyn Store>,
    past: Past,
    /// The store is to begin with what is wanted now.
    anew: bool,
    writing: Writing,
}

enum Turn {
    Wrote,
    /// Nothing waits.
    Nothing,
    /// The store cannot be written now.
    Failed,
    /// Nothing is written any more.
    Over,
}

impl Writer {
    /// Writes one batch of what waits.
    fn turn(&mut self) -> Turn {
        let Some(inner) = self.writing.0.upgrade() else { return Turn::Over };
        let batch = inner.ledger.take(BATCH, self.anew);
        if batch.records.is_empty() {
            return Turn::Nothing;
        }
        match self.past.put(&mut *self.store, &batch) {
            Ok(()) => {
                self.anew = false;
                inner.ledger.written(&batch);
                if let Some((number @ 1.., _)) = batch.anew {
                    let text = format!("{number} records before this one are lost: the journal was behind");
                    let asked = Asked { text, ..Asked::default() };
                    inner.ledger.enter(|_| (Entry::Noted, Some((asked, Ok(Default::default())))));
                }
                Turn::Wrote
            }
            Err(e) => {
                let why = e.to_string();
                inner.ledger.not_written(batch, why);
                // The store may have been removed, or filled in the middle.
                self.anew = true;
                if e.unusable == Unusable::Now { Turn::Failed } else { Turn::Over }
            }
        }
    }

    /// Writes each time the bell rings, until the GCM is gone.
    fn on_thread(mut self, bell: &mpsc::Receiver<()>) {
        let mut again = None;
        loop {
            let is_last = !rung(bell, again.take());
            loop {
                match self.turn() {
                    Turn::Wrote => {}
                    Turn::Nothing => break,
                    Turn::Failed => {
                        again = Some(Instant::now() + AGAIN);
                        break;
                    }
                    Turn::Over => return,
                }
            }
            if is_last {
                return;
            }
        }
    }

    /// Does the same in a task.
    async fn in_task(
        mut self,
        mut bell: tokio::sync::mpsc::Receiver<()>,
        mut takes: impl FnMut() -> Duration,
    ) {
        let mut is_last = false;
        while !is_last {
            is_last = bell.recv().await.is_none();
            loop {
                tokio::time::sleep(takes()).await;
                match self.turn() {
                    Turn::Wrote => {}
                    Turn::Nothing => break,
                    // More records do not make room in a store; the end does not wait for it.
                    Turn::Failed if is_last || bell.is_closed() => return,
                    Turn::Failed => tokio::time::sleep(AGAIN).await,
                    Turn::Over => return,
                }
            }
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

    /// Tells whether another GCM may lead this one's system by now.
    pub(crate) fn is_doubted(&self) -> bool {
        self.inner.ledger.is_doubted()
    }

    /// Waits until everything that was decided is on record, or until it is known not to be.
    pub async fn flush(&self) {
        // Known not to be is known, too.
        let _ = self.inner.ledger.durable(self.inner.ledger.last()).await;
    }

    /// Waits until nothing is written any more, which only a start of another GCM mends.
    pub(crate) async fn journal_ended(&self) {
        self.inner.ledger.over().await;
    }

    /// Ends the way to the store, which then is another GCM's to use.
    pub(crate) async fn close_journal(&self) {
        // A disk that hangs keeps nobody.
        let _ = tokio::time::timeout(AT_THE_END, self.inner.ledger.close()).await;
    }
}

/// The other end of a bell.
pub(super) enum Rung {
    Thread(mpsc::Receiver<()>),
    Task(tokio::sync::mpsc::Receiver<()>, Box<dyn FnMut() -> Duration + Send>),
}

/// Returns a bell and its other end. A bell that was not heard yet rings already.
pub(super) fn bell(recording: Recording) -> (Bell, Rung) {
    match recording {
        Recording::Thread => {
            let (ring, rung) = mpsc::sync_channel(1);
            (Box::new(move || _ = ring.try_send(())), Rung::Thread(rung))
        }
        Recording::Task(takes) => {
            let (ring, rung) = tokio::sync::mpsc::channel(1);
            (Box::new(move || _ = ring.try_send(())), Rung::Task(rung, takes))
        }
    }
}

/// Has a store written each time the bell rings.
///
/// # Errors
/// The machine gives no more threads.
pub(super) fn keep_writing(
    inner: &Arc<Inner>,
    store: Box<dyn Store>,
    rung: Rung,
    past: Past,
) -> io::Result<()> {
    let anew = !past.is_loaded;
    let writer = Writer { store, anew, past, writing: Writing(Arc::downgrade(inner)) };
    match rung {
        Rung::Thread(bell) => {
            let work = move || writer.on_thread(&bell);
            house::spawn(thread::Builder::new().name("trocar-journal".into()), work).map(|_| ())
        }
        Rung::Task(bell, takes) => {
            tokio::spawn(writer.in_task(bell, takes));
            Ok(())
        }
    }
}
