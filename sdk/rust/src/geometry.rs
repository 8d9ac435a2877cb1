//! Conversions between the standard payloads and nalgebra's types, checked on the way in.
//!
//! Invariant: quaternions are x, y, z, w in payloads, of unit length within [`UNIT_TOLERANCE`]; anything that is not a
//! finite number, or no rotation, is refused with what is wrong, never repaired. Nothing here allocates.

use crate::data::{JointState, Pose, Transform, Twist, Wrench};
use core::fmt;
use nalgebra::{Isometry3, Quaternion, SVector, Translation3, UnitQuaternion, Vector6};

/// How far the length of an orientation may be from 1: rounding to f32 or to four decimals passes, a forgotten
/// normalisation does not.
pub const UNIT_TOLERANCE: f64 = 1e-3;

/// Why a payload is not the geometry it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GeometryError {
    /// A number is NaN or infinite.
    NotFinite {
        /// The field: "position", "orientation".
        field: &'static str,
        /// Place in the field, from 0.
        at: usize,
        value: f64,
    },
    /// The orientation is no unit quaternion.
    NotUnit {
        /// x, y, z, w.
        orientation: [f64; 4],
    },
    /// Another number of joints.
    Joints { field: &'static str, have: usize, want: usize },
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

impl JointState {
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
