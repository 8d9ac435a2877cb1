//! `biquad`: gains, a step, and designs that cannot be.

use std::f64::consts::{PI, TAU};

use super::*;

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
fn biquads_that_cannot_be_are_refused() {
    let mut bench = Bench::<Biquad>::new("{}");
    through(&mut bench, 1, |_| 1.0);
    assert_eq!(
        bench.configure(r#"{"frequency_hz": 500}"#).unwrap_err().reason,
        "frequency_hz: 500 Hz is not below half the rate of the samples, 1000 Hz: choose less than 500 Hz"
    );
    assert!(refused::<Biquad>(r#"{"kind": "comb"}"#).contains(r#""comb" is not one of"#));
    assert!(refused::<Biquad>(r#"{"q": 0}"#).contains("is below 0.05"));
}

/// Outputs for a source of 200 Hz before steps of 1 kHz.
fn slow_samples(bench: &mut Bench<Biquad>, count: usize, value: impl Fn(f64) -> f64) -> Vec<f64> {
    for n in 0..count {
        let stamp = bench.now();
        bench.push("value", Scalar { stamp, value: value(n as f64 / 200.0) });
        bench.step(5);
    }
    bench.outputs::<Scalar>("filtered").iter().map(|s| s.value).collect()
}

#[test]
fn a_biquad_is_made_for_the_rate_of_the_samples_and_not_for_its_own() {
    let mut bench = Bench::<Biquad>::new(r#"{"frequency_hz": 20}"#);
    let out = slow_samples(&mut bench, 600, |t| (TAU * 20.0 * t).sin());
    // At its corner it lets half of the power through.
    let power = out[200..].iter().map(|y| y * y).sum::<f64>() / 400.0;
    assert!((power - 0.25).abs() < 0.01, "{power}");
    assert!((bench.state().value_hz - 200.0).abs() < 1e-6, "{}", bench.state().value_hz);
    let refused = bench.configure(r#"{"frequency_hz": 150}"#).unwrap_err().reason;
    assert_eq!(
        refused,
        "frequency_hz: 150 Hz is not below half the rate of the samples, 200 Hz: choose less than 100 Hz"
    );
}

#[test]
fn a_rate_that_becomes_known_moves_no_constant() {
    let mut bench = Bench::<Biquad>::new(r#"{"frequency_hz": 20}"#);
    let out = slow_samples(&mut bench, 100, |_| 3.0);
    assert!(out.len() == 100 && out.iter().all(|y| (y - 3.0).abs() < 1e-9), "{out:?}");
}

#[test]
fn a_corner_that_the_samples_are_too_slow_for_is_a_fault_that_says_so() {
    let mut bench = Bench::<Biquad>::new(r#"{"frequency_hz": 150}"#);
    let why = (0..20).find_map(|n| {
        let stamp = bench.now();
        bench.push("value", Scalar { stamp, value: f64::from(n) });
        (0..5).find_map(|_| bench.try_step().err())
    });
    let why = why.expect("it goes on with a filter that cannot be").reason;
    assert!(why.contains("is not below half the rate of the samples, 200 Hz"), "{why}");
}

#[test]
fn a_corner_that_only_the_rate_of_the_component_is_too_slow_for_is_no_fault() {
    let mut bench = Bench::<Biquad>::new(r#"{"frequency_hz": 600}"#);
    for _ in 0..100 {
        // Four samples of 4 kHz in each step of 1 kHz.
        for quarter in 0..4 {
            let stamp = Stamp::from_ns(bench.now().ns() + quarter * 250_000);
            bench.push("value", Scalar { stamp, value: 3.0 });
        }
        bench.step(1);
    }
    assert!((bench.state().value_hz - 4000.0).abs() < 1e-6, "{}", bench.state().value_hz);
    assert!(bench.outputs::<Scalar>("filtered").iter().all(|s| (s.value - 3.0).abs() < 1e-9));
}

#[test]
fn a_corner_that_is_too_high_is_a_fault_where_stamps_say_nothing_too() {
    let mut bench = Bench::<Biquad>::new(r#"{"frequency_hz": 600}"#);
    let stamp = Stamp::from_ns(77);
    let why = (0..40).find_map(|_| {
        bench.push("value", Scalar { stamp, value: 3.0 });
        bench.try_step().err()
    });
    let why = why.expect("it goes on without a filter").reason;
    assert!(why.contains("is not below half the rate of the samples, 1000 Hz"), "{why}");
}
