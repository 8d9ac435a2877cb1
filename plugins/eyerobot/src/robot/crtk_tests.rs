//! Gate D1 of the design, on the component: CRTK states, stamps, pre-emption, and what leaves as samples.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{
    ArmState, CartesianState, JointState, OperatingMode, OperatingState, Pose, Twist, Wrench,
};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use super::EyeRobot;
use super::bench::{DT, joints, operating, push, say};
use crate::payloads::Jacobian;

/// An arm whose setpoint goes on without a joint that is blocked.
fn faulted() -> Bench<EyeRobot> {
    let mut bench = Bench::<EyeRobot>::new(r#"{"blocked_joint": "x"}"#);
    bench.command::<_, ()>("servo_jp", joints([0.04, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(250);
    assert_eq!(operating(&bench).state, OperatingMode::FAULT);
    bench
}

#[test]
fn a_fault_says_joint_unit_limit_and_what_to_send() {
    for (joint, unit, limit) in [("x", "m", "0.000500"), ("tilt", "rad", "0.017453")] {
        let mut bench = Bench::<EyeRobot>::new(format!(r#"{{"blocked_joint": "{joint}"}}"#));
        bench.command::<_, ()>("servo_jp", joints([0.04, 0.0, 0.0, 0.0, 0.4])).unwrap();
        bench.step(400);
        let told = operating(&bench).message.to_string();
        assert!(told.starts_with(&format!("joint {joint} is 0.0")), "{told}");
        let rest =
            format!(" {unit} behind its setpoint, limit {limit} {unit}: see what holds it, send \"enable\"");
        assert!(told.ends_with(&rest), "{told}");
    }
    // The longest one is not cut.
    let limit = crate::arm::Fault::Limit { joint: 3, value: -1.100001, limit: -60f64.to_radians() };
    let told = limit.to_string();
    assert!(
        told.len() <= 128 && told.contains("it is at -1.100001 rad: send \"enable\", then move_jp inside"),
        "{told}"
    );
}

#[test]
fn all_sixteen_transitions_of_the_crtk_table_are_those_of_the_document() {
    const DISABLED: OperatingMode = OperatingMode::DISABLED;
    const ENABLED: OperatingMode = OperatingMode::ENABLED;
    const PAUSED: OperatingMode = OperatingMode::PAUSED;
    const FAULT: OperatingMode = OperatingMode::FAULT;
    let words = ["enable", "disable", "pause", "resume"];
    // None: invalid, the state stays.
    let table = [
        (DISABLED, [Some(ENABLED), Some(DISABLED), None, None]),
        (ENABLED, [Some(ENABLED), Some(DISABLED), Some(PAUSED), None]),
        (PAUSED, [None, Some(DISABLED), Some(PAUSED), Some(ENABLED)]),
        (FAULT, [Some(ENABLED), Some(DISABLED), None, None]),
    ];
    for (from, row) in table {
        for (word, to) in words.into_iter().zip(row) {
            let mut bench =
                if from == FAULT { faulted() } else { Bench::<EyeRobot>::new(r#"{"auto_enable": false}"#) };
            if [ENABLED, PAUSED].contains(&from) {
                assert!(say(&mut bench, "enable"));
            }
            if from == PAUSED {
                assert!(say(&mut bench, "pause"));
            }
            assert_eq!(operating(&bench).state, from);
            bench.events::<OperatingState>("arm/operating_state");
            let taken = say(&mut bench, word);
            bench.step(3);
            assert_eq!(
                (taken, operating(&bench).state),
                (to.is_some(), to.unwrap_or(from)),
                "{from:?} {word}"
            );
            let told = bench.events::<OperatingState>("arm/operating_state");
            let changes = usize::from(to.is_some_and(|to| to != from));
            assert_eq!(told.len(), changes, "{from:?} {word}: {told:?}");
        }
    }
}

#[test]
fn cartesian_values_carry_the_stamp_of_the_joints_and_what_is_not_known_stamp_0() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.step(5);
    let stamp = bench.read::<(), JointState>("arm/measured_js", ()).unwrap().stamp;
    assert!(stamp.is_valid() && stamp == bench.now());
    let pose = |bench: &Bench<EyeRobot>, of: &str| bench.read::<(), Pose>(of, ()).unwrap().stamp;
    let of_tip = ["arm/measured_cp", "local/measured_cp", "arm/setpoint_cp", "arm/goal_cp"];
    assert!(of_tip.iter().all(|of| pose(&bench, of) == stamp));
    assert_eq!(bench.read::<(), Twist>("arm/measured_cv", ()).unwrap().stamp, stamp);
    let all: CartesianState = bench.read("arm/measured_cs", ()).unwrap();
    assert_eq!([all.stamp, all.pose.stamp, all.twist.stamp], [stamp; 3]);
    bench.command::<_, ()>("arm/servo_cv", Twist { linear: [0.001, 0.0, 0.0], ..Twist::default() }).unwrap();
    push(&mut bench, [0.0, 0.0, 0.5], 1);
    for of in ["arm/setpoint_cp", "arm/goal_cp"] {
        assert_eq!(pose(&bench, of), Stamp::INVALID, "{of} of a motion by velocity");
    }
    assert_eq!(bench.read::<(), JointState>("arm/goal_js", ()).unwrap().stamp, Stamp::INVALID);
    assert_eq!(bench.read::<(), Twist>("arm/setpoint_cv", ()).unwrap().stamp, bench.now());
    let felt: Wrench = bench.read("hand/measured_cf", ()).unwrap();
    assert_eq!(felt.stamp, bench.now());
    assert!((felt.force[2] - 0.5).abs() < 1e-6, "{felt:?}");
    let spatial = |bench: &Bench<EyeRobot>| {
        let jacobian: Jacobian = bench.read("spatial/jacobian", ()).unwrap();
        let js: JointState = bench.read("arm/measured_js", ()).unwrap();
        [0, 1, 2].map(|row| (0..5).map(|i| jacobian.values[5 * row + i] * js.velocity[i]).sum::<f64>())
    };
    let v: Twist = bench.read("spatial/measured_cv", ()).unwrap();
    assert!((0..3).all(|i| (spatial(&bench)[i] - v.linear[i]).abs() < 1e-12) && v.stamp == bench.now());
    // A hand on the handle is nothing that the tip meets (CRTK measured_cf), and no one measures that.
    let all: CartesianState = bench.read("arm/measured_cs", ()).unwrap();
    let streamed = bench.outputs::<ArmState>("state");
    let met = streamed.iter().map(|state| state.measured_cf).chain([all.wrench]);
    assert!(met.into_iter().all(|tip| tip == Wrench::default()));
    for of in ["arm/measured_cf", "spatial/measured_cf", "body/measured_cf"] {
        let read = std::panic::catch_unwind(|| Bench::<EyeRobot>::new("{}").read::<(), Wrench>(of, ()));
        assert!(!matches!(read, Ok(Ok(_))), "{of} is offered");
    }
    let hand = bench.outputs::<Wrench>("hand_cf");
    assert_eq!((hand[0].stamp, hand.last()), (Stamp::INVALID, Some(&felt)), "first there was no hand");
    let poses = bench.outputs::<Pose>("measured_cp");
    let same: Vec<Pose> = streamed.iter().map(|state| state.measured_cp).collect();
    assert_eq!(poses, same, "of the same cycles");
    bench.make_stale("handle");
    bench.step(1);
    assert_eq!(bench.read::<(), Wrench>("hand/measured_cf", ()).unwrap(), Wrench::default());
}

#[test]
fn a_servo_motion_pre_empts_a_move_and_a_move_is_busy_until_it_says_that_it_arrived() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let busy = |bench: &Bench<EyeRobot>| bench.read::<(), Flag>("arm/is_busy", ()).unwrap().get();
    bench.command::<_, ()>("move_jp", joints([0.01, 0.0, 0.0, 0.0, 0.0])).unwrap();
    assert!(busy(&bench));
    bench.step(100);
    bench.command::<_, ()>("servo_jp", joints([0.0; 5])).unwrap();
    bench.step(1);
    assert!(!busy(&bench));
    assert_eq!(bench.events::<Flag>("arm/goal_reached"), [Flag::FALSE]);
    let mut goal: Pose = bench.read("arm/measured_cp", ()).unwrap();
    goal.position[2] -= 0.002;
    bench.command::<_, ()>("move_cp", goal).unwrap();
    while busy(&bench) {
        assert!(bench.events::<Flag>("arm/goal_reached").is_empty());
        bench.step(1);
    }
    assert_eq!(bench.events::<Flag>("arm/goal_reached"), [Flag::TRUE]);
    bench.step(300);
    let at: Pose = bench.read("arm/measured_cp", ()).unwrap();
    assert!((at.position[2] - goal.position[2]).abs() < 5e-6, "{at:?}");
}

#[test]
fn the_tip_leaves_as_a_sample_in_the_world_at_each_step() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"standoff_m": 0.002}"#);
    bench.step(2);
    let samples = bench.samples::<CartesianState>("tip");
    let (tip, stamp) = samples[1];
    assert_eq!((samples.len(), stamp, tip.pose.stamp, tip.twist.stamp), (2, bench.now(), stamp, stamp));
    assert!((tip.pose.position[2] + 0.002).abs() < 1e-6, "{tip:?}");
    assert_eq!(tip, bench.read::<(), CartesianState>("truth/measured_cs", ()).unwrap());
    let twist = Twist { linear: [0.0, 0.0, 0.004], ..Twist::default() };
    for _ in 0..100 {
        bench.command::<_, ()>("arm/servo_cv", twist).unwrap();
        bench.step(1);
    }
    let way = bench.outputs::<CartesianState>("tip");
    let (last, before) = (way[99], way[98]);
    let gone = last.pose.position[2] - before.pose.position[2];
    assert!((last.twist.linear[2] - gone / DT).abs() < 1e-5, "the twist is the slope of the pose");
    assert!((last.twist.linear[2] - 0.004).abs() < 0.1e-3, "{last:?}");
}
