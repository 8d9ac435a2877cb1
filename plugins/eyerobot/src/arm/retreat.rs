//! The way back along the tool, which the arm takes by itself when its client falls silent.
//!
//! Invariant: it begins from rest, once for each time it is set, and never after another command. A moving
//! surface may come near a tip that stands, so a client that sees it sets the way before, and the arm needs
//! no further command to take it.

use trocar_sdk::data;

use super::motion::{Ends, Motion, Move};
use super::{Arm, ArmError};
use crate::drive::Drive;
use crate::joints::{Joints, Limits};
use crate::kinematics::tool_axis;
use crate::trajectory::Trajectory;

/// Longest way, m.
const FARTHEST_M: f64 = 5e-3;
/// Longest wait, s.
const LONGEST_S: f64 = 1.0;
/// Highest speed, m/s: more than any slide does.
const FASTEST_M_S: f64 = 0.1;
/// Lowest speed, m/s; also of a slide that has next to no part in the way.
const LEAST_M_S: f64 = 1e-6;

/// Way back that follows when a motion by velocity or force is not repeated in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retreat {
    /// Back along the tool, m.
    pub distance_m: f64,
    /// Highest speed of the tip, m/s.
    pub speed_m_s: f64,
    /// From the brake to the way back, s.
    pub delay_s: f64,
}

impl Retreat {
    /// Returns the way back that a payload describes; none if it says 0 m.
    ///
    /// # Errors
    /// A number that is not finite or not within its limits.
    pub fn checked(told: &data::Retreat) -> Result<Option<Retreat>, ArmError> {
        let within = |what, value: f64, least: f64, limit: f64, unit| match value >= least && value <= limit {
            true => Ok(value),
            false => Err(ArmError::Retreat { what, value, least, limit, unit }),
        };
        let distance_m = within("distance", told.distance, 0.0, FARTHEST_M, "m")?;
        if distance_m == 0.0 {
            return Ok(None);
        }
        let speed_m_s = within("speed", told.speed, LEAST_M_S, FASTEST_M_S, "m/s")?;
        let delay_s = within("delay", told.delay, 0.0, LONGEST_S, "s")?;
        Ok(Some(Retreat { distance_m, speed_m_s, delay_s }))
    }

    /// The payload of one, or of none.
    pub fn payload(retreat: Option<Retreat>) -> data::Retreat {
        retreat.map_or(data::Retreat::default(), |Retreat { distance_m, speed_m_s, delay_s }| data::Retreat {
            distance: distance_m,
            speed: speed_m_s,
            delay: delay_s,
        })
    }

    /// Returns its end from `q` (m, rad): straight back along the tool, as far as the slides go.
    fn end(&self, q: &Joints, limits: &Limits) -> Joints {
        let way = tool_axis(q) * -self.distance_m;
        let room = |i: usize| match way[i] {
            part if part > 0.0 => (limits.upper[i] - q[i]) / part,
            part if part < 0.0 => (limits.lower[i] - q[i]) / part,
            _ => 1.0,
        };
        let share = (0..3).map(room).fold(1.0, f64::min).max(0.0);
        Joints::from_fn(|i, _| if i < 3 { q[i] + share * way[i] } else { q[i] })
    }

    /// Limits with which the tip is no faster than it may be, and the slides keep it on a straight line.
    fn slow(&self, q: &Joints, limits: &Limits) -> Limits {
        let axis = tool_axis(q);
        let part = |i: usize| (self.speed_m_s * axis[i].abs()).clamp(LEAST_M_S, limits.speed[i]);
        Limits { speed: Joints::from_fn(|i, _| if i < 3 { part(i) } else { limits.speed[i] }), ..*limits }
    }
}

impl<D: Drive> Arm<D> {
    /// Sets what follows when a motion by velocity or force that is commanded from now on is not repeated in
    /// time.
    pub fn set_retreat(&mut self, retreat: Option<Retreat>) {
        self.retreat = retreat;
        // A client that fell silent before has nothing to do with it.
        self.silent_s = None;
    }

    /// Takes the way back once the arm stands and has waited.
    pub(super) fn mind_silence(&mut self, dt_s: f64) {
        let Some(silent_s) = self.silent_s.as_mut() else { return };
        *silent_s += dt_s;
        let waited = *silent_s;
        let due = |retreat: &Retreat| waited > retreat.delay_s && !self.braking;
        let Some(retreat) = self.retreat.filter(due) else { return };
        self.retreat = None;
        if self.operating.require_ready().is_err() {
            return;
        }
        let (q, limits) = (&self.setpoint.position, &self.settings.limits);
        let (goal, slow) = (retreat.end(q, limits), retreat.slow(q, limits));
        let trajectory = Trajectory::plan(q, &Joints::zeros(), &goal, &slow);
        self.pre_empt(Motion::Move(Move { trajectory, goal, elapsed_s: 0.0, ends: Ends::Quietly }));
        self.news.retreats = Some(retreat);
    }
}

#[cfg(test)]
#[path = "retreat_tests.rs"]
mod tests;
