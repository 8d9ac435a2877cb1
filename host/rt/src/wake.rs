//! Wakes one sleeping executor from many threads: a latched notification over a futex.
//!
//! A notification is never lost: whatever a notifier wrote before `notify` is seen by the owner after the
//! `wait` or `take` that consumed it. The system call is made only when the owner really sleeps.

use std::sync::Arc;

use crate::os::WaitResult;
use crate::region::{Layout, Place};
use crate::sync::{Futex, Ordering, Scope};

const EMPTY: u32 = 0;
const NOTIFIED: u32 = 1;
const ASLEEP: u32 = 2;

/// One sleeper (the executor that owns it), any number of notifiers.
pub struct Waker {
    state: Place<Futex>,
    scope: Scope,
}

impl Default for Waker {
    fn default() -> Self {
        Self::new()
    }
}

impl Waker {
    pub fn new() -> Self {
        Layout::on_heap(Self::lay_out)
    }

    /// A bell between two processes: one of them notifies, an executor of the other one looks at it and
    /// sleeps on it.
    pub fn lay_out(layout: &mut Layout) -> Self {
        Self { state: layout.place(|| Futex::new(EMPTY)), scope: layout.scope() }
    }

    /// Leaves a notification and wakes the owner if it sleeps. Any thread; never waits; one atomic operation,
    /// and a system call only when the owner sleeps (then `true`).
    pub fn notify(&self) -> bool {
        // Always a swap, never "already notified, so skip": it orders this notifier's writes before the wait.
        let asleep = self.state.word.swap(NOTIFIED, Ordering::Release) == ASLEEP;
        if asleep {
            self.state.wake(1, self.scope);
        }
        asleep
    }

    /// Consumes a notification without waiting; returns whether there was one. Owner only.
    pub fn take(&self) -> bool {
        let word = &self.state.word;
        word.compare_exchange(NOTIFIED, EMPTY, Ordering::Acquire, Ordering::Relaxed).is_ok()
    }

    /// As [`Waker::take`]: a plain load while there is nothing.
    #[inline]
    pub fn take_if_set(&self) -> bool {
        self.state.word.load(Ordering::Relaxed) == NOTIFIED && self.take()
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
            if self.state.wait(ASLEEP, deadline_ns, self.scope) == WaitResult::TimedOut {
                return word.swap(EMPTY, Ordering::Acquire) == NOTIFIED;
            }
        }
    }

    /// Marks the word for a sleep; returns false when a notification came, which stays to be taken.
    fn lie_down(&self) -> bool {
        let word = &self.state.word;
        word.compare_exchange(EMPTY, ASLEEP, Ordering::Relaxed, Ordering::Relaxed) != Err(NOTIFIED)
    }

    /// Takes the mark for a sleep off; a notification stays to be taken.
    fn get_up(&self) {
        let word = &self.state.word;
        // Any other value that another process wrote there is no notification.
        let now = word.load(Ordering::Relaxed);
        if now != NOTIFIED {
            let _ = word.compare_exchange(now, EMPTY, Ordering::Relaxed, Ordering::Relaxed);
        }
    }
}

/// Bells one sleeper can have beside its own waker.
pub const MOST_BELLS: usize = crate::os::MOST_WORDS - 1;

/// Sleeps until `own` was notified (`true`, consumed), or until one of `bells` was (`true`, left to be
/// taken), or until the absolute monotonic deadline in ns (`false`). For the owner of all of them; at most
/// [`MOST_BELLS`]. Where the kernel cannot sleep on several words (before Linux 5.16, or a sandbox without
/// that call) bells are heard within a millisecond, the rest as ever.
pub fn wait_any(own: &Waker, bells: &[Arc<Waker>], deadline_ns: Option<u64>) -> bool {
    if bells.is_empty() {
        return own.wait(deadline_ns);
    }
    loop {
        let down = bells.iter().position(|bell| !bell.lie_down());
        let rung = down.is_some() || !own.lie_down();
        let slept = if rung { WaitResult::Woken } else { wait_on(own, bells, deadline_ns) };
        bells[..down.unwrap_or(bells.len())].iter().for_each(|bell| bell.get_up());
        own.get_up();
        let mine = own.take();
        if mine || bells.iter().any(|bell| bell.state.word.load(Ordering::Relaxed) == NOTIFIED) {
            return true;
        }
        // A bell that another process plays with must not keep the sleeper either.
        let is_over = |end| slept == WaitResult::TimedOut || crate::os::now_ns() >= end;
        if deadline_ns.is_some_and(is_over) {
            return false;
        }
    }
}

#[cfg(not(loom))]
fn wait_on(own: &Waker, bells: &[Arc<Waker>], deadline_ns: Option<u64>) -> WaitResult {
    let all = std::iter::once(own).chain(bells.iter().map(|bell| &**bell));
    let words = all.map(|waker| (&waker.state.word, waker.scope));
    crate::os::futex_wait_any(words, ASLEEP, deadline_ns).unwrap_or_else(|_| {
        // Own wakes come at once here, too; bells are looked at again and again.
        let look_ns = crate::os::now_ns() + LOOK_NS;
        let until_ns = deadline_ns.map_or(look_ns, |end| end.min(look_ns));
        own.state.wait(ASLEEP, Some(until_ns), own.scope);
        WaitResult::Woken
    })
}

/// Time between two looks at bells where the kernel cannot sleep on several words, ns.
#[cfg(not(loom))]
const LOOK_NS: u64 = 1_000_000;

/// Loom has no such sleep; a thread that gives way and looks again meets the same interleavings of the words.
#[cfg(loom)]
fn wait_on(own: &Waker, bells: &[Arc<Waker>], deadline_ns: Option<u64>) -> WaitResult {
    let is_up = |waker: &Waker| waker.state.word.load(Ordering::Relaxed) != ASLEEP;
    if is_up(own) || bells.iter().any(|bell| is_up(bell)) {
        return WaitResult::Changed;
    }
    if deadline_ns.is_some() {
        return WaitResult::TimedOut;
    }
    crate::sync::rest(0);
    WaitResult::Woken
}

/// Most wakes one step can collect before further ones are issued at once.
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

    /// Notifies every collected waker in the order they were noted; returns how many.
    pub fn flush(&mut self) -> usize {
        let collected = std::mem::take(&mut self.len);
        for waker in self.wakers[..collected].iter_mut().filter_map(Option::take) {
            waker.notify();
        }
        collected
    }

    /// Returns the number of wakers collected.
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
