//! Readings of an arm.
//!
//! Invariant: nothing here changes the arm; all readings are of the end of the last step.

use nalgebra::{Isometry3, SMatrix, Vector6};
use trocar_sdk::crtk::OperatingStateMachine;

use super::motion::{Motion, Move};
use super::{Arm, Fault, Retreat, Settings, turned};
use crate::drive::{Drive, Measured};
use crate::fixture::{Fixtures, Stance};
use crate::joints::{COUNT, Joints};

impl<D: Drive> Arm<D> {
    /// CRTK operating state.
    pub fn operating(&self) -> OperatingStateMachine {
        self.operating
    }

    /// Why the arm is in FAULT; none in other states.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Returns the settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Encoder positions (m, rad) and joint velocities (m/s, rad/s) at the end of the last step.
    pub fn measured(&self) -> Measured {
        self.measured
    }

    /// Returns the setpoint of the joints (m, rad) and their velocities (m/s, rad/s).
    pub fn setpoint(&self) -> Measured {
        self.setpoint
    }

    /// Returns the drive.
    pub fn drive(&self) -> &D {
        &self.drive
    }

    /// Fixtures in force, in the kinematic base.
    pub fn fixtures(&self) -> &Fixtures {
        &self.fixtures
    }

    /// Returns the way back that follows when the arm's client falls silent.
    pub fn retreat(&self) -> Option<Retreat> {
        self.retreat
    }

    /// Gains of hands-on control: m/(s·N), then rad/(s·N·m), in the frame of the tip.
    pub fn gain(&self) -> Vector6<f64> {
        self.admittance.law.gain
    }

    /// Returns the place of the kinematic base in the frame of `set_base_frame`.
    pub fn base(&self) -> Isometry3<f64> {
        self.base
    }

    /// The setpoint's pose is what was asked for: the motion is no one by velocity or force.
    pub fn is_position_based(&self) -> bool {
        self.motion.is_position_based()
    }

    /// Returns the end of the running motion, m and rad; none for one by velocity or force, which has no end.
    pub fn goal(&self) -> Option<Joints> {
        match &self.motion {
            Motion::Hold => Some(self.setpoint.position),
            Motion::ServoPosition { goal } | Motion::Move(Move { goal, .. }) => Some(*goal),
            Motion::ServoVelocity { .. } | Motion::Tip(_) => None,
        }
    }

    /// Pose of the tip from the encoders, in the kinematic base, m.
    pub fn local_cp(&self) -> Isometry3<f64> {
        self.settings.kinematics.forward(&self.measured.position)
    }

    /// Pose of the tip from the encoders, m.
    pub fn measured_cp(&self) -> Isometry3<f64> {
        self.base * self.local_cp()
    }

    /// Twist of the tip from the encoders: v (m/s) then ω (rad/s).
    pub fn measured_cv(&self) -> Vector6<f64> {
        let Measured { position, velocity } = &self.measured;
        turned(&self.base.rotation, &self.settings.kinematics.twist(position, velocity))
    }

    /// Wrench of the hand, N and N·m, with the orientation of the base frame.
    pub fn hand_cf(&self) -> Vector6<f64> {
        turned(&self.measured_cp().rotation, &self.handle)
    }

    /// Joint velocities to the twist of the tip in its own frame.
    pub fn body_jacobian(&self) -> SMatrix<f64, 6, COUNT> {
        let Stance { tip, jacobian, .. } = Stance::of(&self.settings.kinematics, &self.measured.position);
        let back = tip.rotation.inverse();
        let columns = std::array::from_fn::<_, COUNT, _>(|i| turned(&back, &jacobian.column(i).into_owned()));
        SMatrix::from_columns(&columns)
    }

    /// Joint velocities to the twist of the tip with the orientation of the base frame.
    pub fn spatial_jacobian(&self) -> SMatrix<f64, 6, COUNT> {
        let Stance { jacobian, .. } = Stance::of(&self.settings.kinematics, &self.measured.position);
        let turn = self.base.rotation;
        let columns = std::array::from_fn::<_, COUNT, _>(|i| turned(&turn, &jacobian.column(i).into_owned()));
        SMatrix::from_columns(&columns)
    }

    /// Pose of the tip at joints `q` (m, rad), m.
    pub fn pose_at(&self, q: &Joints) -> Isometry3<f64> {
        self.base * self.settings.kinematics.forward(q)
    }

    /// Pose of the tip at the setpoint, m.
    pub fn setpoint_cp(&self) -> Isometry3<f64> {
        self.pose_at(&self.setpoint.position)
    }

    /// Twist of the tip at the setpoint, m/s and rad/s.
    pub fn setpoint_cv(&self) -> Vector6<f64> {
        let Measured { position, velocity } = &self.setpoint;
        turned(&self.base.rotation, &self.settings.kinematics.twist(position, velocity))
    }
}
