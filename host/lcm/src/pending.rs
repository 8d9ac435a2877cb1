//! State rows that are published a little later: after inline commands of the thread that runs the component.
//!
//! Invariant: the delay cannot be noticed. A row is published before this thread reads it, before anything
//! leaves this thread for another one, and at the end of the cycle. `Core::owed` is set only while the
//! core stands in its thread's list.

use std::cell::{Cell, RefCell};
use std::sync::Arc;

/// Most components a thread may owe a row at once; one more makes it publish all.
const MOST: usize = 16;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
    static OWED: RefCell<[Option<Arc<dyn Owes>>; MOST]> = const { RefCell::new([const { None }; MOST]) };
}

/// A component whose row may be published later.
pub(super) trait Owes: Send + Sync {
    fn owed(&self) -> &Owed;

    /// Publishes its row, unless a thread is inside, which owes the row again on leaving.
    fn publish_owed(&self);
}

/// Puts a component of this thread into its list; the caller knows that nobody notices the delay.
pub(super) fn enlist(component: Arc<dyn Owes>) {
    if COUNT.get() == MOST {
        publish_all();
    }
    let at = COUNT.get();
    component.owed().set(true);
    OWED.with_borrow_mut(|owed| owed[at] = Some(component));
    COUNT.set(at + 1);
}

/// Publishes the rows this thread owes.
#[inline]
pub(super) fn publish() {
    if COUNT.get() > 0 {
        publish_all();
    }
}

#[inline(never)]
fn publish_all() {
    for at in 0..COUNT.replace(0) {
        let Some(component) = OWED.with_borrow_mut(|owed| owed[at].take()) else { continue };
        // If it is not owed, it was published in another way: by a step, or for an answer.
        if component.owed().take() {
            component.publish_owed();
        }
    }
}

/// Tells whether a thread owes this component's row; written by the thread that runs it.
#[derive(Default)]
pub(super) struct Owed(std::sync::atomic::AtomicBool);

impl Owed {
    #[inline]
    pub(super) fn get(&self) -> bool {
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
