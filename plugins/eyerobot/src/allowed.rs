//! From wanted motion to joint velocities that limits and fixtures allow.
//!
//! Invariant: the result keeps every fixture and joint limit, or is zero; acceleration gives way to both. A
//! wish that is allowed comes out unchanged.

use nalgebra::{Matrix3, Vector6};

use crate::arm::Settings;
use crate::drive::Measured;
use crate::fixture::{Fixtures, Stance};
use crate::joints::{COUNT, Joints, per_kind};
use crate::least_squares::{HalfSpaces, Square, near, nearest, track};

/// Towards its limit a joint moves at most at this times the way that is left, 1/s: from full speed it brakes
/// with 0.2 m/s².
const BRAKE_PER_S: f64 = 20.0;

/// Weight of turning against the tip's translation, in tool lengths: the tip keeps its direction rather than
/// bend around a limit, and yields it where a remote centre turns the tool anyway.
const TURN_WEIGHT: f64 = 10.0;
const FREE_TURN_WEIGHT: f64 = 1e-3;

/// Weight of the turn about the tool's own axis, which five joints cannot choose, against other turns.
const SPIN_WEIGHT: f64 = 0.01;

/// Damping of the joints against the tip's velocity: bounds them where the arm is singular, costs 1e-6
/// elsewhere.
const DAMPING: f64 = 1e-3;

/// State of an arm that is to be moved.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Geometry and limits.
    pub settings: &'a Settings,
    /// Fixtures in force.
    pub fixtures: &'a Fixtures,
    /// Setpoint: its place and velocity.
    pub from: Measured,
    /// Place by the encoders, m and rad.
    pub measured: Joints,
    /// Period, s.
    pub dt_s: f64,
}

/// Velocities that are allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed {
    /// Joint velocities, m/s and rad/s.
    pub velocity: Joints,
    /// Joints that stand at a limit of their travel and would have gone on.
    pub at_limit: [bool; COUNT],
}

impl Scene<'_> {
    /// The joint velocities whose twist of the tip (m/s, rad/s, kinematic base) is nearest to `wanted`.
    pub fn twist(&self, wanted: &Vector6<f64>) -> Allowed {
        let Settings { kinematics, .. } = self.settings;
        let at = Stance::of(kinematics, &self.from.position);
        let weight = if self.fixtures.turn_the_tool() { FREE_TURN_WEIGHT } else { TURN_WEIGHT };
        let spin = at.axis * at.axis.transpose();
        let turns = (Matrix3::identity() - spin * (1.0 - SPIN_WEIGHT)) * (weight * kinematics.tool_length_m);
        let (mut rows, mut goal) = (at.jacobian, *wanted);
        rows.fixed_rows_mut::<3>(3).copy_from(&(turns * at.jacobian.fixed_rows::<3>(3)));
        goal.fixed_rows_mut::<3>(3).copy_from(&(turns * wanted.fixed_rows::<3>(3)));
        self.solve(&track(&rows, &goal, &self.scale(), DAMPING), &at)
    }

    /// The joint velocities nearest to `wanted` (m/s, rad/s).
    pub fn velocity(&self, wanted: &Joints) -> Allowed {
        let at = Stance::of(&self.settings.kinematics, &self.from.position);
        self.solve(&near(wanted, &self.scale()), &at)
    }

    /// Returns what fixtures, and beside them the acceleration, leave of a motion whose joint velocities are
    /// planned; none if they leave it as it is. Without a fixture only speeds are bounded: the plan is then
    /// the client's.
    pub fn planned(&self, wanted: &Joints, at_rest: bool) -> Option<Joints> {
        let speed = &self.settings.limits.speed;
        let clamped = Joints::from_fn(|i, _| wanted[i].clamp(-speed[i], speed[i]));
        let as_wanted = (clamped - wanted).amax() <= 1e-6 * speed.amax();
        if self.fixtures.is_empty() {
            return if as_wanted { None } else { Some(clamped) };
        }
        let at = Stance::of(&self.settings.kinematics, &self.from.position);
        let (h, g) = near(&clamped, &self.scale());
        let (slowest, fastest) = self.reachable(&-speed, speed);
        for (lower, upper) in [(&slowest, &fastest), (&-speed, speed)] {
            let mut set = HalfSpaces::within(lower, upper);
            self.restrict(&at, at_rest, &mut set);
            if as_wanted && set.hold(&clamped) {
                return None;
            }
            if let Ok(found) = nearest(&h, &g, &set) {
                return Some(found.velocity);
            }
        }
        Some(Joints::zeros())
    }

    fn solve(&self, (h, g): &(Square, Joints), at: &Stance) -> Allowed {
        let (lower, upper) = self.bounds();
        let (from, limits) = (&self.from, &self.settings.limits);
        let (slowest, fastest) = self.reachable(&lower, &upper);
        for (lower, upper) in [(&slowest, &fastest), (&lower, &upper)] {
            let mut set = HalfSpaces::within(lower, upper);
            self.restrict(at, false, &mut set);
            let Ok(found) = nearest(h, g, &set) else { continue };
            let close = per_kind(10e-6, 100e-6);
            let at_limit = std::array::from_fn(|i| {
                let q = from.position[i];
                (found.is_held_by(2 * i) && q > limits.upper[i] - close[i])
                    || (found.is_held_by(2 * i + 1) && q < limits.lower[i] + close[i])
            });
            return Allowed { velocity: found.velocity, at_limit };
        }
        Allowed { velocity: Joints::zeros(), at_limit: [false; COUNT] }
    }

    /// Returns the part of the bounds that the acceleration reaches in this period; a bound out of its reach
    /// holds all the same.
    fn reachable(&self, lower: &Joints, upper: &Joints) -> (Joints, Joints) {
        let most = self.settings.limits.acceleration * self.dt_s;
        let within = |v: f64, i: usize| v.max(lower[i]).min(upper[i]);
        let slowest = Joints::from_fn(|i, _| within(self.from.velocity[i] - most[i], i));
        (slowest, Joints::from_fn(|i, _| within(self.from.velocity[i] + most[i], i)))
    }

    /// Velocities between which each joint stays within its speed and can still brake before its limits.
    fn bounds(&self) -> (Joints, Joints) {
        let (limits, q) = (&self.settings.limits, &self.from.position);
        let towards = |left: f64, speed: f64| (BRAKE_PER_S * left).max(-speed).min(speed);
        let upper = Joints::from_fn(|i, _| towards(limits.upper[i] - q[i], limits.speed[i]));
        let lower = Joints::from_fn(|i, _| -towards(q[i] - limits.lower[i], limits.speed[i]));
        (lower, upper)
    }

    fn restrict(&self, at: &Stance, at_rest: bool, set: &mut HalfSpaces) {
        if self.fixtures.is_empty() {
            return;
        }
        let measured = Stance::of(&self.settings.kinematics, &self.measured);
        for fixture in self.fixtures.iter() {
            fixture.restrict(at, &measured, at_rest, set);
        }
    }

    /// Makes turning joints comparable with slides: by the way of the tip.
    fn scale(&self) -> Joints {
        per_kind(1.0, self.settings.kinematics.tool_length_m)
    }
}

#[cfg(test)]
#[path = "allowed_tests.rs"]
mod tests;
