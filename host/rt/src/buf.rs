//! A fixed block of zeroed bytes, 64-byte aligned, reached by address from several threads.
//!
//! The block itself keeps no order: whoever touches a part of it holds the right to that part by some atomic.

use std::alloc::{Layout, alloc_zeroed, dealloc, handle_alloc_error};
use std::ptr::NonNull;

pub(crate) const ALIGN: usize = 64;

/// `n` rounded up to a multiple of `step` (a power of two).
pub(crate) const fn round_up(n: usize, step: usize) -> usize {
    (n + step - 1) & !(step - 1)
}

pub(crate) struct AlignedBuf {
    start: NonNull<u8>,
    layout: Layout,
}

impl AlignedBuf {
    /// A block of at least one byte, so that every block has an address of its own.
    pub(crate) fn new(bytes: usize) -> Self {
        let layout =
            Layout::from_size_align(bytes.max(1), ALIGN).expect("a block is smaller than isize::MAX");
        // SAFETY: the layout's size is at least one byte.
        let start = unsafe { alloc_zeroed(layout) };
        let Some(start) = NonNull::new(start) else { handle_alloc_error(layout) };
        Self { start, layout }
    }

    /// The address of byte `offset`.
    #[inline]
    pub(crate) fn at(&self, offset: usize) -> *mut u8 {
        assert!(offset <= self.layout.size(), "offset {offset} is outside the {} bytes", self.layout.size());
        // SAFETY: the offset was just checked to lie inside the block or one past its end.
        unsafe { self.start.as_ptr().add(offset) }
    }

    /// The whole block, for a sole owner.
    pub(crate) fn as_mut_slice(&mut self) -> &mut [u8] {
        // SAFETY: the block is initialised (zeroed) and `&mut self` proves that nobody else reaches it.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.layout.size()) }
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
        unsafe { dealloc(self.start.as_ptr(), self.layout) }
    }
}

// SAFETY: plain bytes without an owner thread; shared access goes through raw addresses whose users order it.
unsafe impl Send for AlignedBuf {}
// SAFETY: as above: `&AlignedBuf` only gives addresses out.
unsafe impl Sync for AlignedBuf {}
