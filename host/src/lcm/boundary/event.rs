//! Event generators: broadcast to any number of handlers, each with its own bounded queue.
//!
//! Invariant: emitting never waits; what a full queue could not take is counted at that queue.

use std::ffi::c_void;
use std::sync::Arc;

use trocar_plugin_api::abi::{EXECUTED, Outcome, QUEUE_FULL, UNBOUND};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::os;

use super::super::inbox::{ENTRY_EVENT, Inbox};
use super::super::instance::Instance;

/// One observer of one event.
pub(in crate::lcm) enum EventSink {
    /// A handler of a connected component.
    Handler { observer: Arc<Instance>, inbox: Arc<Inbox>, index: u32 },
    /// Somebody outside: the control plane.
    Tap(Arc<Tap>),
}

/// A queue read from outside; the oldest entries give way.
pub(in crate::lcm) struct Tap {
    pub(in crate::lcm) mailbox: Mailbox,
}

/// Host cell behind an event slot.
pub(in crate::lcm) struct EventCell {
    pub(in crate::lcm) sinks: BindingCell<Vec<Arc<EventSink>>>,
    pub(in crate::lcm) bytes: usize,
}

pub(super) unsafe extern "C" fn emit(ctx: *mut c_void, payload: *const c_void) -> Outcome {
    // SAFETY: ctx is the EventCell whose slot this is.
    let cell = unsafe { &*ctx.cast::<EventCell>() };
    let payload: &[u8] = if cell.bytes == 0 {
        &[]
    } else {
        // SAFETY: the caller lends a payload of the event's type.
        unsafe { std::slice::from_raw_parts(payload.cast(), cell.bytes) }
    };
    cell.emit(payload)
}

impl EventCell {
    /// Any thread. Real-time.
    pub(in crate::lcm) fn emit(&self, payload: &[u8]) -> Outcome {
        let sinks = self.sinks.enter();
        if sinks.is_empty() {
            return UNBOUND;
        }
        let stamp_ns = os::now_ns();
        let mut outcome = EXECUTED;
        for sink in sinks.iter() {
            match &**sink {
                EventSink::Handler { observer, inbox, index } => {
                    let head = EntryHead { kind: ENTRY_EVENT, index: *index, reply: 0, stamp_ns };
                    if matches!(inbox.mailbox.push(head, payload, Overflow::Reject), Push::Full) {
                        outcome = QUEUE_FULL;
                    }
                    observer.signal();
                    observer.drain_if_passive();
                }
                EventSink::Tap(tap) => {
                    let head = EntryHead { kind: ENTRY_EVENT, index: 0, reply: 0, stamp_ns };
                    let _ = tap.mailbox.push(head, payload, Overflow::DropOldest);
                }
            }
        }
        outcome
    }

    /// Adds or removes observers; managers only.
    pub(in crate::lcm) fn edit(&self, f: impl FnOnce(&mut Vec<Arc<EventSink>>)) {
        let mut sinks = self.sinks.enter().clone();
        f(&mut sinks);
        self.sinks.swap(Box::new(sinks));
    }
}
