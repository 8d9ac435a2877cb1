//! Conversions between the standard payloads and nalgebra's types, checked on the way in.
//!
//! Invariant: quaternions are x, y, z, w in payloads, of unit length within [`UNIT_TOLERANCE`]; a number that
//! is not finite, or no rotation, is refused with the reason, never repaired. Nothing here allocates.

use crate::data::{CartesianState, JointState, Pose, Transform, Twist, Wrench};
use crate::values::{List, Stamp, Text};
use core::fmt;
use nalgebra::{Isometry3, Quaternion, SVector, Translation3, UnitQuaternion, Vector6};

/// Largest difference of an orientation's length from 1: rounding to f32 or to four decimals passes, a
/// forgotten normalisation does not.
pub const UNIT_TOLERANCE: f64 = 1e-3;

/// Longest time over which a twist is taken to say where its pose is, s, ahead as well as back.
pub const CARRIED_S: f64 = 0.02;

/// Why a payload is not the geometry it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GeometryError {
    /// A number is NaN or infinite.
    NotFinite {
        /// The field: "position", "orientation".
        field: &'static str,
        /// Place in the field, from 0.
        at: usize,
        /// The number itself.
        value: f64,
    },
    /// The orientation is no unit quaternion.
    NotUnit {
        /// x, y, z, w.
        orientation: [f64; 4],
    },
    /// Another number of joints.
    Joints {
        /// The field: "position", "velocity".
        field: &'static str,
        /// Joints in the payload.
        have: usize,
        /// Joints that were asked for.
        want: usize,
    },
}

impl fmt::Display for GeometryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            GeometryError::NotFinite { field, at, value } => {
                write!(f, "{field}[{at}] is {value}: give a finite number")
            }
            GeometryError::NotUnit { orientation } => write!(
                f,
                "orientation {orientation:?} is no unit quaternion x, y, z, w: normalise it, or give [0, 0, 0, 1] for none"
            ),
            GeometryError::Joints { field, have, want } => {
                write!(f, "{field} has {have} items, this arm has {want} joints: give one per joint")
            }
        }
    }
}

impl std::error::Error for GeometryError {}

fn finite(field: &'static str, values: &[f64]) -> Result<(), GeometryError> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(GeometryError::NotFinite { field, at, value: values[at] }),
        None => Ok(()),
    }
}

impl From<Isometry3<f64>> for Pose {
    /// Without a stamp: set it to the time of the measurement.
    fn from(t: Isometry3<f64>) -> Pose {
        Pose {
            position: t.translation.vector.into(),
            orientation: t.rotation.coords.into(),
            ..Pose::default()
        }
    }
}

impl Pose {
    /// The pose as an isometry; the stamp is not looked at.
    ///
    /// # Errors
    /// A number that is not finite, an orientation whose length is not 1.
    pub fn isometry(&self) -> Result<Isometry3<f64>, GeometryError> {
        finite("position", &self.position)?;
        finite("orientation", &self.orientation)?;
        let turn = Quaternion::from(self.orientation);
        if (turn.norm() - 1.0).abs() > UNIT_TOLERANCE {
            return Err(GeometryError::NotUnit { orientation: self.orientation });
        }
        let turn = UnitQuaternion::from_quaternion(turn);
        Ok(Isometry3::from_parts(Translation3::from(self.position), turn))
    }
}

impl Transform {
    /// Returns the isometry that takes coordinates in `child` to coordinates in `parent`, without a stamp.
    /// Names are cut at 32 bytes.
    pub fn between(
        parent: impl Into<Text<32>>,
        child: impl Into<Text<32>>,
        isometry: Isometry3<f64>,
    ) -> Transform {
        Transform { pose: isometry.into(), parent: parent.into(), child: child.into() }
    }

    /// Takes coordinates in `child` to coordinates in `parent`.
    ///
    /// # Errors
    /// As [`Pose::isometry`].
    pub fn isometry(&self) -> Result<Isometry3<f64>, GeometryError> {
        self.pose.isometry()
    }
}

impl TryFrom<&Pose> for Isometry3<f64> {
    type Error = GeometryError;
    fn try_from(pose: &Pose) -> Result<Self, GeometryError> {
        pose.isometry()
    }
}

impl From<Vector6<f64>> for Twist {
    /// Linear part (m/s) first; without a stamp.
    fn from(v: Vector6<f64>) -> Twist {
        Twist { linear: [v[0], v[1], v[2]], angular: [v[3], v[4], v[5]], ..Twist::default() }
    }
}

impl Twist {
    /// Linear part first, m/s and rad/s.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn vector(&self) -> Result<Vector6<f64>, GeometryError> {
        finite("linear", &self.linear)?;
        finite("angular", &self.angular)?;
        Ok(joined(self.linear, self.angular))
    }
}

impl From<Vector6<f64>> for Wrench {
    /// Force (N) first; without a stamp.
    fn from(v: Vector6<f64>) -> Wrench {
        Wrench { force: [v[0], v[1], v[2]], torque: [v[3], v[4], v[5]], ..Wrench::default() }
    }
}

impl Wrench {
    /// Force first, N and N·m.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn vector(&self) -> Result<Vector6<f64>, GeometryError> {
        finite("force", &self.force)?;
        finite("torque", &self.torque)?;
        Ok(joined(self.force, self.torque))
    }
}

/// A pose at another time than its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// The pose at that time.
    pub isometry: Isometry3<f64>,
    /// True: the pose was carried all the way. False: the time lies further than [`CARRIED_S`] from the
    /// stamp, or there is none, and the pose stands where it had been carried to.
    pub known: bool,
}

impl CartesianState {
    /// Returns the pose at a time near its own: moved on by the twist, for [`CARRIED_S`] at most. The stamp
    /// is that of the pose, or else of the whole sample.
    ///
    /// # Errors
    /// As [`Pose::isometry`] and [`Twist::vector`].
    pub fn carried(&self, to: Stamp) -> Result<Carried, GeometryError> {
        let (pose, twist) = (self.pose.isometry()?, self.twist.vector()?);
        let taken = [self.pose.stamp, self.stamp].into_iter().find(|stamp| stamp.is_valid());
        let ahead_s = taken.map_or(f64::NAN, |taken| to.seconds_since(taken));
        let known = ahead_s.abs() <= CARRIED_S;
        let by_s = if ahead_s.is_nan() { 0.0 } else { ahead_s.clamp(-CARRIED_S, CARRIED_S) };
        let (linear, angular) = (twist.fixed_rows::<3>(0), twist.fixed_rows::<3>(3));
        let turn = UnitQuaternion::from_scaled_axis(angular * by_s);
        let moved = Translation3::from(pose.translation.vector + linear * by_s);
        Ok(Carried { isometry: Isometry3::from_parts(moved, turn * pose.rotation), known })
    }
}

/// Joints a [`JointState`] has room for.
const MOST_JOINTS: usize = 16;

impl JointState {
    /// Returns this state with the positions of `N` joints, m and rad. More joints than it has room for do
    /// not compile.
    ///
    /// ```
    /// use trocar_sdk::data::JointState;
    /// # use nalgebra::Vector3;
    /// let state = JointState::default().with_positions(&Vector3::new(0.1, 0.2, 0.3));
    /// assert_eq!(state.positions::<3>().unwrap().y, 0.2);
    /// ```
    #[must_use]
    pub fn with_positions<const N: usize>(self, m_rad: &SVector<f64, N>) -> JointState {
        JointState { position: listed(m_rad), ..self }
    }

    /// This state with the velocities of `N` joints, m/s and rad/s.
    #[must_use]
    pub fn with_velocities<const N: usize>(self, m_s_rad_s: &SVector<f64, N>) -> JointState {
        JointState { velocity: listed(m_s_rad_s), ..self }
    }

    /// This state with the forces and torques of `N` joints, N and N·m.
    #[must_use]
    pub fn with_efforts<const N: usize>(self, n_nm: &SVector<f64, N>) -> JointState {
        JointState { effort: listed(n_nm), ..self }
    }

    /// Positions of an arm with `N` joints, m and rad.
    ///
    /// # Errors
    /// Another number of joints, a number that is not finite.
    pub fn positions<const N: usize>(&self) -> Result<SVector<f64, N>, GeometryError> {
        joints("position", &self.position)
    }

    /// Velocities of an arm with `N` joints, m/s and rad/s.
    ///
    /// # Errors
    /// As `positions`.
    pub fn velocities<const N: usize>(&self) -> Result<SVector<f64, N>, GeometryError> {
        joints("velocity", &self.velocity)
    }

    /// Forces and torques of an arm with `N` joints, N and N·m.
    ///
    /// # Errors
    /// As `positions`.
    pub fn efforts<const N: usize>(&self) -> Result<SVector<f64, N>, GeometryError> {
        joints("effort", &self.effort)
    }
}

fn listed<const N: usize>(values: &SVector<f64, N>) -> List<f64, MOST_JOINTS> {
    const { assert!(N <= MOST_JOINTS, "a JointState has room for 16 joints") };
    List::of(values.as_slice())
}

fn joints<const N: usize>(field: &'static str, values: &[f64]) -> Result<SVector<f64, N>, GeometryError> {
    if values.len() != N {
        return Err(GeometryError::Joints { field, have: values.len(), want: N });
    }
    finite(field, values)?;
    Ok(SVector::from_column_slice(values))
}

fn joined([a, b, c]: [f64; 3], [d, e, f]: [f64; 3]) -> Vector6<f64> {
    Vector6::new(a, b, c, d, e, f)
}

#[cfg(test)]
#[path = "geometry_tests.rs"]
mod tests;
