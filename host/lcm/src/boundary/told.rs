//! Components of other threads for which this thread's turn has queued something: marked, and woken, when the
//! turn ends.
//!
//! Invariant: the list holds only instances that stay until the turn's end, and is empty when it ends. A mark
//! is one atomic operation, so one mark for everything a cycle has sent is better than one for each.

use std::cell::Cell;
use std::ptr;

use trocar_rt::turn;

use super::super::context;
use super::super::instance::Instance;

/// Most components a turn tells at its end; beyond that it tells at once.
const MOST: usize = 64;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
    static TOLD: [Cell<*const Instance>; MOST] = const { [const { Cell::new(ptr::null()) }; MOST] };
}

/// Tells `instance` that data or calls wait for it: inside a turn at its end, else at once. Real-time.
///
/// # Safety
/// In a turn of this thread: `instance` was reached through a binding in that very turn, which keeps it to
/// its end.
#[inline]
pub(super) unsafe fn signal(instance: &Instance) {
    if !turn::is_inside() || instance.signals_itself() {
        instance.signal();
    } else if instance.teller() != context::executor() {
        note(instance);
    }
}

#[inline(never)]
fn note(instance: &Instance) {
    let at = COUNT.get();
    if at == MOST {
        instance.signal();
        return;
    }
    TOLD.with(|told| told[at].set(instance));
    COUNT.set(at + 1);
    // Another thread may overwrite this number with its own: then the instance stands in this list twice,
    // which does no harm.
    instance.set_teller(context::executor());
}

/// Marks the instances told in this turn, and issues the wakes collected during the step.
pub(crate) fn flush_wakes() {
    context::flush_wakes(mark);
}

/// Marks all listed instances and notes the wakes. In the same turn.
fn mark() {
    for at in 0..COUNT.replace(0) {
        let instance = TOLD.with(|told| told[at].replace(ptr::null()));
        // SAFETY: by the promise of `signal` it stays until this turn's end, and a thread that runs turns
        // comes here before.
        let Some(instance) = (unsafe { instance.as_ref() }) else { continue };
        instance.set_teller(0);
        instance.signal();
    }
}
