//! The queue of the services that components ask for: a bounded queue, and an account for each component.
//!
//! Invariant: asking never waits, locks or allocates on the asking thread. Every request that was taken
//! leaves its account once: when its reply is handed over, or dropped.

mod verb;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Weak};
use std::thread::{self, JoinHandle};

use parking_lot::{Mutex, MutexGuard};
use trocar_model::ComponentId;
use trocar_plugin_api::abi::{DISABLED, NOT_ACTIVE, Outcome, QUEUE_FULL, QUEUED};
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::wake::Waker;
use trocar_rt::{house, os};

use super::context;

pub use verb::VERBS as SERVICE_VERBS;

/// Requests of one component that wait for their reply.
const OUTSTANDING: u32 = 64;
/// Requests of all components that wait for the services' thread.
const DEPTH: usize = 64;
/// Longest request, bytes.
const REQUEST_BYTES: usize = 16 << 10;

/// A component that asks.
pub(super) trait Asker: Send + Sync {
    fn id(&self) -> &ComponentId;

    fn account(&self) -> &Account;
}

/// Queue of the requests of one LCM's components.
pub(super) struct RequestQueue {
    requests: Mailbox,
    waker: Arc<Waker>,
    open: AtomicBool,
    /// Components by number.
    members: Mutex<BTreeMap<u32, Weak<dyn Asker>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// One component's account in the queue.
#[derive(Default)]
pub(super) struct Account {
    outstanding: AtomicU32,
    /// Counts the instances made for this component: 0 before the first is ready, one more after each Reset.
    made: AtomicU32,
}

impl Account {
    /// Number of instances made so far.
    pub(super) fn made(&self) -> u32 {
        self.made.load(Ordering::Acquire)
    }

    /// Counts a new instance that is ready: replies to requests of an earlier one are dropped from now on.
    pub(super) fn made_anew(&self) {
        self.made.fetch_add(1, Ordering::AcqRel);
    }
}

impl RequestQueue {
    pub(super) fn new() -> Arc<RequestQueue> {
        Arc::new(RequestQueue {
            requests: Mailbox::new(DEPTH, REQUEST_BYTES, 0),
            waker: Arc::new(Waker::new()),
            open: AtomicBool::new(false),
            members: Mutex::new(BTreeMap::new()),
            thread: Mutex::new(None),
        })
    }

    pub(super) fn enter(&self, number: u32, asker: Weak<dyn Asker>) {
        self.members().insert(number, asker);
    }

    pub(super) fn leave(&self, number: u32) {
        self.members().remove(&number);
    }

    fn members(&self) -> MutexGuard<'_, BTreeMap<u32, Weak<dyn Asker>>> {
        self.members.lock()
    }

    /// Starts the thread that hands requests to `carry_out`.
    pub(super) fn open(
        self: &Arc<Self>,
        carry_out: impl Fn(Asked, String) + Send + 'static,
    ) -> std::io::Result<()> {
        let request_queue = self.clone();
        self.open.store(true, Ordering::Release);
        let run = move || {
            while request_queue.open.load(Ordering::Acquire) {
                let pass_on = |head: EntryHead, text: &[u8]| {
                    if let Some(asked) = request_queue.asked(&head) {
                        carry_out(asked, String::from_utf8_lossy(text).into_owned());
                    }
                };
                request_queue.requests.drain(pass_on, |_| ());
                request_queue.waker.wait(None);
            }
        };
        let thread = house::spawn(thread::Builder::new().name("trocar-services".into()), run)?;
        *self.thread.lock() = Some(thread);
        Ok(())
    }

    fn asked(&self, head: &EntryHead) -> Option<Asked> {
        let asker = self.members().get(&head.index).cloned()?;
        let id = asker.upgrade()?.id().clone();
        Some(Asked { id, number: head.index, made: head.kind, token: head.reply, asker })
    }

    /// Takes no more requests; those not yet passed on are dropped. Replies still arrive.
    pub(super) fn close(&self) {
        self.open.store(false, Ordering::Release);
        self.waker.notify();
        let thread = self.thread.lock().take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the thread of the component services panicked");
        }
    }

    /// Any thread of the component, outside of its step. Never waits, locks or allocates.
    ///
    /// # Errors
    /// The request is none, in words.
    pub(super) fn ask(
        &self,
        account: &Account,
        number: u32,
        token: u64,
        request: &[u8],
    ) -> Result<Outcome, &'static str> {
        let made = account.made.load(Ordering::Acquire);
        if made == 0 {
            return Ok(NOT_ACTIVE);
        }
        check(request)?;
        if !self.open.load(Ordering::Acquire) {
            return Ok(DISABLED);
        }
        if account.outstanding.fetch_add(1, Ordering::AcqRel) >= OUTSTANDING {
            account.outstanding.fetch_sub(1, Ordering::AcqRel);
            return Ok(QUEUE_FULL);
        }
        let head = EntryHead { kind: made, index: number, reply: token, stamp_ns: os::now_ns() };
        match self.requests.push(head, request, Overflow::Reject) {
            Push::Queued => {
                context::wake(&self.waker);
                Ok(QUEUED)
            }
            _ => {
                account.outstanding.fetch_sub(1, Ordering::AcqRel);
                Ok(QUEUE_FULL)
            }
        }
    }
}

fn check(request: &[u8]) -> Result<(), &'static str> {
    if request.len() > REQUEST_BYTES {
        return Err("a request for a service is longer than 16 KiB: it is refused");
    }
    verb::known(request).map(drop)
}

/// A request that was taken and whose reply has not been handed over.
pub(super) struct Asked {
    pub(super) id: ComponentId,
    /// Number of the component.
    pub(super) number: u32,
    /// Number of the component's instance that asked.
    pub(super) made: u32,
    pub(super) token: u64,
    asker: Weak<dyn Asker>,
}

impl Drop for Asked {
    fn drop(&mut self) {
        if let Some(asker) = self.asker.upgrade() {
            asker.account().outstanding.fetch_sub(1, Ordering::AcqRel);
        }
    }
}
