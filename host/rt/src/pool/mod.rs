//! Frame pools: fixed slots of header and bytes in a sealed memfd, lent, shared by count, and given back.
//!
//! A slot has either one [`FrameMut`] or any number of [`Frame`]s; each loan keeps its pool alive; giving
//! back is two atomic operations on any thread and never a system call while the pool's owner still holds it.

mod borrowed;
mod file;
mod frame;
mod slots;
mod views;

use std::io;
use std::sync::Arc;

pub use file::{PoolFile, PoolShape};
pub use frame::{Frame, FrameMut};
pub use slots::PoolStats;
pub(crate) use views::MOST_VIEWS;
pub use views::RemoteViews;

pub use crate::mapping::room_for;
use crate::os::OsError;
use crate::region::Table;
use crate::sync::AtomicU64;
use borrowed::Borrowed;
use slots::Slots;

/// A pool of equal slots.
pub struct FramePool {
    slots: Slots,
    store: Store,
}

/// Place of the frames.
enum Store {
    Own(Arc<PoolFile>),
    /// In pools of another process; a slot is a lease.
    Borrowed(Borrowed),
}

impl FramePool {
    /// Maps `slots` slots with a header of `header_bytes` and up to `max_bytes` each, both 64-byte aligned;
    /// all pages are present and zeroed. Manager's thread: takes about 0.3 ms per MiB.
    ///
    /// # Errors
    /// With no slots, or when the machine has not that much memory (or memfd is not allowed).
    pub fn new(slots: u32, header_bytes: usize, max_bytes: usize) -> io::Result<Arc<Self>> {
        let file = PoolFile::create(PoolShape { slots, header_bytes, max_bytes })?;
        Ok(Arc::new(Self { slots: Slots::new(slots), store: Store::Own(file) }))
    }

    /// Bytes a pool takes; `None` for no slots or more bytes than an address can reach.
    pub fn bytes(slots: u32, header_bytes: usize, max_bytes: usize) -> Option<usize> {
        PoolShape { slots, header_bytes, max_bytes }.size().map(|(_, total)| total)
    }

    /// Makes room for frames of another process, one for each number under which it can lend one.
    pub(crate) fn borrowed(leases: u32, returned: Table<AtomicU64>, views: &Arc<RemoteViews>) -> Arc<Self> {
        let store = Store::Borrowed(Borrowed::new(leases, returned, views));
        Arc::new(Self { slots: Slots::new(leases), store })
    }

    /// Takes in the frame the other process lent under this number; `None` when there cannot be such a frame,
    /// or when the number is held here already.
    pub(crate) fn admit(self: &Arc<Self>, lease: u32, view: u32, slot: u32, len: usize) -> Option<Frame> {
        let Store::Borrowed(borrowed) = &self.store else { return None };
        if !borrowed.fits(view, slot, len) || !self.slots.claim(lease) {
            return None;
        }
        borrowed.set(lease, view, slot);
        Some(FrameMut::lend(Arc::clone(self), lease).freeze(len))
    }

    /// Gives back a frame lent under this number that is not wanted.
    pub(crate) fn decline(&self, lease: u32) {
        if let Store::Borrowed(borrowed) = &self.store {
            borrowed.give_back(lease);
        }
    }

    /// A slot to write into, or `None` (counted) when all are lent. Any thread; never waits. The slot holds
    /// what its last frame held.
    pub fn loan(self: &Arc<Self>) -> Option<FrameMut> {
        let slot = self.slots.take()?;
        Some(FrameMut::lend(Arc::clone(self), slot))
    }

    /// The longest frame, in bytes after the header; 0 where frames are only borrowed.
    pub fn max_bytes(&self) -> usize {
        self.file().map_or(0, |file| file.shape().max_bytes)
    }

    pub fn header_bytes(&self) -> usize {
        match &self.store {
            Store::Own(file) => file.header_bytes(),
            Store::Borrowed(borrowed) => borrowed.header_bytes(),
        }
    }

    /// Its memory, where it is this process's own.
    pub fn file(&self) -> Option<&Arc<PoolFile>> {
        match &self.store {
            Store::Own(file) => Some(file),
            Store::Borrowed(_) => None,
        }
    }

    /// The counters now, nearly of one moment.
    pub fn stats(&self) -> PoolStats {
        self.slots.stats()
    }

    /// Locks the pool's pages into memory; counts against `RLIMIT_MEMLOCK`.
    pub fn lock_memory(&self) -> Result<(), OsError> {
        self.file().map_or(Ok(()), |file| file.lock())
    }

    /// Tells whether the number of a [`FrameMut`] or [`Frame`] names a slot of this pool, whatever has become
    /// of it. Any number may be asked for.
    pub fn is_descriptor(&self, raw: u64) -> bool {
        self.slots.has_entry(raw)
    }

    /// Returns the memory a slot lies in, and which of its slots that is.
    #[inline]
    fn find(&self, slot: u32) -> (&PoolFile, u32) {
        match &self.store {
            Store::Own(file) => (file, slot),
            Store::Borrowed(borrowed) => borrowed.find(slot),
        }
    }

    fn header_ptr(&self, slot: u32) -> *mut u8 {
        match &self.store {
            Store::Own(file) => file.header_ptr(slot),
            Store::Borrowed(borrowed) => borrowed.header_ptr(slot),
        }
    }

    fn bytes_ptr(&self, slot: u32) -> *mut u8 {
        let (file, slot) = self.find(slot);
        file.bytes_ptr(slot)
    }

    /// Handles the return of the last count on the slot.
    fn came_back(&self, slot: u32) {
        if let Store::Borrowed(borrowed) = &self.store {
            borrowed.give_back(slot);
        }
    }
}
