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
    assert_eq!(
        refused::<Biquad>(r#"{"frequency_hz": 500}"#),
        "frequency_hz: 500 Hz is not below half of sample_hz, 500 Hz"
    );
    assert!(refused::<Biquad>(r#"{"kind": "comb"}"#).contains(r#""comb" is not one of"#));
    assert!(refused::<Biquad>(r#"{"q": 0}"#).contains("is below 0.05"));
}
