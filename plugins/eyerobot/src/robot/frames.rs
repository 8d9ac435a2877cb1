//! The interfaces `local`, `spatial`, `body` and `truth`: the tip as other frames see it.
//!
//! Invariant: reads only; what `truth` says is for tests, recorders and plots, never for a controller.

use trocar_sdk::data::{CartesianState, Pose, Twist};
use trocar_sdk::prelude::*;

use super::{EyeRobot, EyeRobotState};
use crate::payloads::Jacobian;

/// The tip relative to the arm's first link, whatever `set_base_frame` says.
#[provides("local")]
impl EyeRobot {
    /// Pose of the tip from the encoders.
    #[read(name = "measured_cp")]
    fn local_measured_cp(s: &EyeRobotState) -> Pose {
        s.local_cp
    }
}

/// The tip with the orientation of the base.
#[provides("spatial")]
impl EyeRobot {
    /// Velocity of the tip.
    #[read(name = "measured_cv")]
    fn spatial_measured_cv(s: &EyeRobotState) -> Twist {
        s.measured_cv
    }

    /// Joint velocities to the twist of the tip.
    #[read(name = "jacobian")]
    fn spatial_jacobian(s: &EyeRobotState) -> Jacobian {
        s.spatial_jacobian
    }
}

/// The tip in its own frame.
#[provides("body")]
impl EyeRobot {
    /// Joint velocities to the twist of the tip.
    #[read]
    fn jacobian(s: &EyeRobotState) -> Jacobian {
        s.body_jacobian
    }
}

/// True place of the tip in the simulated world: behind encoders and backlash.
#[provides("truth", tag = "truth")]
impl EyeRobot {
    /// True pose of the tip.
    #[read(name = "measured_cp")]
    fn true_cp(s: &EyeRobotState) -> Pose {
        s.truth.pose
    }

    /// True pose and twist of the tip.
    #[read(name = "measured_cs")]
    fn true_cs(s: &EyeRobotState) -> CartesianState {
        s.truth
    }
}
