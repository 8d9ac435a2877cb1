//! Frames lent to a reader in another process, by number.
//!
//! Invariant: a frame is in its lease exactly while that is LENT. The thread that moves it on to ENDING takes
//! the frame out, and no other looks there; only the writer fills one that is FREE. So any thread may take
//! back, beside the writer, frames the reader has done with, and that costs no push.

use crate::pool::Frame;
use crate::region::{Layout, Table};
use crate::sync::{AtomicU32, AtomicU64, Ordering, Shared};

/// Frames one link can have lent at once.
pub(super) const LEASES: usize = 256;

const FREE: u32 = 0;
const LENT: u32 = 1;
const ENDING: u32 = 2;

/// A bit for each lease the reader has done with.
pub(super) fn returned(layout: &mut Layout) -> Table<AtomicU64> {
    layout.table(LEASES / 64, |_| AtomicU64::new(0))
}

struct Lease {
    state: AtomicU32,
    frame: Shared<Option<Frame>>,
}

pub(super) struct Leases {
    all: Box<[Lease]>,
    /// Number of leases that are not FREE.
    out: AtomicU64,
    /// Number of frames ever lent, and how many of these `collect_if_idle` knows of.
    lent: AtomicU64,
    known: AtomicU64,
    returned: Table<AtomicU64>,
}

// SAFETY: a frame may go anywhere, and `state` lets one thread at a time reach it.
unsafe impl Send for Leases {}
// SAFETY: as above.
unsafe impl Sync for Leases {}

impl Leases {
    pub(super) fn lay_out(layout: &mut Layout) -> Self {
        let lease = || Lease { state: AtomicU32::new(FREE), frame: Shared::new(None) };
        Self {
            all: (0..LEASES).map(|_| lease()).collect(),
            out: AtomicU64::new(0),
            lent: AtomicU64::new(0),
            known: AtomicU64::new(0),
            returned: returned(layout),
        }
    }

    /// Returns the number of frames lent.
    pub(super) fn out(&self) -> u64 {
        self.out.load(Ordering::Acquire)
    }

    /// Lends a frame under the first free number from `from` on; `None` when all are out. For the writer.
    pub(super) fn lend(&self, frame: Frame, from: usize) -> Option<u32> {
        let numbers = (0..LEASES).map(|n| (from + n) % LEASES);
        let number = numbers.into_iter().find(|n| self.all[*n].state.load(Ordering::Acquire) == FREE)?;
        let lease = &self.all[number];
        // SAFETY: only the writer fills what is FREE, and nobody looks into it before it is LENT.
        unsafe { *lease.frame.exclusive() = Some(frame) };
        self.out.fetch_add(1, Ordering::Relaxed);
        self.lent.fetch_add(1, Ordering::Relaxed);
        lease.state.store(LENT, Ordering::Release);
        Some(number as u32)
    }

    /// Takes a frame back. A number that is not out, or comes twice, is ignored. Any thread; never waits.
    pub(super) fn end(&self, number: u32) {
        let Some(lease) = self.all.get(number as usize) else { return };
        if lease.state.compare_exchange(LENT, ENDING, Ordering::AcqRel, Ordering::Relaxed).is_err() {
            return;
        }
        // SAFETY: whoever moved it on from LENT is alone with it until it is FREE.
        let frame = unsafe { (*lease.frame.exclusive()).take() };
        lease.state.store(FREE, Ordering::Release);
        // Before it is counted as back.
        drop(frame);
        self.out.fetch_sub(1, Ordering::Release);
    }

    /// As [`Leases::collect`], where nothing was lent since the last call of this. A writer that is at work
    /// takes back by itself; a thread that is set aside in the middle of taking back would keep a slot from
    /// it.
    pub(super) fn collect_if_idle(&self) {
        let lent = self.lent.load(Ordering::Relaxed);
        if self.known.swap(lent, Ordering::Relaxed) == lent {
            self.collect();
        }
    }

    /// Takes back frames the reader has done with. Any thread; never waits.
    pub(super) fn collect(&self) {
        for at in 0..self.returned.len() {
            if self.returned[at].load(Ordering::Relaxed) == 0 {
                continue;
            }
            // Acquire: the reader has read before the frame is written anew.
            let mut bits = self.returned[at].swap(0, Ordering::Acquire);
            while bits != 0 {
                self.end(at as u32 * 64 + bits.trailing_zeros());
                bits &= bits - 1;
            }
        }
    }
}
