//! The component `eyerobot`: the arm behind CRTK interfaces, and the place of its simulated self in the
//! world.
//!
//! Invariant: commands only hand goals to the arm, `step` alone moves it; every read is a pure function of
//! the state row, which `publish` fills after each entry that changes the arm. Values that no encoder sees
//! leave only by outputs and interfaces tagged `sim` or `truth`.

mod arm_interface;
mod config;
mod frames;
mod hands_on;
mod stand;

use std::fmt;

use nalgebra::{Isometry3, Vector6};
use trocar_phantom::Hand;
use trocar_sdk::crtk;
use trocar_sdk::data::{
    ArmState, CartesianState, JointConfiguration, JointState, OperatingMode, OperatingState, Pose, Retreat,
    Twist, VirtualFixture, Wrench,
};
use trocar_sdk::prelude::*;

use crate::arm::{self, Arm, ArmError, Settings};
use crate::drive::{Measured, SimulatedDrive};
use crate::fixture::{FAR_M, Fixtures, Stance};
use crate::joints::{COUNT, Joints};
use crate::payloads::{self, Jacobian, VirtualFixtures};
use config::EyeRobotConfig;

/// Length of the cycle that completes the homing of an arm that stands at home, s.
const FIRST_CYCLE_S: f64 = 1e-3;

/// A simulated five-joint eye robot (x, y, z in m; roll, tilt in rad) at 1 kHz.
#[derive(Component)]
#[component(
    name = "eyerobot",
    rate_hz = 1000,
    models("periodic", "exec_in", "exec_out"),
    rates_hz(100, 8000),
    safety = "actuator",
    provides("arm", "local", "spatial", "body", "hand", "compliance", "axis", "virtual_fixture", "truth")
)]
pub struct EyeRobot {
    /// Force and torque of the hand on the handle, in the frame of the tip; one with stamp 0 or older than
    /// handle_timeout_s counts as none
    #[input(optional)]
    handle: In<Wrench>,
    /// Joints and tip of each cycle
    #[output]
    state: Out<ArmState>,
    /// Pose of the tip from the encoders of each cycle, in the base frame; filters of poses take it
    #[output(name = "measured_cp")]
    pose: Out<Pose>,
    /// The hand's wrench of each cycle, with the orientation of the base frame; stamp 0 while there is no
    /// hand
    #[output]
    hand_cf: Out<Wrench>,
    /// True pose and twist of the tip in the simulated world
    #[output(tag = "sim")]
    tip: Out<CartesianState>,
    /// The operating state changed.
    #[event("arm", name = "operating_state")]
    changed: Event<OperatingState>,
    /// A move_jp, move_jr, move_cp or move_cr is over: whether the encoders say that it arrived.
    #[event("arm")]
    goal_reached: Event<Flag>,
    /// A joint, by its place in configuration_js, came to a limit of its travel and would have gone on.
    #[event("arm")]
    limit_hit: Event<u32>,
    /// The force on the handle is above its limit and no longer followed, or below it again.
    #[event("arm")]
    force_limit: Event<Flag>,
    /// The arm's client fell silent, and the tip goes back along the tool.
    #[event("axis")]
    retreats: Event<Retreat>,
    #[state]
    measured_js: JointState,
    #[state]
    measured_cp: Pose,
    #[state]
    measured_cv: Twist,
    /// Wrench of the hand, with the orientation of the base frame.
    #[state]
    felt_cf: Wrench,
    #[state]
    setpoint_js: JointState,
    #[state]
    setpoint_cp: Pose,
    #[state]
    setpoint_cv: Twist,
    #[state]
    goal_js: JointState,
    #[state]
    goal_cp: Pose,
    #[state]
    operating_state: OperatingState,
    #[state]
    configuration_js: JointConfiguration,
    #[state]
    local_cp: Pose,
    #[state]
    body_jacobian: Jacobian,
    #[state]
    spatial_jacobian: Jacobian,
    /// Pose of the kinematic base in the base frame.
    #[state]
    base_frame: Pose,
    /// In force, in the kinematic base.
    #[state]
    fixtures: VirtualFixtures,
    /// Beside them, kind 0 without one.
    #[state]
    guard: VirtualFixture,
    /// Way back when the arm's client falls silent.
    #[state]
    retreat: Retreat,
    /// Gains of hands-on control.
    #[state]
    gain: [f64; 6],
    /// Samples of the handle since Start that were no wrench.
    #[state]
    handle_rejected: u64,
    /// Servo commands since Start whose stamp was too old, or ahead of the clock.
    #[state]
    stale_commands: u64,
    /// Motions by velocity or force since Start that ended because they were not repeated within
    /// servo_timeout_s: if it grows while a client commands, commands come too slowly, and the arm brakes
    /// between them.
    #[state]
    servo_timeouts: u64,
    /// Count of the arm at Start.
    timeouts_before: u64,
    /// Value of the output `tip`.
    #[state]
    truth: CartesianState,
    #[config]
    cfg: EyeRobotConfig,
    #[host]
    host: Host,
    arm: Arm<SimulatedDrive>,
    hand: Option<Hand>,
    /// The component was configured before, and the arm stands where it stood.
    stands: bool,
    /// The kinematic base in the frame of poses while no client has set that.
    first_base: Isometry3<f64>,
    /// The kinematic base in the simulated world.
    world_from_base: Isometry3<f64>,
    /// The handle was felt in this cycle.
    felt: bool,
    /// Period of the last step; a command waits for the next one at least.
    period_s: f64,
}

impl EyeRobot {
    /// Builds the arm as the configuration wants it, DISABLED at `position` (m, rad), with base frame,
    /// fixtures and gains of the state row; referenced, if the one before was.
    fn build(&mut self, position: Joints, homed: bool) {
        let drive = SimulatedDrive::new(self.cfg.simulation(), position);
        self.arm = Arm::new(self.cfg.settings(), drive, position);
        self.stands = true;
        self.timeouts_before = 0;
        if homed {
            self.arm.referenced();
        }
        if !self.configuration_js.names.is_empty() {
            // Gains were checked when they were set; a row of another version may hold others, which are left
            // out.
            let _ = self.arm.set_gain(&Vector6::from(self.gain));
        }
        let fixtures = self.fixtures.fixtures.iter().enumerate();
        let fixtures = fixtures.filter_map(|(place, fixture)| payloads::checked(fixture, place).ok());
        let guard = payloads::checked(&self.guard, 0).ok();
        self.world_from_base = self.cfg.world_from_base(self.arm.settings());
        let port = self.cfg.port(self.arm.settings());
        self.arm.restore_fixtures(Fixtures::restored(fixtures).with_guard(guard).with_port(port));
        let (first, before) = (self.cfg.first_base(self.arm.settings()), self.first_base);
        self.first_base = first;
        let base = self.base_frame.isometry().ok().filter(|base| *base != before);
        self.arm.set_base_frame(&base.unwrap_or(first));
        self.hand = (self.cfg.hand == "simulated").then(|| Hand::new(self.cfg.seed));
        self.configuration_js = payloads::configuration(self.host.now(), &self.arm.settings().limits);
    }

    /// Joints of the arm (m, rad); one that nobody has configured yet stands at home.
    fn stands_at(&self) -> Joints {
        if self.stands { self.arm.measured().position } else { self.cfg.settings().home }
    }

    /// A shaft that stands beside a port cannot go through it.
    ///
    /// # Errors
    /// The shaft passes beside the port: how far, and what to do.
    fn check_port(&self) -> Result {
        let settings = self.cfg.settings();
        let at = Stance::of(&settings.kinematics, &self.stands_at());
        let beside_m = self.cfg.port(&settings).map_or(0.0, |port| -port.distance_m(&at));
        if beside_m > FAR_M {
            return Err(format!(
                "port_m: the shaft passes {:.3} mm beside a port {} mm from the tip at home; send the arm home first (state_command \"home\")",
                beside_m * 1e3,
                self.cfg.port_m * 1e3
            )
            .into());
        }
        Ok(())
    }

    /// Feels the handle: the connected input, or the simulated hand.
    fn feel(&mut self, now: Stamp) {
        let wrench = match (self.handle.sample(), &self.hand) {
            (Some(sample), _) if sample.stale => None,
            (Some(sample), _) => {
                // An invalid wrench (stamp 0, CRTK) is none, and so is one that is not renewed.
                let age_s = now.seconds_since(sample.value.stamp);
                if !sample.value.is_valid() || age_s.abs() > self.cfg.handle_timeout_s {
                    return self.felt_wrench(None);
                }
                let wrench = sample.value.vector().ok();
                if wrench.is_none() && sample.fresh {
                    self.handle_rejected += 1;
                }
                wrench
            }
            (None, Some(hand)) => {
                let turn = self.arm.local_cp().rotation.inverse();
                let force = turn * hand.sensed_n(now.ns() as f64 * 1e-9);
                Some(Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0))
            }
            (None, None) => None,
        };
        self.felt_wrench(wrench);
    }

    /// For each command that is only good when it is new.
    ///
    /// # Errors
    /// The goal lay in wait, or its stamp is of another clock.
    fn require_in_time(&mut self, stamp: Stamp) -> Result<(), ArmError> {
        let in_time = crtk::require_in_time(stamp, self.host.now(), self.cfg.command_age_s + self.period_s);
        self.stale_commands += u64::from(in_time.is_err());
        Ok(in_time?)
    }

    fn felt_wrench(&mut self, wrench: Option<Vector6<f64>>) {
        self.felt = wrench.is_some();
        self.arm.feel(&wrench.unwrap_or_default());
    }

    /// Fills the state row, and tells what happened.
    fn publish(&mut self, stamp: Stamp) {
        let arm = &self.arm;
        let only = |valid: bool| if valid { stamp } else { Stamp::INVALID };
        let felt = only(self.felt);
        self.measured_js = payloads::joint_state(stamp, &arm.measured());
        self.measured_cp = Pose { stamp, ..arm.measured_cp().into() };
        self.measured_cv = Twist { stamp, ..arm.measured_cv().into() };
        self.felt_cf = Wrench { stamp: felt, ..arm.hand_cf().into() };
        self.setpoint_js = payloads::joint_state(stamp, &arm.setpoint());
        let position_based = only(arm.is_position_based());
        self.setpoint_cp = Pose { stamp: position_based, ..arm.setpoint_cp().into() };
        self.setpoint_cv = Twist { stamp, ..arm.setpoint_cv().into() };
        let goal = arm.goal();
        let end = goal.unwrap_or(arm.setpoint().position);
        self.goal_js = payloads::joint_positions(only(goal.is_some()), &end);
        self.goal_cp = Pose { stamp: only(goal.is_some()), ..arm.pose_at(&end).into() };
        self.local_cp = Pose { stamp, ..arm.local_cp().into() };
        self.body_jacobian = Jacobian::of(stamp, &arm.body_jacobian());
        self.spatial_jacobian = Jacobian::of(stamp, &arm.spatial_jacobian());
        self.base_frame = Pose { stamp, ..arm.base().into() };
        self.gain = arm.gain().into();
        self.retreat = arm::Retreat::payload(arm.retreat());
        self.servo_timeouts = arm.timeouts().saturating_sub(self.timeouts_before);
        self.truth = self.true_tip(stamp);
        self.tell(stamp);
    }

    /// Pose and twist of the tip in the world, behind what encoders see.
    fn true_tip(&self, stamp: Stamp) -> CartesianState {
        let Settings { kinematics, .. } = self.arm.settings();
        let Measured { position, velocity } = self.arm.drive().truth();
        CartesianState {
            stamp,
            pose: Pose { stamp, ..(self.world_from_base * kinematics.forward(&position)).into() },
            twist: Twist { stamp, ..kinematics.twist(&position, &velocity).into() },
            wrench: Wrench::default(),
        }
    }

    fn tell(&mut self, stamp: Stamp) {
        let (before, fault) = (self.operating_state, self.arm.fault());
        let why = fault.as_ref().map(|fault| fault as &dyn fmt::Display);
        self.operating_state = self.arm.operating().payload(stamp, why);
        if (OperatingState { stamp, ..before }) != self.operating_state {
            self.changed.emit(self.operating_state);
        }
        let news = self.arm.take_news();
        for _ in 0..news.missed {
            self.goal_reached.emit(Flag::FALSE);
        }
        for _ in 0..news.reached {
            self.goal_reached.emit(Flag::TRUE);
        }
        for (joint, _) in news.limit_hit.iter().enumerate().filter(|(_, hit)| **hit) {
            self.limit_hit.emit(joint as u32);
        }
        if news.retreats.is_some() {
            self.retreats.emit(arm::Retreat::payload(news.retreats));
        }
        if let Some(too_strong) = news.force_limit {
            self.force_limit.emit(too_strong.into());
        }
    }
}

impl Component for EyeRobot {
    fn configure(&mut self) -> Result {
        self.cfg.check()?;
        self.check_port()?;
        // The arm stands where it stood, and knows where that is; a new one stands at home.
        self.arm.settle();
        self.build(self.stands_at(), self.arm.operating().is_homed());
        self.publish(self.host.now());
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.handle_rejected, self.stale_commands) = (0, 0);
        self.timeouts_before = self.arm.timeouts();
        self.arm.settle();
        if self.cfg.auto_enable {
            let paused = self.arm.operating().mode() == OperatingMode::PAUSED;
            self.arm.state_command(if paused { "resume" } else { "enable" })?;
            if !self.arm.operating().is_homed() && self.arm.is_at_home() {
                self.arm.state_command("home")?;
                self.arm.step(FIRST_CYCLE_S);
            } else if !self.arm.operating().is_homed() {
                log::warn!("not homed, and away from home: nothing moves until state_command \"home\"");
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
        self.period_s = tick.period_s();
        self.feel(tick.now());
        let missed = (tick.elapsed_s() / self.period_s).round() - 1.0;
        if missed > 0.0 {
            self.arm.miss(missed * self.period_s);
        }
        self.arm.step(self.period_s);
        self.publish(tick.now());
        self.state.write(&ArmState {
            stamp: tick.now(),
            measured_js: self.measured_js,
            measured_cp: self.measured_cp,
            // Nothing measures what the tip meets.
            measured_cf: Wrench::default(),
        });
        self.pose.write(&self.measured_cp);
        self.hand_cf.write(&self.felt_cf);
        self.tip.write(&self.truth);
        Ok(())
    }

    /// Returns the positions of the joints (m, rad).
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
        self.build(position, self.operating_state.is_homed.get());
        self.publish(self.host.now());
        Ok(())
    }
}

#[cfg(test)]
#[path = "robot_tests.rs"]
mod tests;

#[cfg(test)]
mod bench;
#[cfg(test)]
mod crtk_tests;
#[cfg(test)]
mod fixture_tests;
#[cfg(test)]
mod hand_tests;
#[cfg(test)]
mod stand_tests;
