//! A command that waits for its server's own thread: it is queued, and its answer is awaited where one is
//! wanted.
//!
//! Invariant: a call is answered, or its deadline ends it; the thread that ends the server answers the queued
//! calls, and a caller checks the server once more after it has queued.

use std::sync::Arc;

use trocar_plugin_api::abi::{CallOpts, DEADLINE, MODE_CALL, Outcome, QUEUE_FULL, QUEUED};
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::os;
use trocar_rt::reply::{Reply, ReplyPool, Ticket};

use super::super::context;
use super::super::inbox::{ENTRY_COMMAND, ENTRY_DUE};
use super::super::pending;
use super::texts::write_err;

/// One command of one connection: its place in the queue and its sizes.
pub(crate) struct Lane {
    /// Position in the queue's table.
    pub(crate) index: u32,
    /// True when its argument is a goal that ages.
    pub(crate) ages: bool,
    pub(crate) arg_bytes: usize,
    pub(crate) ret_bytes: usize,
    pub(crate) overflow: Overflow,
}

/// A queue into a server, in this process or another one.
pub(super) trait Destination {
    fn mailbox(&self) -> &Mailbox;
    fn replies(&self) -> &Arc<ReplyPool>;
    /// Tells the server's thread that a call waits.
    fn signal(&self);
    /// As above, and at once: the queue is full, and the caller may try again in this very step.
    fn signal_now(&self);
    /// Called after a call was queued.
    fn queued(&self) {}
    /// Reason why the queue takes nothing any more.
    fn closed(&self) -> Outcome;
    /// Reason why the server would not run the call now; `None`: it would.
    fn away(&self) -> Option<Outcome>;
}

/// Text beside QUEUE_FULL when a newer call replaced this one.
pub(crate) const REPLACED: &str = "a newer call took its place before it ran";

/// Answers a call that a newer one replaced, unexecuted. Real-time.
pub(crate) fn replaced(replies: &ReplyPool, token: u64) {
    if let Some(running) = replies.begin(token, QUEUE_FULL) {
        running.finish(QUEUE_FULL, |_, text| {
            let len = REPLACED.len().min(text.len());
            text[..len].copy_from_slice(&REPLACED.as_bytes()[..len]);
            len
        });
    }
}

/// Queues a call and, in the mode that asks for it, waits for the answer, `deadline_ns` from now at most.
/// `arg` and `ret` have the lane's sizes. Real-time unless it waits.
pub(super) fn queue(
    to: &impl Destination,
    lane: &Lane,
    arg: *const u8,
    ret: *mut u8,
    mode: u32,
    deadline_ns: u64,
    opts: Option<&mut CallOpts>,
) -> Outcome {
    pending::publish();
    let ticket = match mode {
        MODE_CALL => match to.replies().acquire() {
            Some(ticket) => Some(ticket),
            None => return QUEUE_FULL,
        },
        _ => None,
    };
    let says_when = opts.as_ref().is_some_and(|o| o.deadline_ns > 0);
    let (kind, stamp_ns) = if ticket.is_some() || says_when {
        (ENTRY_DUE, os::now_ns().saturating_add(deadline_ns))
    } else {
        // The server judges the age of a call without a deadline of its own.
        (ENTRY_COMMAND, if lane.ages { context::about_now_ns() } else { 0 })
    };
    let reply = ticket.as_ref().map_or(0, |t| t.token());
    if let Some(refused) = push(to, lane, EntryHead { kind, index: lane.index, reply, stamp_ns }, arg) {
        return refused;
    }
    to.signal();
    to.queued();
    let Some(ticket) = ticket else { return QUEUED };
    if let Some(why) = to.away() {
        // The server was stopped after the first check, perhaps on a thread that is held up: the thread that
        // stopped it may have looked into the queue before this call was there.
        to.replies().fail(ticket.token(), why);
    }
    wait(ticket, stamp_ns, (ret, lane.ret_bytes), opts)
}

/// Puts a call into the queue; the outcome of one that was not taken.
#[inline]
fn push(to: &impl Destination, lane: &Lane, head: EntryHead, arg: *const u8) -> Option<Outcome> {
    let payload: &[u8] = if lane.arg_bytes == 0 {
        &[]
    } else {
        // SAFETY: the caller lends an argument of the command's type, whose size was fixed when bound.
        unsafe { std::slice::from_raw_parts(arg, lane.arg_bytes) }
    };
    match to.mailbox().push(head, payload, lane.overflow) {
        Push::Queued => {}
        Push::Full => {
            to.signal_now();
            return Some(QUEUE_FULL);
        }
        Push::TooLong => return Some(QUEUE_FULL),
        Push::Closed => return Some(to.closed()),
        Push::DroppedOldest(old) => replaced(to.replies(), old.reply),
    }
    None
}

/// Waits until `until_ns` for the answer of a queued call, whose result goes to `ret`.
fn wait(
    ticket: Ticket,
    until_ns: u64,
    (ret, ret_bytes): (*mut u8, usize),
    opts: Option<&mut CallOpts>,
) -> Outcome {
    let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
    let reply = ticket.wait(until_ns, |value, text| {
        if ret_bytes > 0 {
            // SAFETY: `ret` has room for the result type; reply cells are made at least that large.
            unsafe { std::ptr::copy_nonoverlapping(value.as_ptr(), ret, ret_bytes.min(value.len())) };
        }
        write_err(err, text);
    });
    match reply {
        Reply::Done(outcome) => outcome,
        Reply::DeadlineNotStarted => DEADLINE,
        Reply::DeadlineMayRun => {
            if let Some(opts) = opts {
                opts.may_still_run = 1;
            }
            DEADLINE
        }
    }
}
