//! Standard payloads. Use them where they fit, so that components of different authors connect.
//!
//! Invariant: SI units inside; a released struct never changes, a better one gets a new name. A stamp of 0
//! says that the value beside it is not valid.
//!
//! Coordinate frames: a standard pose is in the frame that its interface names (`docs/INTERFACES.md`). Where
//! two frames could be confused, name the frame at the port; Connect compares the names of both ends:
//! ```
//! use trocar_sdk::{data::Pose, prelude::*};
//! #[derive(Component)]
//! struct Guide {
//!     #[input]
//!     #[frame("retina")]
//!     goal: In<Pose>,
//! }
//! impl Component for Guide {}
//! ```
//! The name applies to the fields that hold coordinates: arrays of floating point numbers in structs. Where
//! there are none, the plugin does not compile:
//! ```compile_fail,E0080
//! use trocar_sdk::{data::JointState, prelude::*};
//! #[derive(Component)]
//! struct Guide {
//!     #[input]
//!     #[frame("retina")]
//!     joints: In<JointState>,
//! }
//! impl Component for Guide {}
//! ```
//! ```compile_fail,E0080
//! use trocar_sdk::{data::Pose, prelude::*};
//! #[derive(Component)]
//! #[component(provides("ctl"))]
//! struct Guide {}
//! #[provides("ctl")]
//! impl Guide {
//!     #[command]
//!     fn aim(&mut self, #[frame("retina")] goal: f64) {}
//! }
//! impl Component for Guide {}
//! ```

mod basic;
mod device;
mod image;
mod motion;
mod oct;
mod view;

pub use basic::{Message, Scalar};
pub use device::{
    ButtonEvent, ForceRange, InputLayout, InputState, MAX_AXES, MAX_BUTTONS, MAX_TOOLS, ToolPose, ToolStatus,
    TrackedTools,
};
pub use image::{CameraGeometry, ImageHeader, PixelFormat, StereoHeader};
pub use motion::{
    ArmState, CartesianState, FixtureKind, JointConfiguration, JointKind, JointState, MAX_JOINTS,
    OperatingMode, OperatingState, Pose, Retreat, Transform, Twist, VirtualFixture, Wrench,
};
pub use oct::{AScanHeader, Distance, SampleFormat, SpectraHeader, Spectrometer};
pub use view::{BadFrame, ImageView, LinesView};
