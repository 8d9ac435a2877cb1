//! Copies of values at addresses that suit every payload.
//!
//! Invariant: the address is a multiple of 8, as the alignment of a payload is at most 8.

use core::ffi::c_void;

/// Bytes at an address that suits every payload.
#[derive(Clone)]
pub(crate) struct Aligned(Vec<u64>);

impl Aligned {
    pub(crate) fn of(bytes: &[u8]) -> Aligned {
        let words = bytes.chunks(8).map(|c| {
            let mut word = [0; 8];
            word[..c.len()].copy_from_slice(c);
            u64::from_ne_bytes(word)
        });
        Aligned(words.collect())
    }

    pub(crate) fn ptr(&self) -> *const c_void {
        self.0.as_ptr().cast()
    }

    pub(crate) fn ptr_mut(&mut self) -> *mut c_void {
        self.0.as_mut_ptr().cast()
    }

    /// The first `len` bytes.
    pub(crate) fn bytes(&self, len: usize) -> Vec<u8> {
        self.0.iter().flat_map(|w| w.to_ne_bytes()).take(len).collect()
    }
}
