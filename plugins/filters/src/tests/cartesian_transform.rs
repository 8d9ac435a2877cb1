//! `cartesian_transform`: sides, inverses, and transforms that come in.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_sdk::data::Transform;

use super::*;

#[test]
fn poses_are_multiplied_on_the_side_asked_for() {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.5));
    let by = Isometry3::from_parts(Vector3::new(0.1, 0.2, 0.3).into(), turn);
    let pose = Isometry3::new(Vector3::new(-1.0, 0.5, 0.0), Vector3::new(0.0, 0.7, 0.0));
    let q = turn.coords;
    for (more, wanted) in [
        ("", by * pose),
        (r#", "side": "behind""#, pose * by),
        (r#", "inverse": true"#, by.inverse() * pose),
        (r#", "inverse": true, "side": "behind""#, pose * by.inverse()),
    ] {
        let config = format!(
            r#"{{"translation_m": [0.1, 0.2, 0.3], "rotation": [{}, {}, {}, {}]{more}}}"#,
            q.x, q.y, q.z, q.w
        );
        let mut bench = Bench::<CartesianTransform>::new(config);
        let stamp = bench.now();
        bench.push("pose", Pose { stamp, ..pose.into() });
        bench.step(1);
        let out = bench.outputs::<Pose>("transformed")[0];
        let off = out.isometry().unwrap().to_homogeneous() - wanted.to_homogeneous();
        assert!(off.norm() < 1e-12 && out.stamp == stamp, "{more}: {off}");
    }
}

#[test]
fn a_transform_that_comes_in_takes_the_place_of_the_configured_one() {
    let mut bench = Bench::<CartesianTransform>::new(r#"{"translation_m": [1, 0, 0]}"#);
    let x = |bench: &mut Bench<CartesianTransform>| {
        bench.push("pose", Pose::default());
        bench.step(1);
        bench.outputs::<Pose>("transformed").first().map(|pose| pose.position[0])
    };
    assert_eq!(x(&mut bench), Some(1.0));
    let live = Isometry3::translation(5.0, 0.0, 0.0);
    bench.push("transform", Transform::between("base", "tool", live));
    assert_eq!(x(&mut bench), Some(5.0));
    bench.make_stale("transform");
    assert_eq!(x(&mut bench), None, "an old transform is none");
    bench.push("transform", Transform::default());
    bench.push("pose", Pose { orientation: [0.0; 4], ..Pose::default() });
    bench.step(1);
    assert_eq!(bench.state().rejected, 2);
    let why = refused::<CartesianTransform>(r#"{"rotation": [0, 0, 0, 2]}"#);
    assert_eq!(why, "rotation: its norm is 2; give a unit quaternion x, y, z, w");
}

#[test]
fn poses_and_transforms_that_are_too_old_are_left_out() {
    let mut bench = Bench::<CartesianTransform>::new("{}");
    let x = |bench: &mut Bench<CartesianTransform>, pose_age_ms: u64| {
        let stamp = Stamp::from_ns(bench.now().ns() - pose_age_ms * 1_000_000);
        bench.push("pose", Pose { stamp, ..Pose::default() });
        bench.step(1);
        bench.outputs::<Pose>("transformed").first().map(|pose| pose.position[0])
    };
    assert_eq!(x(&mut bench, 90), Some(0.0));
    assert_eq!(x(&mut bench, 110), None, "the pose is too old");
    bench.push("transform", Transform::between("a", "b", Isometry3::translation(5.0, 0.0, 0.0)));
    assert_eq!(x(&mut bench, 0), Some(5.0));
    bench.step(60);
    assert_eq!(x(&mut bench, 0), Some(5.0));
    bench.step(60);
    assert_eq!(x(&mut bench, 0), None, "the transform is too old for this pose");
    assert_eq!(x(&mut bench, 50), Some(5.0), "and not for an earlier one");
    bench.connect_input("transform", false);
    assert_eq!(x(&mut bench, 0), None, "the configured one does not come back by itself");
    assert_eq!(bench.state().rejected, 3);
    bench.configure(r#"{"max_age_s": 0}"#).unwrap();
    assert_eq!(x(&mut bench, 800), Some(5.0), "any age");
}

#[test]
fn a_transform_of_a_clock_that_is_ahead_is_as_old_as_its_coming() {
    let mut bench = Bench::<CartesianTransform>::new(r#"{"max_age_s": 0.1}"#);
    let ahead = |bench: &Bench<CartesianTransform>| Stamp::from_ns(bench.now().ns() + 900_000_000);
    let x = |bench: &mut Bench<CartesianTransform>, stamp: Stamp| {
        bench.push("pose", Pose { stamp, ..Pose::default() });
        bench.step(1);
        bench.outputs::<Pose>("transformed").first().map(|pose| pose.position[0])
    };
    let stamp = ahead(&bench);
    let by = Transform::between("a", "b", Isometry3::translation(5.0, 0.0, 0.0));
    bench.push_at("transform", by, stamp);
    assert_eq!(x(&mut bench, stamp), Some(5.0), "both are of one clock");
    bench.step(60);
    let stamp = ahead(&bench);
    assert_eq!(x(&mut bench, stamp), Some(5.0));
    bench.step(60);
    for stamp in [ahead(&bench), bench.now()] {
        assert_eq!(x(&mut bench, stamp), None, "it has been silent for more than 0.1 s");
    }
}
