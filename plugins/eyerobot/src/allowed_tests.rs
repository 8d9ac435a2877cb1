//! Setpoints under limits and fixtures: what is wished comes out where it is allowed, and nothing else moves.
//!
//! Invariant: purely the solver on an ideal arm that stands where it is sent; seeds are fixed.

use super::*;
use crate::fixture::{Fixture, Kind, STIFFNESS_PER_S};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

const DT: f64 = 1e-3;

struct Ideal {
    settings: Settings,
    fixtures: Fixtures,
    at: Measured,
}

impl Ideal {
    fn at(q: [f64; COUNT]) -> Ideal {
        let at = Measured { position: Joints::from_column_slice(&q), velocity: Joints::zeros() };
        Ideal { settings: Settings::default(), fixtures: Fixtures::default(), at }
    }

    fn fixed(mut self, list: &[Fixture]) -> Ideal {
        self.fixtures =
            Fixtures::checked(list.iter(), &Isometry3::identity(), &self.stance()).expect("inside");
        self
    }

    fn scene(&self) -> Scene<'_> {
        let (settings, fixtures) = (&self.settings, &self.fixtures);
        Scene { settings, fixtures, from: self.at, measured: self.at.position, dt_s: DT }
    }

    fn stance(&self) -> Stance {
        Stance::of(&self.settings.kinematics, &self.at.position)
    }

    fn tip(&self) -> Vector3<f64> {
        self.stance().tip.translation.vector
    }

    fn go(&mut self, wanted: &Vector6<f64>) -> Allowed {
        let allowed = self.scene().twist(wanted);
        self.at.position += allowed.velocity * DT;
        self.at.velocity = allowed.velocity;
        allowed
    }

    fn twist(&self) -> Vector6<f64> {
        self.settings.kinematics.twist(&self.at.position, &self.at.velocity)
    }
}

fn random_twist(rng: &mut fastrand::Rng, linear: f64, angular: f64) -> Vector6<f64> {
    Vector6::from_fn(|i, _| (2.0 * rng.f64() - 1.0) * if i < 3 { linear } else { angular })
}

fn fixture(kind: Kind, origin: Vector3<f64>, z: Vector3<f64>) -> Fixture {
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &z)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    Fixture { kind, frame: Isometry3::from_parts(origin.into(), turn), stiffness_per_s: STIFFNESS_PER_S }
}

#[test]
fn a_slow_twist_that_five_joints_can_do_comes_out_as_it_was() {
    let mut rng = fastrand::Rng::with_seed(3);
    for _ in 0..200 {
        let mut arm = Ideal::at([0.01, -0.02, 0.0, 0.4, 0.5]);
        let joints = Joints::from_fn(|i, _| (2.0 * rng.f64() - 1.0) * 0.4 * arm.settings.limits.speed[i]);
        let wanted = arm.settings.kinematics.twist(&arm.at.position, &joints);
        for _ in 0..30 {
            arm.at.position = Joints::from_column_slice(&[0.01, -0.02, 0.0, 0.4, 0.5]);
            arm.go(&wanted);
        }
        assert!((arm.at.velocity - joints).amax() < 1e-4 * 0.1, "{:?} for {joints:?}", arm.at.velocity);
    }
}

#[test]
fn limits_of_position_speed_and_acceleration_hold_for_any_wish() {
    for seed in 0..20 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut arm = Ideal::at([0.0499, -0.0495, 0.0, 1.04, -0.78]);
        let mut wanted = Vector6::zeros();
        for n in 0..600 {
            if n % 150 == 0 {
                wanted = random_twist(&mut rng, 0.05, 0.5);
            }
            let before = arm.at.velocity;
            arm.go(&wanted);
            let limits = arm.settings.limits;
            for i in 0..COUNT {
                let (q, v) = (arm.at.position[i], arm.at.velocity[i]);
                assert!(
                    (limits.lower[i]..=limits.upper[i]).contains(&q),
                    "seed {seed} period {n} joint {i}: {q}"
                );
                assert!(v.abs() <= limits.speed[i] * (1.0 + 1e-9), "seed {seed} period {n} joint {i}: {v}");
                let a = (v - before[i]).abs() / DT;
                assert!(a <= limits.acceleration[i] * (1.0 + 1e-6), "seed {seed} period {n} joint {i}: {a}");
            }
        }
    }
}

#[test]
fn a_joint_at_its_limit_is_named_and_the_rest_of_the_wish_goes_on() {
    let mut arm = Ideal::at([0.05, 0.0, 0.0, 0.0, 0.3]);
    let wanted = Vector6::new(0.004, 0.003, 0.0, 0.0, 0.0, 0.0);
    let mut allowed = arm.go(&wanted);
    for _ in 0..100 {
        allowed = arm.go(&wanted);
    }
    assert_eq!(allowed.at_limit, [true, false, false, false, false]);
    let twist = arm.twist();
    assert!(twist[0].abs() < 0.1e-3 && (twist[1] - 0.003).abs() < 0.05e-3, "{twist:?}");
    let turns = twist.fixed_rows::<3>(3).norm();
    assert!(turns < 2e-3, "it bends around the limit with {turns} rad/s");
    assert_eq!(arm.go(&-wanted).at_limit, [false; COUNT]);
}

#[test]
fn the_shaft_stays_within_a_micrometre_of_a_remote_centre_whatever_is_wished() {
    for seed in 0..20 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let arm = Ideal::at([0.0, 0.0, 0.0, rng.f64() - 0.5, 0.2 + 0.3 * rng.f64()]);
        let stance = arm.stance();
        let centre = arm.tip() - stance.axis * 22e-3;
        let rcm = fixture(Kind::Rcm, centre, Vector3::z());
        let mut arm = arm.fixed(&[rcm]);
        let (mut worst, mut way, mut wanted) = (0.0_f64, 0.0, Vector6::zeros());
        for n in 0..1_500 {
            if n % 250 == 0 {
                wanted = random_twist(&mut rng, 0.008, 0.1);
            }
            arm.go(&wanted);
            worst = worst.max(-rcm.distance_m(&arm.stance()));
            way += arm.twist().fixed_rows::<3>(0).norm() * DT;
        }
        assert!(worst <= 1e-6, "seed {seed}: the shaft drifted {worst:e} m");
        assert!(way > 1e-3, "seed {seed}: it went {way} m only");
    }
}

#[test]
fn under_a_remote_centre_the_tip_goes_where_it_is_led() {
    let arm = Ideal::at([0.0, 0.0, 0.0, 0.0, 0.35]);
    let stance = arm.stance();
    let rcm = fixture(Kind::Rcm, arm.tip() - stance.axis * 22e-3, Vector3::z());
    let mut arm = arm.fixed(&[rcm]);
    // Across the tool, in the plane of its tilt, 1 mm/s for 1 s: 45 mrad about the centre.
    let across = stance.axis.cross(&Vector3::x()).normalize();
    let from = arm.tip();
    for _ in 0..1_000 {
        arm.go(&Vector6::new(across.x * 1e-3, across.y * 1e-3, across.z * 1e-3, 0.0, 0.0, 0.0));
    }
    let way = arm.tip() - from;
    assert!((way.dot(&across) - 1e-3).abs() < 20e-6, "{way:?}");
    let turned = arm.stance().axis.angle(&stance.axis);
    assert!((turned - 1.0 / 22.0).abs() < 2e-3, "{turned} rad");
}

#[test]
fn no_wish_brings_the_tip_through_planes_and_along_them_it_goes_on() {
    for seed in 0..20 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let arm = Ideal::at([0.0, 0.0, 0.0, 0.3, 0.4]);
        let tip = arm.tip();
        let normal = Vector3::new(rng.f64() - 0.5, rng.f64() - 0.5, -1.0).normalize();
        let floor = fixture(Kind::Plane, tip - normal * 0.3e-3, normal);
        let wall = fixture(Kind::Plane, tip - Vector3::x() * 0.2e-3, Vector3::x());
        let mut arm = arm.fixed(&[floor, wall]);
        let (mut along, mut nearest) = (0.0, f64::INFINITY);
        for _ in 0..1_500 {
            // Always into the floor, sometimes into the wall.
            let push = random_twist(&mut rng, 0.02, 0.1)
                - Vector6::new(normal.x, normal.y, normal.z, 0.0, 0.0, 0.0) * 0.01;
            arm.go(&push);
            for plane in [&floor, &wall] {
                let left = plane.distance_m(&arm.stance());
                assert!(left > -0.01e-6, "seed {seed}: {left:e} m beyond");
            }
            along += arm.twist()[1].abs() * DT;
            nearest = floor.distance_m(&arm.stance()).min(nearest);
        }
        assert!(nearest < 20e-6, "seed {seed}: it comes to {nearest:e} m of the floor only");
        assert!(along > 0.5e-3, "seed {seed}: it slides {along} m");
    }
}

#[test]
fn on_a_line_the_tip_goes_along_it_only() {
    let arm = Ideal::at([0.0, 0.0, 0.0, 0.2, 0.3]);
    let (from, direction) = (arm.tip(), Vector3::new(1.0, 2.0, -2.0).normalize());
    let line = fixture(Kind::Line, from, direction);
    let mut arm = arm.fixed(&[line]);
    for _ in 0..1_000 {
        arm.go(&Vector6::new(0.003, 0.0, 0.0, 0.0, 0.0, 0.0));
        let beside = -line.distance_m(&arm.stance());
        assert!(beside < 1e-6, "{beside:e} m beside the line");
    }
    let way = (arm.tip() - from).dot(&direction);
    assert!((way - 1e-3).abs() < 30e-6, "a third of the wish lies along it: {way}");
}

#[test]
fn a_planned_motion_that_fixtures_allow_is_left_as_it_is() {
    let arm = Ideal::at([0.0; COUNT]);
    let floor = fixture(Kind::Plane, arm.tip() + Vector3::z() * 1e-3, -Vector3::z());
    let mut arm = arm.fixed(&[floor]);
    let aside = Joints::from_column_slice(&[0.005, 0.0, 0.0, 0.0, 0.0]);
    let at_once = arm.scene().planned(&aside, false).expect("no drive follows that");
    assert!((at_once[0] - 0.5e-3).abs() < 1e-12, "{at_once:?}");
    arm.at.velocity = Joints::from_column_slice(&[0.005, 0.0, 0.0098, 0.0, 0.0]);
    assert_eq!(arm.scene().planned(&(arm.at.velocity * 0.99), false), None);
    let down = Joints::from_column_slice(&[0.005, 0.0, 0.03, 0.0, 0.0]);
    let left = arm.scene().planned(&down, false).expect("faster than a slide");
    assert!((left[0] - 0.005).abs() < 1e-9 && (left[2] - 0.01).abs() < 1e-9, "{left:?}");
}

#[test]
fn an_arm_at_rest_outside_of_a_fixture_stays_and_one_in_motion_comes_back_slowly() {
    let arm = Ideal::at([0.0; COUNT]);
    let floor = fixture(Kind::Plane, arm.tip() - Vector3::z() * 0.09e-3, -Vector3::z());
    let mut arm = arm.fixed(&[floor]);
    assert_eq!(arm.scene().planned(&Joints::zeros(), true), None);
    arm.go(&Vector6::zeros());
    let back = arm.twist();
    assert!((-1e-3 - 1e-9..-0.9e-3).contains(&back[2]), "{back:?}");
}

#[test]
fn fixtures_that_contradict_each_other_stop_the_arm() {
    let arm = Ideal::at([0.0; COUNT]);
    let below = fixture(Kind::Plane, arm.tip() + Vector3::z() * 0.05e-3, Vector3::z());
    let above = fixture(Kind::Plane, arm.tip() - Vector3::z() * 0.05e-3, -Vector3::z());
    let mut arm = arm.fixed(&[below, above]);
    arm.at.velocity[0] = 0.01;
    let allowed = arm.go(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.0, 0.0));
    assert_eq!(allowed.velocity, Joints::zeros());
}
