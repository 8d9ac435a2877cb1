//! Structs that a plugin lends room for and the host fills, as far as the plugin's `struct_size` reaches.
//!
//! Invariant: no byte behind the caller's size is touched, so that a plugin of an earlier minor, whose struct
//! is shorter, is served as before.

use trocar_plugin_api::abi::{Held, Loan, SampleView};

/// A struct that the caller lends.
///
/// # Safety
/// The struct is `repr(C)`, begins with `struct_size: u32`, and grows at its end only.
pub(super) unsafe trait Room: Sized {
    /// Bytes it had in the first minor of the ABI that has it.
    const FIRST: usize;
}

// SAFETY: as asked for; layouts/1.0.txt has the size.
unsafe impl Room for SampleView {
    const FIRST: usize = 56;
}
// SAFETY: as above.
unsafe impl Room for Loan {
    const FIRST: usize = 40;
}
// SAFETY: as asked for; layouts/1.2.txt has the size.
unsafe impl Room for Held {
    const FIRST: usize = 40;
}

/// Tells whether the caller lends a struct, and one as long as the first of its kind at least.
///
/// # Safety
/// `lent` is null, or points to a struct as long as its `struct_size` says, four bytes at least.
#[inline(always)]
pub(super) unsafe fn is_lent<T: Room>(lent: *const T) -> bool {
    // SAFETY: the caller's promise; such a struct begins with its size.
    !lent.is_null() && unsafe { lent.cast::<u32>().read() } as usize >= T::FIRST
}

/// Writes what the caller has room for. Its `struct_size` says afterwards how much of the struct both sides
/// know.
///
/// # Safety
/// [`is_lent`] is true of `lent`, and the caller lends it for writing.
#[inline(always)]
pub(super) unsafe fn fill<T: Room>(lent: *mut T, value: T) {
    // SAFETY: the caller's promise.
    let said = unsafe { lent.cast::<u32>().read() } as usize;
    if said >= size_of::<T>() {
        // SAFETY: as above; there is room for all of it.
        unsafe { lent.write(value) };
    } else {
        // SAFETY: as above.
        unsafe { fill_short(lent, said, &value) };
    }
}

/// The same for a struct of an earlier minor.
#[cold]
unsafe fn fill_short<T: Room>(lent: *mut T, said: usize, value: &T) {
    const SIZE: usize = size_of::<u32>();
    let from = std::ptr::from_ref(value).cast::<u8>();
    // SAFETY: both structs have `said` bytes, and the value is one of this function's caller.
    unsafe { lent.cast::<u8>().add(SIZE).copy_from_nonoverlapping(from.add(SIZE), said - SIZE) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[repr(C)]
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Grown {
        struct_size: u32,
        flags: u32,
        first: u64,
        second: u64,
    }

    // SAFETY: as asked for; `second` came later.
    unsafe impl Room for Grown {
        const FIRST: usize = 16;
    }

    const VALUE: Grown = Grown { struct_size: 24, flags: 1, first: 2, second: 3 };

    /// The lent struct after a fill, when its caller says this size of it.
    fn filled(says: u32) -> Grown {
        let mut lent = Grown { struct_size: says, flags: 0, first: 0, second: 77 };
        // SAFETY: the struct is as long as any size below says, or longer.
        assert!(unsafe { is_lent(&raw const lent) });
        // SAFETY: as above.
        unsafe { fill(&raw mut lent, VALUE) };
        lent
    }

    #[test]
    fn a_struct_of_an_earlier_minor_is_filled_as_far_as_it_reaches_and_stays_as_long() {
        assert_eq!(filled(16), Grown { struct_size: 16, second: 77, ..VALUE });
    }

    #[test]
    fn a_struct_of_this_minor_and_of_a_later_one_is_filled_whole_and_says_how_much_that_is() {
        assert_eq!(filled(24), VALUE);
        assert_eq!(filled(32), VALUE);
    }

    #[test]
    fn nothing_is_lent_by_null_nor_by_less_than_the_first_minor_had() {
        let short = Grown { struct_size: 15, ..VALUE };
        // SAFETY: null, and a struct longer than it says.
        assert!(!unsafe { is_lent::<Grown>(std::ptr::null()) } && !unsafe { is_lent(&raw const short) });
    }

    #[test]
    fn no_struct_is_shorter_than_it_first_was() {
        const {
            assert!(SampleView::FIRST <= size_of::<SampleView>());
            assert!(Loan::FIRST <= size_of::<Loan>());
            assert!(Held::FIRST <= size_of::<Held>());
        }
    }
}
