//! The component whose code runs on this thread.
//!
//! Invariant: the pointer is that of a component whose entry lock a call further up this very stack holds, or
//! a thread of its device that has come in and has not left: such a component is not dropped.

use std::cell::Cell;
use std::ptr;

use trocar_rt::turn;

use super::super::books::Misuse;
use super::super::core::Core;

thread_local! {
    static COMPONENT: Cell<*const Core> = const { Cell::new(ptr::null()) };
}

/// The component whose code runs on this thread; null = none.
#[cfg(test)]
pub(crate) fn component() -> *const Core {
    COMPONENT.get()
}

/// Sets the running component and returns the previous one, to be put back.
#[inline]
pub(crate) fn swap_component(core: *const Core) -> *const Core {
    COMPONENT.replace(core)
}

/// Shows `f` the component whose code runs on this thread, unless there is none.
pub(super) fn running<R>(f: impl FnOnce(&Core) -> R) -> Option<R> {
    // SAFETY: null, or the core of the component that is being called on this very thread, inside its entry
    // lock: the manager that removes it waits for that lock, or leaves it where it is for good.
    unsafe { COMPONENT.get().as_ref() }.map(f)
}

/// Tells whether no other thread enters the component whose code runs on this thread before this turn ends.
pub(super) fn runs_kept() -> bool {
    turn::is_inside() && running(|core| core.object.is_kept_here()) == Some(true)
}

/// Counts a misuse by the component whose code runs on this thread.
#[cold]
pub(super) fn misused(what: Misuse) {
    running(|core| core.books.misuse(what));
}
