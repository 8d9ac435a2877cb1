//! The place in the input that an output pixel of a map comes from.
//!
//! Invariant: the four input pixels around a place are weighted in whole steps, so that sums are exact.

/// Steps between two input pixels.
pub(crate) const STEPS: i32 = 32;

/// The place in the input that an output pixel is made from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub(crate) struct Tap {
    /// Column of the left upper one of the four input pixels.
    pub(crate) x: i16,
    /// Its row.
    pub(crate) y: i16,
    /// Distance to the right of it, 1/32 px.
    pub(crate) fx: u8,
    /// Distance below it.
    pub(crate) fy: u8,
}
