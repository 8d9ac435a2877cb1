//! Weights of colours after ITU-R BT.601, as whole numbers.
//!
//! Invariant: the same numbers with and without AVX2, so that both give the same bytes.

/// Weights of red, green, blue in the brightness, 1/256.
pub(crate) const LUMA: [u16; 3] = [77, 150, 29];

// 255/219, and 1.596, 0.813, 0.391, 2.018 of the standard, times 2^20.
pub(crate) const Y: i32 = 1_220_542;
pub(crate) const RV: i32 = 1_673_527;
pub(crate) const GV: i32 = -852_492;
pub(crate) const GU: i32 = -409_993;
pub(crate) const BU: i32 = 2_116_026;
