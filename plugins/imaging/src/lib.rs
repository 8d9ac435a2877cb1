//! What the vision plugins share: stereo calibration, brightness of colours, colours of YUYV and of mosaics, images as people look
//! at them, letters, threads beside the step, and which instructions the processor has.
//!
//! Invariant: functions of pixels give the same bytes whichever instructions they use.
#![deny(unsafe_code)]

pub mod calibration;
mod camera;
pub mod debayer;
pub mod letters;
mod luma;
pub mod nearness;
pub mod pixels;
pub mod side;
pub mod simd;
pub mod yuyv;

pub use calibration::{Calibration, CalibrationError};
pub use camera::Camera;
pub use luma::{luma, luma_row};
