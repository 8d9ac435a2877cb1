//! Image filters on stereo frames: `rectify`, `debayer`, `color`, `gray`, `resize`, `crop`, `flip`,
//! `exposure`, `overlay`, `pip` (picture in picture).
//!
//! Invariant: pixels are touched only through `view`, which has checked that every row lies inside its bytes.
#![deny(unsafe_code)]

pub mod color;
mod components;
pub mod exposure;
pub mod flip;
pub mod gray;
pub mod overlay;
pub mod pip;
pub mod remap;
pub mod resize;
pub mod scale;
mod simd;
mod tap;
pub mod view;

pub use trocar_imaging::debayer;

pub use components::{
    Color, Crop, Debayer, Exposure, Eye, Flip, Gray, Overlay, OverlayLine, OverlayPicture, OverlayText, Pip,
    PipRect, RectifiedGeometry, Rectify, Resize, Tally,
};

trocar_sdk::trocar_plugin!(Rectify, Debayer, Color, Gray, Resize, Crop, Flip, Exposure, Overlay, Pip);
