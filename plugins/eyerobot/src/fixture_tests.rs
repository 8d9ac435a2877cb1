//! Distances and half-spaces of fixtures against finite differences of the kinematics.
//!
//! Invariant: fixed seeds; the arm is nothing but its kinematics here.

use super::*;
use crate::joints::Limits;

const ARM: Kinematics = Kinematics { tool_length_m: 0.12 };

fn random(rng: &mut fastrand::Rng) -> Joints {
    let Limits { lower, upper, .. } = Limits::default();
    Joints::from_fn(|i, _| lower[i] + rng.f64() * (upper[i] - lower[i]))
}

#[test]
fn a_point_of_the_shaft_moves_as_its_row_says() {
    let mut rng = fastrand::Rng::with_seed(5);
    let h = 1e-6;
    for _ in 0..1_000 {
        let q = random(&mut rng);
        let at = Stance::of(&ARM, &q);
        let back_m = 0.03 * rng.f64();
        let direction = Vector3::new(rng.f64() - 0.5, rng.f64() - 0.5, rng.f64() - 0.5).normalize();
        let row = at.along(&direction, &(at.axis * -back_m));
        let point = |q: &Joints| {
            let at = Stance::of(&ARM, q);
            at.tip_m() - at.axis * back_m
        };
        for i in 0..COUNT {
            let mut step = Joints::zeros();
            step[i] = h;
            let slope = (point(&(q + step)) - point(&(q - step))).dot(&direction) / (2.0 * h);
            assert!((slope - row[i]).abs() < 1e-8, "joint {i}: {slope} instead of {}", row[i]);
        }
    }
}

#[test]
fn inside_every_fixture_zero_velocity_is_allowed() {
    let mut rng = fastrand::Rng::with_seed(6);
    for n in 0..1_000 {
        let q = random(&mut rng);
        let at = Stance::of(&ARM, &q);
        let frame = Isometry3::from_parts(at.tip.translation, at.tip.rotation);
        let kind = [Kind::Plane, Kind::Line, Kind::Rcm][n % 3];
        let fixture = Fixture { kind, frame, stiffness_per_s: STIFFNESS_PER_S };
        let mut set = HalfSpaces::default();
        fixture.restrict(&at, &at, false, &mut set);
        assert!(set.hold(&Joints::zeros()), "{kind:?} at {q:?}");
        assert_eq!(set.len(), if kind == Kind::Plane { 1 } else { 4 });
    }
}

#[test]
fn to_a_plane_the_nearer_of_setpoint_and_encoders_counts() {
    let q = Joints::zeros();
    let (at, mut deeper) = (Stance::of(&ARM, &q), q);
    deeper[2] = 0.1e-3;
    let frame = Isometry3::from_parts(
        Vector3::new(0.0, 0.0, 0.1202).into(),
        nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
    );
    let plane = Fixture { kind: Kind::Plane, frame, stiffness_per_s: 10.0 };
    assert!((plane.distance_m(&at) - 0.2e-3).abs() < 1e-12);
    for (measured, most) in [(at, 2e-3), (Stance::of(&ARM, &deeper), 1e-3)] {
        let mut set = HalfSpaces::default();
        plane.restrict(&at, &measured, false, &mut set);
        let (row, bound) = set.iter().next().expect("one");
        assert!((row[2] - 1.0).abs() < 1e-12 && (bound - most).abs() < 1e-12, "{row:?} {bound}");
    }
}

#[test]
fn the_distance_of_a_remote_centre_is_that_of_the_shafts_line() {
    let at = Stance::of(&ARM, &Joints::zeros());
    let rcm = |x: f64, z: f64| Fixture {
        kind: Kind::Rcm,
        frame: Isometry3::translation(x, 0.0, z),
        stiffness_per_s: STIFFNESS_PER_S,
    };
    assert!((rcm(0.3e-3, 0.1).distance_m(&at) + 0.3e-3).abs() < 1e-12);
    assert!(rcm(0.0, -0.4).distance_m(&at).abs() < 1e-12);
}
