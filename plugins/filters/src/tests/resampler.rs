//! `resampler`: the grid, the delay, and what comes out when nothing comes in.

use std::f64::consts::TAU;

use super::*;

#[test]
fn a_slow_signal_comes_out_on_the_grid_with_the_delay_asked_for() {
    let mut bench = Bench::<Resampler>::new(r#"{"delay_s": 0.035}"#);
    let signal = |t: f64| (TAU * 0.8 * t).sin();
    for n in 0..1000 {
        // At 30 Hz, more or less.
        if n % 33 == 0 {
            let stamp = bench.now();
            bench.push("value", Scalar { stamp, value: signal(stamp.ns() as f64 * 1e-9) });
        }
        bench.step(1);
    }
    let out = bench.outputs::<Scalar>("resampled");
    assert!(out.len() > 960, "{}", out.len());
    for pair in out.windows(2) {
        assert_eq!(pair[1].stamp.ns() - pair[0].stamp.ns(), 1_000_000, "the grid");
    }
    let off = out.iter().map(|s| (s.value - signal(s.stamp.ns() as f64 * 1e-9)).abs()).fold(0.0, f64::max);
    // Between samples a line is off by (2π f T)² / 8 at most.
    assert!(off < (TAU * 0.8 * 0.033).powi(2) / 8.0 + 1e-6, "{off}");
    assert_eq!(bench.state().extrapolated, 0);
}

#[test]
fn beyond_the_newest_sample_the_motion_goes_on_for_a_while_and_then_stays() {
    let mut bench = Bench::<Resampler>::new(r#"{"delay_s": 0.0, "ahead_s": 0.01}"#);
    for value in [0.0, 1.0] {
        let stamp = bench.now();
        bench.push("value", Scalar { stamp, value });
        bench.step(10);
    }
    bench.step(40);
    let out: Vec<f64> = bench.outputs::<Scalar>("resampled").iter().map(|s| s.value).collect();
    assert_eq!(out[..10], [0.0; 10], "one sample is held");
    // From 1.0 at 10 ms on, 0.1 per ms for 10 ms.
    assert!((out[14] - 1.5).abs() < 1e-6 && (out[30] - 2.0).abs() < 1e-6, "{out:?}");
    assert_eq!(bench.state().extrapolated, 60);
    let mut hold = Bench::<Resampler>::new(r#"{"delay_s": 0.0, "method": "hold"}"#);
    for value in [0.0, 1.0] {
        let stamp = hold.now();
        hold.push("value", Scalar { stamp, value });
        hold.step(10);
    }
    let out: Vec<f64> = hold.outputs::<Scalar>("resampled").iter().map(|s| s.value).collect();
    assert_eq!(out, [[0.0; 10], [1.0; 10]].concat());
}

#[test]
fn orientations_are_interpolated_on_the_shortest_arc() {
    let mut bench = Bench::<Resampler>::new(r#"{"delay_s": 0.010}"#);
    let turned = |angle: f64, sign: f64| {
        let (s, c) = (0.5 * angle).sin_cos();
        [0.0, 0.0, sign * s, sign * c]
    };
    // The same turn with the other sign is the same turn.
    for (angle, sign) in [(0.2, 1.0), (1.0, -1.0)] {
        let stamp = bench.now();
        bench.push("pose", Pose { stamp, position: [angle, 0.0, 0.0], orientation: turned(angle, sign) });
        bench.step(10);
    }
    bench.step(5);
    let out = bench.outputs::<Pose>("resampled_pose");
    for pose in out.iter().skip(1) {
        let turn = pose.isometry().unwrap().rotation.scaled_axis().z;
        // Up to the second one both go together.
        if pose.position[0] <= 1.0 {
            assert!((turn - pose.position[0]).abs() < 1e-9, "{turn} at {:?}", pose.position);
        }
    }
    assert!(out.iter().any(|pose| (pose.position[0] - 0.6).abs() < 0.05));
    bench.push("pose", Pose { stamp: bench.now(), orientation: [0.0; 4], ..Pose::default() });
    bench.step(1);
    assert_eq!(bench.state().rejected, 1);
}

#[test]
fn what_is_only_held_keeps_its_stamp_and_ends_when_it_is_too_old() {
    for (method, held_from_ms) in [("hold", 0), ("linear", 5)] {
        let config =
            format!(r#"{{"method": "{method}", "delay_s": 0, "ahead_s": 0.005, "max_age_s": 0.05}}"#);
        let mut bench = Bench::<Resampler>::new(config);
        bench.push("value", scalar(1.0));
        bench.push("pose", Pose::default());
        bench.step(10);
        bench.push("value", scalar(2.0));
        bench.push("pose", Pose::default());
        let newest = bench.now();
        bench.step(100);
        let out = bench.outputs::<Scalar>("resampled");
        let last = *out.last().unwrap();
        assert_eq!(last.stamp.ns() - newest.ns(), held_from_ms * 1_000_000, "{method}");
        assert_eq!(out.len(), 10 + 50, "{method}: 50 ms and no more");
        assert!(out.windows(2).all(|two| two[0].stamp <= two[1].stamp), "{method}");
        assert_eq!(bench.outputs::<Pose>("resampled_pose").last().unwrap().stamp, last.stamp, "{method}");
        assert_eq!(bench.state().too_old, 2 * 50, "{method}");
        bench.push("value", scalar(7.0));
        bench.step(1);
        let out = bench.outputs::<Scalar>("resampled");
        assert_eq!(out.iter().map(|s| s.value).collect::<Vec<_>>(), [7.0], "{method}: not across the gap");
    }
    let why = refused::<Resampler>(r#"{"ahead_s": 2}"#);
    assert!(why.contains("2 s ahead is longer than a sample is held, 0.5 s: raise max_age_s"), "{why}");
}
