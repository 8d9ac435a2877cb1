//! A value that any thread writes anew, none waits for, and whose last write is never missed.
//!
//! Invariant: a write that finds another one under way returns at once; that one writes once more.

use std::sync::atomic::{AtomicBool, Ordering};

use trocar_rt::exclusive::TryCell;

/// A value that any thread writes anew; a thread that finds another one at it makes that one write once more.
pub(super) struct Kept<T> {
    value: TryCell<T>,
    missed: AtomicBool,
}

impl<T> Kept<T> {
    pub(super) fn new(value: T) -> Kept<T> {
        Kept { value: TryCell::new(value), missed: AtomicBool::new(false) }
    }

    /// Returns after `f`, or that of another thread, has begun to write; that write began after this call.
    /// Never waits.
    pub(super) fn write(&self, mut f: impl FnMut(&mut T)) {
        if !self.attempt(&mut f) {
            // Either this thread finds the place free now, or the thread that leaves it finds the mark.
            self.missed.swap(true, Ordering::AcqRel);
            self.attempt(&mut f);
        }
    }

    fn attempt(&self, f: &mut impl FnMut(&mut T)) -> bool {
        // Writes once more for each thread that came meanwhile.
        loop {
            let Some(mut value) = self.value.try_enter() else { return false };
            f(&mut value);
            drop(value);
            if !self.missed.swap(false, Ordering::AcqRel) {
                return true;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::atomic::AtomicU64;

    use super::*;

    /// The last value published is the last one shown, whichever thread was writing meanwhile.
    #[test]
    fn what_was_published_before_a_write_is_seen_after_it() {
        let (kept, published, shown) = (Kept::new(()), AtomicU64::new(0), AtomicU64::new(0));
        let show = || kept.write(|()| shown.store(published.load(Ordering::SeqCst), Ordering::SeqCst));
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    for _ in 0..20_000 {
                        published.fetch_add(1, Ordering::SeqCst);
                        show();
                    }
                });
            }
        });
        assert_eq!(shown.into_inner(), 40_000, "the last one was not shown");
    }
}
