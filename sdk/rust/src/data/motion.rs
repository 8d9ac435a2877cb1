//! Payloads of robots: joint and cartesian values, limits, and the CRTK operating state.
//!
//! Invariant: a part whose stamp is 0 is not measured, whatever its numbers are (CRTK); empty joint lists are
//! absent, and all lists that are not empty have one length. Source: A. Su et al., "Collaborative Robotics
//! Toolkit (CRTK)", IEEE IRC 2020.
#![allow(
    missing_docs,
    reason = "the docs of fields go into every manifest: a field has one where name, type and unit do not say it all"
)]

use crate as trocar_sdk;
use trocar_sdk::{Flag, List, Payload, Stamp, Text, named_values};

/// Most joints of one `JointState`.
pub const MAX_JOINTS: usize = 16;

/// Joint vectors of a robot (CRTK `measured_js`, `setpoint_js`). Prismatic joints in m, revolute ones in rad;
/// the interface's `configuration_js` says which is which.
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

named_values! {
    /// Kind of a joint; decides the unit of its values.
    pub struct JointKind: u32 {
        /// Moves along its axis: m, m/s, N.
        PRISMATIC = 1,
        /// Turns about its axis: rad, rad/s, N·m.
        REVOLUTE = 2,
    }
}

/// Names, kinds and limits of the joints (CRTK `configuration_js`), one item per joint in each list.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct JointConfiguration {
    /// When these limits began to hold.
    pub stamp: Stamp,
    pub names: List<Text<16>, MAX_JOINTS>,
    pub kinds: List<JointKind, MAX_JOINTS>,
    #[unit("m|rad")]
    pub lower: List<f64, MAX_JOINTS>,
    #[unit("m|rad")]
    pub upper: List<f64, MAX_JOINTS>,
    /// Highest speed, to both sides.
    #[unit("m/s|rad/s")]
    pub speed: List<f64, MAX_JOINTS>,
    /// Highest acceleration, to both sides; empty where it is not limited.
    #[unit("m/s^2|rad/s^2")]
    pub acceleration: List<f64, MAX_JOINTS>,
    /// Highest force or torque, to both sides; empty where it is not limited.
    #[unit("N|N.m")]
    pub effort: List<f64, MAX_JOINTS>,
}

/// A position and orientation (CRTK `measured_cp`), in the frame that the interface says.
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

/// Pose, twist and wrench of one instant (`measured_cs`). A part that is not measured keeps stamp 0.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct CartesianState {
    pub stamp: Stamp,
    pub pose: Pose,
    pub twist: Twist,
    pub wrench: Wrench,
}

/// A rigid transform between two named frames: takes coordinates in `child` to coordinates in `parent`.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Transform {
    pub pose: Pose,
    pub parent: Text<32>,
    pub child: Text<32>,
}

/// One sample of an arm's stream: joints, tip and wrench of the same instant, so they carry the same stamp; a
/// wrench that is not measured has stamp 0.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ArmState {
    pub stamp: Stamp,
    pub measured_js: JointState,
    pub measured_cp: Pose,
    /// As the read `measured_cf` of the arm: what the tip meets; stamp 0 where nothing measures it.
    pub measured_cf: Wrench,
}

named_values! {
    /// Kind of a virtual fixture.
    pub struct FixtureKind: u32 {
        /// The tip stays on the side of the frame's xy plane to which its z axis points.
        PLANE = 1,
        /// The tip stays on the frame's z axis.
        LINE = 2,
        /// The tool's shaft passes through the frame's origin (remote centre of motion).
        RCM = 3,
    }
}

/// A virtual fixture.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct VirtualFixture {
    pub kind: FixtureKind,
    pub reserved: u32,
    /// Where; commands take it in the arm's base frame.
    pub frame: Pose,
    /// Towards the border the tip moves at most at this times the distance that is left, 0 = 20 /s.
    #[unit("1/s")]
    pub stiffness: f64,
}

/// What an arm does by itself when a motion by velocity or force is not repeated in time: it brakes, waits,
/// and takes its tip back along the tool.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Retreat {
    /// Back along the tool; 0 = it stays where it stands.
    #[unit("m")]
    pub distance: f64,
    /// Of the tip, at most.
    #[unit("m/s")]
    pub speed: f64,
    /// From the brake to the way back: who is only late finds the tip where it was.
    #[unit("s")]
    pub delay: f64,
}

named_values! {
    /// CRTK operating states.
    pub struct OperatingMode: u32 {
        /// Motors off; motions are refused.
        DISABLED = 0,
        /// Motions are taken, once homed.
        ENABLED = 1,
        /// Holds its position; motions are refused until `resume`.
        PAUSED = 2,
        /// Stopped by a fault of the device; `enable` or `disable` try again.
        FAULT = 3,
    }
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

macro_rules! stamped {
    ($($ty:ty),*) => {$(
        impl $ty {
            /// True when the value is one: its stamp is not 0 (CRTK).
            pub const fn is_valid(&self) -> bool {
                self.stamp.is_valid()
            }
        }
    )*};
}
stamped!(JointState, JointConfiguration, Pose, Twist, Wrench, CartesianState, ArmState, OperatingState);
