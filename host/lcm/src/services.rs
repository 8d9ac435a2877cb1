//! Dynamic component services: a component's own code asks for services that the GCM offers to everybody.
//!
//! Invariant: asking never waits, locks or allocates on the asking thread, so commands and event handlers of
//! a real-time thread may ask; `step` may not. A reply is handed over between two steps, by the component's
//! own thread, or dropped when the instance that asked is gone.

mod verb;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::{self, JoinHandle};

use trocar_loader::system;
use trocar_model::{ComponentId, State};
use trocar_plugin_api::abi::{
    DISABLED, INVALID_ARGUMENT, LOG_WARN, NOT_ACTIVE, Outcome, QUEUE_FULL, QUEUED, WOULD_BLOCK,
};
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::wake::Waker;
use trocar_rt::{house, os};

use super::context;
use super::executor::Executor;
use super::instance::{Instance, Misuse};
use super::local::LocalLcm;
use super::supervise::Entry;

pub use verb::VERBS as SERVICE_VERBS;

/// Requests of one component that wait for their reply.
const OUTSTANDING: u32 = 64;
/// Requests of all components that wait for the services' thread.
const DEPTH: usize = 64;
/// Longest request, bytes.
const REQUEST_BYTES: usize = 16 << 10;
/// Longest wait of a reply for a thread inside the component, ns, before it queues again.
const PATIENCE_NS: u64 = 20_000_000;
/// Number of times a reply queues before it is given up.
const ATTEMPTS: u32 = 500;

/// Takes the reply, as JSON; called once, from any thread.
pub type ReplyTo = Box<dyn FnOnce(String) + Send>;

/// Executor of the components' requests; given to an LCM from above, see [`LocalLcm::offer_services`].
pub trait Services: Send + Sync {
    /// Begins to carry out `request`, a JSON object with its verb, and returns at once.
    fn request(&self, from: ComponentId, request: String, reply: ReplyTo);
}

/// Queue of the requests of one LCM's components.
pub(super) struct Desk {
    requests: Mailbox,
    waker: Arc<Waker>,
    open: AtomicBool,
    /// Components by number.
    members: Mutex<BTreeMap<u32, Weak<Instance>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// One component's account at the desk.
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

impl Desk {
    pub(super) fn new() -> Arc<Desk> {
        Arc::new(Desk {
            requests: Mailbox::new(DEPTH, REQUEST_BYTES, 0),
            waker: Arc::new(Waker::new()),
            open: AtomicBool::new(false),
            members: Mutex::new(BTreeMap::new()),
            thread: Mutex::new(None),
        })
    }

    pub(super) fn enter(&self, instance: &Arc<Instance>) {
        self.members().insert(instance.number, Arc::downgrade(instance));
    }

    pub(super) fn leave(&self, number: u32) {
        self.members().remove(&number);
    }

    fn members(&self) -> std::sync::MutexGuard<'_, BTreeMap<u32, Weak<Instance>>> {
        self.members.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts the thread that hands requests to `services`.
    pub(super) fn open(
        self: &Arc<Self>,
        services: Arc<dyn Services>,
        lcm: Weak<LocalLcm>,
    ) -> std::io::Result<()> {
        let desk = self.clone();
        self.open.store(true, Ordering::Release);
        let run = move || {
            while desk.open.load(Ordering::Acquire) {
                desk.requests.drain(|head, text| desk.pass_on(&head, text, &*services, &lcm), |_| ());
                desk.waker.wait(None);
            }
        };
        let thread = house::spawn(thread::Builder::new().name("trocar-services".into()), run)?;
        *self.thread.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        Ok(())
    }

    /// Takes no more requests; those not yet passed on are dropped. Replies still arrive.
    pub(super) fn close(&self) {
        self.open.store(false, Ordering::Release);
        self.waker.notify();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the thread of the component services panicked");
        }
    }

    /// Any thread of the component. Never waits, locks or allocates.
    pub(super) fn ask(&self, instance: &Instance, token: u64, request: &[u8]) -> Outcome {
        if context::in_step() {
            instance.counters.misuse(Misuse::ServiceFromStep);
            return WOULD_BLOCK;
        }
        let account = instance.account();
        let made = account.made.load(Ordering::Acquire);
        if made == 0 {
            return NOT_ACTIVE;
        }
        if let Err(why) = check(request) {
            instance.log(LOG_WARN, "services", why);
            return INVALID_ARGUMENT;
        }
        if !self.open.load(Ordering::Acquire) {
            return DISABLED;
        }
        if account.outstanding.fetch_add(1, Ordering::AcqRel) >= OUTSTANDING {
            account.outstanding.fetch_sub(1, Ordering::AcqRel);
            return QUEUE_FULL;
        }
        let head = EntryHead { kind: made, index: instance.number, reply: token, stamp_ns: os::now_ns() };
        match self.requests.push(head, request, Overflow::Reject) {
            Push::Queued => {
                context::wake(&self.waker);
                QUEUED
            }
            _ => {
                account.outstanding.fetch_sub(1, Ordering::AcqRel);
                QUEUE_FULL
            }
        }
    }

    fn pass_on(&self, head: &EntryHead, text: &[u8], services: &dyn Services, lcm: &Weak<LocalLcm>) {
        let Some(instance) = self.members().get(&head.index).cloned() else { return };
        let Some(id) = instance.upgrade().map(|i| i.id.clone()) else { return };
        let pending = Pending { instance, made: head.kind, token: head.reply };
        let lcm = lcm.clone();
        let reply = Box::new(move |reply: String| {
            if let Some(instance) = pending.instance.upgrade()
                && let Some(executor) = lcm.upgrade().and_then(|lcm| lcm.executor_of(&instance))
            {
                hand_over(instance, &executor, pending, reply, ATTEMPTS);
            }
        });
        services.request(id, String::from_utf8_lossy(text).into_owned(), reply);
    }
}

fn check(request: &[u8]) -> Result<(), &'static str> {
    if request.len() > REQUEST_BYTES {
        return Err("a request for a service is longer than 16 KiB: it is refused");
    }
    verb::known(request).map(drop)
}

/// A request whose reply has not been handed over.
struct Pending {
    instance: Weak<Instance>,
    /// Number of the component's instance that asked.
    made: u32,
    token: u64,
}

impl Drop for Pending {
    fn drop(&mut self) {
        if let Some(instance) = self.instance.upgrade() {
            instance.account().outstanding.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// Queues a reply behind the jobs of the component's thread.
fn hand_over(instance: Arc<Instance>, executor: &Arc<Executor>, pending: Pending, reply: String, left: u32) {
    let (here, runs_on) = (executor.clone(), Arc::downgrade(executor));
    here.submit(move |_| {
        let gone = instance.account().made.load(Ordering::Acquire) != pending.made;
        if gone || instance.state() == State::Fault {
            return;
        }
        let Some(mut entered) = instance.object.enter_until(os::now_ns() + PATIENCE_NS) else {
            // A callback thread, or a caller of a passive component, is inside.
            match runs_on.upgrade().filter(|_| left > 0) {
                Some(executor) => hand_over(instance, &executor, pending, reply, left - 1),
                None => log::error!("{}: a service's reply was given up: it is never free", instance.id),
            }
            return;
        };
        let token = pending.token;
        // Frees its place before the component may ask again.
        drop(pending);
        match instance.as_running(Entry::Service, || entered.on_service(token, &reply)) {
            Ok(()) => instance.publish_state(&mut entered),
            Err(e) if e.panicked() => instance.fail(&mut entered, "on_service", &e),
            Err(e) => {
                let text = format!("on_service: {}", e.text);
                instance.message(system::ERROR, &text);
                instance.warn(&text);
                instance.publish_state(&mut entered);
            }
        }
        instance.pay_safe(&mut entered);
        drop(entered);
        instance.drain_if_passive();
    });
}
