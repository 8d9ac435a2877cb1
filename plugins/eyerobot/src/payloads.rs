//! What the arm's interface carries beside the standard payloads, and the way from nalgebra to payloads.
//!
//! Invariant: orientations are x, y, z, w on both sides; nothing here allocates.

use std::fmt::{self, Write};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector6};
use trocar_sdk::data::{JointState, OperatingMode, OperatingState, Pose, Twist};
use trocar_sdk::prelude::*;

use crate::arm::Fault;
use crate::crtk::{Operating, State};
use crate::drive::Measured;
use crate::joints::{KINDS, Kind, Limits, NAMES};

/// A quaternion's length may differ this much from 1.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Room for joints.
const MAX: usize = 8;

named_values! {
    /// What a joint does; decides the unit of its values.
    pub struct JointKind: u32 { PRISMATIC = 1, REVOLUTE = 2 }
}

/// Names, kinds and limits of the joints (CRTK `configuration_js`).
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct JointConfiguration {
    pub names: List<Text<8>, MAX>,
    pub kinds: List<JointKind, MAX>,
    #[unit("m|rad")]
    pub lower: List<f64, MAX>,
    #[unit("m|rad")]
    pub upper: List<f64, MAX>,
    #[unit("m/s|rad/s")]
    pub speed: List<f64, MAX>,
    #[unit("m/s^2|rad/s^2")]
    pub acceleration: List<f64, MAX>,
}

/// One sample of the arm's stream.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ArmState {
    pub stamp: Stamp,
    pub measured_js: JointState,
    pub measured_cp: Pose,
}

pub(crate) fn configuration(limits: &Limits) -> JointConfiguration {
    let kind = |k| if k == Kind::Prismatic { JointKind::PRISMATIC } else { JointKind::REVOLUTE };
    JointConfiguration {
        names: List::of(&NAMES.map(Text::new)),
        kinds: List::of(&KINDS.map(kind)),
        lower: List::of(limits.lower.as_slice()),
        upper: List::of(limits.upper.as_slice()),
        speed: List::of(limits.speed.as_slice()),
        acceleration: List::of(limits.acceleration.as_slice()),
    }
}

pub(crate) fn joint_state(stamp: Stamp, at: &Measured) -> JointState {
    JointState {
        stamp,
        position: List::of(at.position.as_slice()),
        velocity: List::of(at.velocity.as_slice()),
        effort: List::default(),
    }
}

pub(crate) fn pose(stamp: Stamp, at: &Isometry3<f64>) -> Pose {
    Pose { stamp, position: at.translation.vector.into(), orientation: at.rotation.coords.into() }
}

/// The pose as a transform; none when its orientation is no unit quaternion.
pub(crate) fn isometry(pose: &Pose) -> Option<Isometry3<f64>> {
    let turn = Quaternion::from(pose.orientation);
    let unit = (turn.norm() - 1.0).abs() <= UNIT_TOLERANCE;
    let [x, y, z] = pose.position;
    unit.then(|| Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(turn)))
}

pub(crate) fn twist(stamp: Stamp, v: &Vector6<f64>) -> Twist {
    Twist { stamp, linear: [v[0], v[1], v[2]], angular: [v[3], v[4], v[5]] }
}

pub(crate) fn operating_state(stamp: Stamp, now: Operating, fault: Option<Fault>) -> OperatingState {
    OperatingState {
        stamp,
        state: match now.state {
            State::Disabled => OperatingMode::DISABLED,
            State::Enabled => OperatingMode::ENABLED,
            State::Paused => OperatingMode::PAUSED,
            State::Fault => OperatingMode::FAULT,
        },
        is_homed: now.is_homed.into(),
        is_busy: now.is_busy.into(),
        reserved: [0; 2],
        message: fault.map_or_else(Text::default, |fault| text(&fault)),
    }
}

/// `what` as text of a payload, cut where it does not fit.
fn text(what: &impl fmt::Display) -> Text<128> {
    struct Line {
        bytes: [u8; 128],
        len: usize,
    }
    impl Write for Line {
        fn write_str(&mut self, part: &str) -> fmt::Result {
            for byte in part.bytes().take(self.bytes.len() - self.len) {
                self.bytes[self.len] = byte;
                self.len += 1;
            }
            Ok(())
        }
    }
    let mut line = Line { bytes: [0; 128], len: 0 };
    let _ = write!(line, "{what}");
    Text::new(line.bytes[..line.len].utf8_chunks().next().map_or("", |whole| whole.valid()))
}
