//! Reads that have to be asked for: those with an argument, answered by the server's process while the caller
//! waits.
//!
//! Invariant: each question is answered, or given up at its deadline or with the link.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use trocar_plugin_api::abi::{DEADLINE, Outcome, PEER_LOST};
use trocar_rt::os;

use super::super::boundary::{Asking, ReadAnswer};
use super::medium::Session;
use super::words::Words;

/// The questions of one link.
pub(super) struct Asks {
    /// `None`: there is no peer to ask.
    session: Option<Weak<dyn Session>>,
    connection: u64,
    epoch: u64,
    next: AtomicU64,
    /// Unanswered questions; `None` when no answer can come any more.
    open: Mutex<Option<BTreeMap<u64, SyncSender<ReadAnswer>>>>,
}

impl Asks {
    pub(super) fn new(session: &Arc<dyn Session>, connection: u64, epoch: u64) -> Arc<Asks> {
        Arc::new(Asks {
            session: Some(Arc::downgrade(session)),
            connection,
            epoch,
            next: AtomicU64::new(1),
            open: Mutex::new(Some(BTreeMap::new())),
        })
    }

    /// Asks of a link that has no peer to ask.
    pub(super) fn of_nobody(connection: u64, epoch: u64) -> Arc<Asks> {
        let (next, open) = (AtomicU64::new(1), Mutex::new(None));
        Arc::new(Asks { session: None, connection, epoch, next, open })
    }

    fn open(&self) -> MutexGuard<'_, Option<BTreeMap<u64, SyncSender<ReadAnswer>>>> {
        self.open.lock()
    }

    /// Delivers the answer to a question.
    pub(super) fn answer(&self, number: u64, answer: ReadAnswer) {
        if let Some(tell) = self.open().as_mut().and_then(|open| open.remove(&number)) {
            // Fails when the caller waits no more.
            let _ = tell.try_send(answer);
        }
    }

    /// Ends all questions: no answer can come any more.
    pub(super) fn end(&self) {
        *self.open() = None;
    }
}

impl Asking for Asks {
    fn ask(&self, index: u32, arg: &[u8], within_ns: u64) -> Result<ReadAnswer, Outcome> {
        let session = self.session.as_ref().and_then(Weak::upgrade).ok_or(PEER_LOST)?;
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let (tell, told) = sync_channel(1);
        self.open().as_mut().ok_or(PEER_LOST)?.insert(number, tell);
        let left_ns = within_ns;
        let words = Words::Ask { connection: self.connection, epoch: self.epoch, number, index, left_ns };
        let until_ns = os::now_ns().saturating_add(within_ns);
        let answer = session.say(&words, arg, &[]).map_err(|_| PEER_LOST).and_then(|()| {
            let left = Duration::from_nanos(until_ns.saturating_sub(os::now_ns()));
            told.recv_timeout(left).map_err(|why| match why {
                RecvTimeoutError::Timeout => DEADLINE,
                RecvTimeoutError::Disconnected => PEER_LOST,
            })
        });
        if let Some(open) = self.open().as_mut() {
            open.remove(&number);
        }
        answer
    }
}
