//! A mark that something waits, beside a lock that somebody may hold: nobody waits for the lock, and nothing marked stays
//! behind.
//!
//! Whoever brings something marks it and tries to come in; whoever leaves looks at the mark. Each of them changes the mark by
//! a read-modify-write and never only reads or writes it: whoever comes second in its order sees what the first did before,
//! so either the one who leaves finds the mark, or the other one finds the lock free.

use crate::sync::{AtomicBool, Ordering};

/// Something is there for whoever can come in. On a line of its own: others write it while its owner works.
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

    /// Marks, for the thread that alone takes it off and looks at it later by itself: without a read-modify-write.
    #[inline]
    pub fn set_here(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether it is on; in one order with all that is `SeqCst`.
    #[inline]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Takes it off; whether it was on. Sees what was done before it was set.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::AcqRel)
    }

    /// As [`Mark::take`], for a thread that is told when there is something: a plain load while there is nothing.
    #[inline]
    pub fn take_if_set(&self) -> bool {
        self.is_set() && self.take()
    }

    /// Leaves the mark as it is and comes into one order with those who set it: who set it before brought what is seen from now
    /// on, and who sets it later sees what the caller did before. For whoever takes something from all who might bring more.
    pub fn meet(&self) {
        self.0.fetch_or(false, Ordering::SeqCst);
    }

    /// Leaves the mark for whoever is inside, who looks at it when leaving; true when nobody is any more, and the one who
    /// asked has to try again. `is_free` loads the lock with Acquire.
    pub fn leave(&self, is_free: impl FnOnce() -> bool) -> bool {
        self.0.swap(true, Ordering::AcqRel);
        is_free()
    }

    /// Works off what is marked, in `rounds` at most: `enter` comes in, `work` works and leaves. Asked by whoever has just
    /// marked something, and by whoever has just left. True when something is still marked and nobody was seen inside: then
    /// another thread must go on.
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

    /// A lock as that of an instance: taken by a compare-and-swap, given back by a swap, never waited for here.
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

    /// A passive component: what was brought and not worked off (one flag per bringer), and what only the holder touches.
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

        /// What its own thread does when it is woken; then nothing may be left.
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

    /// A caller inside runs its own command, in which something comes back to the component it is in: queued, and run when it
    /// leaves; so is what another thread brings meanwhile.
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
