//! The interface `arm`: the CRTK commands and queries in the base frame.
//!
//! Invariant: names and payloads are CRTK's; each command is one call of the arm. Commands sent at a rate
//! (`servo_*`, `interpolate_*`) are carried out only in time; a `move_*` is decided once, and is carried out
//! however late it comes.

use trocar_sdk::data::{CartesianState, JointConfiguration, JointState, OperatingState, Pose, Twist, Wrench};
use trocar_sdk::prelude::*;

use super::{EyeRobot, EyeRobotState};
use crate::arm::ArmError;

/// CRTK interface of the arm. Joints are x, y, z (m), roll, tilt (rad), in this order.
#[provides("arm")]
impl EyeRobot {
    /// Joint positions and velocities from the encoders.
    #[read]
    fn measured_js(s: &EyeRobotState) -> JointState {
        s.measured_js
    }

    /// Pose of the tip from the encoders.
    #[read]
    fn measured_cp(s: &EyeRobotState) -> Pose {
        s.measured_cp
    }

    /// Velocity of the tip, in the base frame.
    #[read]
    fn measured_cv(s: &EyeRobotState) -> Twist {
        s.measured_cv
    }

    /// Pose and velocity of one instant; the wrench has stamp 0, as nothing measures what the tip meets.
    #[read]
    fn measured_cs(s: &EyeRobotState) -> CartesianState {
        let (stamp, pose) = (s.measured_cp.stamp, s.measured_cp);
        CartesianState { stamp, pose, twist: s.measured_cv, wrench: Wrench::default() }
    }

    /// Setpoint of the joints, and their speed.
    #[read]
    fn setpoint_js(s: &EyeRobotState) -> JointState {
        s.setpoint_js
    }

    /// Setpoint of the tip; stamp 0 while it is moved by velocity or force.
    #[read]
    fn setpoint_cp(s: &EyeRobotState) -> Pose {
        s.setpoint_cp
    }

    /// Setpoint of the tip's velocity, in the base frame.
    #[read]
    fn setpoint_cv(s: &EyeRobotState) -> Twist {
        s.setpoint_cv
    }

    /// End of the running motion; stamp 0 for one by velocity or force.
    #[read]
    fn goal_js(s: &EyeRobotState) -> JointState {
        s.goal_js
    }

    /// Pose of the tip where the running motion ends; stamp 0 for one by velocity or force.
    #[read]
    fn goal_cp(s: &EyeRobotState) -> Pose {
        s.goal_cp
    }

    /// Names, kinds and limits of the joints.
    #[read]
    fn configuration_js(s: &EyeRobotState) -> JointConfiguration {
        s.configuration_js
    }

    /// Operating state, and why after a fault.
    #[read]
    fn operating_state(s: &EyeRobotState) -> OperatingState {
        s.operating_state
    }

    /// The joints are referenced.
    #[read]
    fn is_homed(s: &EyeRobotState) -> Flag {
        s.operating_state.is_homed
    }

    /// A move or the homing is running.
    #[read]
    fn is_busy(s: &EyeRobotState) -> Flag {
        s.operating_state.is_busy
    }

    /// Pose of the arm's kinematic base in the base frame.
    #[read]
    fn base_frame(s: &EyeRobotState) -> Pose {
        s.base_frame
    }

    /// Goes to joint positions now, at most at the joints' speeds: `{"position": [0, 0, 0.01, 0, 0]}`.
    #[command(overflow = "latest_wins")]
    fn servo_jp(
        &mut self,
        #[arg(doc = "position of the five joints, and the stamp; the rest is not looked at")]
        goal: &JointState,
    ) -> Result<(), ArmError> {
        self.require_in_time(goal.stamp)?;
        self.arm.servo_jp(&goal.position)
    }

    /// Changes the joint setpoint by this much now.
    #[command(overflow = "latest_wins")]
    fn servo_jr(
        &mut self,
        #[arg(doc = "change of position of the five joints, and the stamp; the rest is not looked at")]
        change: &JointState,
    ) -> Result<(), ArmError> {
        self.require_in_time(change.stamp)?;
        self.arm.servo_jr(&change.position)
    }

    /// Moves at joint velocities until the next command, at most for servo_timeout_s.
    #[command(overflow = "latest_wins")]
    fn servo_jv(
        &mut self,
        #[arg(doc = "velocity of the five joints, and the stamp; the rest is not looked at")]
        goal: &JointState,
    ) -> Result<(), ArmError> {
        self.require_in_time(goal.stamp)?;
        self.arm.servo_jv(&goal.velocity)
    }

    /// Brings the tip to a pose now; the turn about the tool's own axis is not followed.
    #[command(overflow = "latest_wins")]
    fn servo_cp(&mut self, goal: &Pose) -> Result<(), ArmError> {
        self.require_in_time(goal.stamp)?;
        self.arm.servo_cp(&goal.isometry()?)
    }

    /// Changes the setpoint of the tip by this much now: the translation is added, the rotation turns the tip
    /// about itself, both along the axes of the base frame.
    #[command(overflow = "latest_wins")]
    fn servo_cr(&mut self, change: &Pose) -> Result<(), ArmError> {
        self.require_in_time(change.stamp)?;
        self.arm.servo_cr(&change.isometry()?)
    }

    /// Moves the tip with a twist until the next command, at most for servo_timeout_s; axis/servo_cv is added
    /// to it.
    #[command(overflow = "latest_wins")]
    fn servo_cv(&mut self, twist: &Twist) -> Result<(), ArmError> {
        self.require_in_time(twist.stamp)?;
        self.arm.servo_cv(&twist.vector()?)
    }

    /// Goes to joint positions along a trajectory, without being busy: for goals that come slowly.
    #[command(overflow = "latest_wins")]
    fn interpolate_jp(
        &mut self,
        #[arg(doc = "position of the five joints, and the stamp; the rest is not looked at")]
        goal: &JointState,
    ) -> Result<(), ArmError> {
        self.require_in_time(goal.stamp)?;
        self.arm.interpolate_jp(&goal.position)
    }

    /// Brings the tip to a pose along a trajectory of the joints, without being busy: for goals that come
    /// slowly.
    #[command(overflow = "latest_wins")]
    fn interpolate_cp(&mut self, goal: &Pose) -> Result<(), ArmError> {
        self.require_in_time(goal.stamp)?;
        self.arm.interpolate_cp(&goal.isometry()?)
    }

    /// Goes to joint positions along a trajectory; is_busy until it has ended.
    #[command]
    fn move_jp(
        &mut self,
        #[arg(doc = "position of the five joints; the rest is not looked at")] goal: &JointState,
    ) -> Result<(), ArmError> {
        self.arm.move_jp(&goal.position)?;
        self.publish(self.host.now());
        Ok(())
    }

    /// Changes the joint setpoint by this much along a trajectory; is_busy until it has ended.
    #[command]
    fn move_jr(
        &mut self,
        #[arg(doc = "change of position of the five joints; the rest is not looked at")] change: &JointState,
    ) -> Result<(), ArmError> {
        self.arm.move_jr(&change.position)?;
        self.publish(self.host.now());
        Ok(())
    }

    /// Brings the tip to a pose along a trajectory of the joints; is_busy until it has ended.
    #[command]
    fn move_cp(&mut self, goal: &Pose) -> Result<(), ArmError> {
        self.arm.move_cp(&goal.isometry()?)?;
        self.publish(self.host.now());
        Ok(())
    }

    /// Changes the setpoint of the tip by this much, as servo_cr does, along a trajectory; is_busy until it
    /// has ended.
    #[command]
    fn move_cr(&mut self, change: &Pose) -> Result<(), ArmError> {
        self.arm.move_cr(&change.isometry()?)?;
        self.publish(self.host.now());
        Ok(())
    }

    /// Brakes and stays.
    #[command]
    fn hold(&mut self) {
        self.arm.hold();
        self.publish(self.host.now());
    }

    /// Follows the hand on the handle until the next command.
    #[command]
    fn free(&mut self) -> Result<(), ArmError> {
        self.arm.free()?;
        self.publish(self.host.now());
        Ok(())
    }

    /// Says where the arm's kinematic base stands in the frame of all poses, twists and wrenches of this
    /// interface.
    #[command]
    fn set_base_frame(&mut self, base: &Pose) -> Result<(), ArmError> {
        self.arm.set_base_frame(&base.isometry()?);
        self.publish(self.host.now());
        Ok(())
    }

    /// Changes the operating state: enable, disable, pause, resume, home, unhome.
    #[command]
    fn state_command(
        &mut self,
        #[arg(doc = "enable, disable, pause, resume, home or unhome")] word: &Text<32>,
    ) -> Result<(), ArmError> {
        self.arm.state_command(word)?;
        self.publish(self.host.now());
        Ok(())
    }
}
