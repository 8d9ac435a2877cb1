//! State rows that are published a little later: after inline commands of the thread that runs the component.
//!
//! Invariant: the delay cannot be noticed. A row is published before this thread reads it, before anything
//! leaves this thread for another one, and at the end of the cycle. `Instance::owed` is set only while the
//! instance stands in its thread's list.

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use super::context;
use super::instance::Instance;

/// Most components a thread may owe a row at once; one more makes it publish all.
const MOST: usize = 16;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
    static OWED: RefCell<[Option<Arc<Instance>>; MOST]> = const { RefCell::new([const { None }; MOST]) };
}

/// Defers the row of a component of this thread; false where it has to be published now.
#[inline]
pub(super) fn later(instance: &Instance) -> bool {
    // Set only by the thread that runs it: a thread that is inside and finds it set is that thread.
    instance.state_bytes == 0 || instance.owed.get() || enlist(instance)
}

#[inline(never)]
fn enlist(instance: &Instance) -> bool {
    let own_thread_only = !instance.is_passive() && !instance.is_called_back();
    if !context::stepping() || !own_thread_only || context::executor() != instance.executor_id() {
        return false;
    }
    let Some(me) = instance.me() else { return false };
    if COUNT.get() == MOST {
        publish_all();
    }
    let at = COUNT.get();
    OWED.with_borrow_mut(|owed| owed[at] = Some(me));
    COUNT.set(at + 1);
    instance.owed.set(true);
    true
}

/// Publishes the rows this thread owes.
#[inline]
pub(super) fn publish() {
    if COUNT.get() > 0 {
        publish_all();
    }
}

/// Publishes the row of this component, and all others this thread owes, if this thread owes it.
#[inline]
pub(super) fn publish_of(instance: &Instance) {
    if instance.owed.get() && COUNT.get() > 0 && context::executor() == instance.executor_id() {
        publish_all();
    }
}

#[inline(never)]
fn publish_all() {
    for at in 0..COUNT.replace(0) {
        let Some(instance) = OWED.with_borrow_mut(|owed| owed[at].take()) else { continue };
        if !instance.owed.take() {
            // Published in another way: by a step, or for an answer.
            continue;
        }
        // A thread inside it owes the row again on leaving.
        if let Some(mut entered) = instance.object.try_enter() {
            instance.publish_state(&mut entered);
        }
    }
}

/// Tells whether a thread owes this component's row; written by the thread that runs it.
#[derive(Default)]
pub(super) struct Owed(std::sync::atomic::AtomicBool);

impl Owed {
    fn get(&self) -> bool {
        self.0.load(std::sync::atomic::Ordering::Relaxed)
    }

    fn set(&self, owed: bool) {
        self.0.store(owed, std::sync::atomic::Ordering::Relaxed);
    }

    /// Notes that the row is published; returns whether it was owed.
    pub(super) fn take(&self) -> bool {
        let owed = self.get();
        self.set(false);
        owed
    }
}
