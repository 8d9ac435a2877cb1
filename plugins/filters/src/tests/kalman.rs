//! `kalman`: what moves evenly, outliers, poses.

use std::f64::consts::TAU;

use trocar_sdk::data::CartesianState;

use super::*;

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
fn a_filter_that_took_noise_for_motion_does_not_go_on_with_it_when_sigma_is_put_right() {
    let mut bench = Bench::<Kalman>::new(r#"{"sigma": 1e-6, "acceleration": 100}"#);
    let mut random = fastrand::Rng::with_seed(5);
    for n in 0..2000u64 {
        if n == 500 {
            bench.configure(r#"{"sigma": 1, "acceleration": 100}"#).unwrap();
        }
        let stamp = Stamp::from_ns(1 + n * 1_000_000);
        bench.push("value", Scalar { stamp, value: 2.0 * random.f64() - 1.0 });
        bench.step(1);
    }
    let out = bench.outputs::<Estimate>("estimate");
    let most = out.iter().map(|e| e.value.abs()).fold(0.0, f64::max);
    assert!(most < 2.0, "{most} out of noise within 1");
    assert!(out[1900..].iter().all(|e| e.value.abs() < 0.5), "and it does filter in the end");
}

#[test]
fn numbers_beside_which_a_measurement_has_no_noise_leave_no_variance_below_zero() {
    let mut bench = Bench::<Kalman>::new(r#"{"sigma": 3e-12, "acceleration": 1}"#);
    for (value, after_ns) in [(0.0, 1_000_000), (0.45, 10_000_000), (0.0, 1_000_000), (0.3, 1_000_000)] {
        let stamp = bench.now();
        bench.push("value", Scalar { stamp, value });
        bench.step_after(after_ns).unwrap();
        bench.configure(r#"{"sigma": 1, "acceleration": 1}"#).unwrap();
    }
    let out = bench.outputs::<Estimate>("estimate");
    assert!(out.iter().all(|e| e.value.abs() < 1.0 && e.sigma > 0.0), "{out:?}");
}
