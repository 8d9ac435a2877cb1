//! Image filters on stereo frames: `gray`, `resize`, `pip` (picture in picture).
//!
//! Invariant: pixels are touched only through `view`, which has checked that every row lies inside its bytes.
#![forbid(unsafe_code)]

mod components;
pub mod gray;
pub mod pip;
pub mod resize;
pub mod view;

pub use components::{Gray, Pip, Resize, Tally};

trocar_sdk::trocar_plugin!(Gray, Resize, Pip);
