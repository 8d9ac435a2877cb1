//! The motions of an arm: what the last command asked for, and how much of it is left.
//!
//! Invariant: plain values; a motion by velocity or force carries the time after which it is over.

use nalgebra::{Vector3, Vector6};

use crate::joints::Joints;
use crate::trajectory::Trajectory;

/// Remainder that rounding leaves of a time that is over, s.
const OVER_S: f64 = 1e-9;

#[expect(clippy::large_enum_variant, reason = "a box would allocate on the step path")]
#[derive(Clone, Copy, Debug)]
pub(super) enum Motion {
    Hold,
    ServoPosition { goal: Joints },
    ServoVelocity { velocity: Joints, left_s: f64 },
    Tip(Tip),
    Move(Move),
}

impl Motion {
    /// The setpoint's pose is what was asked for, not the sum of velocities.
    pub(super) fn is_position_based(&self) -> bool {
        matches!(self, Motion::Hold | Motion::ServoPosition { .. } | Motion::Move(_))
    }

    /// Time passes in which it was not carried out.
    pub(super) fn pass(&mut self, s: f64) {
        match self {
            Motion::ServoVelocity { left_s, .. } => *left_s -= s,
            Motion::Tip(Tip { twist, force, axis }) => {
                for left_s in [&mut twist.left_s, &mut force.left_s, &mut axis.left_s] {
                    *left_s -= s;
                }
            }
            Motion::Hold | Motion::ServoPosition { .. } | Motion::Move(_) => {}
        }
    }

    /// A motion by velocity or force that was not repeated in time.
    pub(super) fn is_over(&self) -> bool {
        match self {
            Motion::ServoVelocity { left_s, .. } => *left_s <= OVER_S,
            Motion::Tip(tip) => tip.is_over(),
            Motion::Hold | Motion::ServoPosition { .. } | Motion::Move(_) => false,
        }
    }

    /// Shown as `is_busy`.
    pub(super) fn is_busy(&self) -> bool {
        matches!(self, Motion::Move(Move { ends: Ends::Told | Ends::Homing, .. }))
    }
}

/// Along a trajectory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Move {
    pub(super) trajectory: Trajectory,
    pub(super) goal: Joints,
    pub(super) elapsed_s: f64,
    pub(super) ends: Ends,
}

/// Meaning of a trajectory's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ends {
    /// `interpolate_*`: nothing.
    Quietly,
    /// `move_*`: `goal_reached`.
    Told,
    /// `home`: the arm is homed.
    Homing,
}

/// The tip's velocity as a sum of three wishes, each of which is over when it is not repeated.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tip {
    /// `servo_cv`, m/s and rad/s, kinematic base.
    twist: Timed<Vector6<f64>>,
    /// Force beside the hand's (N, N·m, kinematic base) of `compliance/servo_cf`: while it lasts the hand is
    /// followed.
    force: Timed<Vector6<f64>>,
    /// `axis/servo_cv`, m/s along the tool.
    axis: Timed<f64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Timed<T> {
    value: T,
    left_s: f64,
}

impl<T: Copy> Timed<T> {
    fn take(&mut self, dt_s: f64) -> Option<T> {
        if self.left_s <= OVER_S {
            return None;
        }
        self.left_s -= dt_s;
        Some(self.value)
    }
}

impl Tip {
    /// A given twist in the place of any other and of the hand; the axis' velocity goes on.
    pub(super) fn with_twist(self, value: Vector6<f64>, left_s: f64) -> Tip {
        Tip { twist: Timed { value, left_s }, force: Timed::default(), ..self }
    }

    /// The hand, with a force beside it, in the place of a given twist; the axis' velocity goes on.
    pub(super) fn with_hand(self, force: Vector6<f64>, left_s: f64) -> Tip {
        Tip { force: Timed { value: force, left_s }, twist: Timed::default(), ..self }
    }

    /// A velocity along the tool, added to the rest.
    pub(super) fn with_axis(self, m_s: f64, left_s: f64) -> Tip {
        Tip { axis: Timed { value: m_s, left_s }, ..self }
    }

    /// Force beside the hand's; none while the hand is not followed.
    pub(super) fn force(&self) -> Option<Vector6<f64>> {
        (self.force.left_s > 0.0).then_some(self.force.value)
    }

    /// Returns the twist of this period, kinematic base. `hand` is the twist of the hand, `axis` the
    /// direction of the tool.
    pub(super) fn take(&mut self, hand: &Vector6<f64>, axis: &Vector3<f64>, dt_s: f64) -> Vector6<f64> {
        let mut sum = self.twist.take(dt_s).unwrap_or_default();
        if self.force.take(dt_s).is_some() {
            sum += hand;
        }
        let along = axis * self.axis.take(dt_s).unwrap_or_default();
        sum + Vector6::new(along.x, along.y, along.z, 0.0, 0.0, 0.0)
    }

    /// Nothing of it is left.
    fn is_over(&self) -> bool {
        [self.twist.left_s, self.force.left_s, self.axis.left_s].iter().all(|&left_s| left_s <= OVER_S)
    }
}
