//! Places on the stack for a row of a state table.
//!
//! Invariant: nothing is allocated, and few words are cleared needlessly.

use trocar_loader::convert::MAX_PAYLOAD;

/// Words of the stack copies a read chooses from: the smallest one that holds the row is taken, so that
/// nothing is allocated on a step and few words are cleared needlessly.
pub(super) const FEW_WORDS: usize = 8;
pub(super) const TINY_ROW: usize = 32;
pub(super) const SMALL_ROW: usize = 128;
pub(super) const MIDDLE_ROW: usize = 1024;
pub(super) const LARGEST_ROW: usize = MAX_PAYLOAD / 8;

/// Calls `f` with a place on the stack for a row of so many bytes: zeroed, in whole words.
#[inline]
pub(super) fn with_row<R>(bytes: usize, f: impl FnOnce(&mut [u64]) -> R) -> R {
    match bytes.div_ceil(8) {
        words if words <= FEW_WORDS => with_words::<FEW_WORDS, R>(words, f),
        words if words <= TINY_ROW => with_words::<TINY_ROW, R>(words, f),
        words if words <= SMALL_ROW => with_words::<SMALL_ROW, R>(words, f),
        words if words <= MIDDLE_ROW => with_words::<MIDDLE_ROW, R>(words, f),
        words => with_words::<LARGEST_ROW, R>(words, f),
    }
}

#[inline(never)]
fn with_words<const N: usize, R>(words: usize, f: impl FnOnce(&mut [u64]) -> R) -> R {
    let mut place = [0u64; N];
    f(&mut place[..words])
}

/// The first `bytes` bytes of a row.
#[inline]
pub(super) fn bytes_of(row: &mut [u64], bytes: usize) -> &mut [u8] {
    let bytes = bytes.min(size_of_val(row));
    // SAFETY: a u64 slice viewed as its first bytes.
    unsafe { std::slice::from_raw_parts_mut(row.as_mut_ptr().cast::<u8>(), bytes) }
}
