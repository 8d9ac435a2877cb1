//! How one sleeping executor is woken by many: a latched notification over a futex.
//!
//! A notification is never lost: whatever a notifier wrote before `notify` is seen by the owner after the
//! `wait` or `take` that consumed it. The system call is made only when the owner really sleeps.

use std::sync::Arc;

use crate::os::WaitResult;
use crate::sync::{Futex, Ordering};

const EMPTY: u32 = 0;
const NOTIFIED: u32 = 1;
const ASLEEP: u32 = 2;

/// One sleeper (the executor that owns it), any number of notifiers.
pub struct Waker {
    state: Futex,
}

impl Default for Waker {
    fn default() -> Self {
        Self::new()
    }
}

impl Waker {
    pub fn new() -> Self {
        Self { state: Futex::new(EMPTY) }
    }

    /// Leaves a notification and wakes the owner if it sleeps. Any thread; never waits; one atomic operation,
    /// and a system call only when the owner sleeps (then `true`).
    pub fn notify(&self) -> bool {
        // Always a swap, never "already notified, so skip": it orders this notifier's writes before the wait.
        let asleep = self.state.word.swap(NOTIFIED, Ordering::Release) == ASLEEP;
        if asleep {
            self.state.wake(1);
        }
        asleep
    }

    /// Consumes a notification without waiting: whether there was one. Owner only.
    pub fn take(&self) -> bool {
        let word = &self.state.word;
        word.compare_exchange(NOTIFIED, EMPTY, Ordering::Acquire, Ordering::Relaxed).is_ok()
    }

    /// Sleeps until notified (`true`, consumed) or until the absolute monotonic deadline in ns (`false`).
    /// Owner only: with two threads waiting, one of them may miss its notification.
    pub fn wait(&self, deadline_ns: Option<u64>) -> bool {
        let word = &self.state.word;
        loop {
            if self.take() {
                return true;
            }
            if word.compare_exchange(EMPTY, ASLEEP, Ordering::Relaxed, Ordering::Relaxed) == Err(NOTIFIED) {
                continue;
            }
            if self.state.wait(ASLEEP, deadline_ns) == WaitResult::TimedOut {
                return word.swap(EMPTY, Ordering::Acquire) == NOTIFIED;
            }
        }
    }
}

/// How many wakes one step can collect before further ones are issued at once.
pub const WAKE_LIST_CAPACITY: usize = 64;

/// The wakes collected during a step and issued after it, so that no system call falls into the step.
pub struct WakeList {
    wakers: [Option<Arc<Waker>>; WAKE_LIST_CAPACITY],
    len: usize,
}

impl Default for WakeList {
    fn default() -> Self {
        Self::new()
    }
}

impl WakeList {
    pub const fn new() -> Self {
        Self { wakers: [const { None }; WAKE_LIST_CAPACITY], len: 0 }
    }

    /// Notes a waker once; with the list full it is notified at once, so nothing is ever lost. Allocates
    /// nothing. The list holds a count on the waker until the flush.
    pub fn add(&mut self, waker: &Arc<Waker>) {
        if self.wakers[..self.len].iter().flatten().any(|w| Arc::ptr_eq(w, waker)) {
            return;
        }
        match self.wakers.get_mut(self.len) {
            Some(place) => {
                *place = Some(Arc::clone(waker));
                self.len += 1;
            }
            None => {
                waker.notify();
            }
        }
    }

    /// Notifies every collected waker in the order they were noted; how many.
    pub fn flush(&mut self) -> usize {
        let collected = std::mem::take(&mut self.len);
        for waker in self.wakers[..collected].iter_mut().filter_map(Option::take) {
            waker.notify();
        }
        collected
    }

    /// How many wakers are collected.
    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl Drop for WakeList {
    fn drop(&mut self) {
        self.flush();
    }
}
