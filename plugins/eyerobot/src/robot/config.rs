//! The robot's configuration.
//!
//! Invariant: plain data; what the arm and its drive are made of follows from it alone.

use trocar_sdk::prelude::*;

use crate::admittance::Law;
use crate::arm::Settings;
use crate::drive::Simulation;
use crate::fixture::STIFFEST_PER_S;
use crate::joints::{Joints, Limits, NAMES, per_kind};
use crate::kinematics::Kinematics;

#[derive(Config)]
pub(super) struct EyeRobotConfig {
    /// Enables the arm at Start, and homes it if it stands at home, so that motions are taken at once;
    /// nothing moves. Without it, send state_command "enable", then "home", which moves to the rest pose
    #[config(default = true)]
    pub(super) auto_enable: bool,
    /// Seed of the simulation: where the encoders' steps lie, and how the simulated hand moves
    #[config(default = 1)]
    pub(super) seed: u64,
    /// Hand on the handle while the input handle has nothing: none, or that of the simulated world
    #[config(one_of = ["none", "simulated"], default = "none")]
    pub(super) hand: String,
    /// At home the tip stands this far above the origin of the simulated world, along the tool
    #[config(min = -0.1, max = 0.1, unit = "m", default = 0.001)]
    pub(super) standoff_m: f64,
    /// Roll at home, where the slides stand at 0: the side from which a tilted tool comes
    #[config(min = -3.14, max = 3.14, unit = "rad", default = 0.0)]
    rest_roll_rad: f64,
    /// Tilt at home: how far the tool leans from the axis of the simulated eye
    #[config(min = -1.5, max = 1.5, unit = "rad", default = 0.0)]
    rest_tilt_rad: f64,
    /// From the tip at home up the shaft to the wall of the eye: the shaft passes there always (remote centre
    /// of motion), whatever fixtures are set; 0 is no wall
    #[config(min = 0.0, max = 0.05, unit = "m", default = 0.0)]
    pub(super) port_m: f64,
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
    /// Highest speed of a slide; at most what acceleration_m_s2 brakes before a border: a thirtieth of it per
    /// second
    #[config(min = 0.0001, max = 0.1, unit = "m/s", default = 0.01)]
    speed_m_s: f64,
    /// Highest speed of a turning joint; at most a thirtieth of acceleration_rad_s2
    #[config(min = 0.001, max = 1.0, unit = "rad/s", default = 0.12217304763960307)]
    speed_rad_s: f64,
    /// Highest acceleration of a slide
    #[config(min = 0.001, max = 0.5, unit = "m/s^2", default = 0.5)]
    acceleration_m_s2: f64,
    /// Highest acceleration of a turning joint
    #[config(min = 0.01, max = 6.0, unit = "rad/s^2", default = 6.0)]
    acceleration_rad_s2: f64,
    /// A motion by velocity or force that is not repeated for this long is braked and held: for clients that
    /// send less than 125 times per second, make it longer
    #[config(min = 0.002, max = 10.0, unit = "s", default = 0.008)]
    servo_timeout_s: f64,
    /// A servo command whose stamp is older than this and a period of the robot, or as far ahead, lay in wait
    /// or is of another clock, and is refused and counted; stamp 0 is taken as now
    #[config(min = 0.001, max = 10.0, unit = "s", default = 0.01)]
    pub(super) command_age_s: f64,
    /// Play of the simulated slides, from one side to the other
    #[config(min = 0.0, max = 1e-5, unit = "m", default = 0.0)]
    backlash_m: f64,
    /// Play of the simulated turning joints, from one side to the other
    #[config(min = 0.0, max = 1e-4, unit = "rad", default = 0.0)]
    backlash_rad: f64,
    /// A simulated joint that stands whatever its drive does: to see what a fault does
    #[config(one_of = ["none", "x", "y", "z", "roll", "tilt"], default = "none")]
    blocked_joint: String,
    /// Forces of the hand below this do not move the tip
    #[config(min = 0.0, max = 1.0, unit = "N", default = 0.03)]
    dead_band_n: f64,
    /// Torques of the hand below this do not turn the tip
    #[config(min = 0.0, max = 0.1, unit = "N.m", default = 0.001)]
    dead_band_n_m: f64,
    /// -6 dB corner of the filter of the hand's force
    #[config(min = 1.0, max = 50.0, unit = "Hz", default = 5.0)]
    hand_corner_hz: f64,
    /// A wrench of the hand whose stamp is older than this counts as none
    #[config(min = 0.002, max = 1.0, unit = "s", default = 0.05)]
    pub(super) handle_timeout_s: f64,
    /// Above this force of the hand the arm lets it go
    #[config(min = 0.1, max = 100.0, unit = "N", default = 20.0)]
    force_limit_n: f64,
}

impl EyeRobotConfig {
    /// No joint is faster than it can brake before the stiffest fixture.
    ///
    /// # Errors
    /// Names the setting, what it asks for, and what would be taken.
    pub(super) fn check(&self) -> Result {
        let slides = ["speed_m_s", "acceleration_m_s2", "m/s"];
        let turns = ["speed_rad_s", "acceleration_rad_s2", "rad/s"];
        for ([speed, acceleration, unit], asked, brakes) in [
            (slides, self.speed_m_s, self.acceleration_m_s2),
            (turns, self.speed_rad_s, self.acceleration_rad_s2),
        ] {
            let most = brakes / STIFFEST_PER_S;
            if asked > most {
                // The named value must be one that is taken: three digits, rounded down.
                let digits = (2.0 - most.log10().floor()).max(0.0) as usize;
                let step = 0.1f64.powi(digits as i32);
                let named = (most / step * (1.0 + 1e-9)).floor() * step;
                return Err(format!(
                    "{speed}: {asked} {unit} is more than the arm can brake before a border: a fixture of {STIFFEST_PER_S} /s makes it \
                     brake with {:.3} {unit}^2, and {acceleration} is {brakes} {unit}^2; set {speed} to {named:.digits$} at most",
                    asked * STIFFEST_PER_S
                )
                .into());
            }
        }
        for (name, rest, most) in [
            ("rest_roll_rad", self.rest_roll_rad, self.roll_rad),
            ("rest_tilt_rad", self.rest_tilt_rad, self.tilt_rad),
        ] {
            if rest.abs() > most {
                return Err(format!(
                    "{name}: {rest} rad is beyond the joint's travel of {most} rad to each side"
                )
                .into());
            }
        }
        Ok(())
    }

    pub(super) fn settings(&self) -> Settings {
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
            law: Law {
                dead_band_n: self.dead_band_n,
                dead_band_n_m: self.dead_band_n_m,
                corner_hz: self.hand_corner_hz,
                limit_n: self.force_limit_n,
                ..Law::default()
            },
            home: Joints::from_column_slice(&[0.0, 0.0, 0.0, self.rest_roll_rad, self.rest_tilt_rad]),
            ..Settings::default()
        }
    }

    pub(super) fn simulation(&self) -> Simulation {
        let backlash = per_kind(self.backlash_m, self.backlash_rad);
        let blocked = NAMES.iter().position(|name| *name == self.blocked_joint);
        Simulation { seed: self.seed, backlash, blocked, ..Simulation::default() }
    }
}
