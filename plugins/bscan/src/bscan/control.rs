//! One period of a scan: from readings to the robot's commands.
//!
//! Invariant: every speed that is sent comes from `depth` and `line`, and whatever cannot go on says why.

use trocar_oct_core::tip::axis_of;
use trocar_sdk::data::{FixtureKind, Pose, Twist, VirtualFixture};
use trocar_sdk::prelude::*;

use super::{BScan, LONGEST_DELAY_S, ROBOT_LOST_S, SURFACE_LOST_S, is_ready};
use crate::depth::Advice;
use crate::line::Line;
use crate::payloads::Phase;

/// A robot that is further from where the line has it ends the scan, m.
const LAG_M: f64 = 0.2e-3;
/// Across the tool the tip goes to the begin only when it is this near to the offset, m.
const CLOSE_M: f64 = 50e-6;
/// A tip this near to the offset, m, and near to where the scan sets off, does so after so long, s.
const NEAR_M: f64 = 15e-6;
const SETTLED_S: f64 = 0.1;
/// A tip at the end of the line waits for A-scans at most so long, s. If distances end with them, the tip
/// stands 15 ms later, so a tip that came to the end all the same is done before the surface counts as lost.
const LAST_ASCAN_S: f64 = 0.03;
/// Highest speed towards the guard per distance that is left, 1/s: the most that the robot takes for its own
/// guard. `depth` brakes at a rate of its own, which counts from the surface's velocity.
const GUARD_STIFFNESS_PER_S: f64 = 30.0;

/// A tool that leans further from z than by 60° does not point at what is below it.
pub(super) const LEAST_COSINE: f64 = 0.5;

impl BScan {
    /// Velocities along and across the tool, m/s.
    fn send(&self, stamp: Stamp, along: [f64; 3], across: [f64; 3]) {
        let twist = |linear| Twist { stamp, linear, ..Twist::default() };
        self.servo_along.send(twist(along));
        self.servo_across.send(twist(across));
    }

    /// Moves the robot for one period; the reason when it cannot go on.
    pub(super) fn drive(&mut self, tick: &Tick) -> Result<(), &'static str> {
        let (now, dt_s) = (tick.now(), tick.period_s());
        let Some(line) = self.line else { return Ok(()) };
        if now.seconds_since(self.since.robot) > ROBOT_LOST_S {
            return Err("the robot has not told for 20 ms where it is");
        }
        if !is_ready(&self.robot) {
            return Err("the robot is no longer enabled and homed");
        }
        if now.seconds_since(self.since.surface) > SURFACE_LOST_S {
            return Err(if self.since.jumped {
                "the surface was not where it can be for 50 ms: perhaps a deeper layer was seen in its place"
            } else {
                "the surface was not seen for 50 ms"
            });
        }
        if self.measured_delay_s() > LONGEST_DELAY_S {
            return Err("the measured delay is above 12 ms");
        }
        let offset_m = line.offset_m + self.retracted_m(now);
        let Some(axis) = axis_of(&self.pose.orientation) else {
            return Err("the robot's orientation is no unit quaternion");
        };
        let Some(least_m) = self.least_m(&axis) else {
            return Err("the tool leans by more than 60 degrees from z of the robot's base frame");
        };
        let settings = self.cfg.depth(self.progress.loop_delay, least_m);
        let Some(advice) = self.depth.advise(now.ns(), dt_s, offset_m, &settings) else {
            // The robot is late: it stands until it is here again, or is lost.
            self.send(now, [0.0; 3], [0.0; 3]);
            return Ok(());
        };
        if self.progress.phase != Phase::RETRACT && advice.distance_m < least_m {
            return Err("the tip is nearer to the surface than min_distance_m");
        }
        if !advice.blind {
            let taken = self.set_guard.send(self.guard(&axis, advice.distance_m - least_m));
            self.count(taken);
        }
        self.near_m = if advice.blind { self.near_m.min(advice.distance_m) } else { advice.distance_m };
        self.progress.distance = advice.distance_m;
        self.progress.error = advice.distance_m - offset_m;
        let across = if advice.blind { [0.0; 3] } else { self.across(&line, &advice, tick) };
        if self.progress.phase == Phase::SCAN && line.lag_m(&self.pose.position, self.planned_m) > LAG_M {
            return Err("the robot is more than 0.2 mm away from where it should be on the line");
        }
        self.send(now, axis.map(|a| a * advice.speed_m_s), across);
        if self.progress.phase == Phase::APPROACH
            && now.seconds_since(self.since.phase) > self.cfg.approach_timeout_s
        {
            return Err("the begin of the line was not reached in time");
        }
        if self.progress.phase == Phase::SCAN && now.seconds_since(self.since.phase) > line.latest_s() {
            return Err("the end of the line was not reached in time");
        }
        Ok(())
    }

    /// Returns the distance along the tool at which the tip is min_distance_m above a surface that lies
    /// across z: more for a tool that leans. None for one that leans so far that it does not point at what is
    /// below it.
    pub(super) fn least_m(&self, axis: &[f64; 3]) -> Option<f64> {
        (axis[2] > LEAST_COSINE).then(|| self.cfg.min_distance_m / axis[2])
    }

    /// Returns a plane across z through the place `below_m` before the tip: under a tool that leans, one
    /// across the tool would let the tip go aside into the surface.
    fn guard(&self, axis: &[f64; 3], below_m: f64) -> VirtualFixture {
        let position = [0, 1, 2].map(|i| self.pose.position[i] + axis[i] * below_m);
        // Half a turn about x: the allowed side is where z points.
        let frame = Pose { stamp: self.pose.stamp, position, orientation: [1.0, 0.0, 0.0, 0.0] };
        VirtualFixture { kind: FixtureKind::PLANE, reserved: 0, frame, stiffness: GUARD_STIFFNESS_PER_S }
    }

    /// Returns the distance beyond the offset that the tip should have by now, m.
    fn retracted_m(&self, now: Stamp) -> f64 {
        if self.progress.phase != Phase::RETRACT {
            return 0.0;
        }
        self.cfg.retract_m.min(self.cfg.approach_m_s * now.seconds_since(self.since.phase))
    }

    /// Velocity across the tool; goes on from APPROACH to SCAN.
    fn across(&mut self, line: &Line, advice: &Advice, tick: &Tick) -> [f64; 3] {
        let (now, tip_m) = (tick.now(), &self.pose.position);
        match self.progress.phase {
            Phase::SCAN => {
                let arrived = self.since.end.is_valid();
                let pace_m_s = if arrived { 0.0 } else { line.pace_m_s(now.seconds_since(self.since.phase)) };
                self.planned_m += pace_m_s * tick.period_s();
                return line.follow(tip_m, pace_m_s);
            }
            Phase::RETRACT => return [0.0; 3],
            _ => {}
        }
        let (velocity, at_start) = line.to_start(tip_m);
        let off_m = (advice.distance_m - line.offset_m).abs();
        if !at_start || off_m >= NEAR_M {
            self.since.near = Stamp::INVALID;
        } else if !self.since.near.is_valid() {
            self.since.near = now;
        } else if now.seconds_since(self.since.near) > SETTLED_S {
            self.planned_m = line.along_m(tip_m);
            self.enter(Phase::SCAN, now);
        }
        // Low over the retina nothing goes across: first to the offset, then to the begin.
        if off_m < CLOSE_M { velocity } else { [0.0; 3] }
    }

    /// Tells whether all A-scans of the line have been seen. They come in their order, so one that was taken
    /// at its end is behind all of them.
    pub(super) fn is_over(&self, now: Stamp) -> bool {
        let end = self.since.end;
        end.is_valid() && (self.sending.newest() >= end || now.seconds_since(end) > LAST_ASCAN_S)
    }

    /// Has the tip been given the time to go away, and to come to rest?
    pub(super) fn is_away(&self, now: Stamp) -> bool {
        let away_s = self.cfg.retract_m / self.cfg.approach_m_s + SETTLED_S;
        now.seconds_since(self.since.phase) > away_s
    }
}
