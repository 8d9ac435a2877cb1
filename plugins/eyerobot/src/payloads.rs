//! Payloads of the robot's own, and the way from the arm's values to payloads.
//!
//! Invariant: nothing here allocates; incoming values are checked, never repaired.

use nalgebra::SMatrix;
use trocar_sdk::data::{FixtureKind, JointConfiguration, JointKind, JointState, VirtualFixture};
use trocar_sdk::prelude::*;

use crate::arm::ArmError;
use crate::drive::Measured;
use crate::fixture::{Fixture, FixtureRefused, Kind as Holds, MOST_FIXTURES, STIFFNESS_PER_S};
use crate::joints::{COUNT, Joints, KINDS, Kind, Limits, NAMES};

/// All virtual fixtures in force.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct VirtualFixtures {
    pub stamp: Stamp,
    pub fixtures: List<VirtualFixture, MOST_FIXTURES>,
}

/// Jacobian of the tip: joint velocities to its twist. Rows vx vy vz (m/s) ωx ωy ωz (rad/s), columns joints
/// in the order of `configuration_js`, row after row.
#[derive(Payload, Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Jacobian {
    pub stamp: Stamp,
    pub values: [f64; 6 * COUNT],
}

impl Default for Jacobian {
    fn default() -> Self {
        Jacobian { stamp: Stamp::INVALID, values: [0.0; 6 * COUNT] }
    }
}

impl Jacobian {
    pub(crate) fn of(stamp: Stamp, matrix: &SMatrix<f64, 6, COUNT>) -> Jacobian {
        Jacobian { stamp, values: std::array::from_fn(|at| matrix[(at / COUNT, at % COUNT)]) }
    }
}

/// The fixture at `place` of a list, as it came.
///
/// # Errors
/// A kind that is none, a frame that is no pose.
pub(crate) fn checked(fixture: &VirtualFixture, place: usize) -> Result<Fixture, ArmError> {
    let kind = match fixture.kind {
        FixtureKind::PLANE => Holds::Plane,
        FixtureKind::LINE => Holds::Line,
        FixtureKind::RCM => Holds::Rcm,
        FixtureKind(kind) => return Err(FixtureRefused::Kind { place, kind }.into()),
    };
    let stiffness_per_s = if fixture.stiffness == 0.0 { STIFFNESS_PER_S } else { fixture.stiffness };
    Ok(Fixture { kind, frame: fixture.frame.isometry()?, stiffness_per_s })
}

/// The payload of a fixture.
pub(crate) fn payload(fixture: &Fixture) -> VirtualFixture {
    let kind = match fixture.kind {
        Holds::Plane => FixtureKind::PLANE,
        Holds::Line => FixtureKind::LINE,
        Holds::Rcm => FixtureKind::RCM,
    };
    VirtualFixture { kind, reserved: 0, frame: fixture.frame.into(), stiffness: fixture.stiffness_per_s }
}

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
    joint_positions(stamp, &at.position).with_velocities(&at.velocity)
}

pub(crate) fn joint_positions(stamp: Stamp, position: &Joints) -> JointState {
    JointState { stamp, ..JointState::default() }.with_positions(position)
}
