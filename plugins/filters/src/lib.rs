//! Filters of plain samples, one file each.
//!
//! Invariant: `low_pass.rs` is the sample that the documentation shows; it stays on one screen and is laid out by hand.
#![forbid(unsafe_code)]

#[rustfmt::skip]
mod low_pass;

pub use low_pass::Force;
