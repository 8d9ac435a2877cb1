//! The component `eyerobot`: the arm behind the CRTK interface `arm`.
//!
//! Invariant: commands only hand goals to the arm, `step` alone moves it; every read is a pure function of the state
//! row, which `publish` fills after each entry that changes the arm.

use std::fmt;

use trocar_sdk::GeometryError;
use trocar_sdk::data::{
    ArmState, JointConfiguration, JointState, OperatingMode, OperatingState, Pose, Twist,
};
use trocar_sdk::prelude::*;

use crate::arm::{Arm, ArmError, Settings};
use crate::drive::{SimulatedDrive, Simulation};
use crate::joints::{COUNT, Joints, Limits, per_kind};
use crate::kinematics::Kinematics;
use crate::payloads;

/// Length of the cycle that completes the homing of an arm that stands at home, s.
const FIRST_CYCLE_S: f64 = 1e-3;

#[derive(Config)]
struct EyeRobotConfig {
    /// Enables and homes the arm at Start (it moves to all zeros), so that motions are taken at once. Without it, send
    /// state_command "enable", then "home"
    #[config(default = true)]
    auto_enable: bool,
    /// Seed of the simulation: where the encoders' steps lie
    #[config(default = 1)]
    seed: u64,
    /// Length of the tool
    #[config(min = 0.01, max = 0.5, unit = "m", default = 0.12)]
    tool_length_m: f64,
    /// Travel of the slides x, y, z to each side
    #[config(min = 0.001, max = 0.2, unit = "m", default = 0.05)]
    travel_m: f64,
    /// Largest roll to each side
    #[config(min = 0.01, max = 3.14, unit = "rad", default = 1.0471975511965976)]
    roll_rad: f64,
    /// Largest tilt to each side
    #[config(min = 0.01, max = 1.5, unit = "rad", default = 0.7853981633974483)]
    tilt_rad: f64,
    /// Highest speed of a slide
    #[config(min = 0.0001, max = 0.1, unit = "m/s", default = 0.01)]
    speed_m_s: f64,
    /// Highest speed of a turning joint
    #[config(min = 0.001, max = 1.0, unit = "rad/s", default = 0.12217304763960307)]
    speed_rad_s: f64,
    /// Highest acceleration of a slide
    #[config(min = 0.001, max = 0.5, unit = "m/s^2", default = 0.5)]
    acceleration_m_s2: f64,
    /// Highest acceleration of a turning joint
    #[config(min = 0.01, max = 6.0, unit = "rad/s^2", default = 6.0)]
    acceleration_rad_s2: f64,
    /// `servo_jv` not repeated for this long holds the arm
    #[config(min = 0.002, max = 10.0, unit = "s", default = 0.1)]
    servo_timeout_s: f64,
}

impl EyeRobotConfig {
    fn settings(&self) -> Settings {
        let travel = self.travel_m;
        let upper = Joints::from_column_slice(&[travel, travel, travel, self.roll_rad, self.tilt_rad]);
        Settings {
            kinematics: Kinematics { tool_length_m: self.tool_length_m },
            limits: Limits {
                lower: -upper,
                upper,
                speed: per_kind(self.speed_m_s, self.speed_rad_s),
                acceleration: per_kind(self.acceleration_m_s2, self.acceleration_rad_s2),
            },
            servo_timeout_s: self.servo_timeout_s,
            ..Settings::default()
        }
    }
}

/// A simulated five-joint eye robot (x, y, z in m; roll, tilt in rad) at 1 kHz.
#[derive(Component)]
#[component(name = "eyerobot", rate_hz = 1000, safety = "actuator", provides("arm"))]
pub struct EyeRobot {
    /// Joints and tip of each cycle
    #[output]
    state: Out<ArmState>,
    /// The operating state changed.
    #[event("arm", name = "operating_state")]
    changed: Event<OperatingState>,
    #[state]
    measured_js: JointState,
    #[state]
    measured_cp: Pose,
    #[state]
    measured_cv: Twist,
    #[state]
    setpoint_js: JointState,
    #[state]
    setpoint_cp: Pose,
    #[state]
    operating_state: OperatingState,
    #[state]
    configuration_js: JointConfiguration,
    #[config]
    cfg: EyeRobotConfig,
    #[host]
    host: Host,
    arm: Arm<SimulatedDrive>,
}

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

    /// Where the joints are sent, and how fast.
    #[read]
    fn setpoint_js(s: &EyeRobotState) -> JointState {
        s.setpoint_js
    }

    /// Where the tip is sent.
    #[read]
    fn setpoint_cp(s: &EyeRobotState) -> Pose {
        s.setpoint_cp
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

    /// Goes to joint positions now, at most at the joints' speeds: `{"position": [0, 0, 0.01, 0, 0]}`.
    #[command(overflow = "latest_wins")]
    fn servo_jp(
        &mut self,
        #[arg(doc = "position of the five joints; the rest is not looked at")] goal: &JointState,
    ) -> Result<(), ArmError> {
        self.arm.servo_jp(&goal.position)
    }

    /// Moves at joint velocities until the next command, at most for servo_timeout_s.
    #[command(overflow = "latest_wins")]
    fn servo_jv(
        &mut self,
        #[arg(doc = "velocity of the five joints; the rest is not looked at")] goal: &JointState,
    ) -> Result<(), ArmError> {
        self.arm.servo_jv(&goal.velocity)
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

    /// Brings the tip to a pose now; the turn about the tool's own axis is not followed.
    #[command(overflow = "latest_wins")]
    fn servo_cp(&mut self, goal: &Pose) -> Result<(), PoseRefused> {
        let wanted = goal.isometry().map_err(PoseRefused::Geometry)?;
        self.arm.servo_cp(&wanted).map_err(PoseRefused::Arm)
    }

    /// Brakes and stays.
    #[command]
    fn hold(&mut self) {
        self.arm.hold();
        self.publish(self.host.now());
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

impl EyeRobot {
    /// The arm as the configuration wants it, DISABLED at `position` (m, rad).
    fn build(&mut self, position: Joints) {
        let drive =
            SimulatedDrive::new(Simulation { seed: self.cfg.seed, ..Simulation::default() }, position);
        self.arm = Arm::new(self.cfg.settings(), drive, position);
        self.configuration_js = payloads::configuration(self.host.now(), &self.arm.settings().limits);
    }

    /// Fills the state row, and tells when the operating state is another one.
    fn publish(&mut self, stamp: Stamp) {
        self.measured_js = payloads::joint_state(stamp, &self.arm.measured());
        self.measured_cp = Pose { stamp, ..self.arm.measured_cp().into() };
        self.measured_cv = Twist { stamp, ..self.arm.measured_cv().into() };
        self.setpoint_js = payloads::joint_state(stamp, &self.arm.setpoint());
        self.setpoint_cp = Pose { stamp, ..self.arm.setpoint_cp().into() };
        let (before, fault) = (self.operating_state, self.arm.fault());
        let why = fault.as_ref().map(|fault| fault as &dyn fmt::Display);
        self.operating_state = self.arm.operating().payload(stamp, why);
        if (OperatingState { stamp, ..before }) != self.operating_state {
            self.changed.emit(self.operating_state);
        }
    }
}

impl Component for EyeRobot {
    fn configure(&mut self) -> Result {
        // The arm stands where it stood; a new one stands at home.
        self.build(self.arm.measured().position);
        self.publish(self.host.now());
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.arm.hold();
        if self.cfg.auto_enable {
            let paused = self.arm.operating().mode() == OperatingMode::PAUSED;
            self.arm.state_command(if paused { "resume" } else { "enable" })?;
            if !self.arm.operating().is_homed() {
                self.arm.state_command("home")?;
                self.arm.step(FIRST_CYCLE_S);
            }
        }
        self.publish(self.host.now());
        Ok(())
    }

    fn resume(&mut self) -> Result {
        if self.arm.operating().mode() == OperatingMode::PAUSED {
            self.arm.state_command("resume")?;
        }
        self.publish(self.host.now());
        Ok(())
    }

    fn make_safe(&mut self) -> Result {
        self.arm.make_safe();
        self.publish(self.host.now());
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        self.arm.step(tick.period_s());
        self.publish(tick.now());
        self.state.write(&ArmState {
            stamp: tick.now(),
            measured_js: self.measured_js,
            measured_cp: self.measured_cp,
        });
        Ok(())
    }

    /// Where the joints stand (m, rad).
    fn snapshot(&self) -> Vec<u8> {
        self.arm.measured().position.iter().flat_map(|q| q.to_le_bytes()).collect()
    }

    /// The new version's arm stands where the former one stood, DISABLED: nothing moves because of a swap.
    fn restore(&mut self, snapshot: &[u8]) -> Result {
        let (values, rest) = snapshot.as_chunks::<8>();
        if values.len() != COUNT || !rest.is_empty() {
            return Err(format!("snapshot of {} bytes: an arm's has {}", snapshot.len(), 8 * COUNT).into());
        }
        let position = Joints::from_fn(|i, _| f64::from_le_bytes(values[i]));
        self.build(position);
        self.publish(self.host.now());
        Ok(())
    }
}

/// Why a pose was not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PoseRefused {
    /// No position and unit quaternion.
    Geometry(GeometryError),
    /// The arm's own reason.
    Arm(ArmError),
}

impl fmt::Display for PoseRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PoseRefused::Geometry(why) => why.fmt(f),
            PoseRefused::Arm(why) => why.fmt(f),
        }
    }
}

#[cfg(test)]
#[path = "robot_tests.rs"]
mod tests;
