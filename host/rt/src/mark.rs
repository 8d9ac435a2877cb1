//! A mark that something waits, beside a lock that another thread may hold: no thread waits for the lock, and
//! nothing marked stays behind.
//!
//! A thread that brings something marks it and tries to come in; a thread that leaves looks at the mark. Both
//! change the mark by a read-modify-write and never only read or write it: the second one in the mark's order
//! sees what the first one did before. So either the leaving thread finds the mark, or the other one finds
//! the lock free.

use crate::sync::{AtomicBool, Ordering};

/// Tells that something is there for the next thread that comes in. On a line of its own: others write it
/// while its owner works.
#[repr(align(64))]
pub struct Mark(AtomicBool);

impl Default for Mark {
    fn default() -> Self {
        Self(AtomicBool::new(false))
    }
}

impl Mark {
    /// Marks. Any thread; in one order with all that is `SeqCst`.
    pub fn set(&self) {
        self.0.swap(true, Ordering::SeqCst);
    }

    /// Marks, without a read-modify-write. Only for the thread that alone takes the mark off and looks at it
    /// later by itself.
    #[inline]
    pub fn set_here(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Tells whether it is on; in one order with all that is `SeqCst`.
    #[inline]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Takes it off; returns whether it was on. Sees what was done before it was set.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::AcqRel)
    }

    /// As [`Mark::take`], for a thread that is told when there is something: a plain load while there is
    /// nothing.
    #[inline]
    pub fn take_if_set(&self) -> bool {
        self.is_set() && self.take()
    }

    /// Leaves the mark as it is and comes into one order with the threads that set it: the caller sees from
    /// now on what was brought before an earlier set, and a later set sees what the caller did before. For a
    /// thread that takes something from all who might bring more.
    pub fn meet(&self) {
        self.0.fetch_or(false, Ordering::SeqCst);
    }

    /// Leaves the mark for the thread inside, which looks at it when leaving. Returns true when no thread is
    /// inside any more: the caller has to try again. `is_free` loads the lock with Acquire.
    pub fn leave(&self, is_free: impl FnOnce() -> bool) -> bool {
        self.0.swap(true, Ordering::AcqRel);
        is_free()
    }

    /// Works off what is marked, in `rounds` at most: `enter` comes in, `work` works and leaves. For a thread
    /// that has just marked something, or has just left. Returns true when something is still marked and no
    /// thread was seen inside: then another thread must go on.
    pub fn serve<G>(
        &self,
        rounds: usize,
        enter: impl Fn() -> Option<G>,
        is_free: impl Fn() -> bool,
        mut work: impl FnMut(G),
    ) -> bool {
        for _ in 0..rounds {
            if !self.take() {
                return false;
            }
            if let Some(inside) = enter() {
                work(inside);
            } else if !self.leave(&is_free) {
                return false;
            }
        }
        self.is_set()
    }
}

#[cfg(all(test, loom))]
mod models {
    use std::sync::Arc;

    use super::*;
    use crate::loom_models::{Plain, model_within};
    use crate::sync::AtomicU32;

    /// A lock as that of an instance: taken by a compare-and-swap, given back by a swap, never waited for
    /// here.
    struct Lock(AtomicU32);

    struct Held<'a>(&'a Lock);

    impl Lock {
        fn try_enter(&self) -> Option<Held<'_>> {
            let taken = self.0.compare_exchange(0, 1, Ordering::Acquire, Ordering::Relaxed);
            taken.is_ok().then(|| Held(self))
        }

        fn is_free(&self) -> bool {
            self.0.load(Ordering::Acquire) == 0
        }
    }

    impl Drop for Held<'_> {
        fn drop(&mut self) {
            self.0.0.swap(0, Ordering::Release);
        }
    }

    /// A passive component: things brought and not worked off (one flag per bringer), and data only the
    /// holder touches.
    struct Passive {
        mark: Mark,
        lock: Lock,
        brought: [AtomicBool; 2],
        inside: Plain,
    }

    impl Passive {
        fn new() -> Arc<Passive> {
            let brought = [AtomicBool::new(false), AtomicBool::new(false)];
            Arc::new(Passive {
                mark: Mark::default(),
                lock: Lock(AtomicU32::new(0)),
                brought,
                inside: Plain::new(),
            })
        }

        /// Relaxed throughout: the mark and the lock bring the order.
        fn work(&self, held: Held<'_>) {
            for flag in &self.brought {
                if flag.load(Ordering::Relaxed) {
                    flag.store(false, Ordering::Relaxed);
                    self.inside.set(self.inside.get() + 1);
                }
            }
            drop(held);
        }

        fn serve(&self) -> bool {
            self.mark.serve(2, || self.lock.try_enter(), || self.lock.is_free(), |held| self.work(held))
        }

        fn bring(&self, which: usize) -> bool {
            self.brought[which].store(true, Ordering::Relaxed);
            self.mark.set();
            self.serve()
        }

        /// Work of the component's own thread when it is woken; then nothing may be left.
        fn ends(&self, woken: bool) {
            if woken {
                self.serve();
            }
            let held = self.lock.try_enter().expect("nobody is inside");
            assert!(self.brought.iter().all(|b| !b.load(Ordering::Relaxed)), "forgotten");
            drop(held);
        }
    }

    #[test]
    fn loom_two_callers_that_meet_in_a_passive_component_forget_nothing() {
        model_within(3, || {
            let passive = Passive::new();
            let theirs = Arc::clone(&passive);
            let thread = loom::thread::spawn(move || theirs.bring(0));
            let mine = passive.bring(1);
            let woken = thread.join().expect("a caller's checks hold") | mine;
            passive.ends(woken);
            assert_eq!(passive.inside.get(), 2, "each once");
        });
    }

    /// A caller inside runs its own command, which brings something back to its component: it is queued, and
    /// run when the caller leaves; so is what another thread brings meanwhile.
    #[test]
    fn loom_what_comes_while_somebody_is_inside_runs_when_that_one_leaves() {
        model_within(3, || {
            let passive = Passive::new();
            let theirs = Arc::clone(&passive);
            let held = passive.lock.try_enter().expect("nobody is inside yet");
            let thread = loom::thread::spawn(move || theirs.bring(0));
            passive.inside.set(passive.inside.get() + 10);
            let entered_again = passive.bring(1);
            assert!(!entered_again, "it is inside itself, and looks when it leaves");
            drop(held);
            let mine = passive.serve();
            let woken = thread.join().expect("a caller's checks hold") | mine;
            passive.ends(woken);
            assert_eq!(passive.inside.get(), 12, "each once");
        });
    }
}
