//! Standard payloads. Use them where they fit, so that components of different authors connect.
//!
//! Invariant: SI units inside; a released struct never changes, a better one gets a new name. A stamp of 0 says that the
//! value beside it is not valid.
//!
//! Coordinate frames: a standard pose is in the frame that its interface names (`docs/INTERFACES.md`). Where two frames
//! could be confused, wrap the pose into a payload of your own and tag it; Connect then compares the tags:
//! ```
//! use trocar_sdk::{data::Pose, prelude::*};
//! #[derive(Payload, Clone, Copy, Default)]
//! #[repr(C)]
//! struct Target {
//!     #[frame("retina")]
//!     tip: Pose,
//! }
//! ```

mod basic;
mod device;
mod image;
mod motion;
mod oct;

pub use basic::{Message, Scalar};
pub use device::{
    ButtonEvent, ForceRange, InputLayout, InputState, MAX_AXES, MAX_BUTTONS, MAX_TOOLS, ToolPose, ToolStatus,
    TrackedTools,
};
pub use image::{CameraGeometry, ImageHeader, PixelFormat, StereoHeader};
pub use motion::{
    ArmState, CartesianState, JointConfiguration, JointKind, JointState, MAX_JOINTS, OperatingMode,
    OperatingState, Pose, Transform, Twist, Wrench,
};
pub use oct::{AScanHeader, Distance, SampleFormat, SpectraHeader, Spectrometer};
