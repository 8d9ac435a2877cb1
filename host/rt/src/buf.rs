//! A fixed block of zeroed bytes, 64-byte aligned, reached by address from several threads.
//!
//! The block itself keeps no order: a thread that touches a part of it holds the right to that part by some
//! atomic.

use std::alloc::{Layout, alloc_zeroed, dealloc, handle_alloc_error};
use std::ptr::NonNull;

pub(crate) const ALIGN: usize = 64;

/// `n` rounded up to a multiple of `step` (a power of two).
pub(crate) const fn round_up(n: usize, step: usize) -> usize {
    (n + step - 1) & !(step - 1)
}

pub(crate) struct AlignedBuf {
    /// The first aligned byte of what was allocated.
    start: NonNull<u8>,
    bytes: usize,
    allocated: NonNull<u8>,
}

/// Bytes to which the allocator aligns every block.
const ALLOCATED: usize = 16;
/// Smallest page size of the machine, bytes.
const PAGE: usize = 4096;

impl AlignedBuf {
    /// Makes a block of at least one byte, so that every block has an address of its own. All its pages are
    /// there.
    pub(crate) fn new(bytes: usize) -> Self {
        let bytes = bytes.max(1);
        let layout = Self::layout(bytes);
        // SAFETY: the layout's size is at least one byte.
        let allocated = unsafe { alloc_zeroed(layout) };
        let Some(allocated) = NonNull::new(allocated) else { handle_alloc_error(layout) };
        let offset = allocated.as_ptr().addr().wrapping_neg() % ALIGN;
        // SAFETY: a multiple of 16 lies at most 48 bytes before one of 64, and the layout has as many more.
        let start = unsafe { allocated.add(offset) };
        // The pages of a large block come when they are touched first, which no real-time thread may do.
        for at in (0..bytes).step_by(PAGE).chain([bytes - 1]) {
            // SAFETY: inside the block, which is nobody else's yet.
            unsafe { start.add(at).write_volatile(0) };
        }
        Self { start, bytes, allocated }
    }

    /// The allocator is asked for more room instead of for alignment: aligned blocks that come and go
    /// leave holes in the heap of glibc before 2.38 that it does not use again (its bug 14581).
    fn layout(bytes: usize) -> Layout {
        Layout::from_size_align(bytes.saturating_add(ALIGN - ALLOCATED), ALLOCATED)
            .expect("a block is smaller than isize::MAX")
    }

    /// The address of byte `offset`.
    #[inline]
    pub(crate) fn at(&self, offset: usize) -> *mut u8 {
        assert!(offset <= self.bytes, "offset {offset} is outside the {} bytes", self.bytes);
        // SAFETY: the offset was just checked to lie inside the block or one past its end.
        unsafe { self.start.as_ptr().add(offset) }
    }

    /// The whole block, for a sole owner.
    pub(crate) fn as_mut_slice(&mut self) -> &mut [u8] {
        // SAFETY: the block is initialised (zeroed) and `&mut self` proves that nobody else reaches it.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.bytes) }
    }
}

/// Copies `n` bytes, those of a few numbers without a call.
///
/// # Safety
/// As for [`std::ptr::copy_nonoverlapping`].
#[inline(always)]
pub(crate) unsafe fn copy(from: *const u8, to: *mut u8, n: usize) {
    macro_rules! of {
        ($($known:literal)*) => {
            match n {
                // SAFETY: the caller's promise, for a length the compiler knows.
                $($known => unsafe { to.copy_from_nonoverlapping(from, $known) },)*
                // SAFETY: the caller's promise.
                _ => unsafe { to.copy_from_nonoverlapping(from, n) },
            }
        };
    }
    of!(0 8 16 24 32)
}

impl Drop for AlignedBuf {
    fn drop(&mut self) {
        // SAFETY: allocated in `new` with this very layout, and freed only here.
        unsafe { dealloc(self.allocated.as_ptr(), Self::layout(self.bytes)) }
    }
}

// SAFETY: plain bytes without an owner thread; shared access goes through raw addresses whose users order it.
unsafe impl Send for AlignedBuf {}
// SAFETY: as above: `&AlignedBuf` only gives addresses out.
unsafe impl Sync for AlignedBuf {}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn a_block_of_any_size_is_aligned_zeroed_and_all_there_while_the_allocator_is_asked_for_no_alignment() {
        for bytes in [0, 1, 15, 16, 63, 64, 65, 4095, 4096, 4097, 1 << 20] {
            let mut blocks: Vec<_> = (0..9).map(|_| AlignedBuf::new(bytes)).collect();
            for block in &mut blocks {
                assert_eq!(block.at(0).addr() % ALIGN, 0, "{bytes} bytes");
                let all = block.as_mut_slice();
                assert_eq!(all.len(), bytes.max(1));
                assert!(all.iter().all(|b| *b == 0), "{bytes} bytes");
                // Each block is its own to the last byte: the next blocks are still zero, and the allocator
                // stays whole.
                all.fill(0xA5);
            }
            assert!(AlignedBuf::layout(bytes).align() <= ALLOCATED, "it would leave holes in the heap");
        }
    }
}
