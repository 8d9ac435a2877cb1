//! A frame while it is written ([`FrameMut`]) and while it is read ([`Frame`]).
//!
//! The content of a slot is written only through its one `FrameMut`; a `Frame` only reads. A loan holds one
//! count on its pool, made at `loan` and given back with the slot's last count, so cloning touches the slot
//! alone.

use std::fmt;
use std::mem::ManuallyDrop;
use std::sync::Arc;

use super::FramePool;
use super::slots::Slots;

/// A frame that is being written: the only handle to its slot.
#[derive(Debug)]
pub struct FrameMut(Loan);

/// A written frame: shared by count, read-only.
#[derive(Clone, Debug)]
pub struct Frame(Loan);

impl FrameMut {
    pub(super) fn lend(pool: Arc<FramePool>, slot: u32) -> Self {
        let pool = Arc::into_raw(pool);
        let loan = Loan { pool, slot };
        loan.pool().slots.set_owner(slot, pool);
        Self(loan)
    }

    /// Address of the header: `header_bytes` of the pool, 64-byte aligned.
    pub fn header_ptr(&self) -> *mut u8 {
        self.0.pool().header_ptr(self.0.slot)
    }

    /// Address of the bytes: `capacity` of them, 64-byte aligned.
    pub fn bytes_ptr(&self) -> *mut u8 {
        self.0.pool().bytes_ptr(self.0.slot)
    }

    /// Returns the number of bytes that fit after the header.
    pub fn capacity(&self) -> usize {
        self.0.pool().max_bytes()
    }

    /// Header and bytes, to be written. They hold what the slot's last frame held.
    pub fn parts_mut(&mut self) -> (&mut [u8], &mut [u8]) {
        let pool = self.0.pool();
        // SAFETY: two disjoint parts of the slot, mapped and zeroed at first, and `self` is its only handle.
        unsafe {
            (
                std::slice::from_raw_parts_mut(self.header_ptr(), pool.header_bytes()),
                std::slice::from_raw_parts_mut(self.bytes_ptr(), pool.max_bytes()),
            )
        }
    }

    /// Ends the writing: a frame with `len` bytes (at most `capacity`) after its header.
    pub fn freeze(self, len: usize) -> Frame {
        let slots = &self.0.pool().slots;
        let longest = self.capacity();
        // The length of a borrowed frame was compared with its pool's when it came.
        let len = if self.0.pool().file().is_some() { len.min(longest) } else { len };
        slots.set_len(self.0.slot, len);
        Frame(self.0)
    }

    /// Hands this handle out as a number; it must come back through [`FrameMut::from_raw`], or the slot is
    /// lost.
    pub fn into_raw(self) -> u64 {
        self.0.pool().slots.go_out(self.0.slot);
        self.0.into_raw() | WRITING
    }

    /// Takes a handle back; `None` for 0, for a [`Frame`]'s number and for one whose handle has come back
    /// already, on whatever thread and however often its slot was lent since: an old number never fits a slot
    /// that another holder has.
    ///
    /// # Safety
    /// 0, or a number that names a slot of a pool that is still alive: see [`FramePool::is_descriptor`].
    pub unsafe fn from_raw(raw: u64) -> Option<Self> {
        // Even generations are never out, so this also rejects the numbers of slots that were never lent.
        if raw & WRITING == 0 || raw >> 48 & 1 == 0 {
            return None;
        }
        // SAFETY: the caller's promise is the one asked for.
        let (pool, slot) = unsafe { Loan::named_by(raw & !WRITING) }?;
        // SAFETY: as above: the pool that was found is alive.
        let slots = unsafe { &(*pool).slots };
        slots.come_back(slot, raw).then(|| Self(Loan { pool, slot }))
    }
}

impl Frame {
    /// The header, as long as the pool's `header_bytes`.
    pub fn header(&self) -> &[u8] {
        let pool = self.0.pool();
        // SAFETY: mapped, initialised, and written by nobody while a `Frame` of this slot exists.
        unsafe { std::slice::from_raw_parts(pool.header_ptr(self.0.slot), pool.header_bytes()) }
    }

    /// The bytes after the header, as many as were frozen.
    pub fn bytes(&self) -> &[u8] {
        let pool = self.0.pool();
        // SAFETY: as for the header; the length was limited to the slot's when frozen.
        unsafe { std::slice::from_raw_parts(pool.bytes_ptr(self.0.slot), pool.slots.len(self.0.slot)) }
    }

    /// Tells whether this is the only handle to its slot. A frame of another process never is: this process
    /// may not write it.
    pub fn is_unique(&self) -> bool {
        let pool = self.0.pool();
        pool.file().is_some() && pool.slots.is_unique(self.0.slot)
    }

    /// Returns the number of the memory it lies in, see [`PoolFile::numbered`](super::PoolFile::numbered),
    /// and its slot there.
    pub fn location(&self) -> (u64, u32) {
        let (file, slot) = self.0.pool().find(self.0.slot);
        (file.number(), slot)
    }

    /// Tells whether it can be held beyond its turn: its maker has slots left for one more that is shown, one
    /// that waits and one that is filled. A frame of another process must be the only one here, since the
    /// free slots there are not known here.
    pub fn can_be_held(&self) -> bool {
        let pool = self.0.pool();
        if pool.file().is_some() { pool.slots.has_free(FREE_BESIDE_HELD) } else { pool.slots.lent() <= 1 }
    }

    /// Tells whether at least `n` slots of its pool are free now.
    pub fn pool_has_free(&self, n: u64) -> bool {
        self.0.pool().slots.has_free(n)
    }

    /// Returns the frame for writing in place, or itself when others read it too.
    pub fn try_unique(self) -> Result<FrameMut, Frame> {
        if !self.is_unique() {
            return Err(self);
        }
        self.0.pool().slots.make_stale(self.0.slot);
        Ok(FrameMut(self.0))
    }

    /// Hands this count out as a number; it must come back through [`Frame::from_raw`], or the slot is lost.
    pub fn into_raw(self) -> u64 {
        self.0.into_raw()
    }

    /// Takes a count back; `None` for 0, for a [`FrameMut`]'s number and for one of a frame that is gone (as
    /// long as the slot was not lent, frozen or given back 65 536 times since).
    ///
    /// # Safety
    /// 0, or from [`Frame::into_raw`] of a frame whose pool is still alive; and it comes back at most once,
    /// which is not noticed while other handles keep the frame alive.
    pub unsafe fn from_raw(raw: u64) -> Option<Self> {
        if raw & WRITING != 0 {
            return None;
        }
        // SAFETY: the caller's promise is the one asked for.
        let (pool, slot) = unsafe { Loan::named_by(raw) }?;
        Some(Self(Loan { pool, slot }))
    }
}

/// Slots that stay free where a frame is held.
const FREE_BESIDE_HELD: u64 = 3;

/// Marks the number of a [`FrameMut`]; the lowest bit of a descriptor is 0.
const WRITING: u64 = 1;

/// One count on a slot.
struct Loan {
    pool: *const FramePool,
    slot: u32,
}

// SAFETY: a count may be given back on any thread, and pools may be dropped on any thread.
unsafe impl Send for Loan {}
// SAFETY: `&Loan` reads, or counts atomically.
unsafe impl Sync for Loan {}

impl Loan {
    fn pool(&self) -> &FramePool {
        // SAFETY: the pool is alive while a slot of it is lent, by the count taken in `lend`.
        unsafe { &*self.pool }
    }

    fn into_raw(self) -> u64 {
        let loan = ManuallyDrop::new(self);
        loan.pool().slots.descriptor(loan.slot)
    }

    /// Returns the pool and the slot that a number names, where its generation is the slot's.
    ///
    /// # Safety
    /// 0, or a number that names a slot of a pool that is still alive, lent at least once.
    unsafe fn named_by(raw: u64) -> Option<(*const FramePool, u32)> {
        // SAFETY: the caller's promise is the one asked for.
        let (pool, entry) = unsafe { Slots::resolve::<FramePool>(raw) }?;
        // SAFETY: the slot was lent, so its owner is its pool, which the caller vouches for.
        Some((pool, unsafe { &*pool }.slots.slot_at(entry)))
    }
}

impl Clone for Loan {
    fn clone(&self) -> Self {
        self.pool().slots.share(self.slot);
        Self { pool: self.pool, slot: self.slot }
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        if self.pool().slots.give_back(self.slot) {
            self.pool().came_back(self.slot);
            // SAFETY: the count that `lend` took for this loan, given back once, with its last handle.
            unsafe { Arc::decrement_strong_count(self.pool) };
        }
    }
}

impl fmt::Debug for Loan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "slot {}", self.slot)
    }
}
