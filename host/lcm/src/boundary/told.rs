//! Components of other threads for which this thread's turn has queued something: marked, and woken, when the
//! turn ends.
//!
//! Invariant: the list holds only cores that stay until the turn's end, and is empty when it ends. A mark
//! is one atomic operation, so one mark for everything a cycle has sent is better than one for each.

use std::cell::Cell;
use std::ptr;

use trocar_rt::turn;

use super::super::context;
use super::super::core::Core;

/// Most components a turn tells at its end; beyond that it tells at once.
const MOST: usize = 64;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
    static TOLD: [Cell<*const Core>; MOST] = const { [const { Cell::new(ptr::null()) }; MOST] };
}

/// Tells the component of `core` that data or calls wait for it: inside a turn at its end, else at once.
/// Real-time.
///
/// # Safety
/// In a turn of this thread: `core` was reached through a binding in that very turn, which keeps it to
/// its end.
#[inline]
pub(super) unsafe fn signal(core: &Core) {
    if !turn::is_inside() || core.signals_itself() {
        core.signal();
    } else if core.teller() != context::executor() {
        note(core);
    }
}

#[inline(never)]
fn note(core: &Core) {
    let at = COUNT.get();
    if at == MOST {
        core.signal();
        return;
    }
    TOLD.with(|told| told[at].set(core));
    COUNT.set(at + 1);
    // Another thread may overwrite this number with its own: then the core stands in this list twice,
    // which does no harm.
    core.set_teller(context::executor());
}

/// Marks the components told in this turn, and issues the wakes collected during the step.
pub(crate) fn flush_wakes() {
    context::flush_wakes(mark);
}

/// Marks all that are listed, and notes the wakes. In the same turn.
fn mark() {
    for at in 0..COUNT.replace(0) {
        let core = TOLD.with(|told| told[at].replace(ptr::null()));
        // SAFETY: by the promise of `signal` it stays until this turn's end, and a thread that runs turns
        // comes here before.
        let Some(core) = (unsafe { core.as_ref() }) else { continue };
        core.set_teller(0);
        core.signal();
    }
}
