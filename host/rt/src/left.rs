//! Values a real-time thread lets go of and a manager drops: a list that is pushed to without waiting and
//! taken out whole.
//!
//! A value stands in one list at most, once, and the list owns every count that was left: the last count is
//! always dropped by a manager. Entries only come singly and go all at once, so no address that returns can
//! confuse a push.

use std::ptr::null_mut;
use std::sync::Arc;

use crate::sync::{AtomicPtr, AtomicU32, Ordering};

/// The place inside a value that the list uses.
pub struct Left<T> {
    /// Counts that the list owns; with any it stands in the list, or is about to.
    counts: AtomicU32,
    next: AtomicPtr<T>,
}

impl<T> Default for Left<T> {
    fn default() -> Self {
        Self { counts: AtomicU32::new(0), next: AtomicPtr::new(null_mut()) }
    }
}

/// A value that can be left.
///
/// # Safety
/// `left` answers the same place of the value each time, which nobody else uses, and the value goes into one
/// list only.
pub unsafe trait Leave: Sized {
    fn left(&self) -> &Left<Self>;
}

/// Values that were left and not dropped yet; dropping the list drops them.
pub struct LeftList<T: Leave> {
    first: AtomicPtr<T>,
    owns: std::marker::PhantomData<Arc<T>>,
}

impl<T: Leave> Default for LeftList<T> {
    fn default() -> Self {
        Self { first: AtomicPtr::new(null_mut()), owns: std::marker::PhantomData }
    }
}

impl<T: Leave> LeftList<T> {
    /// Leaves a value to the managers. Any thread; no allocation, no release of memory, never waits.
    pub fn leave(&self, value: Arc<T>) {
        let value = Arc::into_raw(value).cast_mut();
        // Release: all uses of the value come before its end; the thread that takes this count over sees to
        // that.
        // SAFETY: the count stays this call's until it is added.
        if unsafe { &*value }.left().counts.fetch_add(1, Ordering::AcqRel) > 0 {
            // The value stands in the list already; the count goes with that entry.
            return;
        }
        let mut first = self.first.load(Ordering::Relaxed);
        loop {
            // SAFETY: the count just given away is not dropped before the value has been in the list.
            unsafe { &*value }.left().next.store(first, Ordering::Relaxed);
            match self.first.compare_exchange_weak(first, value, Ordering::Release, Ordering::Relaxed) {
                Ok(_) => return,
                Err(now) => first = now,
            }
        }
    }

    /// Gives up the list's counts on all that was left; returns the number of values. Managers only.
    pub fn drop_all(&self) -> usize {
        self.drop_each(|_| {})
    }

    /// As [`LeftList::drop_all`], and shows each value to `see` before.
    pub fn drop_each(&self, see: impl Fn(&T)) -> usize {
        let mut dropped = 0;
        // Acquire: sees each value, and its place in the list, as the leaving thread did.
        let mut at = self.first.swap(null_mut(), Ordering::Acquire);
        while !at.is_null() {
            // SAFETY: the entry owns a count that `leave` gave it, and the list was taken out whole.
            let value = unsafe { Arc::from_raw(at) };
            at = value.left().next.load(Ordering::Relaxed);
            // Acquire: sees all that each leaving thread has done. From here on the value may enter the list
            // anew.
            let counts = value.left().counts.swap(0, Ordering::AcqRel);
            see(&value);
            for _ in 1..counts {
                // SAFETY: each of them is a count that `leave` took, and the swap took them out of the value.
                drop(unsafe { Arc::from_raw(Arc::as_ptr(&value)) });
            }
            dropped += 1;
        }
        dropped
    }
}

impl<T: Leave> Drop for LeftList<T> {
    fn drop(&mut self) {
        self.drop_all();
    }
}

#[cfg(all(test, loom))]
mod models {
    use loom::thread::ThreadId;

    use super::*;
    use crate::cell::BindingCell;
    use crate::loom_models::{Plain, model_within};

    struct Link {
        left: Left<Link>,
        content: Plain,
        drops: Arc<Drops>,
    }

    /// Threads that dropped a link, one for each.
    #[derive(Default)]
    struct Drops(std::sync::Mutex<Vec<ThreadId>>);

    impl Drops {
        fn by(&self) -> Vec<ThreadId> {
            self.0.lock().unwrap().clone()
        }
    }

    // SAFETY: its own place, and one list in each model.
    unsafe impl Leave for Link {
        fn left(&self) -> &Left<Self> {
            &self.left
        }
    }

    impl Drop for Link {
        fn drop(&mut self) {
            // The reader's accesses come before the end of the link.
            self.content.set(0);
            self.drops.0.lock().unwrap().push(loom::thread::current().id());
        }
    }

    /// An input: the link behind it now, and those that the reader has left.
    struct Input {
        link: BindingCell<Option<Arc<Link>>>,
        left: LeftList<Link>,
    }

    impl Input {
        /// The reader's look, as inputs do it.
        fn show(&self, held: &mut Option<Arc<Link>>) {
            let before = self.link.look(|now| match now {
                Some(link) if held.as_ref().is_some_and(|h| Arc::ptr_eq(h, link)) => None,
                now => std::mem::replace(held, now.clone()),
            });
            if let Some(before) = before {
                self.left.leave(before);
            }
            if let Some(link) = held {
                let seen = link.content.get();
                assert!(seen > 0, "dropped under the reader");
                link.content.set(seen + 1);
            }
        }
    }

    /// A reader that picks links up while they are replaced, and a manager that drops them: each link ends
    /// once, after all accesses of the reader.
    #[test]
    fn loom_a_link_that_is_replaced_is_dropped_once_and_after_its_reader_left_it() {
        model_within(3, || {
            let drops = Arc::new(Drops::default());
            let link = || {
                let (left, content) = (Left::default(), Plain::new());
                content.set(1);
                Some(Arc::new(Link { left, content, drops: Arc::clone(&drops) }))
            };
            let input =
                Arc::new(Input { link: BindingCell::new(Box::new(link())), left: LeftList::default() });
            let theirs = Arc::clone(&input);
            let reader = loom::thread::spawn(move || {
                let mut held = None;
                theirs.show(&mut held);
                theirs.show(&mut held);
                held
            });
            input.link.swap(Box::new(link()));
            input.left.drop_all();
            input.link.swap(Box::new(None));
            input.link.reclaim();
            input.left.drop_all();
            let held = reader.join().expect("the reader's checks hold");
            assert_eq!(input.link.reclaim(), 0);
            let kept = usize::from(held.is_some());
            input.left.drop_all();
            assert_eq!(drops.by().len(), 2 - kept);
            held.into_iter().for_each(|link| input.left.leave(link));
            assert_eq!((input.left.drop_all(), drops.by().len()), (kept, 2));
        });
    }

    /// The same value left twice while the list is dropped: it is in there once at a time, none of its counts
    /// is lost, and the thread that leaves it never frees it.
    #[test]
    fn loom_a_value_that_is_left_again_is_dropped_once_and_by_a_manager() {
        model_within(3, || {
            let drops = Arc::new(Drops::default());
            let list = Arc::new(LeftList::default());
            let theirs = Arc::clone(&list);
            let link = Link { left: Left::default(), content: Plain::new(), drops: Arc::clone(&drops) };
            let thread = loom::thread::spawn(move || {
                let link = Arc::new(link);
                theirs.leave(Arc::clone(&link));
                theirs.leave(link);
            });
            let leaver = thread.thread().id();
            list.drop_all();
            thread.join().expect("leaving does not fail");
            assert!(list.drop_all() <= 1, "twice in the list");
            let by = drops.by();
            assert!(by.len() == 1 && by[0] != leaver, "freed by {by:?}, left by {leaver:?}");
        });
    }

    /// Two threads leave, a third drops: nothing is lost between a push and the list that is taken out under
    /// it.
    #[test]
    fn loom_all_that_several_threads_leave_is_dropped_once() {
        model_within(3, || {
            let drops = Arc::new(Drops::default());
            let list = Arc::new(LeftList::default());
            let threads: Vec<_> = (0..2)
                .map(|_| {
                    let (list, drops) = (Arc::clone(&list), Arc::clone(&drops));
                    loom::thread::spawn(move || {
                        let link = Link { left: Left::default(), content: Plain::new(), drops };
                        link.content.set(1);
                        list.leave(Arc::new(link));
                    })
                })
                .collect();
            let mut dropped = list.drop_all();
            threads.into_iter().for_each(|t| t.join().expect("leaving does not fail"));
            dropped += list.drop_all();
            assert_eq!((dropped, drops.by().len()), (2, 2));
        });
    }
}
