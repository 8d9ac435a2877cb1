//! The slots of a mailbox, and the owner of each.
//!
//! Invariant: only the thread that moved a slot's sequence to *busy*, or claimed the tail over a free one,
//! touches its body and payload, until the sequence moves on.

use super::{EntryHead, Mailbox, Overflow};
use crate::buf::copy;
use crate::region::{AnyBits, Plain};
use crate::sync::{AtomicU32, AtomicU64, Ordering, Shared, pause_while};

/// Longest look of a thread that empties the mailbox at an entry another thread is just copying, ns: many
/// times the length of a copy, unless that thread was suspended over it.
const COPYING_NS: u64 = 5_000;

pub(super) const FREE: u64 = 0;
pub(super) const READY: u64 = 1;
pub(super) const BUSY: u64 = 2;

/// The sequence of a slot at position `at`. Positions only grow, so no value ever returns.
pub(super) const fn phase(at: u64, phase: u64) -> u64 {
    at.wrapping_mul(4).wrapping_add(phase)
}

/// Returns the position behind. Positions that another process writes may be anything, and then mean nothing.
pub(super) const fn after(at: u64) -> u64 {
    at.wrapping_add(1)
}

/// A line of its own, so that an entry with a small payload crosses between two processors by one line.
#[repr(C, align(64))]
pub(super) struct Slot {
    pub(super) sequence: AtomicU64,
    /// Copy of the head's index that may be read without owning the slot.
    pub(super) index: AtomicU32,
    pub(super) body: Shared<Body>,
    pub(super) small: Shared<[u64; SMALL / 8]>,
}

// SAFETY: atomic numbers and cells of plain bits.
unsafe impl Plain for Slot {}

/// Payloads up to this many bytes lie beside the head.
pub(super) const SMALL: usize = 16;

#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(super) struct Body {
    pub(super) head: EntryHead,
    /// Bytes of the payload.
    pub(super) len: u64,
}

// SAFETY: numbers.
unsafe impl AnyBits for Body {}

pub(super) enum Claim {
    /// The caller owns the slot of this position.
    Mine(u64),
    /// The oldest entry is being written or taken by another thread.
    InWork,
    Empty,
}

impl Mailbox {
    #[inline]
    pub(super) fn slot(&self, at: u64) -> &Slot {
        &self.slots[at as usize & (self.slots.len() - 1)]
    }

    /// Returns room for at least `stride` bytes; for the owner of the slot.
    #[inline]
    pub(super) fn payload(&self, at: u64) -> *mut u8 {
        if self.stride <= SMALL {
            return self.slot(at).small.exclusive().cast();
        }
        self.payloads.at((at as usize & (self.slots.len() - 1)) * self.stride)
    }

    pub(super) fn claim_tail(&self, tail: u64) -> bool {
        self.ours.0.tail.compare_exchange(tail, after(tail), Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    /// Takes the right to a queued entry.
    pub(super) fn claim(&self, at: u64) -> bool {
        let sequence = &self.slot(at).sequence;
        let (ready, busy) = (phase(at, READY), phase(at, BUSY));
        sequence.compare_exchange(ready, busy, Ordering::Acquire, Ordering::Relaxed).is_ok()
    }

    /// Takes the right to the oldest entry before position `end`. Each further turn means that another thread
    /// took one; more turns than entries mean a process that plays with the words.
    #[inline]
    pub(super) fn claim_oldest(&self, end: u64) -> Claim {
        for _ in 0..=self.slots.len() {
            let oldest = self.theirs.0.head.load(Ordering::Acquire);
            if oldest >= end {
                return Claim::Empty;
            }
            if self.claim(oldest) {
                return Claim::Mine(oldest);
            }
            if self.theirs.0.head.load(Ordering::Acquire) == oldest {
                return Claim::InWork;
            }
        }
        Claim::InWork
    }

    /// As `claim_oldest`, for managers and failures: an entry in another thread's hands is looked at a little
    /// longer.
    pub(super) fn claim_patiently(&self, end: u64) -> Claim {
        let claim = self.claim_oldest(end);
        let Claim::InWork = claim else { return claim };
        let at = self.theirs.0.head.load(Ordering::Acquire);
        let is_ready = || self.slot(at).sequence.load(Ordering::Acquire) == phase(at, READY);
        pause_while(COPYING_NS, || !is_ready() && self.theirs.0.head.load(Ordering::Acquire) == at);
        self.claim_oldest(end)
    }

    /// Gives an owned oldest slot to the push of one round later.
    pub(super) fn release(&self, at: u64) {
        self.theirs.0.head.store(after(at), Ordering::Release);
        let next_round = at.wrapping_add(self.slots.len() as u64);
        self.slot(at).sequence.store(phase(next_round, FREE), Ordering::Release);
    }

    #[inline]
    pub(super) fn fill(&self, at: u64, head: EntryHead, payload: &[u8], overflow: Overflow) {
        self.write(at, head, payload);
        self.slot(at).index.store(head.index, Ordering::Relaxed);
        if overflow == Overflow::LatestWins
            && let Some(newest) = self.newest.get(head.index as usize)
        {
            newest.fetch_max(after(at), Ordering::AcqRel);
        }
        self.slot(at).sequence.store(phase(at, READY), Ordering::Release);
    }

    /// The slot of `at` must be owned by this thread.
    pub(super) fn write(&self, at: u64, head: EntryHead, payload: &[u8]) {
        // SAFETY: the slot is owned, and its payload block has `stride >= payload.len()` bytes.
        unsafe {
            *self.slot(at).body.exclusive() = Body { head, len: payload.len() as u64 };
            copy(payload.as_ptr(), self.payload(at), payload.len());
        }
    }
}
