//! Frame pools: a slot has one writer or many readers, and goes from holder to holder in order.

use std::sync::Arc;

use loom::sync::atomic::{AtomicU64, Ordering};
use loom::thread;

use super::{Plain, model};
use crate::pool::{FrameMut, FramePool};

#[test]
fn loom_a_slot_is_lent_to_one_and_comes_back_after_its_last_frame() {
    model(|| {
        let pool = FramePool::new(1, 8, 0).unwrap();
        let mut writing = pool.loan().unwrap();
        writing.parts_mut().0[0] = 1;
        let frame = writing.freeze(0);
        let other = frame.clone();
        let thread = thread::spawn(move || {
            assert_eq!(other.header()[0], 1);
            if let Ok(mut mine) = other.try_unique() {
                mine.parts_mut().0[0] = 2;
            }
        });
        if let Ok(mut mine) = frame.try_unique() {
            assert_eq!(mine.parts_mut().0[0], 1, "written by another holder");
        }
        thread.join().unwrap();
        assert_eq!(pool.stats().free, 1);
        assert!(pool.loan().is_some());
    });
}

/// The next holder of a slot sees what the last one wrote beside it, and every loan is a slot or counted as
/// refused.
#[test]
fn loom_a_slot_goes_from_holder_to_holder_and_refusals_are_counted() {
    model(|| {
        let shared = Arc::new((FramePool::new(1, 8, 0).unwrap(), Plain::new()));
        let borrow = |(pool, content): &(Arc<FramePool>, Plain)| {
            if let Some(frame) = pool.loan() {
                content.set(content.get() + 1);
                drop(frame);
            }
        };
        let theirs = Arc::clone(&shared);
        let thread = thread::spawn(move || borrow(&theirs));
        borrow(&shared);
        thread.join().unwrap();
        let stats = shared.0.stats();
        assert_eq!(shared.1.get() + stats.exhausted, 2, "{stats:?}");
        assert_eq!((stats.free, stats.high_water), (1, 1), "{stats:?}");
    });
}

/// The last of several readers gives the slot back: its next writer comes after all of them.
#[test]
fn loom_a_slot_is_written_again_after_its_last_reader() {
    model(|| {
        let shared = Arc::new((FramePool::new(1, 8, 0).unwrap(), Plain::new()));
        let (pool, content) = &*shared;
        let frame = pool.loan().unwrap().freeze(0);
        let (other, theirs) = (frame.clone(), Arc::clone(&shared));
        let thread = thread::spawn(move || {
            assert_eq!(theirs.1.get(), 0, "written under a reader");
            drop(other);
        });
        assert_eq!(content.get(), 0, "written under a reader");
        // In place when the other reader has gone already, else whenever the slot is free again.
        if let Ok(_mine) = frame.try_unique() {
            content.set(1);
        }
        if let Some(_again) = pool.loan() {
            content.set(1);
        }
        thread.join().unwrap();
        assert_eq!(pool.stats().free, 1);
    });
}

/// The same number on two threads: one of them gets the frame, and writes it after the thread that gave the
/// number out.
#[test]
fn loom_a_number_that_comes_back_twice_brings_one_frame() {
    model(|| {
        let shared = Arc::new((FramePool::new(1, 8, 0).unwrap(), Plain::new()));
        let writing = shared.0.loan().unwrap();
        let raw = Arc::new(AtomicU64::new(0));
        let take = |shared: &(Arc<FramePool>, Plain), raw: &AtomicU64| {
            // SAFETY: 0, or the number of a slot of that pool, which lives as long as the model.
            let back = unsafe { FrameMut::from_raw(raw.load(Ordering::Relaxed)) };
            if back.is_some() {
                shared.1.set(shared.1.get() + 1);
                assert!(shared.0.loan().is_none(), "given back by the one who came too late");
            }
            back.is_some()
        };
        let (other, theirs) = (Arc::clone(&shared), Arc::clone(&raw));
        let thread = thread::spawn(move || take(&other, &theirs));
        shared.1.set(10);
        // Relaxed on purpose: the number alone brings the order with it.
        raw.store(writing.into_raw(), Ordering::Relaxed);
        let mine = take(&shared, &raw);
        assert!(mine != thread.join().unwrap(), "one of the two");
        assert_eq!((shared.1.get(), shared.0.stats().free), (11, 1));
    });
}
