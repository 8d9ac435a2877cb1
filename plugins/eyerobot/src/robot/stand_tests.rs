//! Place of the component at the eye: rest pose, base frame, port.
#![allow(clippy::unwrap_used)]

use nalgebra::{Point3, Vector3};
use trocar_sdk::data::{Pose, Twist};
use trocar_sdk::testing::Bench;

use super::EyeRobot;
use super::bench::{joints, operating, say};

const FROM_THE_SIDE: &str = r#"{"rest_roll_rad": -0.785, "rest_tilt_rad": 0.48, "port_m": 0.022}"#;

fn pose(bench: &Bench<EyeRobot>, read: &str) -> nalgebra::Isometry3<f64> {
    bench.read::<(), Pose>(read, ()).unwrap().isometry().unwrap()
}

#[test]
fn a_new_arm_stands_at_its_rest_pose_homed_and_points_at_the_origin_of_the_world() {
    for (config, leans_rad) in [("{}", 0.0), (FROM_THE_SIDE, 0.48)] {
        let mut bench = Bench::<EyeRobot>::new(config);
        bench.step(1);
        assert!(operating(&bench).is_homed.get());
        let world = pose(&bench, "truth/measured_cp");
        let ahead = world * Point3::new(0.0, 0.0, 1e-3);
        assert!(ahead.coords.norm() < 1e-6, "{ahead:?}");
        let axis = world.rotation * Vector3::z();
        assert!((axis.z.acos() - leans_rad).abs() < 1e-4, "{axis:?}");
        let base = pose(&bench, "arm/measured_cp") * Point3::new(0.0, 0.0, 1e-3);
        assert!((base - Point3::new(0.0, 0.0, 0.121)).norm() < 2e-6, "{base:?}");
    }
}

#[test]
fn home_brings_the_arm_back_to_its_rest_pose() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"rest_roll_rad": 0.3, "rest_tilt_rad": 0.2}"#);
    bench.step(1);
    bench.command::<_, ()>("arm/move_jp", joints([1e-3, 0.0, 0.0, 0.31, 0.21])).unwrap();
    bench.step(2_000);
    assert!(say(&mut bench, "unhome") && say(&mut bench, "home"));
    bench.step(2_000);
    let at: trocar_sdk::data::JointState = bench.read("arm/measured_js", ()).unwrap();
    for (is, wanted) in at.position.iter().zip([0.0, 0.0, 0.0, 0.3, 0.2]) {
        assert!((is - wanted).abs() < 1e-4, "{:?}", at.position);
    }
    assert!(operating(&bench).is_homed.get());
}

#[test]
fn the_shaft_stays_in_its_port_whatever_the_tip_does_and_whatever_fixtures_are_taken_away() {
    let mut bench = Bench::<EyeRobot>::new(FROM_THE_SIDE);
    bench.step(1);
    let port = pose(&bench, "truth/measured_cp") * Point3::new(0.0, 0.0, -0.022);
    bench.command::<_, ()>("virtual_fixture/set", crate::payloads::VirtualFixtures::default()).unwrap();
    let (mut farthest_m, mut moved_m) = (0.0f64, 0.0f64);
    let first = pose(&bench, "truth/measured_cp").translation.vector;
    for n in 0..2_000 {
        let angle = f64::from(n) * 3e-3;
        let twist = Twist {
            stamp: bench.now(),
            linear: [2e-3 * angle.cos(), 2e-3 * angle.sin(), 0.0],
            ..Twist::default()
        };
        bench.command::<_, ()>("arm/servo_cv", twist).unwrap();
        bench.step(1);
        let tip = pose(&bench, "truth/measured_cp");
        let off = tip.inverse_transform_point(&port);
        farthest_m = farthest_m.max(off.x.hypot(off.y));
        moved_m = moved_m.max((tip.translation.vector - first).norm());
    }
    assert!(moved_m > 0.5e-3, "{moved_m:e}");
    assert!(farthest_m < 20e-6, "{farthest_m:e} m beside its port");
}

#[test]
fn a_rest_pose_out_of_reach_and_a_port_beside_the_shaft_are_refused_with_what_to_do() {
    let refused =
        |bench: &mut Bench<EyeRobot>, config: &str| bench.configure(config).unwrap_err().to_string();
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.stop().unwrap();
    let why = refused(&mut bench, r#"{"rest_tilt_rad": 0.9}"#);
    let beyond = "rest_tilt_rad: 0.9 rad is beyond the joint's travel of 0.7853981633974483 rad to each side";
    assert!(why.starts_with(beyond), "{why}");
    bench.start().unwrap();
    bench.step(1);
    bench.command::<_, ()>("arm/move_jp", joints([1e-3, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(2_000);
    bench.stop().unwrap();
    let why = refused(&mut bench, r#"{"port_m": 0.022}"#);
    let beside =
        "port_m: the shaft passes 1.000 mm beside a port 22 mm from the tip at home; send the arm home first";
    assert!(why.starts_with(beside), "{why}");
}
