//! Samples with numbers that nothing can have measured, into every class: left out, counted, and then
//! forgotten.

use trocar_sdk::data::{CartesianState, Transform};

use super::*;

/// Numbers that no sensor measures.
const BAD: [f64; 6] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e308, -2e100];

/// Runs a class with good samples alone, and with a bad one behind each of them: the output is the same, and
/// all bad ones were counted.
pub(crate) fn as_if_the_bad_ones_had_not_come<C: Class, T: Payload, U: Payload>(
    (config, input, output): (&str, &str, &str),
    feed: impl Fn(&mut Bench<C>),
    good: impl Fn(f64) -> T,
    bad: impl Fn(f64) -> T,
    rejected: impl Fn(&Bench<C>) -> u64,
) {
    let run = |faulty: bool| {
        let mut bench = Bench::<C>::new(config);
        feed(&mut bench);
        for n in 0u8..60 {
            bench.push(input, good(f64::from(n)));
            bench.step(1);
            if faulty {
                bench.push(input, bad(BAD[usize::from(n) % BAD.len()]));
            }
            bench.step(1);
        }
        let out: Vec<Vec<u8>> =
            bench.outputs::<U>(output).iter().map(|u| trocar_sdk::as_bytes(u).to_vec()).collect();
        (out, rejected(&bench))
    };
    let (clean, none) = run(false);
    let (out, counted) = run(true);
    assert!(clean.len() >= 50, "{input}: {} samples came out", clean.len());
    assert_eq!((none, counted), (0, 60), "{input}");
    assert!(out == clean, "{input}: a bad sample left its mark");
}

fn wrench(force: f64) -> Wrench {
    Wrench { force: [1.0, force, 2.0], torque: [0.0, force, 1.0], ..Wrench::default() }
}

fn at(x: f64) -> Pose {
    Pose { position: [0.1, x, -0.1], ..Pose::default() }
}

/// Not a turn: a quaternion of another length.
fn turned(w: f64) -> Pose {
    Pose { orientation: [0.0, 0.0, 0.0, w], ..Pose::default() }
}

#[test]
fn every_filter_goes_on_with_the_next_good_sample() {
    fn row<C: Class, T: Payload, U: Payload>(
        ports: (&str, &str, &str),
        good: impl Fn(f64) -> T,
        bad: impl Fn(f64) -> T,
        rejected: impl Fn(&Bench<C>) -> u64,
    ) {
        as_if_the_bad_ones_had_not_come::<C, T, U>(ports, |_| {}, good, bad, rejected);
    }
    row::<Biquad, _, Scalar>(("{}", "value", "filtered"), scalar, scalar, |b| b.state().rejected);
    row::<Biquad, _, Wrench>(("{}", "wrench", "filtered_wrench"), wrench, wrench, |b| b.state().rejected);
    row::<MovingMedian, _, Scalar>(("{}", "value", "filtered"), scalar, scalar, |b| b.state().rejected);
    row::<MovingMedian, _, Wrench>(("{}", "wrench", "filtered_wrench"), wrench, wrench, |b| {
        b.state().rejected
    });
    row::<Kalman, _, Estimate>(("{}", "value", "estimate"), scalar, scalar, |b| b.state().rejected);
    row::<Kalman, _, CartesianState>(("{}", "pose", "moving"), at, at, |b| b.state().rejected);
    row::<Kalman, _, CartesianState>(("{}", "pose", "moving"), at, turned, |b| b.state().rejected);
    row::<Resampler, _, Scalar>(("{}", "value", "resampled"), scalar, scalar, |b| b.state().rejected);
    row::<Resampler, _, Pose>(("{}", "pose", "resampled_pose"), at, at, |b| b.state().rejected);
    row::<Resampler, _, Pose>(("{}", "pose", "resampled_pose"), at, turned, |b| b.state().rejected);
    row::<CartesianTransform, _, Pose>(("{}", "pose", "transformed"), at, at, |b| b.state().rejected);
    row::<CartesianTransform, _, Pose>(("{}", "pose", "transformed"), at, turned, |b| b.state().rejected);
}

#[test]
fn a_controller_goes_on_with_the_sample_before_the_bad_one() {
    const PID: &str = r#"{"kp": 0.01, "ki": 0.1, "kd": 0.001, "max_age_s": 1, "setpoint_max_age_s": 1}"#;
    for (input, other) in [("measured", "setpoint"), ("setpoint", "measured")] {
        as_if_the_bad_ones_had_not_come::<Pid, Scalar, Scalar>(
            (PID, input, "command"),
            |bench| bench.push(other, scalar(20.0)),
            scalar,
            scalar,
            |bench| bench.state().rejected,
        );
    }
}

#[test]
fn a_bad_transform_leaves_the_one_before_in_use() {
    let mut bench = Bench::<CartesianTransform>::new("{}");
    let mut moved_by = |x: f64| {
        let pose = Pose { position: [x, 0.0, 0.0], ..Pose::default() };
        bench.push("transform", Transform { pose, ..Transform::default() });
        bench.push("pose", Pose::default());
        bench.step(1);
        let out = bench.outputs::<Pose>("transformed");
        (out[0].position[0], bench.state().rejected_transforms)
    };
    assert_eq!(moved_by(5.0), (5.0, 0));
    for (bad, n) in BAD.into_iter().zip(1..) {
        assert_eq!(moved_by(bad), (5.0, n));
    }
    assert_eq!(moved_by(6.0), (6.0, BAD.len() as u64));
}

#[test]
fn a_stamp_from_far_ahead_does_not_make_all_that_follow_late() {
    fn row<C: Class, U: Payload>(output: &str, rejected: impl Fn(&Bench<C>) -> u64) {
        let mut bench = Bench::<C>::new("{}");
        for ns in [u64::MAX, 1 << 63, bench.now().ns() + 3_000_000_000] {
            bench.push("value", Scalar { stamp: Stamp::from_ns(ns), value: 1.0 });
        }
        for _ in 0..30 {
            bench.push("value", scalar(1.0));
            bench.step(1);
        }
        assert_eq!(rejected(&bench), 3);
        assert!(bench.outputs::<U>(output).len() >= 5, "{output}");
    }
    row::<Resampler, Scalar>("resampled", |bench| bench.state().rejected);
    row::<Kalman, Estimate>("estimate", |bench| bench.state().rejected);
}
