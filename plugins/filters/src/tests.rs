//! What each filter does to signals whose answer is known, and what it refuses.
#![allow(clippy::unwrap_used)]

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_sdk::Class;
use trocar_sdk::data::{CartesianState, Pose, Scalar, Transform, Wrench};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::*;

trocar_sdk::testing::count_allocations!();

fn scalar(value: f64) -> Scalar {
    Scalar { stamp: Stamp::INVALID, value }
}

/// What comes out for a signal at 1 kHz.
fn through<C: Class>(bench: &mut Bench<C>, samples: usize, signal: impl Fn(f64) -> f64) -> Vec<f64> {
    for n in 0..samples {
        bench.push("value", scalar(signal(n as f64 * 1e-3)));
        bench.step(1);
    }
    bench.outputs::<Scalar>("filtered").iter().map(|s| s.value).collect()
}

/// Gain at a frequency, from the last second of two.
fn gain(config: &str, hz: f64) -> f64 {
    let mut bench = Bench::<Biquad>::new(config);
    let out = through(&mut bench, 3000, |t| (TAU * hz * t).sin());
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (n, y) in out.iter().enumerate().skip(2000) {
        let (s, c) = (TAU * hz * n as f64 * 1e-3).sin_cos();
        (sine, cosine) = (sine + y * s / 500.0, cosine + y * c / 500.0);
    }
    sine.hypot(cosine)
}

#[track_caller]
fn refused<C: Class>(config: &str) -> String {
    Bench::<C>::created().configure(config).unwrap_err().reason
}

#[test]
fn each_biquad_passes_and_stops_what_it_is_made_for() {
    let half = 0.5f64.sqrt();
    for (kind, passes, stops, corner) in
        [("low_pass", 2.0, 400.0, half), ("high_pass", 400.0, 2.0, half), ("notch", 2.0, 50.0, 0.0)]
    {
        let config = format!(r#"{{"kind": "{kind}", "frequency_hz": 50}}"#);
        assert!(
            (gain(&config, passes) - 1.0).abs() < 0.01,
            "{kind} at {passes} Hz: {}",
            gain(&config, passes)
        );
        assert!(gain(&config, stops) < 0.01, "{kind} at {stops} Hz: {}", gain(&config, stops));
        assert!((gain(&config, 50.0) - corner).abs() < 0.001, "{kind} at 50 Hz: {}", gain(&config, 50.0));
    }
    let band = r#"{"kind": "band_pass", "frequency_hz": 50, "q": 10}"#;
    assert!((gain(band, 50.0) - 1.0).abs() < 0.001 && gain(band, 5.0) < 0.02 && gain(band, 300.0) < 0.02);
    // A band 5 Hz wide, from 47.5 to 52.5 Hz but for the warping of frequencies.
    assert!((gain(band, 52.5) - half).abs() < 0.02, "{}", gain(band, 52.5));
}

#[test]
fn a_butterworth_low_pass_overshoots_a_step_by_four_percent_and_begins_at_rest() {
    let mut bench = Bench::<Biquad>::new(r#"{"frequency_hz": 20}"#);
    let out = through(&mut bench, 500, |t| if t < 0.1 { 3.0 } else { 4.0 });
    assert!(out[..100].iter().all(|y| (y - 3.0).abs() < 1e-12), "it does not swing in");
    let peak = out.iter().copied().fold(f64::MIN, f64::max);
    // exp(−π ζ / sqrt(1 − ζ²)) with ζ = 0.7071.
    assert!((peak - 4.0 - (-PI).exp()).abs() < 0.002, "{peak}");
    assert!((out[499] - 4.0).abs() < 1e-6);
}

#[test]
fn a_biquad_filters_each_number_of_a_wrench_and_keeps_stamps() {
    let mut bench = Bench::<Biquad>::new("{}");
    let stamp = Stamp::from_ns(77);
    for force in [[0.0; 3], [1.0, 2.0, -3.0]] {
        bench.push("wrench", Wrench { stamp, force, torque: force });
    }
    bench.step(1);
    let out = bench.outputs::<Wrench>("filtered_wrench");
    assert_eq!(out.len(), 2);
    let [x, y, z] = out[1].force;
    assert!(x > 0.0 && (y - 2.0 * x).abs() < 1e-15 && (z + 3.0 * x).abs() < 1e-15, "{:?}", out[1]);
    assert_eq!((out[1].torque, out[1].stamp), ([x, y, z], stamp));
}

#[test]
fn numbers_that_are_not_finite_are_left_out_and_counted() {
    fn of<C: Class>(count: impl Fn(&Bench<C>) -> u64) {
        let mut bench = Bench::<C>::new("{}");
        let out = through(&mut bench, 30, |t| if t == 0.01 { f64::NAN } else { 1.0 });
        assert_eq!((out.len(), count(&bench)), (29, 1));
        assert!(out.iter().all(|y| (y - 1.0).abs() < 1e-12));
    }
    of::<Biquad>(|bench| bench.state().rejected);
    of::<MovingMedian>(|bench| bench.state().rejected);
}

#[test]
fn biquads_that_cannot_be_are_refused() {
    assert_eq!(
        refused::<Biquad>(r#"{"frequency_hz": 500}"#),
        "frequency_hz: 500 Hz is not below half of sample_hz, 500 Hz"
    );
    assert!(refused::<Biquad>(r#"{"kind": "comb"}"#).contains(r#""comb" is not one of"#));
    assert!(refused::<Biquad>(r#"{"q": 0}"#).contains("is below 0.05"));
}

#[test]
fn the_median_removes_spikes_and_delays_an_edge_by_half_its_window() {
    let mut bench = Bench::<MovingMedian>::new(r#"{"window": 5}"#);
    let spikes = [10usize, 20, 21];
    let out = through(&mut bench, 100, |t| {
        let n = (t * 1e3).round() as usize;
        if spikes.contains(&n) { 1e6 } else { f64::from(u8::from(n >= 50)) }
    });
    assert!(out[..52].iter().all(|y| *y == 0.0), "spikes are gone, the edge is not there yet");
    assert!(out[52..].iter().all(|y| *y == 1.0), "it comes two samples later");
}

#[test]
fn the_median_is_the_one_of_a_sorted_window() {
    let mut random = fastrand::Rng::with_seed(3);
    let signal: Vec<f64> = (0..300).map(|_| random.f64()).collect();
    let mut bench = Bench::<MovingMedian>::new(r#"{"window": 9}"#);
    let out = through(&mut bench, 300, |t| signal[(t * 1e3).round() as usize]);
    for n in 8..300 {
        let mut window = signal[n - 8..=n].to_vec();
        window.sort_by(f64::total_cmp);
        assert_eq!(out[n], window[4]);
    }
    assert_eq!(
        refused::<MovingMedian>(r#"{"window": 4}"#),
        "window: 4 is even: an odd number of samples has a median"
    );
    assert_eq!(refused::<MovingMedian>(r#"{"window": 103}"#), "window: 103 is above 101");
}

/// Estimates of a signal with noise of 1 mm, at 1 kHz with every seventh sample missing.
fn estimates(config: &str, signal: impl Fn(f64) -> f64) -> Vec<(f64, Estimate)> {
    let mut random = fastrand::Rng::with_seed(5);
    let mut bench = Bench::<Kalman>::new(config);
    let mut times = Vec::new();
    for n in 0..4000 {
        let t = f64::from(n) * 1e-3;
        let noise: f64 = (0..12).map(|_| random.f64()).sum::<f64>() - 6.0;
        if n % 7 != 3 {
            bench.push(
                "value",
                Scalar { stamp: Stamp::from_ns(1 + (t * 1e9) as u64), value: signal(t) + 1e-3 * noise },
            );
            times.push(t);
        }
        bench.step(1);
    }
    times.into_iter().zip(bench.outputs::<Estimate>("estimate")).collect()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    (sum / count).sqrt()
}

#[test]
fn the_kalman_filter_finds_the_velocity_of_what_moves_evenly_and_knows_how_well() {
    let out = estimates(r#"{"sigma": 0.001, "acceleration": 1e-6}"#, |t| 0.5 + 0.2 * t);
    let late = || out.iter().filter(|(t, _)| *t > 2.0);
    let off = rms(late().map(|(t, e)| e.value - 0.5 - 0.2 * t));
    assert!(off < 0.15e-3, "{off}: much better than a measurement");
    assert!(rms(late().map(|(_, e)| e.rate - 0.2)) < 1e-3);
    let told = rms(late().map(|(_, e)| e.sigma));
    assert!((0.4..2.5).contains(&(off / told)), "off by {off}, told {told}");
    let innovation = rms(late().map(|(_, e)| e.innovation));
    assert!((innovation / 1e-3 - 1.0).abs() < 0.1, "{innovation}");
}

#[test]
fn a_prediction_is_ahead_by_what_was_asked() {
    let signal = |t: f64| 0.01 * (TAU * 0.5 * t).sin();
    let out = estimates(r#"{"sigma": 0.001, "acceleration": 0.01, "predict_s": 0.05}"#, signal);
    let off =
        |ahead: f64| rms(out.iter().filter(|(t, _)| *t > 1.0).map(|(t, e)| e.value - signal(t + ahead)));
    assert!(off(0.05) < 0.7e-3, "{}", off(0.05));
    assert!(off(0.0) > 0.9e-3 && off(0.1) > 0.9e-3, "{} {}", off(0.0), off(0.1));
}

#[test]
fn outliers_are_left_out_until_they_are_the_truth() {
    let mut bench = Bench::<Kalman>::new(r#"{"gate": 5, "forget_s": 0.1}"#);
    for n in 0..1000u64 {
        let value = if n == 300 || n >= 500 { 1.0 } else { 0.0 };
        bench.push("value", Scalar { stamp: Stamp::from_ns(1 + n * 1_000_000), value });
        bench.step(1);
    }
    let out = bench.outputs::<Estimate>("estimate");
    assert!(out[..499].iter().all(|e| e.value.abs() < 1e-6), "one outlier changes nothing");
    assert_eq!(out.last().unwrap().value, 1.0, "many of them are what is true");
    assert!((100..=110).contains(&bench.state().rejected), "{}", bench.state().rejected);
}

#[test]
fn samples_without_time_or_back_in_time_are_left_out() {
    let mut bench = Bench::<Kalman>::new("{}");
    for (ns, value) in [(5_000_000, 1.0), (5_000_000, 2.0), (4_000_000, 3.0), (6_000_000, f64::INFINITY)] {
        bench.push("value", Scalar { stamp: Stamp::from_ns(ns), value });
    }
    bench.step(1);
    assert_eq!((bench.outputs::<Estimate>("estimate").len(), bench.state().rejected), (1, 3));
    assert!(refused::<Kalman>(r#"{"sigma": 0}"#).contains("sigma: 0 is below"));
}

#[test]
fn the_position_of_a_pose_gets_a_velocity_and_its_orientation_passes() {
    let mut bench = Bench::<Kalman>::new(r#"{"sigma": 1e-6}"#);
    let orientation = [0.0, 0.6, 0.0, 0.8];
    for n in 0..500u64 {
        let t = n as f64 * 1e-3;
        let stamp = Stamp::from_ns(1 + n * 1_000_000);
        bench.push("pose", Pose { stamp, position: [0.01 * t, -0.02 * t, 0.3], orientation });
        bench.step(1);
    }
    let last = *bench.outputs::<CartesianState>("moving").last().unwrap();
    for (rate, wanted) in last.twist.linear.into_iter().zip([0.01, -0.02, 0.0]) {
        assert!((rate - wanted).abs() < 1e-5, "{:?}", last.twist.linear);
    }
    assert_eq!((last.pose.orientation, last.pose.stamp), (orientation, last.twist.stamp));
}

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

/// Runs a controller on a plant `y' = gain · u − y / tau`, at 1 kHz; outputs and measurements.
fn control(bench: &mut Bench<Pid>, steps: usize, setpoint: f64, y: &mut f64) -> Vec<(f64, f64)> {
    let mut told = Vec::new();
    for _ in 0..steps {
        bench.push("setpoint", scalar(setpoint));
        bench.push("measured", scalar(*y));
        bench.step(1);
        let u = bench.state().output;
        *y += 1e-3 * (10.0 * u - *y / 0.2);
        told.push((u, *y));
    }
    told
}

#[test]
fn a_pi_controller_reaches_its_setpoint_and_a_p_controller_stays_below() {
    let mut y = 0.0;
    let mut bench = Bench::<Pid>::new(r#"{"kp": 2, "ki": 10, "lowest": -10, "highest": 10}"#);
    let told = control(&mut bench, 3000, 1.0, &mut y);
    assert!((y - 1.0).abs() < 1e-3, "{y}");
    assert_eq!(bench.outputs::<Scalar>("command").len(), 3000);
    assert!((told[0].0 - 2.01).abs() < 1e-9, "kp and one step of ki: {}", told[0].0);
    let mut y = 0.0;
    control(&mut Bench::<Pid>::new(r#"{"kp": 2, "lowest": -10, "highest": 10}"#), 3000, 1.0, &mut y);
    // gain · tau · kp / (1 + gain · tau · kp) with 10 · 0.2 · 2.
    assert!((y - 0.8).abs() < 1e-3, "{y}");
}

#[test]
fn the_derivative_damps_and_a_setpoint_that_jumps_gives_no_kick() {
    let mut bench = Bench::<Pid>::new(r#"{"kp": 0, "kd": 0.5, "smooth_s": 0, "lowest": -9, "highest": 9}"#);
    for (setpoint, measured) in [(0.0, 0.0), (100.0, 0.0), (100.0, 0.002)] {
        bench.push("setpoint", scalar(setpoint));
        bench.push("measured", scalar(measured));
        bench.step(1);
    }
    let out: Vec<f64> = bench.outputs::<Scalar>("command").iter().map(|s| s.value).collect();
    // 2 per second upwards: half of it against.
    assert_eq!(out[..2], [0.0, 0.0]);
    assert!((out[2] + 1.0).abs() < 1e-9, "{out:?}");
}

#[test]
fn an_output_at_its_limit_is_told_and_the_integral_does_not_wind_up() {
    let mut bench = Bench::<Pid>::new(r#"{"kp": 1, "ki": 20, "highest": 0.4}"#);
    let mut y = 0.0;
    // 0.8 at most: 1 is out of reach.
    control(&mut bench, 2000, 1.0, &mut y);
    assert!((y - 0.8).abs() < 1e-3 && bench.state().at_limit.get());
    let wound = bench.state().integral;
    assert!(wound <= 0.4, "{wound}");
    let told = control(&mut bench, 200, 0.2, &mut y);
    assert!(told.iter().take(30).any(|(u, _)| *u < 0.3), "it comes back at once");
    assert_eq!(bench.events::<Flag>("ctl/saturated"), [Flag::TRUE, Flag::FALSE]);
}

#[test]
fn without_a_fresh_measurement_the_output_is_the_safe_one() {
    let mut bench = Bench::<Pid>::new(r#"{"ki": 5, "safe": 0.25}"#);
    bench.step(1);
    assert_eq!((bench.state().output, bench.state().controls), (0.25, Flag::FALSE));
    let mut y = 0.0;
    control(&mut bench, 100, 0.5, &mut y);
    assert!(bench.state().controls.get() && bench.state().integral > 0.0);
    bench.make_stale("measured");
    bench.step(1);
    assert_eq!((bench.state().output, bench.state().integral), (0.25, 0.0));
    bench.push("measured", scalar(f64::NAN));
    bench.step(1);
    assert_eq!(bench.state().output, 0.25);
}

#[test]
fn controllers_that_cannot_be_are_refused() {
    assert_eq!(
        refused::<Pid>(r#"{"lowest": 1, "highest": -1}"#),
        "lowest, highest: 1 is not below -1: exchange them"
    );
    assert_eq!(refused::<Pid>(r#"{"safe": 2}"#), "safe: 2 is not between lowest, -1, and highest, 1");
}

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
        bench.push("pose", Pose { stamp: Stamp::from_ns(9), ..pose.into() });
        bench.step(1);
        let out = bench.outputs::<Pose>("transformed")[0];
        let off = out.isometry().unwrap().to_homogeneous() - wanted.to_homogeneous();
        assert!(off.norm() < 1e-12 && out.stamp == Stamp::from_ns(9), "{more}: {off}");
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
fn lost_data_are_told_once_with_their_age_and_the_device_holds() {
    let mut bench = Bench::<Watchdog>::new(r#"{"timeout_s": 0.02}"#);
    for _ in 0..10 {
        bench.push("watched", scalar(1.0));
        bench.step(1);
    }
    bench.step(100);
    assert_eq!(bench.calls::<()>("device/hold").len(), 1);
    let lost = bench.events::<f64>("ctl/lost");
    assert_eq!(lost.len(), 1);
    assert!(lost[0] > 0.02 && lost[0] < 0.0225, "{lost:?}");
    assert!(!bench.read::<(), Flag>("alive", ()).unwrap().get());
    bench.push("watched", scalar(2.0));
    bench.step(1);
    let found = bench.events::<f64>("ctl/found");
    assert!(found.len() == 1 && (found[0] - 0.08).abs() < 0.003, "{found:?}");
    assert_eq!(bench.state().losses, 1);
}

#[test]
fn data_that_never_come_are_lost_and_so_are_those_that_repeat_an_old_stamp() {
    let mut bench = Bench::<Watchdog>::new("{}");
    bench.step(100);
    assert_eq!(bench.events::<f64>("ctl/lost").len(), 1);
    bench.push("watched", Wrench::default());
    bench.step(1);
    let old = bench.now();
    for _ in 0..100 {
        bench.push_at("watched", Wrench::default(), old);
        bench.step(1);
    }
    assert_eq!(bench.events::<f64>("ctl/lost").len(), 1, "a source that hangs but sends is lost, too");
    assert!(refused::<Watchdog>(r#"{"timeout_s": 0}"#).starts_with("timeout_s: 0 s is below"));
}

#[test]
fn samples_leave_in_order_after_their_delay_with_their_stamps() {
    for jitter in ["0", "0.02"] {
        let config = format!(r#"{{"delay_s": 0.01, "jitter_s": {jitter}}}"#);
        let mut bench = Bench::<AddLatency>::new(config);
        bench.connect_as::<Scalar>("delayed");
        let (mut sent, mut left) = (Vec::new(), Vec::new());
        for n in 0..300 {
            if n < 200 {
                let stamp = bench.now();
                bench.push("sample", Scalar { stamp, value: f64::from(n) });
                sent.push(stamp);
            }
            bench.step(1);
            left.extend(bench.samples::<Scalar>("delayed").into_iter().map(|(s, at)| (s, at, bench.now())));
        }
        assert_eq!((left.len(), bench.state().rejected, bench.state().waiting), (200, 0, 0));
        for (n, (sample, stamp, when)) in left.iter().enumerate() {
            assert_eq!((sample.value, *stamp), (n as f64, sent[n]), "in order, with its stamp");
            let kept = when.seconds_since(sent[n]);
            let most = if jitter == "0" { 0.0121 } else { 0.0321 };
            assert!(kept >= 0.011 - 1e-9 && kept < most, "{kept} s");
        }
    }
}

#[test]
fn what_is_too_large_or_too_much_for_the_delay_line_is_counted() {
    let mut bench = Bench::<AddLatency>::new(r#"{"delay_s": 1, "depth": 3, "max_bytes": 16}"#);
    bench.connect_as::<Scalar>("delayed");
    for _ in 0..5 {
        bench.push("sample", scalar(1.0));
        bench.step(1);
    }
    assert_eq!((bench.state().waiting, bench.state().rejected), (3, 2));
    let mut bench = Bench::<AddLatency>::new(r#"{"max_bytes": 16}"#);
    bench.push("sample", Wrench::default());
    bench.step(1);
    assert_eq!(bench.state().rejected, 1);
    let why = refused::<AddLatency>(r#"{"depth": 65536, "max_bytes": 65536}"#);
    assert!(why.starts_with("depth, max_bytes: 65536 samples of 65536 B are more than 256 MiB"), "{why}");
}

#[test]
fn no_filter_allocates_in_a_step() {
    fn quiet<C: Class>(config: &str, feed: impl Fn(&mut Bench<C>)) {
        let mut bench = Bench::<C>::new(config);
        feed(&mut bench);
        bench.step(1);
        bench.assert_no_alloc(|bench| {
            for _ in 0..50 {
                feed(bench);
                bench.step(1);
            }
        });
    }
    quiet::<Biquad>("{}", |bench| bench.push("value", scalar(1.0)));
    quiet::<MovingMedian>(r#"{"window": 101}"#, |bench| bench.push("wrench", Wrench::default()));
    quiet::<Kalman>("{}", |bench| bench.push("pose", Pose::default()));
    quiet::<Resampler>("{}", |bench| bench.push("pose", Pose::default()));
    quiet::<Pid>("{}", |bench| {
        bench.push("setpoint", scalar(1.0));
        bench.push("measured", scalar(0.5));
    });
    quiet::<CartesianTransform>("{}", |bench| bench.push("pose", Pose::default()));
    quiet::<Watchdog>("{}", |bench| bench.push("watched", scalar(1.0)));
    quiet::<AddLatency>("{}", |bench| bench.push("sample", scalar(1.0)));
}
