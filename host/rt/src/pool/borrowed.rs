//! Frames of another process's pools, counted here like one's own and given back by a bit when the last
//! handle goes.
//!
//! Invariant: an entry belongs to a lease. The thread that takes its count from 0 to 1 fills it, and the one
//! that gives the last count back sets its bit; after that the other process may lend it anew. Headers, by
//! which components go, are copied once, so that they stay as they are; the bytes behind them lie where their
//! process has them.

use std::sync::Arc;

use super::file::PoolFile;
use super::views::RemoteViews;
use crate::buf::{ALIGN, AlignedBuf, copy, round_up};
use crate::region::Table;
use crate::sync::{AtomicU32, AtomicU64, Ordering};

pub(super) struct Borrowed {
    views: Arc<RemoteViews>,
    at: Box<[At]>,
    /// Headers by lease.
    headers: AlignedBuf,
    header_stride: usize,
    /// A bit for each lease that is done with.
    returned: Table<AtomicU64>,
}

/// Place of the frame of a lease.
#[derive(Default)]
struct At {
    view: AtomicU32,
    slot: AtomicU32,
}

impl Borrowed {
    pub(super) fn new(leases: u32, returned: Table<AtomicU64>, views: &Arc<RemoteViews>) -> Self {
        let header_stride = round_up(views.header_bytes(), ALIGN);
        Self {
            views: Arc::clone(views),
            at: (0..leases).map(|_| At::default()).collect(),
            headers: AlignedBuf::new(header_stride * leases as usize),
            header_stride,
            returned,
        }
    }

    pub(super) fn header_bytes(&self) -> usize {
        self.views.header_bytes()
    }

    /// Tells whether this place in this view can hold a frame that long.
    pub(super) fn fits(&self, view: u32, slot: u32, len: usize) -> bool {
        self.views.get(view).is_some_and(|file| slot < file.shape().slots && len <= file.shape().max_bytes)
    }

    /// Sets the place of a lease; for the only holder of the lease.
    pub(super) fn set(&self, lease: u32, view: u32, slot: u32) {
        let at = &self.at[lease as usize];
        at.view.store(view, Ordering::Relaxed);
        at.slot.store(slot, Ordering::Relaxed);
        let (file, slot) = self.find(lease);
        // SAFETY: both have a header's length there, since the headers of all views are as long; the entry is
        // this holder's.
        unsafe { copy(file.header_ptr(slot), self.header_ptr(lease), self.header_bytes()) };
    }

    pub(super) fn header_ptr(&self, lease: u32) -> *mut u8 {
        self.headers.at(lease as usize * self.header_stride)
    }

    /// Returns the memory and the slot of a lease that is held.
    pub(super) fn find(&self, lease: u32) -> (&PoolFile, u32) {
        let at = &self.at[lease as usize];
        let view = self.views.get(at.view.load(Ordering::Relaxed));
        (view.expect("a view that was there stays"), at.slot.load(Ordering::Relaxed))
    }

    /// Gives the lease back: the other process may lend it anew.
    pub(super) fn give_back(&self, lease: u32) {
        if let Some(word) = self.returned.get(lease as usize / 64) {
            word.fetch_or(1 << (lease % 64), Ordering::Release);
        }
    }
}
