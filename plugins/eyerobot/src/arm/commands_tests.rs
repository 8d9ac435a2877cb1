//! The CRTK motions beyond servo_jp and move_jp, hands-on control, the axis, and what is refused.
//!
//! Invariant: time is counted in periods of `DT`, never read from a clock.

use super::*;
use crate::drive::{SimulatedDrive, Simulation};
use crate::fixture::{FixtureRefused, Kind};
use crate::joints::COUNT;
use nalgebra::UnitQuaternion;

pub(in crate::arm) const DT: f64 = 1e-3;

pub(in crate::arm) fn ready() -> Arm<SimulatedDrive> {
    let home = Joints::zeros();
    let mut arm = Arm::new(Settings::default(), SimulatedDrive::new(Simulation::default(), home), home);
    arm.state_command("enable").expect("from DISABLED");
    arm.state_command("home").expect("from ENABLED");
    arm.step(DT);
    arm
}

pub(in crate::arm) fn steps(arm: &mut Arm<SimulatedDrive>, count: usize) {
    (0..count).for_each(|_| arm.step(DT));
}

fn tip(arm: &Arm<SimulatedDrive>) -> Vector3<f64> {
    arm.setpoint_cp().translation.vector
}

fn along_z(v: f64) -> Vector6<f64> {
    Vector6::new(0.0, 0.0, v, 0.0, 0.0, 0.0)
}

#[test]
fn relative_motions_change_the_setpoint_by_what_is_given() {
    let mut arm = ready();
    arm.servo_jr(&[0.001, 0.0, 0.0, 0.02, 0.0]).expect("inside");
    steps(&mut arm, 400);
    arm.servo_jr(&[0.001, 0.0, -0.002, 0.0, 0.1]).expect("inside");
    steps(&mut arm, 1_200);
    let wanted = Joints::from_column_slice(&[0.002, 0.0, -0.002, 0.02, 0.1]);
    assert!((arm.setpoint().position - wanted).amax() < 1e-12, "{:?}", arm.setpoint());
    arm.move_jr(&[0.0, 0.003, 0.0, 0.0, 0.0]).expect("inside");
    assert!(arm.operating().is_busy());
    steps(&mut arm, 600);
    assert!((arm.setpoint().position[1] - 0.003).abs() < 1e-12 && !arm.operating().is_busy());
    let refused = arm.servo_jr(&[0.0, 0.048, 0.0, 0.0, 0.0]).expect_err("beyond the travel");
    assert!(refused.to_string().contains("joint y: 0.051"), "{refused}");
}

#[test]
fn servo_cr_adds_the_translation_and_turns_the_tip_about_itself() {
    let mut arm = ready();
    let before = arm.setpoint_cp();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.05);
    let change = Isometry3::from_parts(Vector3::new(0.001, 0.0, -0.002).into(), turn);
    arm.servo_cr(&change).expect("reachable");
    steps(&mut arm, 1_500);
    let after = arm.setpoint_cp();
    let moved = after.translation.vector - before.translation.vector;
    assert!((moved - change.translation.vector).norm() < 1e-9, "{moved:?}");
    let axis = after.rotation * Vector3::z();
    assert!((axis - turn * Vector3::z()).norm() < 1e-9, "{axis:?}");
    arm.move_cr(&change.inverse()).expect("reachable");
    steps(&mut arm, 2_000);
    assert!((tip(&arm) - before.translation.vector).norm() < 5e-4);
    assert_eq!(arm.take_news().reached, 1);
}

#[test]
fn servo_cv_moves_the_tip_along_its_twist_and_holds_when_it_is_not_repeated() {
    let mut arm = ready();
    let from = tip(&arm);
    for _ in 0..500 {
        arm.servo_cv(&Vector6::new(0.003, -0.004, 0.0, 0.0, 0.0, 0.0)).expect("slower than a slide");
        arm.step(DT);
    }
    let speed = arm.setpoint_cv();
    assert!((speed - Vector6::new(0.003, -0.004, 0.0, 0.0, 0.0, 0.0)).norm() < 1e-7, "{speed:?}");
    assert!(!arm.is_position_based() && arm.goal().is_none());
    steps(&mut arm, 200);
    assert!(arm.setpoint_cv().norm() == 0.0 && arm.is_position_based());
    let way = tip(&arm) - from;
    // 0.5 s and the timeout of 8 ms.
    assert!((way - Vector3::new(0.00152, -0.00203, 0.0)).norm() < 0.02e-3, "{way:?}");
}

#[test]
fn a_turn_of_the_tip_leaves_it_where_it_is() {
    let mut arm = ready();
    arm.move_jp(&[0.0, 0.0, 0.0, 0.3, 0.4]).expect("inside");
    steps(&mut arm, 4_000);
    let (from, axis) = (tip(&arm), arm.setpoint_cp().rotation * Vector3::z());
    let turn = axis.cross(&Vector3::y()).normalize() * 0.04;
    for _ in 0..1_000 {
        arm.servo_cv(&Vector6::new(0.0, 0.0, 0.0, turn.x, turn.y, turn.z)).expect("slower than a joint");
        arm.step(DT);
    }
    let turned = (arm.setpoint_cp().rotation * Vector3::z()).angle(&axis);
    assert!((turned - 0.04).abs() < 2e-3, "{turned} rad");
    assert!((tip(&arm) - from).norm() < 20e-6, "{:?}", tip(&arm) - from);
}

#[test]
fn twists_that_are_too_fast_or_no_numbers_are_refused_with_the_limit() {
    let mut arm = ready();
    let refused = arm.servo_cv(&along_z(0.02)).expect_err("20 mm/s");
    assert_eq!(refused.to_string(), "linear speed of the tip: 0.02 m/s is above its limit of 0.01 m/s");
    let spin = Vector6::new(0.0, 0.0, 0.0, 0.0, 1.0, 0.0);
    assert!(matches!(arm.servo_axis(&spin), Err(ArmError::Above { what: "angular speed", .. })));
    assert!(arm.servo_cv(&along_z(f64::NAN)).is_err());
    let refused = arm.follow(&along_z(21.0)).expect_err("21 N");
    assert_eq!(refused.to_string(), "force of the tip: 21 N is above its limit of 20 N");
    assert!(arm.follow(&along_z(f64::INFINITY)).is_err());
}

#[test]
fn the_hand_is_followed_only_while_it_was_asked_for() {
    let mut arm = ready();
    let from = tip(&arm);
    arm.feel(&along_z(1.0));
    steps(&mut arm, 500);
    assert_eq!(tip(&arm), from, "a hand on the handle of an arm that holds");
    for _ in 0..100 {
        arm.follow(&Vector6::zeros()).expect("ready");
        arm.step(DT);
    }
    steps(&mut arm, 400);
    let way = tip(&arm).z - from.z;
    assert!((way - 0.108e-3).abs() < 5e-6, "0.1 s and 8 ms at 1 mm/s are 0.108 mm, not {way}");
    arm.free().expect("ready");
    steps(&mut arm, 2_000);
    let more = tip(&arm).z - from.z - way;
    assert!((more - 2e-3).abs() < 40e-6, "2 s at 1 mm/s are 2 mm, not {more}");
    arm.hold();
    steps(&mut arm, 100);
    let stands = tip(&arm);
    steps(&mut arm, 300);
    assert_eq!(tip(&arm), stands);
}

#[test]
fn the_axis_is_added_to_the_hand_and_to_a_scan_and_ends_by_itself() {
    let mut arm = ready();
    arm.move_jp(&[0.0, 0.0, 0.0, 0.0, 0.2]).expect("inside");
    steps(&mut arm, 3_000);
    let axis = arm.setpoint_cp().rotation * Vector3::z();
    let scan = Vector6::new(0.002, 0.0, 0.0, 0.0, 0.0, 0.0);
    let along = Vector6::new(axis.x, axis.y, axis.z, 0.0, 0.0, 0.0) * 0.001;
    for _ in 0..300 {
        arm.servo_cv(&scan).expect("slow");
        // Only the part along the tool counts.
        arm.servo_axis(&(along + scan * 2.0)).expect("slow");
        arm.step(DT);
    }
    assert!((arm.setpoint_cv() - scan - along).norm() < 1e-7, "{:?}", arm.setpoint_cv());
    for _ in 0..300 {
        arm.servo_cv(&scan).expect("slow");
        arm.step(DT);
    }
    assert!((arm.setpoint_cv() - scan).norm() < 1e-7, "the axis is over: {:?}", arm.setpoint_cv());
    arm.feel(&Vector6::new(0.0, 1.0, 0.0, 0.0, 0.0, 0.0));
    arm.free().expect("ready");
    let across = arm.setpoint_cp().rotation * Vector3::y() * 1e-3;
    for _ in 0..500 {
        arm.servo_axis(&along).expect("slow");
        arm.step(DT);
    }
    let sum = Vector6::new(across.x, across.y, across.z, 0.0, 0.0, 0.0) + along;
    assert!((arm.setpoint_cv() - sum).norm() < 1e-7, "{:?}", arm.setpoint_cv());
    steps(&mut arm, 300);
    assert!((arm.setpoint_cv() - sum + along).norm() < 1e-7, "the hand goes on: {:?}", arm.setpoint_cv());
}

#[test]
fn the_axis_ends_a_move_and_a_servo_goal_ends_the_axis() {
    let mut arm = ready();
    arm.move_jp(&[0.02, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps(&mut arm, 200);
    arm.servo_axis(&along_z(0.001)).expect("slow");
    assert_eq!((arm.take_news().missed, arm.operating().is_busy()), (1, false));
    arm.servo_jp(&[0.0; COUNT]).expect("inside");
    arm.servo_cv(&Vector6::zeros()).expect("slow");
    steps(&mut arm, 50);
    assert!(arm.setpoint_cv()[2].abs() < 1e-9, "an old velocity of the axis came back");
}

#[test]
fn interpolated_goals_are_met_smoothly_without_being_busy() {
    let mut arm = ready();
    let (mut before, most) = (arm.setpoint().velocity, arm.settings().limits.acceleration * DT);
    for n in 0..20 {
        let x = 0.004 * (0.3 * f64::from(n)).sin();
        arm.interpolate_jp(&[x, 0.0, 0.0, 0.0, 0.0]).expect("inside");
        assert!(!arm.operating().is_busy());
        for _ in 0..100 {
            arm.step(DT);
            let jump = (arm.setpoint().velocity - before).abs();
            assert!((0..COUNT).all(|i| jump[i] <= most[i] * 1.01), "{jump:?}");
            before = arm.setpoint().velocity;
        }
    }
    let goal = arm.pose_at(&Joints::from_column_slice(&[0.001, 0.001, 0.0, 0.0, 0.01]));
    arm.interpolate_cp(&goal).expect("reachable");
    steps(&mut arm, 2_000);
    assert!((tip(&arm) - goal.translation.vector).norm() < 1e-9);
    assert_eq!(arm.take_news().reached, 0, "only moves tell their end");
}

#[test]
fn the_end_of_a_move_is_told_whether_it_arrived_or_not() {
    let mut arm = ready();
    arm.move_jp(&[0.002, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps(&mut arm, 100);
    arm.move_jp(&[-0.002, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    assert_eq!((arm.take_news().missed, arm.goal().map(|g| g[0])), (1, Some(-0.002)));
    steps(&mut arm, 1_000);
    let news = arm.take_news();
    assert_eq!((news.reached, news.missed), (1, 0));
    for end in ["hold", "pause", "make_safe", "disable"] {
        let _ = arm.state_command("resume");
        arm.move_jp(&[0.002, 0.0, 0.0, 0.0, 0.0]).unwrap_or_else(|why| panic!("{end}: {why}"));
        steps(&mut arm, 50);
        match end {
            "hold" => arm.hold(),
            "make_safe" => arm.make_safe(),
            word => arm.state_command(word).expect("enabled"),
        }
        let news = arm.take_news();
        assert_eq!((news.reached, news.missed), (0, 1), "{end}");
    }
}

#[test]
fn poses_and_twists_are_in_the_base_frame_that_was_set() {
    let mut arm = ready();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let base = Isometry3::from_parts(Vector3::new(0.1, 0.2, 0.3).into(), turn);
    let local = arm.local_cp();
    arm.set_base_frame(&base);
    assert!((arm.measured_cp().translation.vector - (base * local).translation.vector).norm() < 1e-12);
    assert_eq!(arm.local_cp(), local);
    let goal =
        base * arm.settings().kinematics.forward(&Joints::from_column_slice(&[0.001, 0.0, 0.0, 0.0, 0.0]));
    arm.servo_cp(&goal).expect("reachable");
    steps(&mut arm, 500);
    assert!((arm.setpoint().position[0] - 0.001).abs() < 1e-9, "{:?}", arm.setpoint());
    for _ in 0..100 {
        arm.servo_cv(&Vector6::new(0.0, 0.002, 0.0, 0.0, 0.0, 0.0)).expect("slow");
        arm.step(DT);
    }
    let v = arm.setpoint().velocity;
    assert!((v[0] - 0.002).abs() < 1e-7 && v[1].abs() < 1e-7, "y of the base is x of the arm: {v:?}");
}

#[test]
fn gains_are_of_the_tip_and_refused_outside_their_range() {
    let mut arm = ready();
    arm.set_gain(&Vector6::new(0.0, 0.0, 2e-3, 0.0, 0.0, 0.0)).expect("in range");
    arm.feel(&Vector6::new(1.0, 1.0, 1.0, 0.1, 0.0, 0.0));
    arm.free().expect("ready");
    steps(&mut arm, 1_000);
    assert!((arm.setpoint_cv() - along_z(2e-3)).norm() < 1e-7, "{:?}", arm.setpoint_cv());
    let refused = arm.set_gain(&along_z(0.006)).expect_err("too high");
    assert_eq!(refused.to_string(), "gain[2]: 0.006 m/(s·N) is outside 0 … 0.005 m/(s·N)");
    let turning = Vector6::new(0.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    assert!(matches!(arm.set_gain(&turning), Err(ArmError::Gain { place: 4, .. })));
    assert!(arm.set_gain(&along_z(f64::NAN)).is_err());
    assert_eq!(arm.gain()[2], 2e-3, "a refused gain changes nothing");
}

#[test]
fn fixtures_that_cannot_be_are_refused_and_those_before_stay() {
    let mut arm = ready();
    let at = arm.setpoint_cp();
    let plane = |z: f64, stiffness_per_s: f64| Fixture {
        kind: Kind::Plane,
        frame: Isometry3::translation(0.0, 0.0, at.translation.z + z),
        stiffness_per_s,
    };
    arm.set_fixtures([plane(-1e-3, 20.0)].iter()).expect("1 mm away");
    let beyond = [plane(-1e-3, 20.0), plane(1e-3, 20.0)];
    let refused = arm.set_fixtures(beyond.iter()).expect_err("the tip is beyond it");
    assert_eq!(
        refused.to_string(),
        "fixture 1: the tip is beyond the plane by 1.000 mm; bring it within 0.1 mm first"
    );
    let stiff = arm.set_fixtures([plane(-1e-3, 31.0)].iter());
    assert!(matches!(stiff, Err(ArmError::Fixture(FixtureRefused::Stiffness { place: 0, .. }))), "{stiff:?}");
    let many = [plane(-1e-3, 20.0); 9];
    assert_eq!(arm.set_fixtures(many.iter()), Err(ArmError::Fixture(FixtureRefused::TooMany)));
    assert_eq!(arm.fixtures().iter().count(), 1);
}

#[test]
fn a_move_that_a_plane_keeps_away_stops_there_and_says_that_it_missed() {
    let mut arm = ready();
    let at = arm.setpoint_cp().translation.z;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let frame = Isometry3::from_parts(Vector3::new(0.0, 0.0, at + 1e-3).into(), turn);
    let plane = Fixture { kind: Kind::Plane, frame, stiffness_per_s: 20.0 };
    arm.set_fixtures([plane].iter()).expect("1 mm away");
    arm.move_jp(&[0.002, 0.0, 0.003, 0.0, 0.0]).expect("inside the joints' limits");
    let mut deepest = 0.0_f64;
    for _ in 0..3_000 {
        arm.step(DT);
        deepest = deepest.max(arm.measured_cp().translation.z - at);
    }
    assert!((0.99e-3..1.002e-3).contains(&deepest), "{deepest}");
    let news = arm.take_news();
    assert_eq!((news.missed, news.reached, arm.operating().is_busy()), (1, 0, false));
    assert!((arm.setpoint().position[0] - 0.002).abs() < 1e-5, "it slides along the plane");
    arm.move_jp(&[0.0; COUNT]).expect("back");
    steps(&mut arm, 1_000);
    assert_eq!(arm.take_news().reached, 1);
}
