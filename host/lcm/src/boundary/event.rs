//! Event generators: broadcast to any number of handlers, each with its own bounded queue.
//!
//! Invariant: emitting never waits; an event that a full queue could not take is counted at that queue.

use std::ffi::c_void;
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_plugin_api::abi::{EXECUTED, INVALID_ARGUMENT, Outcome, QUEUE_FULL, UNBOUND};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::os;
use trocar_rt::wake::Waker;

use super::super::context;
use super::super::core::Core;
use super::super::inbox::{ENTRY_EVENT, Inbox, Position};
use super::super::pending;
use super::host_table::HostContext;
use super::tap::EventTap;
use super::told;

/// One observer of one event.
pub(crate) enum EventSink {
    /// A handler of a connected component.
    Handler(Handler),
    /// A handler of a component of another process.
    Remote(RemoteHandler),
    /// An observer outside: the control plane.
    Tap(Arc<Tap>),
}

/// A handler of a connected component, reached through one connection's inbox.
pub(crate) struct Handler {
    pub(crate) observer: Arc<Core>,
    pub(crate) inbox: Arc<Inbox>,
    /// Position in the inbox's table.
    pub(crate) index: u32,
    pub(crate) position: Arc<Position>,
    /// Runs inside `emit` when both ends share an executor.
    pub(crate) direct: bool,
}

/// The queue of events to a component of another process.
pub(crate) struct RemoteEvents {
    pub(crate) mailbox: Mailbox,
    pub(crate) bell: Arc<Waker>,
}

/// A handler of a component of another process.
pub(crate) struct RemoteHandler {
    pub(crate) to: Arc<RemoteEvents>,
    /// Position in the queue's table.
    pub(crate) index: u32,
}

/// A queue read from outside; the oldest entries give way.
pub(crate) struct Tap {
    pub(crate) mailbox: Mailbox,
}

/// Present receivers of an event.
#[derive(Clone, Default)]
struct Sinks {
    all: Vec<Arc<EventSink>>,
    /// Is told of the event as well; the sender does not notice.
    tap: Option<EventTap>,
    /// Set when the component that owned the event is gone.
    gone: Option<Arc<HostContext>>,
}

/// Host cell behind an event slot.
pub(crate) struct EventCell {
    sinks: BindingCell<Sinks>,
    /// Lets managers change the sinks one after the other.
    editing: Mutex<()>,
    pub(crate) bytes: usize,
}

pub(super) unsafe extern "C" fn emit(ctx: *mut c_void, payload: *const c_void) -> Outcome {
    // SAFETY: ctx is the EventCell whose slot this is.
    let cell = unsafe { &*ctx.cast::<EventCell>() };
    let payload: &[u8] = if cell.bytes == 0 {
        &[]
    } else if payload.is_null() {
        return INVALID_ARGUMENT;
    } else {
        // SAFETY: the caller lends a payload of the event's type.
        unsafe { std::slice::from_raw_parts(payload.cast(), cell.bytes) }
    };
    cell.emit(payload)
}

impl EventCell {
    /// Any thread. Real-time.
    pub(crate) fn emit(&self, payload: &[u8]) -> Outcome {
        self.sinks.look(|sinks| {
            if let Some(tap) = &sinks.tap {
                tap.tell(payload);
            }
            if sinks.all.is_empty() { sinks.unbound() } else { give(&sinks.all, payload) }
        })
    }

    pub(super) fn new(bytes: usize) -> EventCell {
        EventCell { sinks: BindingCell::new(Box::default()), editing: Mutex::new(()), bytes }
    }

    pub(super) fn reclaim(&self) -> usize {
        self.sinks.reclaim()
    }

    #[cfg(test)]
    pub(crate) fn listeners(&self) -> usize {
        self.sinks.enter().all.len()
    }

    /// Adds or removes observers; managers only.
    pub(crate) fn edit(&self, f: impl FnOnce(&mut Vec<Arc<EventSink>>)) {
        self.change(|sinks| f(&mut sinks.all));
    }

    /// Sets the tap that is told of the event from now on; managers only.
    pub(crate) fn set_tap(&self, tap: Option<EventTap>) {
        self.change(|sinks| sinks.tap = tap);
    }

    /// Marks the event's component as gone.
    pub(super) fn retire(&self, gone: &Arc<HostContext>) {
        self.change(|sinks| *sinks = Sinks { gone: Some(gone.clone()), ..Sinks::default() });
    }

    fn change(&self, f: impl FnOnce(&mut Sinks)) {
        let _one = self.editing.lock();
        let mut sinks = self.sinks.enter().clone();
        f(&mut sinks);
        self.sinks.swap(Box::new(sinks));
    }
}

impl RemoteHandler {
    /// False when the queue is full: counted there, told by the observer's own process.
    fn give(&self, payload: &[u8]) -> bool {
        pending::publish();
        let head = EntryHead { kind: ENTRY_EVENT, index: self.index, reply: 0, stamp_ns: 0 };
        let pushed = self.to.mailbox.push(head, payload, Overflow::Reject);
        context::wake(&self.to.bell);
        !matches!(pushed, Push::Full)
    }
}

impl Handler {
    /// False when the queue is full: counted there, told by the watchdog.
    fn give(&self, payload: &[u8]) -> bool {
        if self.direct && self.runs(payload) {
            return true;
        }
        pending::publish();
        let head = EntryHead { kind: ENTRY_EVENT, index: self.index, reply: 0, stamp_ns: 0 };
        let pushed = self.inbox.mailbox.push(head, payload, Overflow::Reject);
        // SAFETY: this handler stands behind the event, which was looked at in this turn, if there is one.
        unsafe { told::signal(&self.observer) };
        self.observer.drain_if_passive();
        !matches!(pushed, Push::Full)
    }

    /// Runs the handler here and now where that is allowed: on the observer's own executor, nobody inside,
    /// nothing queued before.
    #[inline]
    fn runs(&self, payload: &[u8]) -> bool {
        let observer = &*self.observer;
        if !self.inbox.mailbox.is_empty() {
            return false;
        }
        if let Some(mut entered) = observer.object.enter_kept() {
            if let Some(handler) = self.position.get() {
                observer.handle(&mut entered, handler, payload);
            }
            return true;
        }
        // A manager's thread only queues: a component that runs on callers' threads then runs on its own
        // thread.
        !context::is_deferred() && observer.runs_here() && self.runs_otherwise(payload)
    }

    #[inline(never)]
    fn runs_otherwise(&self, payload: &[u8]) -> bool {
        let observer = &*self.observer;
        let Some(mut entered) = observer.object.try_enter() else { return false };
        if let Some(handler) = self.position.get() {
            observer.handle(&mut entered, handler, payload);
        }
        observer.leave(entered);
        true
    }
}

impl Sinks {
    /// The outcome of an event without receivers.
    fn unbound(&self) -> Outcome {
        if let Some(gone) = &self.gone {
            gone.note_late();
        }
        UNBOUND
    }
}

/// Gives an event to every receiver. Not inlined: an event without receivers stays cheap.
#[inline(never)]
fn give(sinks: &[Arc<EventSink>], payload: &[u8]) -> Outcome {
    let mut outcome = EXECUTED;
    let mut told_ns = None;
    for sink in sinks.iter() {
        match &**sink {
            EventSink::Handler(handler) => {
                if !handler.give(payload) {
                    outcome = QUEUE_FULL;
                }
            }
            EventSink::Remote(handler) => {
                if !handler.give(payload) {
                    outcome = QUEUE_FULL;
                }
            }
            EventSink::Tap(tap) => {
                // Only the outside is told the time, and all taps there the same one; components need no
                // clock for it.
                let stamp_ns = *told_ns.get_or_insert_with(os::now_ns);
                let head = EntryHead { kind: ENTRY_EVENT, index: 0, reply: 0, stamp_ns };
                let _ = tap.mailbox.push(head, payload, Overflow::DropOldest);
            }
        }
    }
    outcome
}
