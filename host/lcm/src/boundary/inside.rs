//! The component whose code runs on this thread.
//!
//! Invariant: the pointer is that of a component whose entry lock a call further up this very stack holds.

use std::cell::Cell;
use std::ptr;

use trocar_rt::turn;

use super::super::instance::{Instance, Misuse};
use super::host_table::HostContext;

thread_local! {
    static COMPONENT: Cell<*const HostContext> = const { Cell::new(ptr::null()) };
}

/// The component whose code runs on this thread; null = none.
pub(crate) fn component() -> *const HostContext {
    COMPONENT.get()
}

/// Sets the running component and returns the previous one, to be put back.
#[inline]
pub(crate) fn swap_component(host: *const HostContext) -> *const HostContext {
    COMPONENT.replace(host)
}

/// Shows `f` the component whose code runs on this thread, unless there is none or it is being dropped.
pub(super) fn running<R>(f: impl FnOnce(&Instance) -> R) -> Option<R> {
    // SAFETY: null, or the context of the instance that is being called on this very thread.
    let host = unsafe { component().as_ref() }?;
    let instance = host.instance.get().filter(|instance| instance.strong_count() > 0)?;
    // SAFETY: it was not being dropped, and its code runs on this very thread, inside its entry lock: the
    // manager that removes it waits for that lock, or leaves the instance where it is for good.
    Some(f(unsafe { &*instance.as_ptr() }))
}

/// Tells whether no other thread enters the component whose code runs on this thread before this turn ends.
pub(super) fn runs_kept() -> bool {
    turn::is_inside() && running(|instance| instance.object.is_kept_here()) == Some(true)
}

/// Counts a misuse by the component whose code runs on this thread.
#[cold]
pub(super) fn misused(what: Misuse) {
    running(|instance| instance.counters.misuse(what));
}
