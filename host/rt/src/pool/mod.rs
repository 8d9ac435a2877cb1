//! Frame pools: fixed slots of header and bytes in a sealed memfd, lent, shared by count, and given back.
//!
//! A slot has either one [`FrameMut`] or any number of [`Frame`]s; each loan keeps its pool alive; giving back is
//! two atomic operations on any thread and never a system call while the pool's owner still holds it.

mod frame;
mod memory;
mod slots;

use std::io;
use std::os::fd::BorrowedFd;
use std::sync::Arc;

pub use frame::{Frame, FrameMut};

use crate::buf::round_up;
use crate::os::OsError;
use memory::Memory;
pub use memory::room_for;
use slots::Slots;

/// A pool of equal slots.
pub struct FramePool {
    slots: Slots,
    memory: Memory,
    header_bytes: usize,
    max_bytes: usize,
    stride: usize,
}

/// Counters of a pool, in slots and refused loans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PoolStats {
    pub slots: u32,
    /// Slots that can be lent now.
    pub free: u32,
    /// The most slots that were ever lent at once.
    pub high_water: u32,
    /// Loans refused because every slot was lent.
    pub exhausted: u64,
}

impl FramePool {
    /// Maps `slots` slots with a header of `header_bytes` and up to `max_bytes` each, both 64-byte aligned;
    /// all pages are present and zeroed. Manager's thread: takes about 0.3 ms per MiB.
    ///
    /// # Errors
    /// With no slots, or when the machine has not that much memory (or memfd is not allowed).
    pub fn new(slots: u32, header_bytes: usize, max_bytes: usize) -> io::Result<Arc<Self>> {
        let Some((stride, total)) = Self::size(slots, header_bytes, max_bytes) else {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("a pool of {slots} slots of {header_bytes} + {max_bytes} bytes cannot exist"),
            ));
        };
        Ok(Arc::new(Self {
            slots: Slots::new(slots),
            memory: Memory::new(total)?,
            header_bytes,
            max_bytes,
            stride,
        }))
    }

    /// Bytes a pool takes; `None` for no slots or more bytes than an address can reach.
    pub fn bytes(slots: u32, header_bytes: usize, max_bytes: usize) -> Option<usize> {
        Self::size(slots, header_bytes, max_bytes).map(|(_, total)| total)
    }

    /// Bytes of a slot and of the pool; `None` for no slots or more bytes than an address can reach.
    fn size(slots: u32, header_bytes: usize, max_bytes: usize) -> Option<(usize, usize)> {
        let header = header_bytes.checked_next_multiple_of(64)?;
        let stride = header.checked_add(max_bytes.checked_next_multiple_of(64)?)?.max(64);
        let total = stride.checked_mul(slots as usize)?;
        (1..=isize::MAX as usize).contains(&total).then_some((stride, total))
    }

    /// A slot to write into, or `None` (counted) when all are lent. Any thread; never waits. The slot holds
    /// what its last frame held.
    pub fn loan(self: &Arc<Self>) -> Option<FrameMut> {
        let slot = self.slots.take()?;
        Some(FrameMut::lend(Arc::clone(self), slot))
    }

    /// The longest frame, in bytes after the header.
    pub fn max_bytes(&self) -> usize {
        self.max_bytes
    }

    pub fn header_bytes(&self) -> usize {
        self.header_bytes
    }

    /// The counters now, nearly of one moment.
    pub fn stats(&self) -> PoolStats {
        self.slots.stats()
    }

    /// The sealed memfd behind the pool: slot `n` begins at byte `n * stride()`.
    pub fn memfd(&self) -> BorrowedFd<'_> {
        self.memory.fd()
    }

    /// Distance of two slots, in bytes.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Locks the pool's pages into memory; counts against `RLIMIT_MEMLOCK`.
    pub fn lock_memory(&self) -> Result<(), OsError> {
        crate::os::lock_region(self.memory.at(0), self.memory.len())
    }

    /// Whether the number of a [`FrameMut`] or [`Frame`] names a slot of this pool, whatever has become of it. Any number
    /// may be asked for.
    pub fn is_descriptor(&self, raw: u64) -> bool {
        self.slots.has_entry(raw)
    }

    fn header_ptr(&self, slot: u32) -> *mut u8 {
        self.memory.at(slot as usize * self.stride)
    }

    fn bytes_ptr(&self, slot: u32) -> *mut u8 {
        self.memory.at(slot as usize * self.stride + round_up(self.header_bytes, 64))
    }
}
