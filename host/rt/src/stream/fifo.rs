//! A bounded queue of places between one writer and one reader, where the writer can drop the oldest.
//!
//! `head` only grows, and both ends move it by compare-and-swap: the end that moves it owns the place that
//! stood there. Places the reader is done with go back to the writer through a second ring. The other end may
//! be another process: whatever the words hold, a ring yields only one of the places.

use super::DropPolicy;
use crate::region::{Layout, Place, Table};
use crate::sync::{AtomicU32, AtomicU64, Ordering, Padded};

/// Attempts of the reader against a writer that drops the oldest each time in between.
const ATTEMPTS: usize = 1000;
/// Places beside the queued ones: the one being written, and two at the reader for a moment.
const SPARE: usize = 3;

pub(super) struct Fifo {
    depth: usize,
    pub(super) drop: DropPolicy,
    ring: Table<AtomicU32>,
    head: Place<Padded<AtomicU64>>,
    tail: Place<Padded<AtomicU64>>,
    returned: Table<AtomicU32>,
    returned_tail: Place<Padded<AtomicU64>>,
}

/// State only the writer knows: its free places and its positions in both rings. Kept here rather than loaded
/// back from the shared words, also because loom would take such a load for the last conflicting access.
pub(super) struct Writing {
    free: Vec<u32>,
    tail: u64,
    returned_head: u64,
    /// Position of the reader at the last look: it is there or further. Where that is room enough the writer
    /// looks no more, since a line that the other processor has just written costs more than all the rest of
    /// a push.
    seen_head: u64,
    seen_returned_tail: u64,
}

/// State only the reader knows: its position in the ring of returned places.
#[derive(Default)]
pub(super) struct Reading {
    returned_tail: u64,
}

fn ring(layout: &mut Layout, at_least: usize) -> Table<AtomicU32> {
    layout.table(at_least.next_power_of_two(), |_| AtomicU32::new(0))
}

fn position(layout: &mut Layout) -> Place<Padded<AtomicU64>> {
    layout.place(|| Padded(AtomicU64::new(0)))
}

fn at(ring: &[AtomicU32], position: u64) -> &AtomicU32 {
    &ring[position as usize & (ring.len() - 1)]
}

impl Writing {
    /// Frees a place. With a reader that plays with the words there may seem to be more places than there
    /// are: no allocation.
    pub(super) fn give_back(&mut self, place: usize) {
        if self.free.len() < self.free.capacity() {
            self.free.push(place as u32);
        }
    }
}

impl Fifo {
    pub(super) fn lay_out(layout: &mut Layout, depth: usize, drop: DropPolicy) -> Self {
        Self {
            depth,
            drop,
            ring: ring(layout, depth),
            head: position(layout),
            tail: position(layout),
            returned: ring(layout, depth + SPARE),
            returned_tail: position(layout),
        }
    }

    pub(super) fn slots(&self) -> usize {
        self.depth + SPARE
    }

    /// The writer's side at the beginning, with all places free.
    pub(super) fn writing(&self) -> Writing {
        Writing {
            free: (0..self.slots() as u32).collect(),
            tail: 0,
            returned_head: 0,
            seen_head: 0,
            seen_returned_tail: 0,
        }
    }

    /// Writer: returns how many are queued. Until the writer pushes they only become fewer.
    pub(super) fn queued(&self, writing: &Writing) -> u64 {
        writing.tail.wrapping_sub(self.head.0.load(Ordering::Acquire))
    }

    /// Writer: tells whether a push must drop something. Once false, it stays false until the writer pushes.
    #[inline]
    pub(super) fn is_full(&self, writing: &mut Writing) -> bool {
        let too_many = |head: u64| writing.tail.wrapping_sub(head) >= self.depth as u64;
        if !too_many(writing.seen_head) {
            return false;
        }
        writing.seen_head = self.head.0.load(Ordering::Acquire);
        too_many(writing.seen_head)
    }

    /// Writer: while one more would be too many, gives up the oldest place, which `emptied` gets; returns how
    /// many those were. With each turn one leaves the queue, to whichever end, so there are at most `depth`.
    pub(super) fn make_room(
        &self,
        writing: &mut Writing,
        too_many: impl Fn(u64) -> bool,
        mut emptied: impl FnMut(usize),
    ) -> u64 {
        let mut given_up = 0;
        for _ in 0..self.depth {
            let head = self.head.0.load(Ordering::Acquire);
            let queued = writing.tail.wrapping_sub(head);
            if queued == 0 || !too_many(queued.saturating_add(1)) {
                break;
            }
            given_up += u64::from(self.give_up(writing, head, &mut emptied));
        }
        given_up
    }

    /// Writer: takes a free place to fill. Of depth + 3 places at most depth are queued and two at the
    /// reader, so there always is one. A returned place goes first: so only as many places are used as were
    /// ever queued at once, and those of a queue that is much deeper than it is full stay in the cache.
    pub(super) fn free_place(&self, writing: &mut Writing) -> Option<usize> {
        let head = writing.returned_head;
        if writing.seen_returned_tail == head {
            writing.seen_returned_tail = self.returned_tail.0.load(Ordering::Acquire);
        }
        if writing.seen_returned_tail == head {
            return writing.free.pop().map(|place| place as usize);
        }
        writing.returned_head = head + 1;
        Some(self.place_in(at(&self.returned, head)))
    }

    /// Writer: queues a filled place; where the queue is full, `emptied` gets the oldest place, which is free
    /// afterwards. Returns whether that was so.
    pub(super) fn push(&self, writing: &mut Writing, place: usize, emptied: impl FnOnce(usize)) -> bool {
        let dropped = self.is_full(writing) && self.give_up(writing, writing.seen_head, emptied);
        at(&self.ring, writing.tail).store(place as u32, Ordering::Relaxed);
        writing.tail += 1;
        self.tail.0.store(writing.tail, Ordering::Release);
        dropped
    }

    /// Reader: returns how far the queue reaches now.
    pub(super) fn end(&self) -> u64 {
        self.tail.0.load(Ordering::Acquire)
    }

    /// Reader: takes the oldest place before position `end`.
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
    pub(super) fn give_back(&self, reading: &mut Reading, place: usize) {
        at(&self.returned, reading.returned_tail).store(place as u32, Ordering::Relaxed);
        reading.returned_tail += 1;
        self.returned_tail.0.store(reading.returned_tail, Ordering::Release);
    }

    /// Writer: takes the place at `head` out of the queue. A failure means that the reader took exactly this
    /// one, and so made room.
    fn give_up(&self, writing: &mut Writing, head: u64, emptied: impl FnOnce(usize)) -> bool {
        let Some(oldest) = self.take(head) else { return false };
        emptied(oldest);
        writing.give_back(oldest);
        true
    }

    fn place_in(&self, word: &AtomicU32) -> usize {
        (word.load(Ordering::Relaxed) as usize).min(self.slots() - 1)
    }

    fn take(&self, head: u64) -> Option<usize> {
        let place = self.place_in(at(&self.ring, head));
        // Acquire also where the other end was faster: this end sees then what it gave back before, see
        // `free_place`.
        let moved =
            self.head.0.compare_exchange(head, head.wrapping_add(1), Ordering::AcqRel, Ordering::Acquire);
        moved.is_ok().then_some(place)
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn a_deep_queue_that_is_read_in_time_uses_few_of_its_places() {
        let fifo = Layout::on_heap(|layout| Fifo::lay_out(layout, 1000, DropPolicy::DropOldest));
        let (mut writing, mut reading) = (fifo.writing(), Reading::default());
        let mut used = std::collections::BTreeSet::new();
        for _ in 0..1000 {
            for _ in 0..10 {
                let place = fifo.free_place(&mut writing).expect("it is not full");
                used.insert(place);
                assert!(!fifo.push(&mut writing, place, |_| ()));
            }
            let end = fifo.end();
            while let Some(place) = fifo.pop(end) {
                fifo.give_back(&mut reading, place);
            }
        }
        assert_eq!(used.len(), 10);
    }

    /// A place the writer is told of twice would be a place more in its list, in memory taken during a step.
    #[test]
    fn a_reader_that_plays_with_the_words_adds_no_place() {
        let fifo = Layout::on_heap(|layout| Fifo::lay_out(layout, 4, DropPolicy::DropOldest));
        let mut writing = fifo.writing();
        let room = writing.free.capacity();
        for turn in 0..1000u64 {
            fifo.head.0.store(writing.tail.wrapping_sub(turn % 7), Ordering::Relaxed);
            fifo.returned_tail.0.store(turn.wrapping_mul(3), Ordering::Relaxed);
            fifo.ring.iter().for_each(|word| word.store(turn as u32 * 77, Ordering::Relaxed));
            fifo.make_room(&mut writing, |_| true, |place| assert!(place < fifo.slots()));
            let Some(place) = fifo.free_place(&mut writing) else { continue };
            assert!(place < fifo.slots());
            fifo.push(&mut writing, place, |oldest| assert!(oldest < fifo.slots()));
        }
        assert_eq!(writing.free.capacity(), room, "the list grew");
    }
}

#[cfg(all(test, loom))]
mod models {
    use std::sync::Arc;

    use super::*;
    use crate::loom_models::{Plain, model_within};

    /// With a single place in use the writer's next sample goes where the reader has just been: only the way
    /// back through the ring of returned places orders the two.
    #[test]
    fn loom_a_place_that_comes_back_is_written_after_it_was_read() {
        model_within(3, || {
            let shared =
                Arc::new((Layout::on_heap(|l| Fifo::lay_out(l, 1, DropPolicy::DropNewest)), Plain::new()));
            let mut writing = shared.0.writing();
            writing.free = vec![0];
            let theirs = Arc::clone(&shared);
            let reader = loom::thread::spawn(move || {
                let (fifo, content) = &*theirs;
                let mut reading = Reading::default();
                for _ in 0..2 {
                    if let Some(place) = fifo.pop(fifo.end()) {
                        assert_eq!((place, content.get() > 0), (0, true), "another place");
                        fifo.give_back(&mut reading, place);
                    }
                }
            });
            let (fifo, content) = &*shared;
            for sample in 1..=2 {
                if let Some(place) = fifo.free_place(&mut writing) {
                    content.set(sample);
                    assert!(!fifo.push(&mut writing, place, |_| {}), "the only place cannot be queued twice");
                }
            }
            reader.join().expect("the reader's checks hold");
        });
    }
}
