//! Bytes lent to a host where any payload may begin, without an allocation.
//!
//! Invariant: bytes that the other side reads or writes begin at a multiple of [`ALIGN`], whatever the
//! caller's slice does; a copy, where one is needed, lies on the stack.

use core::mem::MaybeUninit;
use trocar_plugin_api::limits::MAX_PAYLOAD;

/// Largest alignment of a payload, bytes.
const ALIGN: usize = align_of::<u64>();
/// Words of the room that most values need, and of the one for the largest payload.
const FEW: usize = 64;
const MOST: usize = MAX_PAYLOAD / ALIGN;

/// Lends `f` the bytes for reading; none when they are more than a payload may have.
pub(crate) fn reading<R>(bytes: &[u8], f: impl FnOnce(*const u8) -> R) -> Option<R> {
    if is_aligned(bytes) {
        return Some(f(bytes.as_ptr()));
    }
    match bytes.len().div_ceil(ALIGN) {
        words if words <= FEW => Some(read_copied::<FEW, R>(bytes, f)),
        words if words <= MOST => Some(read_copied::<MOST, R>(bytes, f)),
        _ => None,
    }
}

/// Lends `f` the bytes for writing; none when they are more than a payload may have.
pub(crate) fn writing<R>(bytes: &mut [u8], f: impl FnOnce(*mut u8) -> R) -> Option<R> {
    if is_aligned(bytes) {
        return Some(f(bytes.as_mut_ptr()));
    }
    match bytes.len().div_ceil(ALIGN) {
        words if words <= FEW => Some(write_copied::<FEW, R>(bytes, f)),
        words if words <= MOST => Some(write_copied::<MOST, R>(bytes, f)),
        _ => None,
    }
}

fn is_aligned(bytes: &[u8]) -> bool {
    bytes.as_ptr().addr().is_multiple_of(ALIGN)
}

// Not inlined: the larger room is on the stack only while it is needed.
#[inline(never)]
fn read_copied<const WORDS: usize, R>(bytes: &[u8], f: impl FnOnce(*const u8) -> R) -> R {
    f(Room::<WORDS>::of(bytes).start())
}

#[inline(never)]
fn write_copied<const WORDS: usize, R>(bytes: &mut [u8], f: impl FnOnce(*mut u8) -> R) -> R {
    let mut room = Room::<WORDS>::of(bytes);
    let answer = f(room.start());
    // SAFETY: the room began with as many bytes of the caller's, so they are there whether `f` wrote them or
    // not.
    unsafe { bytes.as_mut_ptr().copy_from_nonoverlapping(room.start(), bytes.len()) };
    answer
}

/// Aligned room on the stack.
struct Room<const WORDS: usize>([MaybeUninit<u64>; WORDS]);

impl<const WORDS: usize> Room<WORDS> {
    /// A copy of bytes that fit.
    fn of(bytes: &[u8]) -> Self {
        debug_assert!(bytes.len() <= WORDS * ALIGN);
        let mut room = Room([MaybeUninit::uninit(); WORDS]);
        // SAFETY: the caller chose the room by the length, and the room is a place of its own.
        unsafe { room.start().copy_from_nonoverlapping(bytes.as_ptr(), bytes.len()) };
        room
    }

    fn start(&mut self) -> *mut u8 {
        self.0.as_mut_ptr().cast()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Slices of `len` bytes at each distance from an aligned place.
    fn slices(len: usize, mut look: impl FnMut(&mut [u8])) {
        let mut room = vec![0_u64; len.div_ceil(ALIGN) + 1];
        // SAFETY: every byte of the words is a byte, and the slice covers no more than them.
        let bytes =
            unsafe { core::slice::from_raw_parts_mut(room.as_mut_ptr().cast::<u8>(), room.len() * ALIGN) };
        for at in 0..ALIGN {
            bytes.iter_mut().enumerate().for_each(|(i, b)| *b = i as u8);
            look(&mut bytes[at..at + len]);
        }
    }

    #[test]
    fn what_is_lent_begins_where_any_payload_may_and_holds_the_callers_bytes() {
        for len in [0, 1, 8, 24, FEW * ALIGN, FEW * ALIGN + 1, MAX_PAYLOAD] {
            slices(len, |bytes| {
                let told = reading(bytes, |at| {
                    // SAFETY: as many bytes as were given.
                    let seen = unsafe { core::slice::from_raw_parts(at, len) };
                    (len == 0 || at.addr().is_multiple_of(ALIGN), seen.to_vec())
                });
                assert_eq!(told.unwrap(), (true, bytes.to_vec()), "{len} bytes");
            });
        }
    }

    #[test]
    fn what_is_written_comes_back_and_what_is_not_stays() {
        for len in [2, 24, FEW * ALIGN + 9, MAX_PAYLOAD] {
            slices(len, |bytes| {
                let mut want = bytes.to_vec();
                want[1] = 0xA5;
                // SAFETY: there are at least two bytes.
                let aligned = writing(bytes, |at| unsafe {
                    at.add(1).write(0xA5);
                    at.addr().is_multiple_of(ALIGN)
                });
                assert_eq!((aligned, &*bytes), (Some(true), &*want), "{len} bytes");
            });
        }
    }

    #[test]
    fn what_is_larger_than_any_payload_is_not_copied() {
        let mut looked = 0;
        slices(MAX_PAYLOAD + 1, |bytes| looked += usize::from(reading(bytes, |_| ()).is_none()));
        assert_eq!(looked, ALIGN - 1, "only where it lies aligned it is the other side's to refuse");
    }
}
