//! A bounded queue of places between one writer and one reader, where the writer can drop the oldest.
//!
//! `head` only grows, and both ends move it by compare-and-swap: whoever moves it owns the place that stood
//! there. Places the reader is done with go back to the writer through a second ring.

use super::DropPolicy;
use crate::sync::{AtomicU32, AtomicU64, Ordering, Padded};

/// Attempts of the reader against a writer that drops the oldest each time in between.
const ATTEMPTS: usize = 1000;
/// Places beside the queued ones: the one being written, and two at the reader for a moment.
const SPARE: usize = 3;

pub(super) struct Fifo {
    depth: usize,
    pub(super) drop: DropPolicy,
    ring: Box<[AtomicU32]>,
    head: Padded<AtomicU64>,
    tail: Padded<AtomicU64>,
    returned: Box<[AtomicU32]>,
    returned_head: AtomicU64,
    returned_tail: Padded<AtomicU64>,
}

fn ring(at_least: usize) -> Box<[AtomicU32]> {
    (0..at_least.next_power_of_two()).map(|_| AtomicU32::new(0)).collect()
}

fn at(ring: &[AtomicU32], position: u64) -> &AtomicU32 {
    &ring[position as usize & (ring.len() - 1)]
}

impl Fifo {
    pub(super) fn new(depth: usize, drop: DropPolicy) -> Self {
        Self {
            depth,
            drop,
            ring: ring(depth),
            head: Padded(AtomicU64::new(0)),
            tail: Padded(AtomicU64::new(0)),
            returned: ring(depth + SPARE),
            returned_head: AtomicU64::new(0),
            returned_tail: Padded(AtomicU64::new(0)),
        }
    }

    pub(super) fn slots(&self) -> usize {
        self.depth + SPARE
    }

    /// Writer: whether a push must drop something. Once false, it stays false until the writer pushes.
    pub(super) fn is_full(&self) -> bool {
        self.tail.0.load(Ordering::Relaxed) - self.head.0.load(Ordering::Acquire) >= self.depth as u64
    }

    /// Writer: the oldest place, unless the reader made room meanwhile.
    pub(super) fn drop_oldest(&self) -> Option<usize> {
        let head = self.head.0.load(Ordering::Acquire);
        if self.tail.0.load(Ordering::Relaxed) - head < self.depth as u64 {
            return None;
        }
        // A failure means that the reader took exactly this one, and so made room.
        self.take(head)
    }

    /// Writer: queues a place. Not when full.
    pub(super) fn push(&self, place: usize) {
        let tail = self.tail.0.load(Ordering::Relaxed);
        at(&self.ring, tail).store(place as u32, Ordering::Relaxed);
        self.tail.0.store(tail + 1, Ordering::Release);
    }

    /// Writer: a place the reader gave back.
    pub(super) fn reuse(&self) -> Option<usize> {
        let head = self.returned_head.load(Ordering::Relaxed);
        if self.returned_tail.0.load(Ordering::Acquire) == head {
            return None;
        }
        let place = at(&self.returned, head).load(Ordering::Relaxed);
        self.returned_head.store(head + 1, Ordering::Relaxed);
        Some(place as usize)
    }

    /// Reader: how far the queue reaches now.
    pub(super) fn end(&self) -> u64 {
        self.tail.0.load(Ordering::Acquire)
    }

    /// Reader: the oldest place before position `end`.
    pub(super) fn pop(&self, end: u64) -> Option<usize> {
        for _ in 0..ATTEMPTS {
            let head = self.head.0.load(Ordering::Acquire);
            if head >= end {
                return None;
            }
            if let Some(place) = self.take(head) {
                return Some(place);
            }
        }
        None
    }

    /// Reader: gives an emptied place back to the writer. There is room for all places.
    pub(super) fn give_back(&self, place: usize) {
        let tail = self.returned_tail.0.load(Ordering::Relaxed);
        at(&self.returned, tail).store(place as u32, Ordering::Relaxed);
        self.returned_tail.0.store(tail + 1, Ordering::Release);
    }

    fn take(&self, head: u64) -> Option<usize> {
        let place = at(&self.ring, head).load(Ordering::Relaxed);
        let moved = self.head.0.compare_exchange(head, head + 1, Ordering::AcqRel, Ordering::Relaxed);
        moved.is_ok().then_some(place as usize)
    }
}
