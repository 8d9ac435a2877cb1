//! The CRTK commands of an arm.
//!
//! Invariant: a command checks everything before it changes anything, and only hands a motion over: `step`
//! moves.

use nalgebra::{Isometry3, Vector3, Vector6};
use trocar_sdk::crtk::StateCommand;
use trocar_sdk::data::OperatingMode;

use super::motion::{Ends, Motion, Move, Tip};
use super::{Arm, ArmError, Settings, turned};
use crate::admittance::HIGHEST_GAIN;
use crate::drive::{Drive, Measured};
use crate::fixture::{Fixture, Fixtures, Stance};
use crate::joints::{Joints, five};
use crate::kinematics::tool_axis;
use crate::trajectory::Trajectory;

/// Largest torque that `compliance/servo_cf` may ask for beside the hand's, N·m.
const TORQUE_LIMIT_N_M: f64 = 1.0;

impl<D: Drive> Arm<D> {
    /// CRTK `servo_jp`: go to joint positions (m, rad) now, at most at the joints' speeds.
    ///
    /// # Errors
    /// Not enabled and homed; a goal that is not finite or outside the limits.
    pub fn servo_jp(&mut self, goal: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.settings.limits.check_position(goal)?;
        self.pre_empt(Motion::ServoPosition { goal });
        Ok(())
    }

    /// CRTK `servo_jr`: change the joint setpoint by this much (m, rad) now.
    ///
    /// # Errors
    /// As `servo_jp`, of the setpoint after the change.
    pub fn servo_jr(&mut self, change: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.changed(change)?;
        self.pre_empt(Motion::ServoPosition { goal });
        Ok(())
    }

    /// CRTK `servo_jv`: move at joint velocities (m/s, rad/s) until the next command, at most
    /// `servo_timeout_s`; brakes at the limits of the joints' travel.
    ///
    /// # Errors
    /// Not enabled and homed; a velocity that is not finite or above the joint's speed.
    pub fn servo_jv(&mut self, goal: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let velocity = self.settings.limits.check_velocity(goal)?;
        self.pre_empt(Motion::ServoVelocity { velocity, left_s: self.settings.servo_timeout_s });
        Ok(())
    }

    /// CRTK `servo_cp`: bring the tip to a pose (m) now. The turn about the tool's own axis is not followed.
    ///
    /// # Errors
    /// Not enabled and homed; a pose that is not finite or out of reach.
    pub fn servo_cp(&mut self, goal: &Isometry3<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.joints_at(goal)?;
        self.pre_empt(Motion::ServoPosition { goal });
        Ok(())
    }

    /// CRTK `servo_cr`: change the setpoint of the tip by this much now: its translation is added, its
    /// rotation turns the tip about itself, both along the axes of the base frame.
    ///
    /// # Errors
    /// As `servo_cp`, of the setpoint after the change.
    pub fn servo_cr(&mut self, change: &Isometry3<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.joints_at(&self.changed_cp(change))?;
        self.pre_empt(Motion::ServoPosition { goal });
        Ok(())
    }

    /// CRTK `servo_cv`: move the tip with a twist (m/s, rad/s) until the next command, at most
    /// `servo_timeout_s`. Joint limits and fixtures leave of it what they allow. A velocity of `servo_axis`
    /// goes on beside it.
    ///
    /// # Errors
    /// Not enabled and homed; a number that is not finite; faster than a slide, or than a turning joint.
    pub fn servo_cv(&mut self, twist: &Vector6<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        self.check_twist(twist)?;
        let twist = turned(&self.base.rotation.inverse(), twist);
        self.pre_empt(Motion::Tip(self.tip().with_twist(twist, self.settings.servo_timeout_s)));
        Ok(())
    }

    /// `compliance/servo_cf`: follow the hand, and this wrench (N, N·m) beside it, until the next command, at
    /// most `servo_timeout_s`. A velocity of `servo_axis` goes on beside it.
    ///
    /// # Errors
    /// Not enabled and homed; a number that is not finite; a force above the handle's limit.
    pub fn follow(&mut self, wrench: &Vector6<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let (force, torque) = halves(wrench);
        at_most("force", force, self.settings.law.limit_n, "N")?;
        at_most("torque", torque, TORQUE_LIMIT_N_M, "N·m")?;
        let wrench = turned(&self.base.rotation.inverse(), wrench);
        self.pre_empt(Motion::Tip(self.tip().with_hand(wrench, self.settings.servo_timeout_s)));
        Ok(())
    }

    /// CRTK `free`: follow the hand until the next command.
    ///
    /// # Errors
    /// Not enabled and homed.
    pub fn free(&mut self) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        self.pre_empt(Motion::Tip(self.tip().with_hand(Vector6::zeros(), f64::INFINITY)));
        Ok(())
    }

    /// `axis/servo_cv`: add the part along the tool of a twist to what `servo_cv` or the hand does, until it
    /// is sent again, at most `servo_timeout_s`; pre-empts any other motion.
    ///
    /// # Errors
    /// As `servo_cv`.
    pub fn servo_axis(&mut self, twist: &Vector6<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        self.check_twist(twist)?;
        let along = self.base.rotation * tool_axis(&self.setpoint.position);
        let speed = halves(twist).0.dot(&along);
        self.pre_empt(Motion::Tip(self.tip().with_axis(speed, self.settings.servo_timeout_s)));
        Ok(())
    }

    /// CRTK `interpolate_jp`: go to joint positions (m, rad) along a trajectory, without being busy.
    ///
    /// # Errors
    /// As `servo_jp`.
    pub fn interpolate_jp(&mut self, goal: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.settings.limits.check_position(goal)?;
        self.start_move(goal, Ends::Quietly);
        Ok(())
    }

    /// CRTK `interpolate_cp`: bring the tip to a pose along a trajectory of the joints, without being busy.
    ///
    /// # Errors
    /// As `servo_cp`.
    pub fn interpolate_cp(&mut self, goal: &Isometry3<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.joints_at(goal)?;
        self.start_move(goal, Ends::Quietly);
        Ok(())
    }

    /// CRTK `move_jp`: go to joint positions (m, rad) along a trajectory; busy until it has ended.
    ///
    /// # Errors
    /// Not enabled and homed; a goal that is not finite or outside the limits.
    pub fn move_jp(&mut self, goal: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.settings.limits.check_position(goal)?;
        self.start_move(goal, Ends::Told);
        Ok(())
    }

    /// CRTK `move_jr`: change the joint setpoint by this much (m, rad) along a trajectory.
    ///
    /// # Errors
    /// As `servo_jr`.
    pub fn move_jr(&mut self, change: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.changed(change)?;
        self.start_move(goal, Ends::Told);
        Ok(())
    }

    /// CRTK `move_cp`: bring the tip to a pose (m) along a trajectory of the joints; busy until it has ended.
    ///
    /// # Errors
    /// As `servo_cp`.
    pub fn move_cp(&mut self, goal: &Isometry3<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.joints_at(goal)?;
        self.start_move(goal, Ends::Told);
        Ok(())
    }

    /// CRTK `move_cr`: like `move_cp`, by this much from the setpoint, as in `servo_cr`.
    ///
    /// # Errors
    /// As `servo_cr`.
    pub fn move_cr(&mut self, change: &Isometry3<f64>) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.joints_at(&self.changed_cp(change))?;
        self.start_move(goal, Ends::Told);
        Ok(())
    }

    /// CRTK `hold`: brake and stay. Always taken; does nothing to an arm that is not enabled.
    pub fn hold(&mut self) {
        self.pre_empt(Motion::Hold);
    }

    /// CRTK `state_command`: `enable`, `disable`, `pause`, `resume`, `home`, `unhome`. `home` moves to
    /// `Settings::home`.
    ///
    /// # Errors
    /// Another word; a command the CRTK table does not allow now.
    pub fn state_command(&mut self, word: &str) -> Result<(), ArmError> {
        let before = self.operating.mode();
        match self.operating.command(word)? {
            StateCommand::Home => self.start_move(self.settings.home, Ends::Homing),
            StateCommand::Unhome => self.hold(),
            StateCommand::Disable => self.brake(),
            StateCommand::Enable | StateCommand::Pause | StateCommand::Resume
                if self.operating.mode() != before =>
            {
                self.hold()
            }
            StateCommand::Enable | StateCommand::Pause | StateCommand::Resume => {}
        }
        if self.operating.mode() != OperatingMode::FAULT {
            self.fault = None;
        }
        Ok(())
    }

    /// Puts these fixtures (frames in the base frame) in the place of those before; none takes all away.
    ///
    /// # Errors
    /// Too many, a stiffness out of its range, or one that the arm stands outside of; those before stay.
    pub fn set_fixtures<'a>(&mut self, list: impl Iterator<Item = &'a Fixture>) -> Result<(), ArmError> {
        let at = Stance::of(&self.settings.kinematics, &self.setpoint.position);
        self.fixtures = Fixtures::checked(list, &self.base.inverse(), &at)?.beside(&self.fixtures);
        Ok(())
    }

    /// Puts one fixture (frame in the base frame) beside those of `set_fixtures`, in the place of the last
    /// guard.
    ///
    /// # Errors
    /// As `set_fixtures`; the guard before stays.
    pub fn set_guard(&mut self, guard: Option<Fixture>) -> Result<(), ArmError> {
        let at = Stance::of(&self.settings.kinematics, &self.setpoint.position);
        self.fixtures = self.fixtures.guarded(guard, &self.base.inverse(), &at)?;
        Ok(())
    }

    /// Puts fixtures back that were in force before, frames in the kinematic base: the arm may stand outside
    /// of them.
    pub fn restore_fixtures(&mut self, fixtures: Fixtures) {
        self.fixtures = fixtures;
    }

    /// Sets the gains of hands-on control along and about the axes of the tip: m/(s·N), then rad/(s·N·m).
    ///
    /// # Errors
    /// One that is negative, not finite or above [`HIGHEST_GAIN`].
    pub fn set_gain(&mut self, gain: &Vector6<f64>) -> Result<(), ArmError> {
        for (place, &value) in gain.iter().enumerate() {
            let limit = HIGHEST_GAIN[place / 3];
            if !(0.0..=limit).contains(&value) {
                return Err(ArmError::Gain { place, value, limit });
            }
        }
        self.admittance.law.gain = *gain;
        Ok(())
    }

    /// CRTK `set_base_frame`: where the kinematic base stands in the frame of all poses from now on. Nothing
    /// moves, and fixtures stay where they are.
    pub fn set_base_frame(&mut self, base: &Isometry3<f64>) {
        self.base = *base;
    }

    fn start_move(&mut self, goal: Joints, ends: Ends) {
        let Measured { position, velocity } = self.setpoint;
        let trajectory = Trajectory::plan(&position, &velocity, &goal, &self.settings.limits);
        self.pre_empt(Motion::Move(Move { trajectory, goal, elapsed_s: 0.0, ends }));
    }

    /// The running motion of the tip, or one of nothing.
    fn tip(&self) -> Tip {
        match self.motion {
            Motion::Tip(tip) => tip,
            _ => Tip::default(),
        }
    }

    fn changed(&self, change: &[f64]) -> Result<Joints, ArmError> {
        let goal = self.setpoint.position + five(change)?;
        Ok(self.settings.limits.check_position(goal.as_slice())?)
    }

    fn changed_cp(&self, change: &Isometry3<f64>) -> Isometry3<f64> {
        let from = self.setpoint_cp();
        let translation = from.translation.vector + change.translation.vector;
        Isometry3::from_parts(translation.into(), change.rotation * from.rotation)
    }

    fn joints_at(&self, goal: &Isometry3<f64>) -> Result<Joints, ArmError> {
        let goal = self.base.inverse() * goal;
        let Settings { kinematics, limits, .. } = &self.settings;
        let axis = goal.rotation * Vector3::z();
        Ok(kinematics.inverse(&goal.translation.vector, &axis, &self.setpoint.position, limits)?)
    }

    fn check_twist(&self, twist: &Vector6<f64>) -> Result<(), ArmError> {
        let (linear, angular) = halves(twist);
        let speed = &self.settings.limits.speed;
        at_most("linear speed", linear, speed[0], "m/s")?;
        at_most("angular speed", angular, speed[3], "rad/s")
    }
}

fn halves(v: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (v.fixed_rows::<3>(0).into_owned(), v.fixed_rows::<3>(3).into_owned())
}

/// Refuses a value above `limit`, and one that is no number.
fn at_most(what: &'static str, v: Vector3<f64>, limit: f64, unit: &'static str) -> Result<(), ArmError> {
    let value = v.norm();
    // A rounding is no reason to refuse a goal at the limit.
    if value <= limit * (1.0 + 1e-9) { Ok(()) } else { Err(ArmError::Above { what, value, limit, unit }) }
}

#[cfg(test)]
#[path = "commands_tests.rs"]
pub(super) mod tests;
