//! Components of other threads that something was queued for in this thread's turn: marked, and woken, when it ends.
//!
//! Invariant: the list holds only what stays until the turn's end, and is empty when it ends. A mark is one atomic operation, so
//! one for all that a cycle has sent is better than one for each.

use std::cell::Cell;
use std::ptr;

use trocar_rt::turn;

use super::super::context;
use super::super::instance::Instance;

/// How many components a turn may have to tell; with more of them it tells at once.
const MOST: usize = 64;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
    static TOLD: [Cell<*const Instance>; MOST] = const { [const { Cell::new(ptr::null()) }; MOST] };
}

/// Tells `instance` that something is there for it: in a turn when that ends, else at once. Real-time.
///
/// # Safety
/// In a turn of this thread: `instance` was reached through a binding in that very turn, which keeps it to its end.
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
    // Another thread may write its own number over it: then it stands in this list twice, which is no harm.
    instance.set_teller(context::executor());
}

/// Marks all of them and notes whom to wake. In the turn they were told in.
pub(crate) fn flush() {
    for at in 0..COUNT.replace(0) {
        let instance = TOLD.with(|told| told[at].replace(ptr::null()));
        // SAFETY: by the promise of `signal` it stays until this turn's end, and whoever runs turns comes here before.
        let Some(instance) = (unsafe { instance.as_ref() }) else { continue };
        instance.set_teller(0);
        instance.signal();
    }
}
