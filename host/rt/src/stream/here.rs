//! Samples that do not leave their thread: two places of a latest link, exchanged without an atomic
//! operation.
//!
//! Invariant: used only with the right to read the link, which the writer has by promise, see
//! [`super::StreamWriter::push_here`]. Others may look only at `unseen`, to count.

use super::latest;
use crate::sync::{AtomicBool, Ordering, Shared};

/// Places besides those of the exchange between threads.
pub(super) const SLOTS: usize = 2;
const FIRST: usize = latest::SLOTS;

/// Roles of the two places.
pub(super) struct Here {
    /// The place that may be shown; the other one is written.
    front: Shared<usize>,
    unseen: AtomicBool,
}

// SAFETY: `front` is touched with the right to read alone, which one thread has at a time and hands on in
// order.
unsafe impl Sync for Here {}

impl Here {
    pub(super) fn new() -> Self {
        Self { front: Shared::new(FIRST), unseen: AtomicBool::new(false) }
    }

    /// Returns the place to write. An unseen sample in it is gone then.
    ///
    /// # Safety
    /// With the right to read.
    #[inline]
    pub(super) unsafe fn back(&self) -> usize {
        // SAFETY: whoever has the right to read is alone here.
        2 * FIRST + 1 - unsafe { *self.front.exclusive() }
    }

    /// Publishes the written back place; returns whether an unseen sample gave way.
    #[inline]
    pub(super) fn publish(&self) -> bool {
        let gave_way = self.has_unseen();
        self.unseen.store(true, Ordering::Relaxed);
        gave_way
    }

    #[inline]
    pub(super) fn has_unseen(&self) -> bool {
        self.unseen.load(Ordering::Relaxed)
    }

    /// The place of the unseen sample, which may be shown from now on.
    ///
    /// # Safety
    /// As for [`Here::back`].
    #[inline]
    pub(super) unsafe fn take(&self) -> usize {
        self.unseen.store(false, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        let back = unsafe { self.back() };
        // SAFETY: as in `back`.
        unsafe { *self.front.exclusive() = back };
        back
    }
}

#[cfg(all(test, loom))]
mod models {
    use std::sync::Arc;

    use crate::loom_models::model_within;
    use crate::stream::{Meta, Payload, Queue, StreamReader, stream_link};
    use crate::sync::Mutex;

    fn bytes(seq: u64) -> [u8; 8] {
        (seq * 10).to_ne_bytes()
    }

    fn look(reader: &mut StreamReader) -> bool {
        let Some(sample) = reader.next() else { return false };
        assert_eq!(sample.data, bytes(sample.meta.seq), "torn sample");
        true
    }

    /// One sample comes from a thread that has no right to read, one from a thread that has it; the right
    /// changes hands.
    #[test]
    fn loom_samples_of_the_reading_thread_and_of_another_are_whole_and_counted() {
        model_within(3, || {
            let (writer, reader) = stream_link(Payload::Plain { bytes: 8 }, Queue::Latest);
            let writer = Arc::new(writer);
            let right = Arc::new(Mutex::new(reader));
            let (theirs, their_right) = (Arc::clone(&writer), Arc::clone(&right));
            let meta = |seq| Meta { stamp_ns: 0, came_ns: 0, seq };
            let other = loom::thread::spawn(move || {
                let _ = theirs.push(&bytes(1), meta(1));
                look(&mut their_right.lock().expect("no model panics with it"));
            });
            {
                let mut held = right.lock().expect("no model panics with it");
                // SAFETY: this thread holds the reader.
                let _ = unsafe { writer.push_here(&bytes(2), meta(2)) };
                look(&mut held);
            }
            other.join().expect("its checks hold");
            let mut held = right.lock().expect("no model panics with it");
            while look(&mut held) {}
            let stats = held.stats();
            assert_eq!((stats.pushed, stats.taken + stats.dropped), (2, 2), "{stats:?}");
        });
    }
}
