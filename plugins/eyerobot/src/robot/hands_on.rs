//! The interfaces `hand`, `compliance`, `axis` and `virtual_fixture`: hands-on control and what shares the
//! tip with it.
//!
//! Invariant: nothing here moves the arm by itself; hand, axis and fixtures meet in the arm's one step.

use nalgebra::Vector6;
use trocar_sdk::data::{FixtureKind, Retreat, Twist, VirtualFixture, Wrench};
use trocar_sdk::prelude::*;

use super::{EyeRobot, EyeRobotState};
use crate::arm::{self, ArmError};
use crate::fixture::MOST_FIXTURES;
use crate::payloads::{self, VirtualFixtures};

/// The hand on the handle.
#[provides("hand")]
impl EyeRobot {
    /// Force and torque of the hand, with the orientation of the base frame; stamp 0 while there is no hand.
    #[read]
    fn measured_cf(s: &EyeRobotState) -> Wrench {
        s.felt_cf
    }
}

/// Hands-on control.
#[provides("compliance")]
impl EyeRobot {
    /// Follows the hand, and this force (in the base frame) beside it, for servo_timeout_s; zero follows the
    /// hand alone.
    #[command(overflow = "latest_wins")]
    fn servo_cf(&mut self, wrench: &Wrench) -> Result<(), ArmError> {
        self.require_in_time(wrench.stamp)?;
        self.arm.follow(&wrench.vector()?)
    }

    /// Sets how fast the tip follows: along its axes x, y, z in m/(s·N), about them in rad/(s·N·m).
    #[command]
    fn set_gain(
        &mut self,
        #[arg(doc = "three of 0 to 0.005 m/(s·N), three of 0 to 10 rad/(s·N·m)")] gain: [f64; 6],
    ) -> Result<(), ArmError> {
        self.arm.set_gain(&Vector6::from(gain))?;
        self.publish(self.host.now());
        Ok(())
    }

    /// The gains in force.
    #[read]
    fn gain(s: &EyeRobotState) -> [f64; 6] {
        s.gain
    }
}

/// The direction of the tool, for a controller that shares the arm with a hand or a scan.
#[provides("axis")]
impl EyeRobot {
    /// Adds the part along the tool of this twist (base frame) to what servo_cv or the hand does, for
    /// servo_timeout_s.
    #[command(name = "servo_cv", overflow = "latest_wins")]
    fn axis_servo_cv(&mut self, twist: &Twist) -> Result<(), ArmError> {
        self.require_in_time(twist.stamp)?;
        self.arm.servo_axis(&twist.vector()?)
    }

    /// Says what the arm does when a motion by velocity or force is not repeated for servo_timeout_s: it goes
    /// back along the tool, once. For a controller that keeps the tip from what moves, and may die; 0 m takes
    /// it away.
    #[command]
    fn set_retreat(
        &mut self,
        #[arg(doc = "at most 0.005 m, at most 0.1 m/s, after at most 1 s")] retreat: &Retreat,
    ) -> Result<(), ArmError> {
        self.arm.set_retreat(arm::Retreat::checked(retreat)?);
        self.publish(self.host.now());
        Ok(())
    }

    /// Way back that the arm takes when its client falls silent; 0 m: it brakes and stays.
    #[read]
    fn retreat(s: &EyeRobotState) -> Retreat {
        s.retreat
    }
}

/// Bounds for the place of the tip and the turn of the tool, in every motion.
#[provides("virtual_fixture")]
impl EyeRobot {
    /// Puts these fixtures in the place of those before; an empty list takes all away.
    #[command]
    fn set(
        &mut self,
        #[arg(doc = "planes, lines and remote centres, frames in the base frame")] list: &VirtualFixtures,
    ) -> Result<(), ArmError> {
        let mut checked = [None; MOST_FIXTURES];
        for (place, fixture) in list.fixtures.iter().enumerate() {
            checked[place] = Some(payloads::checked(fixture, place)?);
        }
        self.arm.set_fixtures(checked.iter().flatten())?;
        self.fixtures = VirtualFixtures { stamp: self.host.now(), ..VirtualFixtures::default() };
        for fixture in self.arm.fixtures().listed() {
            self.fixtures.fixtures.push(payloads::payload(fixture));
        }
        self.publish(self.host.now());
        Ok(())
    }

    /// Puts one fixture more beside those of `set`, in the place of the last guard: for a controller that
    /// moves it with what it watches. Kind 0 takes it away; nothing else does.
    #[command(overflow = "latest_wins")]
    fn set_guard(
        &mut self,
        #[arg(doc = "usually a plane, frame in the base frame")] guard: &VirtualFixture,
    ) -> Result<(), ArmError> {
        let checked = match guard.kind {
            FixtureKind(0) => None,
            _ => Some(payloads::checked(guard, 0)?),
        };
        self.arm.set_guard(checked)?;
        self.guard = self.arm.fixtures().guard().map(payloads::payload).unwrap_or_default();
        Ok(())
    }

    /// The guard in force, in the arm's kinematic base; kind 0 without one.
    #[read]
    fn guard(s: &EyeRobotState) -> VirtualFixture {
        s.guard
    }

    /// The fixtures in force, in the arm's kinematic base; stamp 0 while there never were any.
    #[read]
    fn fixtures(s: &EyeRobotState) -> VirtualFixtures {
        s.fixtures
    }
}
