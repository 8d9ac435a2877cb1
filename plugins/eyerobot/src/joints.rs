//! The five joints: their order, units, limits, and the refusal of values outside them.
//!
//! Invariant: a [`Joints`] that passed [`Limits::check_position`] or [`Limits::check_velocity`] is finite and
//! inside the limits; nothing else may become a goal of the arm.

use std::fmt;

use nalgebra::SVector;

/// Number of joints.
pub const COUNT: usize = 5;

/// One value per joint in the order x, y, z, roll, tilt. Units: m, m, m, rad, rad (per second for
/// velocities).
pub type Joints = SVector<f64, COUNT>;

/// Names in joint order.
pub const NAMES: [&str; COUNT] = ["x", "y", "z", "roll", "tilt"];

/// Kind of a joint; decides its unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Slides; positions in m.
    Prismatic,
    /// Turns; positions in rad.
    Revolute,
}

/// Kinds in joint order.
pub const KINDS: [Kind; COUNT] =
    [Kind::Prismatic, Kind::Prismatic, Kind::Prismatic, Kind::Revolute, Kind::Revolute];

impl Kind {
    /// Unit of a position of this kind.
    pub fn unit(self) -> &'static str {
        match self {
            Kind::Prismatic => "m",
            Kind::Revolute => "rad",
        }
    }
}

/// The same value for the three slides and the same for the two turning joints (SI units).
pub const fn per_kind(prismatic: f64, revolute: f64) -> Joints {
    Joints::new(prismatic, prismatic, prismatic, revolute, revolute)
}

/// Limits of each joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest position, m or rad.
    pub lower: Joints,
    /// Highest position, m or rad.
    pub upper: Joints,
    /// Highest speed, m/s or rad/s.
    pub speed: Joints,
    /// Highest acceleration, m/s² or rad/s².
    pub acceleration: Joints,
}

impl Default for Limits {
    /// ±50 mm, roll ±60°, tilt ±45°, 10 mm/s, 7°/s, 0.5 m/s², 6 rad/s².
    fn default() -> Self {
        let upper = Joints::from_column_slice(&[0.05, 0.05, 0.05, 60f64.to_radians(), 45f64.to_radians()]);
        Limits {
            lower: -upper,
            upper,
            speed: per_kind(0.010, 7f64.to_radians()),
            acceleration: per_kind(0.5, 6.0),
        }
    }
}

impl Limits {
    /// Takes a position goal of any length into joints.
    ///
    /// # Errors
    /// Another length than five, a value that is not finite, or one outside its joint's limits.
    pub fn check_position(&self, goal: &[f64]) -> Result<Joints, Refusal> {
        let q = five(goal)?;
        match (0..COUNT).find(|&i| q[i] < self.lower[i] || q[i] > self.upper[i]) {
            Some(joint) => Err(Refusal::Position {
                joint,
                value: q[joint],
                lower: self.lower[joint],
                upper: self.upper[joint],
            }),
            None => Ok(q),
        }
    }

    /// Takes a velocity goal of any length into joints.
    ///
    /// # Errors
    /// Another length than five, a value that is not finite, or one above its joint's speed.
    pub fn check_velocity(&self, goal: &[f64]) -> Result<Joints, Refusal> {
        let v = five(goal)?;
        match (0..COUNT).find(|&i| v[i].abs() > self.speed[i]) {
            Some(joint) => Err(Refusal::Speed { joint, value: v[joint], limit: self.speed[joint] }),
            None => Ok(v),
        }
    }

    /// Returns the first joint whose position is more than `margin` outside its limits while `velocity`
    /// carries it further out. A joint that is outside but stands or comes back is not reported, so an
    /// operator can drive it back.
    pub fn leaving(&self, position: &Joints, velocity: &Joints, margin: &Joints) -> Option<usize> {
        (0..COUNT).find(|&i| {
            (position[i] > self.upper[i] + margin[i] && velocity[i] > 0.0)
                || (position[i] < self.lower[i] - margin[i] && velocity[i] < 0.0)
        })
    }
}

/// Takes values of any length into joints, whatever their size: changes of positions, for example.
///
/// # Errors
/// Another length than five, a value that is not finite.
pub fn five(values: &[f64]) -> Result<Joints, Refusal> {
    if values.len() != COUNT {
        return Err(Refusal::Length { got: values.len() });
    }
    match (0..COUNT).find(|&i| !values[i].is_finite()) {
        Some(joint) => Err(Refusal::NotFinite { joint, value: values[joint] }),
        None => Ok(Joints::from_column_slice(values)),
    }
}

/// Why a joint goal was not taken. `joint` is an index into [`NAMES`]; values in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// Not one value per joint.
    Length {
        /// Number of values that came.
        got: usize,
    },
    /// NaN or infinite.
    NotFinite {
        /// Which joint.
        joint: usize,
        /// Value that came.
        value: f64,
    },
    /// Position outside the limits.
    Position {
        /// Which joint.
        joint: usize,
        /// Value that came, m or rad.
        value: f64,
        /// Lowest allowed, m or rad.
        lower: f64,
        /// Highest allowed, m or rad.
        upper: f64,
    },
    /// Velocity above the joint's speed.
    Speed {
        /// Which joint.
        joint: usize,
        /// Value that came, m/s or rad/s.
        value: f64,
        /// Highest allowed magnitude, m/s or rad/s.
        limit: f64,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Refusal::Length { got } => {
                write!(
                    f,
                    "{got} joint values given, this arm has {COUNT} ({}): give one each",
                    NAMES.join(", ")
                )
            }
            Refusal::NotFinite { joint, value } => {
                write!(f, "joint {}: {value} is not a finite number", NAMES[joint])
            }
            Refusal::Position { joint, value, lower, upper } => {
                let (name, unit) = (NAMES[joint], KINDS[joint].unit());
                write!(f, "joint {name}: {value} {unit} is outside {lower:.6} … {upper:.6} {unit}")
            }
            Refusal::Speed { joint, value, limit } => {
                let (name, unit) = (NAMES[joint], KINDS[joint].unit());
                write!(f, "joint {name}: {value} {unit}/s is faster than its limit of {limit:.6} {unit}/s")
            }
        }
    }
}

impl std::error::Error for Refusal {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_goal_outside_a_limit_is_refused_with_joint_value_and_limits() {
        let refused =
            Limits::default().check_position(&[0.0, 0.0, 0.0, 2.0, 0.0]).expect_err("2 rad of roll");
        assert!(matches!(refused, Refusal::Position { joint: 3, .. }), "{refused:?}");
        assert_eq!(refused.to_string(), "joint roll: 2 rad is outside -1.047198 … 1.047198 rad");
    }

    #[test]
    fn a_goal_on_the_limit_is_taken() {
        let limits = Limits::default();
        assert!(limits.check_position(limits.upper.as_slice()).is_ok());
        assert!(limits.check_position(limits.lower.as_slice()).is_ok());
    }

    #[test]
    fn wrong_lengths_and_values_that_are_not_finite_are_refused() {
        let limits = Limits::default();
        assert_eq!(limits.check_position(&[]), Err(Refusal::Length { got: 0 }));
        assert_eq!(limits.check_velocity(&[0.0; 6]), Err(Refusal::Length { got: 6 }));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let goal = [0.0, bad, 0.0, 0.0, 0.0];
            assert!(matches!(limits.check_position(&goal), Err(Refusal::NotFinite { joint: 1, .. })));
            assert!(matches!(limits.check_velocity(&goal), Err(Refusal::NotFinite { joint: 1, .. })));
        }
    }

    #[test]
    fn a_velocity_above_the_speed_is_refused_in_both_directions() {
        let limits = Limits::default();
        for v in [0.0101, -0.0101] {
            let refused = limits.check_velocity(&[0.0, 0.0, v, 0.0, 0.0]);
            assert!(matches!(refused, Err(Refusal::Speed { joint: 2, .. })), "{refused:?}");
        }
    }

    #[test]
    fn a_joint_outside_its_limits_is_reported_only_while_it_goes_further_out() {
        let (limits, margin) = (Limits::default(), per_kind(1e-4, 1e-3));
        let mut q = Joints::zeros();
        q[0] = 0.0502;
        assert_eq!(limits.leaving(&q, &per_kind(0.001, 0.0), &margin), Some(0));
        assert_eq!(limits.leaving(&q, &per_kind(-0.001, 0.0), &margin), None);
        assert_eq!(limits.leaving(&q, &Joints::zeros(), &margin), None);
        q[0] = 0.05005;
        assert_eq!(limits.leaving(&q, &per_kind(0.001, 0.0), &margin), None, "inside the margin");
    }
}
