//! The arm: takes CRTK motions, makes a setpoint of them each period, and drives the joints after it.
//!
//! Invariant: one `step` per control period is the only place that commands motion; every refusal leaves the running
//! motion as it was, every fault ends it with the joints held where they are. No allocation, no clock.

use std::fmt;

use nalgebra::{Isometry3, Vector6};
use trocar_sdk::crtk::{NotReady, OperatingStateMachine, Refused, StateCommand};
use trocar_sdk::data::OperatingMode;

use crate::drive::{Drive, Lost, Measured, SimulatedDrive, Simulation};
use crate::joints::{Joints, Limits, NAMES, Refusal, per_kind};
use crate::kinematics::{Kinematics, Unreachable};
use crate::trajectory::Trajectory;

/// What is set once for an arm. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Geometry.
    pub kinematics: Kinematics,
    /// What each joint may do.
    pub limits: Limits,
    /// Gain of the position loop around the drive's velocity loop, 1/s.
    pub gain_per_s: f64,
    /// `servo_jv` not repeated for this long holds the arm, s.
    pub servo_timeout_s: f64,
    /// Largest allowed distance between setpoint and encoder, m and rad.
    pub following: Joints,
    /// How far an encoder may stand outside a limit before it is a fault, m and rad.
    pub margin: Joints,
}

impl Default for Settings {
    /// Tool of 120 mm; 31.25 /s is the critically damped gain around a lag of 8 ms; faults at 0.5 mm and 1° of
    /// following error, 0.1 mm and 0.1° outside a limit.
    fn default() -> Self {
        Settings {
            kinematics: Kinematics { tool_length_m: 0.12 },
            limits: Limits::default(),
            gain_per_s: 31.25,
            servo_timeout_s: 0.1,
            following: per_kind(0.5e-3, 1f64.to_radians()),
            margin: per_kind(0.1e-3, 0.1f64.to_radians()),
        }
    }
}

#[expect(clippy::large_enum_variant, reason = "a box would allocate on the step path")]
#[derive(Clone, Copy, Debug)]
enum Motion {
    Hold,
    ServoPosition { goal: Joints },
    ServoVelocity { velocity: Joints, left_s: f64 },
    Move { trajectory: Trajectory, elapsed_s: f64, homing: bool },
}

/// Five joints under control.
#[derive(Debug)]
pub struct Arm<D> {
    settings: Settings,
    drive: D,
    operating: OperatingStateMachine,
    fault: Option<Fault>,
    motion: Motion,
    measured: Measured,
    setpoint: Measured,
}

impl Default for Arm<SimulatedDrive> {
    /// The simulated arm at home, in DISABLED.
    fn default() -> Self {
        let home = Joints::zeros();
        Arm::new(Settings::default(), SimulatedDrive::new(Simulation::default(), home), home)
    }
}

impl<D: Drive> Arm<D> {
    /// An arm in DISABLED that stands at `position` (m, rad).
    pub fn new(settings: Settings, drive: D, position: Joints) -> Self {
        let at_rest = Measured { position, velocity: Joints::zeros() };
        Arm {
            settings,
            drive,
            operating: OperatingStateMachine::INITIAL,
            fault: None,
            motion: Motion::Hold,
            measured: at_rest,
            setpoint: at_rest,
        }
    }

    /// One control period of `dt_s` seconds: new setpoint, one cycle of the drive, checks.
    pub fn step(&mut self, dt_s: f64) {
        let driven = matches!(self.operating.mode(), OperatingMode::ENABLED | OperatingMode::PAUSED);
        if driven {
            self.advance(dt_s);
        } else {
            self.setpoint = Measured { position: self.measured.position, velocity: Joints::zeros() };
        }
        let error = self.setpoint.position - self.measured.position;
        let wanted =
            if driven { self.setpoint.velocity + error * self.settings.gain_per_s } else { Joints::zeros() };
        match self.drive.cycle(&wanted, dt_s) {
            Ok(measured) => self.measured = measured,
            Err(lost) => self.fail(Fault::Drive(lost)),
        }
        if let Some(fault) = self.out_of_bounds() {
            self.fail(fault);
        }
    }

    fn advance(&mut self, dt_s: f64) {
        let limits = &self.settings.limits;
        let (from, before) = (self.setpoint.position, self.setpoint.velocity);
        let (position, velocity) = match &mut self.motion {
            Motion::Hold => {
                // Brakes the setpoint itself, so that a hold in full motion is no step for the drive.
                let velocity = Joints::from_fn(|i, _| {
                    let most = limits.acceleration[i] * dt_s;
                    before[i] - before[i].clamp(-most, most)
                });
                (from + velocity * dt_s, velocity)
            }
            Motion::ServoPosition { goal } => {
                let way = Joints::from_fn(|i, _| {
                    (goal[i] - from[i]).clamp(-limits.speed[i] * dt_s, limits.speed[i] * dt_s)
                });
                (from + way, way / dt_s)
            }
            Motion::ServoVelocity { velocity, left_s } => {
                let velocity = *velocity;
                *left_s -= dt_s;
                if *left_s <= 0.0 {
                    self.motion = Motion::Hold;
                }
                (from + velocity * dt_s, velocity)
            }
            Motion::Move { trajectory, elapsed_s, homing } => {
                *elapsed_s += dt_s;
                let at = trajectory.at(*elapsed_s);
                if *elapsed_s >= trajectory.duration_s() {
                    self.operating.move_ends();
                    if *homing {
                        self.operating.homed();
                    }
                    self.motion = Motion::Hold;
                }
                at
            }
        };
        self.setpoint = Measured { position, velocity };
    }

    fn out_of_bounds(&self) -> Option<Fault> {
        if !matches!(self.operating.mode(), OperatingMode::ENABLED | OperatingMode::PAUSED) {
            return None;
        }
        let Settings { limits, margin, following, .. } = &self.settings;
        if let Some(joint) = limits.leaving(&self.measured.position, &self.setpoint.velocity, margin) {
            return Some(Fault::Limit { joint, value: self.measured.position[joint] });
        }
        let error = self.setpoint.position - self.measured.position;
        let joint = (0..error.len()).find(|&i| error[i].is_nan() || error[i].abs() > following[i])?;
        Some(Fault::Following { joint, error: error[joint] })
    }

    fn fail(&mut self, fault: Fault) {
        self.drive.make_safe();
        self.operating.fault();
        self.fault = Some(fault);
        self.stand();
    }

    fn stand(&mut self) {
        self.motion = Motion::Hold;
        self.operating.move_ends();
        self.setpoint = Measured { position: self.measured.position, velocity: Joints::zeros() };
    }

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

    /// CRTK `servo_jv`: move at joint velocities (m/s, rad/s) until the next command, at most `servo_timeout_s`.
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
        let axis = goal.rotation * nalgebra::Vector3::z();
        let Settings { kinematics, limits, .. } = &self.settings;
        let goal = kinematics.inverse(&goal.translation.vector, &axis, &self.setpoint.position, limits)?;
        self.pre_empt(Motion::ServoPosition { goal });
        Ok(())
    }

    /// CRTK `move_jp`: go to joint positions (m, rad) along a trajectory; busy until it has ended.
    ///
    /// # Errors
    /// Not enabled and homed; a goal that is not finite or outside the limits.
    pub fn move_jp(&mut self, goal: &[f64]) -> Result<(), ArmError> {
        self.operating.require_ready()?;
        let goal = self.settings.limits.check_position(goal)?;
        self.start_move(goal, false);
        Ok(())
    }

    fn start_move(&mut self, goal: Joints, homing: bool) {
        let Measured { position, velocity } = self.setpoint;
        let trajectory = Trajectory::plan(&position, &velocity, &goal, &self.settings.limits);
        self.pre_empt(Motion::Move { trajectory, elapsed_s: 0.0, homing });
    }

    fn pre_empt(&mut self, motion: Motion) {
        if matches!(motion, Motion::Move { .. }) {
            self.operating.move_begins();
        } else {
            self.operating.move_ends();
        }
        self.motion = motion;
    }

    /// CRTK `hold`: brake and stay. Always taken; does nothing to an arm that is not enabled.
    pub fn hold(&mut self) {
        self.pre_empt(Motion::Hold);
    }

    /// CRTK `state_command`: `enable`, `disable`, `pause`, `resume`, `home`, `unhome`. `home` moves to all zeros.
    ///
    /// # Errors
    /// Another word; a command the CRTK table does not allow now.
    pub fn state_command(&mut self, word: &str) -> Result<(), ArmError> {
        let before = self.operating.mode();
        match self.operating.command(word)? {
            StateCommand::Home => self.start_move(Joints::zeros(), true),
            StateCommand::Unhome => self.hold(),
            StateCommand::Disable => {
                self.drive.make_safe();
                self.stand();
            }
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

    /// Stops at once, from any state. An enabled arm is PAUSED after it: only `resume` lets it move again.
    pub fn make_safe(&mut self) {
        self.drive.make_safe();
        self.stand();
        self.operating.made_safe();
    }

    /// CRTK operating state.
    pub fn operating(&self) -> OperatingStateMachine {
        self.operating
    }

    /// Why the arm is in FAULT; none in other states.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// What was set.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Encoder positions (m, rad) and joint velocities (m/s, rad/s) at the end of the last step.
    pub fn measured(&self) -> Measured {
        self.measured
    }

    /// Where the joints should be (m, rad) and how fast (m/s, rad/s).
    pub fn setpoint(&self) -> Measured {
        self.setpoint
    }

    /// Pose of the tip from the encoders, m.
    pub fn measured_cp(&self) -> Isometry3<f64> {
        self.settings.kinematics.forward(&self.measured.position)
    }

    /// Twist of the tip from the encoders: v (m/s) then ω (rad/s), base frame.
    pub fn measured_cv(&self) -> Vector6<f64> {
        self.settings.kinematics.twist(&self.measured.position, &self.measured.velocity)
    }

    /// Pose of the tip at the setpoint, m.
    pub fn setpoint_cp(&self) -> Isometry3<f64> {
        self.settings.kinematics.forward(&self.setpoint.position)
    }
}

/// Why the arm went to FAULT. `joint` is an index into `joints::NAMES`; values in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// A joint left its limits.
    Limit {
        /// Which joint.
        joint: usize,
        /// Where it stands, m or rad.
        value: f64,
    },
    /// A joint does not follow its setpoint.
    Following {
        /// Which joint.
        joint: usize,
        /// Setpoint minus encoder, m or rad.
        error: f64,
    },
    /// The drive lost a joint.
    Drive(Lost),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::Limit { joint, value } => {
                write!(f, "joint {} left its limits at {value:.6}", NAMES[*joint])
            }
            Fault::Following { joint, error } => {
                write!(f, "joint {} is {error:.6} behind its setpoint", NAMES[*joint])
            }
            Fault::Drive(lost) => lost.fmt(f),
        }
    }
}

/// Why the arm did not take a command; the running motion goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ArmError {
    /// Not enabled and homed.
    NotReady(NotReady),
    /// A joint goal outside what the joint may do.
    Joints(Refusal),
    /// A pose out of reach.
    Pose(Unreachable),
    /// A state command that is unknown or not allowed now.
    State(Refused),
}

impl From<Refusal> for ArmError {
    fn from(why: Refusal) -> Self {
        ArmError::Joints(why)
    }
}

impl From<Unreachable> for ArmError {
    fn from(why: Unreachable) -> Self {
        ArmError::Pose(why)
    }
}

impl From<NotReady> for ArmError {
    fn from(why: NotReady) -> Self {
        ArmError::NotReady(why)
    }
}

impl From<Refused> for ArmError {
    fn from(why: Refused) -> Self {
        ArmError::State(why)
    }
}

impl fmt::Display for ArmError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ArmError::NotReady(why) => why.fmt(f),
            ArmError::Joints(why) => why.fmt(f),
            ArmError::Pose(why) => why.fmt(f),
            ArmError::State(why) => why.fmt(f),
        }
    }
}

impl std::error::Error for ArmError {}

#[cfg(test)]
#[path = "arm_tests.rs"]
mod tests;
