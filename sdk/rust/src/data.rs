//! Standard payloads. Use them where they fit, so that components of different authors connect.
//!
//! Invariant: SI units inside; a released struct never changes, a better one gets a new name.

use crate as trocar_sdk;
use trocar_sdk::{Flag, List, Payload, Stamp, Text, named_values};

/// Most joints of one `JointState`.
pub const MAX_JOINTS: usize = 16;

/// Joint vectors of a robot (CRTK `measured_js`, `setpoint_js`). Prismatic joints in m, revolute ones in rad; the
/// interface's `configuration_js` says which is which.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct JointState {
    pub stamp: Stamp,
    #[unit("m|rad")]
    pub position: List<f64, MAX_JOINTS>,
    #[unit("m/s|rad/s")]
    pub velocity: List<f64, MAX_JOINTS>,
    #[unit("N|N.m")]
    pub effort: List<f64, MAX_JOINTS>,
}

/// A position and orientation (CRTK `measured_cp`).
#[derive(Payload, Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Pose {
    pub stamp: Stamp,
    #[unit("m")]
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

impl Default for Pose {
    fn default() -> Pose {
        Pose { stamp: Stamp::INVALID, position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] }
    }
}

/// Linear and angular velocity (CRTK `measured_cv`).
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Twist {
    pub stamp: Stamp,
    #[unit("m/s")]
    pub linear: [f64; 3],
    #[unit("rad/s")]
    pub angular: [f64; 3],
}

/// Force and torque (CRTK `measured_cf`).
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Wrench {
    pub stamp: Stamp,
    #[unit("N")]
    pub force: [f64; 3],
    #[unit("N.m")]
    pub torque: [f64; 3],
}

/// Pose and twist of one instant.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct CartesianState {
    pub stamp: Stamp,
    pub pose: Pose,
    pub twist: Twist,
}

/// A rigid transform between two named frames.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Transform {
    pub pose: Pose,
    pub parent: Text<32>,
    pub child: Text<32>,
}

named_values! {
    /// CRTK operating states.
    pub struct OperatingMode: u32 { DISABLED = 0, ENABLED = 1, PAUSED = 2, FAULT = 3 }
}

/// CRTK `operating_state`.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct OperatingState {
    pub stamp: Stamp,
    pub state: OperatingMode,
    pub is_homed: Flag,
    pub is_busy: Flag,
    pub reserved: [u8; 2],
    /// Why, in one sentence.
    pub message: Text<128>,
}

named_values! {
    /// Pixel formats; rows are `stride` bytes apart.
    pub struct PixelFormat: u32 { GRAY8 = 1, RGB8 = 2, BGR8 = 3, RGBA8 = 4, GRAY16 = 5 }
}

impl PixelFormat {
    /// Bytes of one pixel; 0 for an unknown format.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            PixelFormat::GRAY8 => 1,
            PixelFormat::GRAY16 => 2,
            PixelFormat::RGB8 | PixelFormat::BGR8 => 3,
            PixelFormat::RGBA8 => 4,
            _ => 0,
        }
    }
}

/// Header of an image frame.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
#[format("image")]
pub struct ImageHeader {
    /// When the image was taken.
    pub stamp: Stamp,
    /// Counts the source's images, from 0.
    pub index: u64,
    #[unit("px")]
    pub width: u32,
    #[unit("px")]
    pub height: u32,
    /// From one row to the next.
    #[unit("B")]
    pub stride: u32,
    pub format: PixelFormat,
}

/// Header of a stereo pair: two images of one size and format in one frame.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
#[format("stereo")]
pub struct StereoHeader {
    /// When the pair was taken.
    pub stamp: Stamp,
    /// Counts the source's pairs, from 0.
    pub index: u64,
    /// Of one image.
    #[unit("px")]
    pub width: u32,
    #[unit("px")]
    pub height: u32,
    /// From one row to the next.
    #[unit("B")]
    pub stride: u32,
    pub format: PixelFormat,
    /// Where the right image begins; the left one begins at 0.
    #[unit("B")]
    pub right_offset: u64,
}

/// One number with its time: the simplest signal.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Scalar {
    pub stamp: Stamp,
    pub value: f64,
}

/// A measured distance.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Distance {
    pub stamp: Stamp,
    #[unit("m")]
    pub distance: f64,
    /// 0 = useless, 1 = certain.
    pub confidence: f64,
    pub valid: Flag,
    pub reserved: [u8; 7],
}

/// A line for people.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Message {
    pub stamp: Stamp,
    pub text: Text<240>,
}
