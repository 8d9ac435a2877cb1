//! The arm: takes CRTK motions, makes a setpoint of them each period, and drives the joints after it.
//!
//! Invariant: one `step` per control period is the only place that commands motion, and every velocity of it
//! passes `allowed`; every refusal leaves the running motion as it was, every fault ends it with the joints
//! held where they are. No allocation, no clock.

mod commands;
mod motion;
mod readings;
mod refused;
mod retreat;
mod settings;

use nalgebra::{Isometry3, Vector6};
use trocar_sdk::crtk::OperatingStateMachine;
use trocar_sdk::data::OperatingMode;

use crate::admittance::Admittance;
use crate::allowed::{Allowed, Scene};
use crate::drive::{Drive, Measured, SimulatedDrive, Simulation};
use crate::fixture::Fixtures;
use crate::joints::{COUNT, Joints, Limits, per_kind};
use crate::kinematics::tool_axis;
use crate::trajectory::approach;
use motion::{Ends, Motion, Move};

pub use refused::{ArmError, Fault};
pub use retreat::Retreat;
pub use settings::Settings;

/// Drives and fixtures may let a move arrive this long after its trajectory's end, s.
const LATE_S: f64 = 1.0;

/// A move has arrived when its setpoint and the encoders are this near to its goal, m and rad.
const SENT: Joints = per_kind(1e-6, 10e-6);
const ARRIVED: Joints = per_kind(10e-6, 100e-6);

/// A joint slower than this stands, m/s and rad/s.
const STANDS: Joints = per_kind(10e-6, 100e-6);

/// Five joints under control.
///
/// Poses and twists are in the frame of `set_base_frame`, in which the kinematic base stands as that says;
/// `local` ones are in the kinematic base itself.
#[derive(Debug)]
pub struct Arm<D> {
    settings: Settings,
    drive: D,
    operating: OperatingStateMachine,
    fault: Option<Fault>,
    motion: Motion,
    measured: Measured,
    setpoint: Measured,
    fixtures: Fixtures,
    admittance: Admittance,
    /// Wrench of the hand, in the frame of the tip, N and N·m.
    handle: Vector6<f64>,
    base: Isometry3<f64>,
    at_limit: [bool; COUNT],
    /// The drive brakes by itself; the setpoint goes with it.
    braking: bool,
    /// Way back that follows when the arm's client falls silent.
    retreat: Option<Retreat>,
    /// Time since a motion ended that was not repeated, s; none once anything else was commanded.
    silent_s: Option<f64>,
    /// Motions by velocity or force that ended because they were not repeated in time.
    timeouts: u64,
    news: News,
}

/// Happenings since the last call of `take_news`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct News {
    /// Moves that arrived.
    pub reached: u32,
    /// Moves that ended before: pre-empted, held, kept away by a fixture.
    pub missed: u32,
    /// Joints that came to a limit of their travel and would have gone on.
    pub limit_hit: [bool; COUNT],
    /// The force on the handle is above its limit, or below it again.
    pub force_limit: Option<bool>,
    /// The tip goes back since its client fell silent.
    pub retreats: Option<Retreat>,
}

impl Default for Arm<SimulatedDrive> {
    /// The simulated arm at home, in DISABLED.
    fn default() -> Self {
        let home = Joints::zeros();
        Arm::new(Settings::default(), SimulatedDrive::new(Simulation::default(), home), home)
    }
}

impl Arm<SimulatedDrive> {
    /// Time went by without steps: what was braking stands now.
    pub fn settle(&mut self) {
        if !self.braking {
            return;
        }
        self.drive.settle();
        self.braking = false;
        self.measured = self.drive.measured();
        self.pre_empt(Motion::Hold);
        self.setpoint = Measured { position: self.measured.position, velocity: Joints::zeros() };
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
            fixtures: Fixtures::default(),
            admittance: Admittance::new(settings.law),
            handle: Vector6::zeros(),
            base: Isometry3::identity(),
            at_limit: [false; COUNT],
            braking: false,
            retreat: None,
            silent_s: None,
            timeouts: 0,
            news: News::default(),
        }
    }

    /// The joints are referenced already: an arm stood here before, whose encoders still count.
    pub fn referenced(&mut self) {
        self.operating.homed();
    }

    /// All joints are where `home` brings them.
    pub fn is_at_home(&self) -> bool {
        (0..COUNT).all(|i| (self.measured.position[i] - self.settings.home[i]).abs() <= ARRIVED[i])
    }

    /// The hand's wrench in the frame of the tip (N, N·m), from the next step on.
    pub fn feel(&mut self, wrench: &Vector6<f64>) {
        self.handle = *wrench;
    }

    /// Motions by velocity or force so far that ended because nobody repeated them within `servo_timeout_s`.
    pub fn timeouts(&self) -> u64 {
        self.timeouts
    }

    /// Periods of `missed_s` seconds in all were left out before the next step: nothing moved meanwhile, and
    /// time-outs count them.
    pub fn miss(&mut self, missed_s: f64) {
        self.motion.pass(missed_s);
        if let Some(silent_s) = self.silent_s.as_mut() {
            *silent_s += missed_s;
        }
    }

    /// One control period of `dt_s` seconds: new setpoint, one cycle of the drive, checks.
    pub fn step(&mut self, dt_s: f64) {
        let driven = matches!(self.operating.mode(), OperatingMode::ENABLED | OperatingMode::PAUSED);
        let hand = self.follow_hand(dt_s);
        if self.motion.is_over() {
            // Nobody sends it any more: the drive brakes harder than its velocity loop follows.
            self.brake();
            self.silent_s = Some(0.0);
            self.timeouts += 1;
        }
        self.mind_silence(dt_s);
        let follows = driven && !self.braking;
        if follows {
            self.advance(&hand, dt_s);
        } else if !driven {
            self.setpoint = Measured { position: self.measured.position, velocity: Joints::zeros() };
        }
        let error = self.setpoint.position - self.measured.position;
        let wanted =
            if follows { self.setpoint.velocity + error * self.settings.gain_per_s } else { Joints::zeros() };
        match self.drive.cycle(&wanted, dt_s) {
            Ok(measured) => self.measured = measured,
            Err(lost) => self.fail(Fault::Drive(lost)),
        }
        if self.braking {
            self.setpoint = self.towards_measured(dt_s);
            let (v, off) = (self.measured.velocity, self.setpoint.position - self.measured.position);
            self.braking = (0..COUNT).any(|i| v[i].abs() > STANDS[i] || off[i] != 0.0);
        }
        if let Some(fault) = self.out_of_bounds() {
            self.fail(fault);
        }
    }

    /// Returns the twist with which the tip follows the hand, kinematic base. The filter runs in every state,
    /// so that a force felt before the hand is followed does not come as a step.
    fn follow_hand(&mut self, dt_s: f64) -> Vector6<f64> {
        let turn = self.local_cp().rotation;
        let beside = match &self.motion {
            Motion::Tip(tip) => tip.force().map(|force| turned(&turn.inverse(), &force)),
            _ => None,
        };
        let was_too_strong = self.admittance.is_too_strong();
        let twist = self.admittance.step(&(self.handle + beside.unwrap_or_default()), dt_s);
        let too_strong = self.admittance.is_too_strong();
        if too_strong != was_too_strong {
            self.news.force_limit = Some(too_strong);
        }
        turned(&turn, &twist)
    }

    fn advance(&mut self, hand: &Vector6<f64>, dt_s: f64) {
        let limits = &self.settings.limits;
        let (from, before) = (self.setpoint.position, self.setpoint.velocity);
        let scene = Scene {
            settings: &self.settings,
            fixtures: &self.fixtures,
            from: self.setpoint,
            measured: self.measured.position,
            dt_s,
        };
        let mut at_rest = false;
        let planned = match &mut self.motion {
            Motion::Hold => {
                at_rest = true;
                // Brakes the setpoint itself, so that a hold in full motion is no step for the drive.
                let velocity = Joints::from_fn(|i, _| {
                    let most = limits.acceleration[i] * dt_s;
                    before[i] - before[i].clamp(-most, most)
                });
                Measured { position: from + velocity * dt_s, velocity }
            }
            Motion::ServoPosition { goal } => {
                // No joint is sent faster than its drive follows.
                let velocity = Joints::from_fn(|i, _| {
                    let Limits { speed, acceleration, .. } = limits;
                    approach(from[i], before[i], goal[i], speed[i], acceleration[i], dt_s)
                });
                Measured { position: from + velocity * dt_s, velocity }
            }
            Motion::Move(Move { trajectory, elapsed_s, .. }) => {
                *elapsed_s += dt_s;
                let (position, velocity) = trajectory.at(*elapsed_s);
                Measured { position, velocity }
            }
            Motion::ServoVelocity { velocity, left_s } => {
                let allowed = scene.velocity(velocity);
                *left_s -= dt_s;
                return self.go(&allowed, dt_s);
            }
            Motion::Tip(tip) => {
                let allowed = scene.twist(&tip.take(hand, &tool_axis(&from), dt_s));
                return self.go(&allowed, dt_s);
            }
        };
        self.setpoint = match scene.planned(&((planned.position - from) / dt_s), at_rest) {
            Some(velocity) => Measured { position: from + velocity * dt_s, velocity },
            None => planned,
        };
        self.at_limit = [false; COUNT];
        self.end_move();
    }

    /// The setpoint goes on with velocities that are allowed; a joint at its limit is told once.
    fn go(&mut self, allowed: &Allowed, dt_s: f64) {
        let velocity = allowed.velocity;
        self.setpoint = Measured { position: self.setpoint.position + velocity * dt_s, velocity };
        let (q, limits) = (&self.setpoint.position, &self.settings.limits);
        let left = per_kind(20e-6, 200e-6);
        for joint in 0..COUNT {
            let inside =
                q[joint] < limits.upper[joint] - left[joint] && q[joint] > limits.lower[joint] + left[joint];
            self.news.limit_hit[joint] |= allowed.at_limit[joint] && !self.at_limit[joint];
            self.at_limit[joint] = (self.at_limit[joint] && !inside) || allowed.at_limit[joint];
        }
    }

    fn end_move(&mut self) {
        let Motion::Move(Move { trajectory, goal, elapsed_s, ends }) = &self.motion else { return };
        let over_s = elapsed_s - trajectory.duration_s();
        let near = |at: &Joints, near: Joints| (0..COUNT).all(|i| (at[i] - goal[i]).abs() <= near[i]);
        let arrived = near(&self.setpoint.position, SENT) && near(&self.measured.position, ARRIVED);
        if over_s < 0.0 || (!arrived && over_s < LATE_S) {
            return;
        }
        match (ends, arrived) {
            (Ends::Quietly, _) => {}
            (Ends::Told, true) => self.news.reached += 1,
            (Ends::Told, false) => self.news.missed += 1,
            (Ends::Homing, true) => self.operating.homed(),
            (Ends::Homing, false) => {}
        }
        self.operating.move_ends();
        self.motion = Motion::Hold;
    }

    fn out_of_bounds(&self) -> Option<Fault> {
        if !matches!(self.operating.mode(), OperatingMode::ENABLED | OperatingMode::PAUSED) {
            return None;
        }
        let Settings { limits, margin, following, .. } = &self.settings;
        if let Some(joint) = limits.leaving(&self.measured.position, &self.setpoint.velocity, margin) {
            let value = self.measured.position[joint];
            let limit = if value > limits.upper[joint] { limits.upper[joint] } else { limits.lower[joint] };
            return Some(Fault::Limit { joint, value, limit });
        }
        let error = self.setpoint.position - self.measured.position;
        let joint = (0..error.len()).find(|&i| error[i].is_nan() || error[i].abs() > following[i])?;
        Some(Fault::Following { joint, error: error[joint], limit: following[joint] })
    }

    /// The drive brakes as hard as it can, and the arm holds where it comes to rest.
    pub(super) fn brake(&mut self) {
        self.drive.make_safe();
        self.braking = true;
        self.pre_empt(Motion::Hold);
    }

    /// Returns the setpoint on its way back to the encoders' position, at the joints' speeds: it never jumps.
    fn towards_measured(&self, dt_s: f64) -> Measured {
        let (from, to) = (&self.setpoint.position, &self.measured.position);
        let most = self.settings.limits.speed * dt_s;
        let position = Joints::from_fn(|i, _| {
            let way = to[i] - from[i];
            if way.abs() <= most[i] { to[i] } else { from[i] + most[i].copysign(way) }
        });
        Measured { position, velocity: Joints::zeros() }
    }

    fn fail(&mut self, fault: Fault) {
        self.operating.fault();
        if let Fault::Limit { joint, .. } = fault {
            self.news.limit_hit[joint] = true;
        }
        self.fault = Some(fault);
        self.brake();
    }

    fn pre_empt(&mut self, motion: Motion) {
        if matches!(self.motion, Motion::Move(Move { ends: Ends::Told, .. })) {
            self.news.missed += 1;
        }
        if motion.is_busy() {
            self.operating.move_begins();
        } else {
            self.operating.move_ends();
        }
        self.silent_s = None;
        self.motion = motion;
    }

    /// Brakes at once, from any state. An enabled arm is PAUSED after it: only `resume` lets it move again.
    pub fn make_safe(&mut self) {
        self.brake();
        self.operating.made_safe();
    }

    /// Returns what happened since the last call.
    pub fn take_news(&mut self) -> News {
        std::mem::take(&mut self.news)
    }
}

/// Both halves of a twist or wrench, turned.
fn turned(turn: &nalgebra::UnitQuaternion<f64>, v: &Vector6<f64>) -> Vector6<f64> {
    let (first, second) = (turn * v.fixed_rows::<3>(0), turn * v.fixed_rows::<3>(3));
    Vector6::new(first.x, first.y, first.z, second.x, second.y, second.z)
}

#[cfg(test)]
#[path = "arm_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "arm/anything_tests.rs"]
mod anything;
