//! Place of the simulated arm at the simulated eye: its base in the world, and the port that its shaft goes
//! through.
//!
//! Invariant: set by the configuration alone, the axes of the base are those of the world. At home the tool
//! points at the world's origin, and its shaft goes through the port, which it never leaves. Unless
//! `set_base_frame` says otherwise, the world's origin has the coordinates 0, 0, tool_length_m + standoff_m
//! in poses, however the arm stands at home.

use nalgebra::{Isometry3, Translation3};

use super::config::EyeRobotConfig;
use crate::arm::Settings;
use crate::fixture::{Fixture, Kind, STIFFEST_PER_S};

impl EyeRobotConfig {
    /// The kinematic base in the frame of poses, as it is at first.
    pub(super) fn first_base(&self, settings: &Settings) -> Isometry3<f64> {
        let origin = Translation3::new(0.0, 0.0, settings.kinematics.tool_length_m + self.standoff_m);
        origin * self.world_from_base(settings)
    }

    /// The kinematic base in the simulated world.
    pub(super) fn world_from_base(&self, settings: &Settings) -> Isometry3<f64> {
        let over = settings.kinematics.forward(&settings.home) * Translation3::new(0.0, 0.0, self.standoff_m);
        Translation3::from(-over.translation.vector).into()
    }

    /// Returns the remote centre of motion where the shaft passes the wall of the eye, in the kinematic base;
    /// none without a wall.
    pub(super) fn port(&self, settings: &Settings) -> Option<Fixture> {
        let up = Translation3::new(0.0, 0.0, -self.port_m);
        let frame = settings.kinematics.forward(&settings.home) * up;
        (self.port_m > 0.0).then_some(Fixture { kind: Kind::Rcm, frame, stiffness_per_s: STIFFEST_PER_S })
    }
}
