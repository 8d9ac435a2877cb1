//! Image filters: `gray`, `resize`, `pip` (picture in picture).
//!
//! Invariant: pixels are touched only through `view`, which has checked that every row lies inside its bytes.

pub mod gray;
pub mod pip;
pub mod resize;
pub mod view;
