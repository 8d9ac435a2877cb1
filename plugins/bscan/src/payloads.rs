//! Payloads of the B-scan.
//!
//! Invariant: SI; poses are in the robot's base frame, as the robot's interface gives them.

use trocar_sdk::data::Pose;
use trocar_sdk::prelude::*;

/// A scan to make. If `width` is above 0, the line goes through the tip, half of it to each side, at `angle`
/// from the base's x to its y axis; else from `from` to `to`. Only what is across the tool counts: depth is
/// the scan's own affair.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ScanRequest {
    #[unit("m")]
    pub from: [f64; 3],
    #[unit("m")]
    pub to: [f64; 3],
    #[unit("m")]
    pub width: f64,
    #[unit("rad")]
    pub angle: f64,
    #[unit("m/s")]
    pub speed: f64,
    /// From the tip to the surface.
    #[unit("m")]
    pub offset: f64,
    /// Along the line, from one column of the image to the next.
    #[unit("m")]
    pub pitch: f64,
}

named_values! {
    /// State of the scan.
    pub struct Phase: u32 {
        /// Nothing: the robot is not commanded.
        IDLE = 0,
        /// Goes to just before the begin of the line and to the offset.
        APPROACH = 1,
        /// Goes along the line.
        SCAN = 2,
        /// Has the image, and goes away from the surface.
        RETRACT = 3,
    }
}

/// Progress of a scan.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Progress {
    pub stamp: Stamp,
    /// Counts the scans since Start, from 1.
    pub scan: u64,
    pub phase: Phase,
    /// Columns of the image that are there.
    pub columns: u32,
    /// Columns of the whole image.
    pub of: u32,
    /// The tracker's last distance was valid.
    pub surface: Flag,
    /// The last scan ended before its end, and the tip has not gone back from the surface yet: an eye that
    /// moves comes near it.
    pub stranded: Flag,
    pub reserved: [u8; 2],
    /// Predicted for now, from tip to surface.
    #[unit("m")]
    pub distance: f64,
    /// The same less the distance that is wanted now; 0 without a scan.
    #[unit("m")]
    pub error: f64,
    /// From the middle of an exposure to the step that sees its distance, mean.
    #[unit("s")]
    pub delay: f64,
    /// Delay of the whole loop, to which the gains give way: `delay` and the age of the robot's pose, which
    /// together are the measured delay and end a scan above 12 ms, and the robot's own lag as configured.
    #[unit("s")]
    pub loop_delay: f64,
    /// Commands of this scan that the robot did not take: hold, move_cr, set_guard, set_retreat.
    pub refused: u64,
}

/// A column of an image is there. That of an M-scan has scan 0, and counts from Start.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ScanColumn {
    /// When its first A-scan was taken: pose and distance are those of this time.
    pub stamp: Stamp,
    pub scan: u64,
    /// From 0.
    pub column: u32,
    /// A-scans in it.
    pub lines: u32,
    /// Pose of the tip, in the robot's base frame, with the same stamp; stamp 0 if the robot did not tell it.
    pub pose: Pose,
    /// From the tip to the surface, as tracked; NaN where that A-scan shows none, or nobody told.
    #[unit("m")]
    pub distance: f64,
}

/// A scan has come to its end.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ScanDone {
    pub scan: u64,
    /// Columns of the image, and how many of them no A-scan fell into.
    pub columns: u32,
    pub empty: u32,
}
