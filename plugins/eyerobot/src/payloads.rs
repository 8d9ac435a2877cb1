//! The way from the arm's joints to the standard payloads.
//!
//! Invariant: nothing here allocates.

use trocar_sdk::data::{JointConfiguration, JointKind, JointState};
use trocar_sdk::prelude::*;

use crate::drive::Measured;
use crate::joints::{KINDS, Kind, Limits, NAMES};

pub(crate) fn configuration(stamp: Stamp, limits: &Limits) -> JointConfiguration {
    let kind = |k| if k == Kind::Prismatic { JointKind::PRISMATIC } else { JointKind::REVOLUTE };
    JointConfiguration {
        stamp,
        names: List::of(&NAMES.map(Text::new)),
        kinds: List::of(&KINDS.map(kind)),
        lower: List::of(limits.lower.as_slice()),
        upper: List::of(limits.upper.as_slice()),
        speed: List::of(limits.speed.as_slice()),
        acceleration: List::of(limits.acceleration.as_slice()),
        effort: List::default(),
    }
}

pub(crate) fn joint_state(stamp: Stamp, at: &Measured) -> JointState {
    JointState { stamp, ..JointState::default() }.with_positions(&at.position).with_velocities(&at.velocity)
}
