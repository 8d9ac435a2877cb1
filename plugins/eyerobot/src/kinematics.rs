//! Kinematics of the five-joint arm: forward, Jacobian, and closed-form inverse.
//!
//! Invariant: `forward` and `inverse` share one convention, `T = Trans(x,y,z) · Rz(roll) · Rx(tilt) ·
//! Trans(0,0,L)`; SI units (m, rad) everywhere. Homogeneous transforms and the geometric Jacobian follow
//! Siciliano, Sciavicco, Villani, Oriolo, *Robotics: Modelling, Planning and Control* (2009), chapters 2 and
//! 3; the joint order is that of the steady-hand eye robot, Üneri et al., BioRob 2010 (three slides, roll,
//! tilt).

use std::f64::consts::TAU;
use std::fmt;

use nalgebra::{Isometry3, SMatrix, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::joints::{Joints, Limits, Refusal};

/// Below this sine of the tilt (1) the tool stands along z and the roll does not move it: roll is kept as it
/// is.
const STRAIGHT: f64 = 1e-10;

/// Shortest vector (m or 1) still taken as a direction.
const SHORTEST_AXIS: f64 = 1e-6;

/// The arm's geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics {
    /// Distance from the crossing of the roll and tilt axes to the tool's tip, m.
    pub tool_length_m: f64,
}

impl Kinematics {
    /// Pose of the tool's tip in the base frame; its z axis is the tool's axis. Translation in m.
    pub fn forward(&self, q: &Joints) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q[3])
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), q[4]);
        Translation3::new(q[0], q[1], q[2]) * turn * Translation3::new(0.0, 0.0, self.tool_length_m)
    }

    /// Geometric Jacobian at `q`: joint velocities (m/s, rad/s) to the tip's twist in the base frame, rows
    /// vx vy vz (m/s) then ωx ωy ωz (rad/s).
    pub fn jacobian(&self, q: &Joints) -> SMatrix<f64, 6, 5> {
        let lever = tool_axis(q) * self.tool_length_m;
        let (sin, cos) = q[3].sin_cos();
        let mut j = SMatrix::<f64, 6, 5>::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        // A turning joint about the unit axis u moves the tip by u × lever and turns it by u.
        for (column, u) in [(3, Vector3::z()), (4, Vector3::new(cos, sin, 0.0))] {
            j.fixed_view_mut::<3, 1>(0, column).copy_from(&u.cross(&lever));
            j.fixed_view_mut::<3, 1>(3, column).copy_from(&u);
        }
        j
    }

    /// Twist of the tip in the base frame: v (m/s) then ω (rad/s).
    pub fn twist(&self, q: &Joints, velocity: &Joints) -> Vector6<f64> {
        self.jacobian(q) * velocity
    }

    /// Returns the joints that bring the tip to `position` (m, base frame) with the tool along `axis` (any
    /// length): of all solutions inside `limits` the one whose roll and tilt are nearest to `near`. The turn
    /// about the tool's own axis cannot be chosen: the arm has five joints.
    ///
    /// # Errors
    /// A value that is not finite, an axis without direction, or no solution inside the limits (names the
    /// joint of the solution nearest to `near`).
    pub fn inverse(
        &self,
        position: &Vector3<f64>,
        axis: &Vector3<f64>,
        near: &Joints,
        limits: &Limits,
    ) -> Result<Joints, Unreachable> {
        if !position.iter().chain(axis.iter()).all(|v| v.is_finite()) {
            return Err(Unreachable::NotFinite);
        }
        let length = axis.norm();
        if length < SHORTEST_AXIS {
            return Err(Unreachable::NoAxis { length });
        }
        let d = axis / length;
        let slides = position - d * self.tool_length_m;
        let mut best: Option<(f64, Joints)> = None;
        let mut nearest: Option<(f64, Refusal)> = None;
        for (roll, tilt) in angles(&d, near) {
            let q = Joints::from_column_slice(&[slides.x, slides.y, slides.z, roll, tilt]);
            let far = (roll - near[3]).abs() + (tilt - near[4]).abs();
            match limits.check_position(q.as_slice()) {
                Ok(q) if best.is_none_or(|(least, _)| far < least) => best = Some((far, q)),
                Err(why) if nearest.is_none_or(|(least, _)| far < least) => nearest = Some((far, why)),
                _ => {}
            }
        }
        match (best, nearest) {
            (Some((_, q)), _) => Ok(q),
            (None, Some((_, why))) => Err(Unreachable::Limits(why)),
            (None, None) => Err(Unreachable::NotFinite),
        }
    }
}

/// Returns the direction of the tool at `q`, the third column of `Rz(roll)·Rx(tilt)`: (sin r · sin t, −cos r
/// · sin t, cos t).
pub fn tool_axis(q: &Joints) -> Vector3<f64> {
    let (roll, tilt) = (q[3].sin_cos(), q[4].sin_cos());
    Vector3::new(roll.0 * tilt.0, -roll.1 * tilt.0, tilt.1)
}

/// Returns all (roll, tilt) in rad that point the tool along the unit vector `d`: tilt forwards, tilt
/// backwards with the roll half a turn away, and for each roll the whole turns around `near`.
fn angles(d: &Vector3<f64>, near: &Joints) -> impl Iterator<Item = (f64, f64)> {
    let sine = d.x.hypot(d.y);
    let tilt = sine.atan2(d.z);
    let (forwards, backwards) =
        if sine < STRAIGHT { (near[3], near[3]) } else { (d.x.atan2(-d.y), (-d.x).atan2(d.y)) };
    let near = near[3];
    [(forwards, tilt), (backwards, -tilt)].into_iter().flat_map(move |(roll, tilt)| {
        let turns = ((near - roll) / TAU).round();
        [turns - 1.0, turns, turns + 1.0].map(|n| (roll + n * TAU, tilt))
    })
}

/// Why no joints reach the wanted pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unreachable {
    /// NaN or infinite in the position or the axis.
    NotFinite,
    /// The axis is too short to give a direction.
    NoAxis {
        /// Its length.
        length: f64,
    },
    /// The nearest solution leaves a joint's limits.
    Limits(Refusal),
}

impl fmt::Display for Unreachable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Unreachable::NotFinite => write!(f, "the pose holds a value that is not a finite number"),
            Unreachable::NoAxis { length } => {
                write!(f, "the tool axis has length {length:e} and gives no direction: give a unit vector")
            }
            Unreachable::Limits(why) => write!(f, "the pose is out of reach: {why}"),
        }
    }
}

impl std::error::Error for Unreachable {}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: Kinematics = Kinematics { tool_length_m: 0.12 };

    fn random_joints(rng: &mut fastrand::Rng, limits: &Limits) -> Joints {
        Joints::from_fn(|i, _| limits.lower[i] + rng.f64() * (limits.upper[i] - limits.lower[i]))
    }

    fn axis_of(pose: &Isometry3<f64>) -> Vector3<f64> {
        pose.rotation * Vector3::z()
    }

    #[test]
    fn at_zero_the_tip_stands_one_tool_length_up_the_z_axis() {
        let tip = ARM.forward(&Joints::zeros());
        assert_eq!(tip.translation.vector, Vector3::new(0.0, 0.0, 0.12));
        assert_eq!(axis_of(&tip), Vector3::z());
    }

    #[test]
    fn a_quarter_of_tilt_points_the_tool_against_y_and_roll_carries_it_to_x() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let tilted = ARM.forward(&Joints::from_column_slice(&[0.0, 0.0, 0.0, 0.0, quarter]));
        assert!((tilted.translation.vector - Vector3::new(0.0, -0.12, 0.0)).norm() < 1e-15);
        let rolled = ARM.forward(&Joints::from_column_slice(&[0.0, 0.0, 0.0, quarter, quarter]));
        assert!((rolled.translation.vector - Vector3::new(0.12, 0.0, 0.0)).norm() < 1e-15);
    }

    #[test]
    fn forward_of_inverse_gives_the_pose_back_within_1e_9_over_100_000_poses() {
        let limits = Limits::default();
        let mut rng = fastrand::Rng::with_seed(20_240_501);
        for n in 0..100_000 {
            let q = random_joints(&mut rng, &limits);
            let near = random_joints(&mut rng, &limits);
            let tip = ARM.forward(&q);
            let found = ARM
                .inverse(&tip.translation.vector, &axis_of(&tip), &near, &limits)
                .unwrap_or_else(|why| panic!("pose {n} of {q:?}: {why}"));
            let back = ARM.forward(&found);
            let off = (back.translation.vector - tip.translation.vector).norm();
            let turned = (axis_of(&back) - axis_of(&tip)).norm();
            assert!(off <= 1e-9 && turned <= 1e-9, "pose {n} of {q:?}: {off:e} m, {turned:e} rad off");
        }
    }

    #[test]
    fn inverse_gives_the_very_joints_back_when_asked_near_them() {
        let limits = Limits::default();
        let mut rng = fastrand::Rng::with_seed(7);
        for _ in 0..10_000 {
            let q = random_joints(&mut rng, &limits);
            let tip = ARM.forward(&q);
            let found = ARM.inverse(&tip.translation.vector, &axis_of(&tip), &q, &limits).expect("in limits");
            // The roll is known only as well as the tilt lets the axis lean.
            assert!((found - q).norm() <= 1e-12 / q[4].sin().abs().max(1e-9), "{found:?} for {q:?}");
        }
    }

    #[test]
    fn the_jacobian_agrees_with_finite_differences_within_1e_6() {
        let limits = Limits::default();
        let mut rng = fastrand::Rng::with_seed(11);
        let h = 1e-6;
        for _ in 0..10_000 {
            let q = random_joints(&mut rng, &limits);
            let j = ARM.jacobian(&q);
            for i in 0..5 {
                let mut step = Joints::zeros();
                step[i] = h;
                let (behind, ahead) = (ARM.forward(&(q - step)), ARM.forward(&(q + step)));
                let v = (ahead.translation.vector - behind.translation.vector) / (2.0 * h);
                let w = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * h);
                let twist = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
                assert!((j.column(i) - twist).norm() <= 1e-6, "joint {i} at {q:?}: {}", j.column(i) - twist);
            }
        }
    }

    #[test]
    fn a_straight_tool_keeps_its_roll() {
        let near = Joints::from_column_slice(&[0.0, 0.0, 0.0, 0.7, 0.0]);
        let found = ARM
            .inverse(&Vector3::new(0.01, 0.0, 0.12), &Vector3::z(), &near, &Limits::default())
            .expect("straight up is reachable");
        assert_eq!((found[3], found[4]), (0.7, 0.0));
    }

    #[test]
    fn of_two_solutions_inside_wide_limits_the_nearer_is_taken() {
        let wide = Limits { lower: Joints::repeat(-9.0), upper: Joints::repeat(9.0), ..Limits::default() };
        let q = Joints::from_column_slice(&[0.0, 0.0, 0.0, 0.5, 0.3]);
        let tip = ARM.forward(&q);
        let mut near = Joints::zeros();
        (near[3], near[4]) = (0.5 - std::f64::consts::PI, -0.3);
        let found = ARM.inverse(&tip.translation.vector, &axis_of(&tip), &near, &wide).expect("reachable");
        assert!((found - near).fixed_rows::<2>(3).norm() < 1e-12, "{found:?}");
    }

    #[test]
    fn poses_out_of_reach_say_which_joint_and_why() {
        let limits = Limits::default();
        let refused = ARM.inverse(&Vector3::new(0.2, 0.0, 0.12), &Vector3::z(), &Joints::zeros(), &limits);
        assert!(
            matches!(refused, Err(Unreachable::Limits(Refusal::Position { joint: 0, .. }))),
            "{refused:?}"
        );
        let refused = ARM.inverse(&Vector3::zeros(), &Vector3::zeros(), &Joints::zeros(), &limits);
        assert_eq!(refused, Err(Unreachable::NoAxis { length: 0.0 }));
        let refused = ARM.inverse(&Vector3::repeat(f64::NAN), &Vector3::z(), &Joints::zeros(), &limits);
        assert_eq!(refused, Err(Unreachable::NotFinite));
    }
}
