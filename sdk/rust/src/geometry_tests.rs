//! Round trips over many values, and refused values.
#![allow(clippy::unwrap_used)]

use super::*;
use nalgebra::Vector3;
use proptest::prelude::*;

fn six() -> impl Strategy<Value = [f64; 6]> {
    prop::array::uniform6(-1e3..1e3f64)
}

proptest! {
    #[test]
    fn a_pose_survives_the_way_to_nalgebra_and_back(v in six()) {
        let t = Isometry3::new(Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]));
        let pose = Pose::from(t);
        let back = pose.isometry().unwrap();
        prop_assert!((back.translation.vector - t.translation.vector).norm() == 0.0);
        prop_assert!(back.rotation.angle_to(&t.rotation) < 1e-7);
        prop_assert!((Pose::from(back).isometry().unwrap().rotation.coords - back.rotation.coords).norm() < 1e-12);
    }

    #[test]
    fn twists_and_wrenches_survive_the_way_to_a_vector_and_back(v in six()) {
        let v = Vector6::from(v);
        prop_assert_eq!(Twist::from(v).vector().unwrap(), v);
        prop_assert_eq!(Wrench::from(v).vector().unwrap(), v);
    }

    #[test]
    fn joints_survive_the_way_to_a_joint_state_and_back(q in six(), v in six(), f in six()) {
        let [q, v, f] = [q, v, f].map(Vector6::from);
        let state = JointState::default().with_positions(&q).with_velocities(&v).with_efforts(&f);
        prop_assert_eq!(state.positions::<6>().unwrap(), q);
        prop_assert_eq!(state.velocities::<6>().unwrap(), v);
        prop_assert_eq!(state.efforts::<6>().unwrap(), f);
        let only = JointState::default().with_velocities(&v);
        prop_assert!(only.position.is_empty() && only.effort.is_empty(), "the others stay as they were");
    }

    #[test]
    fn a_transform_survives_the_way_to_nalgebra_and_back(v in six(), w in six()) {
        let isometry = |v: [f64; 6]| {
            Isometry3::new(Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
        };
        let (t, u) = (isometry(v), isometry(w));
        let eye_from_tool = Transform::between("eye", "tool", t);
        prop_assert_eq!((eye_from_tool.parent.as_str(), eye_from_tool.child.as_str()), ("eye", "tool"));
        let back = eye_from_tool.isometry().unwrap();
        prop_assert!((back.translation.vector - t.translation.vector).norm() == 0.0);
        prop_assert!(back.rotation.angle_to(&t.rotation) < 1e-7);
        let chained = Transform::between("world", "tool", u * back).isometry().unwrap();
        prop_assert!((chained.translation.vector - (u * t).translation.vector).norm() < 1e-9);
    }

    #[test]
    fn an_orientation_whose_length_is_not_one_is_refused(
        v in prop::array::uniform4(-1.0..1.0f64), length in prop_oneof![0.0..0.99f64, 1.01..100.0f64]
    ) {
        let q = Quaternion::from(v);
        prop_assume!(q.norm() > 1e-3);
        let orientation: [f64; 4] = (q / q.norm() * length).coords.into();
        let refused = Pose { orientation, ..Pose::default() }.isometry().unwrap_err();
        prop_assert!(refused.to_string().contains("no unit quaternion"), "{}", refused);
    }

    #[test]
    fn whatever_the_bits_are_a_pose_is_an_isometry_of_finite_numbers_or_refused(bits in prop::array::uniform7(any::<u64>())) {
        let f = bits.map(f64::from_bits);
        let pose = Pose { position: [f[0], f[1], f[2]], orientation: [f[3], f[4], f[5], f[6]], ..Pose::default() };
        if let Ok(t) = pose.isometry() {
            prop_assert!(t.to_homogeneous().iter().all(|x| x.is_finite()));
        }
    }
}

#[test]
fn a_number_that_is_not_finite_is_named_with_its_place() {
    let nan = Pose { position: [0.0, f64::NAN, 0.0], ..Pose::default() };
    assert_eq!(nan.isometry().unwrap_err().to_string(), "position[1] is NaN: give a finite number");
    let endless = Twist { angular: [0.0, 0.0, f64::INFINITY], ..Twist::default() };
    assert_eq!(endless.vector().unwrap_err().to_string(), "angular[2] is inf: give a finite number");
    let nowhere = Wrench { torque: [f64::NEG_INFINITY, 0.0, 0.0], ..Wrench::default() };
    assert!(nowhere.vector().is_err());
    assert!(Isometry3::try_from(&Pose { orientation: [0.0; 4], ..Pose::default() }).is_err());
}

#[test]
fn a_quaternion_rounded_to_four_decimals_is_taken_and_normalised() {
    let pose = Pose { orientation: [0.6, 0.0, 0.0, 0.8001], ..Pose::default() };
    assert!((pose.isometry().unwrap().rotation.norm() - 1.0).abs() < 1e-15);
}

#[test]
fn joints_become_a_vector_of_the_arms_length_or_are_refused() {
    let state = JointState { position: List::of(&[1.0, 2.0, 3.0]), ..JointState::default() };
    assert_eq!(state.positions::<3>().unwrap(), Vector3::new(1.0, 2.0, 3.0));
    let short = state.positions::<5>().unwrap_err();
    assert_eq!(short.to_string(), "position has 3 items, this arm has 5 joints: give one per joint");
    assert!(state.velocities::<3>().is_err() && state.efforts::<3>().is_err());
}

#[test]
fn a_pose_is_carried_by_its_twist_for_a_bounded_time_to_either_side() {
    let stamp = Stamp::from_ns(5_000_000_000);
    let mut state = CartesianState { stamp, ..CartesianState::default() };
    state.twist.linear = [0.0, 0.1, 0.0];
    state.twist.angular = [0.0, 0.0, 2.0];
    let at = |state: &CartesianState, ms: i64| {
        let ns = stamp.ns().checked_add_signed(1_000_000 * ms).unwrap();
        let Carried { isometry, known } = state.carried(Stamp::from_ns(ns)).unwrap();
        (isometry.translation.y, isometry.rotation.scaled_axis().z, known)
    };
    for (ms, by_s, known) in [(0, 0.0, true), (10, 0.01, true), (-5, -0.005, true), (20, CARRIED_S, true)] {
        let (y_m, turn_rad, is_known) = at(&state, ms);
        assert!((y_m - 0.1 * by_s).abs() < 1e-15 && (turn_rad - 2.0 * by_s).abs() < 1e-15, "{ms} ms");
        assert_eq!(is_known, known, "{ms} ms");
    }
    // Beyond the limit the pose stands where it had been carried to.
    for (ms, by_s) in [(21, CARRIED_S), (900_000, CARRIED_S), (-21, -CARRIED_S)] {
        let (y_m, _, known) = at(&state, ms);
        assert!((y_m - 0.1 * by_s).abs() < 1e-15 && !known, "{ms} ms: {y_m} m");
    }
    // The pose's own stamp goes before that of the sample; without any nothing moves.
    state.pose.stamp = Stamp::from_ns(stamp.ns() + 4_000_000);
    assert!((at(&state, 10).0 - 0.1 * 0.006).abs() < 1e-15);
    (state.stamp, state.pose.stamp) = (Stamp::INVALID, Stamp::INVALID);
    assert_eq!(at(&state, 10), (0.0, 0.0, false));
    state.twist.linear[1] = f64::NAN;
    assert!(matches!(state.carried(stamp), Err(GeometryError::NotFinite { field: "linear", .. })));
}
