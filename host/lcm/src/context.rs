//! Present activity of this thread: the executor it drives, whether it is inside a step, the wakes it owes.
//!
//! Invariant: only executors and the LCM's own workers set it; slots read it to tell "same executor" from
//! "other thread".

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use trocar_rt::os;
use trocar_rt::team::Team;
use trocar_rt::wake::{WakeList, Waker};

/// Identifies a thread of the LCM; 0 is every other thread.
pub(super) type ExecutorId = u64;

thread_local! {
    static EXECUTOR: Cell<ExecutorId> = const { Cell::new(0) };
    static STEPPING: Cell<bool> = const { Cell::new(false) };
    static IN_STEP: Cell<bool> = const { Cell::new(false) };
    static STEP_BEGAN_NS: Cell<u64> = const { Cell::new(0) };
    static WAKES: RefCell<WakeList> = const { RefCell::new(WakeList::new()) };
    static FLUSHING: Cell<bool> = const { Cell::new(false) };
    static DEFERRED: Cell<bool> = const { Cell::new(false) };
    static ROUNDING: Cell<u32> = const { Cell::new(0) };
    static TEAM: RefCell<Option<Arc<Team>>> = const { RefCell::new(None) };
}

#[inline]
pub(super) fn executor() -> ExecutorId {
    EXECUTOR.get()
}

pub(super) fn set_executor(id: ExecutorId) {
    EXECUTOR.set(id);
    // Makes the thread-locals exist before the first step.
    WAKES.with_borrow(|_| ());
    TEAM.with_borrow(|_| ());
    ROUNDING.set(os::rounding());
}

/// Restores the rounding mode that this executor's thread had before any component ran; false when it had
/// changed.
pub(super) fn keep_rounding() -> bool {
    if os::rounding() == ROUNDING.get() {
        return true;
    }
    os::reset_rounding(ROUNDING.get());
    false
}

/// Gives this thread of the LCM the team of its stream; `None` removes it.
pub(super) fn set_team(team: Option<Arc<Team>>) {
    TEAM.set(team);
}

/// The team of the stream whose thread this is; `None` elsewhere and without a pool. Allocates nothing.
pub(super) fn team() -> Option<Arc<Team>> {
    TEAM.with_borrow(Option::clone)
}

/// Runs `f` so that passive components handle its events and calls on their own threads, never here.
pub(super) fn deferred<R>(f: impl FnOnce() -> R) -> R {
    let before = DEFERRED.replace(true);
    let result = f();
    DEFERRED.set(before);
    result
}

/// True inside [`deferred`].
#[inline]
pub(super) fn is_deferred() -> bool {
    DEFERRED.get()
}

/// True inside `step`, commands and handlers run by an executor: waiting is not allowed there.
#[inline]
pub(super) fn stepping() -> bool {
    STEPPING.get()
}

pub(super) fn set_stepping(on: bool) {
    STEPPING.set(on);
}

/// True inside a `step` entry itself, and in everything called from there.
#[inline]
pub(super) fn in_step() -> bool {
    IN_STEP.get()
}

/// Sets when the step that runs on this thread began, ns; 0 ends it.
#[inline]
pub(super) fn set_step_began(ns: u64) {
    STEP_BEGAN_NS.set(ns);
}

/// Start of the step that runs on this thread, ns; outside a step the time now. For statistics, where an
/// error of a step's length does not matter and a look at the clock would.
#[inline]
pub(super) fn about_now_ns() -> u64 {
    match STEP_BEGAN_NS.get() {
        0 => os::now_ns(),
        began => began,
    }
}

/// Runs a `step` entry.
#[inline]
pub(super) fn as_step<R>(f: impl FnOnce() -> R) -> R {
    let before = IN_STEP.replace(true);
    let result = f();
    IN_STEP.set(before);
    result
}

/// Wakes an executor: after the step when called inside one, else at once.
pub(super) fn wake(waker: &Arc<Waker>) {
    if STEPPING.get() || FLUSHING.get() {
        WAKES.with_borrow_mut(|list| list.add(waker));
    } else {
        waker.notify();
    }
}

/// Tells whether wakes noted on this thread are still to be issued.
#[cfg(test)]
pub(super) fn has_wakes() -> bool {
    WAKES.with_borrow(|list| !list.is_empty())
}

/// Issues the wakes collected during the step, and those that `tell` asks for.
pub(super) fn flush_wakes(tell: impl FnOnce()) {
    FLUSHING.set(true);
    tell();
    FLUSHING.set(false);
    WAKES.with_borrow_mut(WakeList::flush);
}
