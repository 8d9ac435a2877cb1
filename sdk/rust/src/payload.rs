//! Plain old data: the values that may cross an input, output, command or event.
//!
//! Invariant: a payload has no padding and every bit pattern is a valid value, so it can be copied byte by
//! byte between processes and languages. The derive refuses anything else.

use trocar_plugin_api::desc::{Prim, TypeDesc, TypeKind};

/// A described plain value. Implement it with `#[derive(Payload)]`.
///
/// ```
/// use trocar_sdk::prelude::*;
/// #[derive(Payload, Clone, Copy, Default)]
/// #[repr(C)]
/// struct Force { stamp: Stamp, #[unit("N")] f: [f64; 3] }
/// assert_eq!(Force::DESC.size, 32);
/// ```
/// A gap that the compiler would fill is refused:
/// ```compile_fail
/// use trocar_sdk::prelude::*;
/// #[derive(Payload, Clone, Copy)]
/// #[repr(C)]
/// struct Gap { small: u8, large: f64 }
/// ```
/// A truth value is a `Flag`, as not every byte is a valid `bool`:
/// ```compile_fail,E0277
/// use trocar_sdk::prelude::*;
/// #[derive(Payload, Clone, Copy)]
/// #[repr(C)]
/// struct Seen { seen: bool }
/// ```
/// An unknown unit is refused, with what was probably meant ("did you mean `N.mm`?"):
/// ```compile_fail
/// use trocar_sdk::prelude::*;
/// #[derive(Payload, Clone, Copy)]
/// #[repr(C)]
/// struct Torque { #[unit("Nmm")] t: f64 }
/// ```
///
/// # Safety
/// The type is `repr(C)` or `repr(transparent)`, has no padding, no pointers, is valid for every bit pattern,
/// is aligned to at most 8 bytes, and `DESC` says exactly where its fields are.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no payload: it cannot cross a port or stand in the state table",
    label = "not plain data of a fixed layout",
    note = "instead of `bool` write `Flag`, of `String` `Text<N>`, of `Vec<T>` `List<T, N>`, of an enum `named_values!`, of \
            `usize` `u64`",
    note = "a struct of one's own needs `#[derive(Payload, Clone, Copy)] #[repr(C)]`; what nobody else sees goes into a field \
            without an attribute"
)]
pub unsafe trait Payload: Copy + Send + Sync + 'static {
    /// The layout: size, alignment, fields with their units.
    const DESC: &'static TypeDesc;
    /// Format of the bytes behind this header when it heads a frame ("image", "spectra"), else empty.
    const FORMAT: &'static str = "";

    /// The value's own `stamp` field in ns, 0 when it has none or it is not set.
    #[inline]
    fn stamp_ns(&self) -> u64 {
        0
    }

    /// All bytes zero.
    #[inline]
    fn zeroed() -> Self {
        // SAFETY: every bit pattern of a payload is valid, by the trait's contract.
        unsafe { core::mem::zeroed() }
    }
}

/// The bytes of a payload.
pub fn as_bytes<T: Payload>(value: &T) -> &[u8] {
    // SAFETY: a payload has no padding, so all its bytes are initialised; the borrow keeps it alive.
    unsafe { core::slice::from_raw_parts((value as *const T).cast(), size_of::<T>()) }
}

/// A payload from its bytes; none when the length is not the payload's.
pub fn from_bytes<T: Payload>(bytes: &[u8]) -> Option<T> {
    // SAFETY: the length is checked, the read asks no alignment, and every bit pattern is valid.
    (bytes.len() == size_of::<T>()).then(|| unsafe { bytes.as_ptr().cast::<T>().read_unaligned() })
}

macro_rules! prims {
    ($($ty:ty => $prim:ident),* $(,)?) => {$(
        // SAFETY: a number of 1 to 8 bytes without padding, valid for every bit pattern.
        unsafe impl Payload for $ty {
            const DESC: &'static TypeDesc = &TypeDesc::prim(Prim::$prim);
        }
    )*};
}
prims!(u8 => U8, i8 => I8, u16 => U16, i16 => I16, u32 => U32, i32 => I32, u64 => U64, i64 => I64, f32 => F32, f64 => F64);

// SAFETY: an array has the layout of its items side by side; items without padding leave none in the array.
unsafe impl<T: Payload, const N: usize> Payload for [T; N] {
    const DESC: &'static TypeDesc = &TypeDesc {
        size: size_of::<[T; N]>(),
        align: align_of::<T>(),
        kind: TypeKind::Array { item: T::DESC, n: N },
    };
}
