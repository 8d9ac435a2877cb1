//! What the present thread is doing: which executor it drives, whether it is inside a step, which component runs.
//!
//! Invariant: only executors and the LCM's own workers set it; slots read it to tell "same executor" from "other thread".

use std::cell::{Cell, RefCell};
use std::ptr;
use std::sync::Arc;

use trocar_rt::wake::{WakeList, Waker};

use super::boundary::HostContext;

/// Identifies a thread of the LCM; 0 is every other thread.
pub(super) type ExecutorId = u64;

thread_local! {
    static EXECUTOR: Cell<ExecutorId> = const { Cell::new(0) };
    static STEPPING: Cell<bool> = const { Cell::new(false) };
    static COMPONENT: Cell<*const HostContext> = const { Cell::new(ptr::null()) };
    static WAKES: RefCell<WakeList> = const { RefCell::new(WakeList::new()) };
}

pub(super) fn executor() -> ExecutorId {
    EXECUTOR.get()
}

pub(super) fn set_executor(id: ExecutorId) {
    EXECUTOR.set(id);
    // Makes the list's thread-local exist before the first step.
    WAKES.with_borrow(|_| ());
}

/// True inside `step`, commands and handlers run by an executor: waiting is not allowed there.
pub(super) fn stepping() -> bool {
    STEPPING.get()
}

pub(super) fn set_stepping(on: bool) {
    STEPPING.set(on);
}

/// The component whose code runs on this thread; null = none.
pub(super) fn component() -> *const HostContext {
    COMPONENT.get()
}

/// Sets the running component and returns the previous one, to be put back.
pub(super) fn swap_component(host: *const HostContext) -> *const HostContext {
    COMPONENT.replace(host)
}

/// Wakes an executor: after the step when called inside one, else at once.
pub(super) fn wake(waker: &Arc<Waker>) {
    if STEPPING.get() {
        WAKES.with_borrow_mut(|list| list.add(waker));
    } else {
        waker.notify();
    }
}

/// Issues the wakes collected during a step.
pub(super) fn flush_wakes() {
    WAKES.with_borrow_mut(WakeList::flush);
}
