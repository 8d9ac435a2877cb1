//! Shared by plugins: stereo calibration, brightness of colours, colours of YUYV and of mosaics, images as
//! people look at them, letters, threads beside the step with the programs they start, and which instructions
//! the processor has.
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
pub mod program;
pub mod side;
pub mod simd;
pub mod waits;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;
mod weights;
pub mod yuyv;

pub use calibration::{Calibration, CalibrationError};
pub use camera::Camera;
pub use luma::{luma, luma_row};
