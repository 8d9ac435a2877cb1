//! Conversions between the standard payloads and nalgebra's types.
//!
//! Invariant: quaternions are x, y, z, w in payloads; one that is not of unit length is normalised, a zero one is refused.

use crate::data::{Pose, Twist, Wrench};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};

impl From<Isometry3<f64>> for Pose {
    fn from(t: Isometry3<f64>) -> Pose {
        let q = t.rotation.coords;
        let v = t.translation.vector;
        Pose { position: [v.x, v.y, v.z], orientation: [q.x, q.y, q.z, q.w], ..Pose::default() }
    }
}

impl Pose {
    /// The same as an isometry; none when the quaternion is zero or a number is not finite.
    pub fn isometry(&self) -> Option<Isometry3<f64>> {
        let [x, y, z, w] = self.orientation;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), f64::EPSILON)?;
        let finite = self.position.iter().chain(&self.orientation).all(|v| v.is_finite());
        finite.then(|| Isometry3::from_parts(Translation3::from(Vector3::from(self.position)), rotation))
    }
}

impl Twist {
    /// Linear part first, m/s and rad/s.
    pub fn vector(&self) -> Vector6<f64> {
        joined(self.linear, self.angular)
    }
}

impl Wrench {
    /// Force first, N and N·m.
    pub fn vector(&self) -> Vector6<f64> {
        joined(self.force, self.torque)
    }
}

fn joined([a, b, c]: [f64; 3], [d, e, f]: [f64; 3]) -> Vector6<f64> {
    Vector6::new(a, b, c, d, e, f)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_pose_survives_the_way_to_nalgebra_and_back() {
        let t = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.1, -0.2, 0.3));
        let back = Pose::from(t).isometry().unwrap();
        assert!((back.inverse() * t).translation.vector.norm() < 1e-12);
        assert!((back.inverse() * t).rotation.angle() < 1e-12);
    }

    #[test]
    fn a_pose_without_direction_or_with_nan_is_no_isometry() {
        let zero = Pose { orientation: [0.0; 4], ..Pose::default() };
        let nan = Pose { position: [f64::NAN, 0.0, 0.0], ..Pose::default() };
        assert!(zero.isometry().is_none() && nan.isometry().is_none());
    }
}
