//! The sample component on the bench.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::tests::{Given, Row, ten_to, told};
use proptest::prelude::*;
use trocar_sdk::testing::Bench;

fn force(z: f64) -> Force {
    Force { stamp: Stamp::INVALID, f: [0.0, 0.0, z] }
}

#[test]
fn a_constant_force_is_reached_in_the_end() {
    let mut bench = Bench::<LowPass>::new("{}");
    for _ in 0..100 {
        bench.push("raw", force(1.0));
        bench.step(1);
    }
    let out = bench.outputs::<Force>("filtered");
    assert_eq!(out.len(), 100);
    assert!(out[0].f[2] < 0.3, "the first sample jumps to {}", out[0].f[2]);
    assert!((out[99].f[2] - 1.0).abs() < 1e-6, "after 100 ms the filter is at {}", out[99].f[2]);
}

#[test]
fn a_sample_is_filtered_once_however_often_the_component_steps() {
    let mut bench = Bench::<LowPass>::new("{}");
    bench.push("raw", force(1.0));
    bench.step(5);
    assert_eq!(bench.outputs::<Force>("filtered").len(), 1);
}

/// The answer of the filter at 1 kHz to a step to 1 N, each sample `dt_ns` after the one before.
fn step_response(dt_ns: u64) -> Vec<f64> {
    let mut bench = Bench::<LowPass>::new(r#"{"cutoff_hz": 10}"#);
    for n in 0..20 {
        let stamp = Stamp::from_ns(1_000_000_000 + n * dt_ns);
        bench.push("raw", Force { stamp, f: [0.0, 0.0, if n == 0 { 0.0 } else { 1.0 }] });
        bench.step(dt_ns.div_ceil(1_000_000));
    }
    bench.outputs::<Force>("filtered").iter().map(|y| y.f[2]).collect()
}

#[test]
fn the_corner_is_the_one_asked_for_whatever_the_rate_of_the_source() {
    for dt_ns in [250_000, 1_000_000, 5_000_000, 40_000_000] {
        let told = step_response(dt_ns);
        assert_eq!(told.len(), 20);
        for (n, y) in told.iter().enumerate() {
            let expected = 1.0 - (-std::f64::consts::TAU * 10.0 * n as f64 * dt_ns as f64 * 1e-9).exp();
            assert!((y - expected).abs() < 1e-9, "{dt_ns} ns apart, sample {n}: {y}, not {expected}");
        }
    }
}

#[test]
fn what_was_filtered_has_the_time_of_its_sample() {
    let mut bench = Bench::<LowPass>::new("{}");
    let stamp = Stamp::from_ns(1_234_567);
    bench.push("raw", Force { stamp, f: [1.0; 3] });
    bench.step(1);
    assert_eq!(bench.samples::<Force>("filtered")[0].1, stamp);
    assert_eq!(bench.read::<(), Force>("value", ()).unwrap().stamp, stamp);
}

#[test]
fn a_sample_carries_the_time_of_its_step_when_it_has_no_stamp_of_its_own() {
    let mut bench = Bench::<LowPass>::new("{}");
    bench.push("raw", force(1.0));
    bench.step(1);
    assert_eq!(bench.samples::<Force>("filtered")[0].1, bench.now());
}

#[test]
fn an_overload_is_told_and_the_robot_held() {
    let mut bench = Bench::<LowPass>::new(r#"{"limit": 0.1}"#);
    bench.push("raw", force(10.0));
    bench.step(1);
    let value = bench.read::<(), Force>("value", ()).unwrap().f[2];
    assert_eq!(bench.events::<f64>("ctl/overload"), [value]);
    assert_eq!(bench.calls::<f64>("hold"), [0.0]);
}

#[test]
fn clear_forgets_the_past() {
    let mut bench = Bench::<LowPass>::new("{}");
    bench.push("raw", force(10.0));
    bench.step(1);
    assert_ne!(bench.state().y.f[2], 0.0);
    bench.command::<(), ()>("clear", ()).unwrap();
    assert_eq!(bench.read::<(), Force>("value", ()).unwrap().f, [0.0; 3]);
}

#[test]
fn a_corner_above_the_limit_is_refused_with_its_unit_and_the_old_one_stays() {
    let mut bench = Bench::<LowPass>::new(r#"{"cutoff_hz": 400}"#);
    let refused = bench.configure(r#"{"cutoff_hz": 1000}"#).unwrap_err();
    assert_eq!(refused.reason, "cutoff_hz: 1000 Hz is above 400 Hz");
    bench.push("raw", force(1.0));
    bench.step(1);
    assert!(bench.state().y.f[2] > 0.9, "a 400 Hz corner follows at once, got {}", bench.state().y.f[2]);
}

#[test]
fn a_disconnected_peer_stops_nobody() {
    let mut bench = Bench::<LowPass>::new(r#"{"limit": 0.1}"#);
    bench.connect_function("hold", false);
    bench.push("raw", force(10.0));
    bench.step(1);
    assert_eq!(bench.events::<f64>("overload").len(), 1);
}

#[test]
fn a_force_that_is_no_number_is_left_out_and_forgotten() {
    crate::tests::as_if_the_bad_ones_had_not_come::<LowPass, Force, Force>(
        (r#"{"limit": 1000}"#, "raw", "filtered"),
        |_| {},
        force,
        force,
        |bench| bench.state().rejected,
    );
}

impl Row for LowPass {
    fn settings() -> BoxedStrategy<String> {
        ten_to(-1.0, 2.6).prop_map(|hz| format!(r#"{{"cutoff_hz": {hz}}}"#)).boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        let [x, y, z, ..] = given.numbers;
        bench.push_at("raw", Force { stamp: given.stamp, f: [x, y, z] }, given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        let filtered = told::<_, Force>(bench, "filtered");
        [filtered, bench.events::<f64>("ctl/overload"), bench.calls::<f64>("hold")].concat()
    }
}

proptest! {
    #[test]
    fn the_output_goes_from_where_it_is_towards_what_comes_whatever_the_corner_becomes(
        steps in prop::collection::vec((LowPass::settings(), -1e8..1e8f64, 0..10u32), 1..40),
    ) {
        let mut bench = Bench::<LowPass>::new(r#"{"limit": 1e9}"#);
        let mut before = 0.0f64;
        for (settings, x, decade) in steps {
            bench.configure(settings.replace('}', r#", "limit": 1e9}"#)).unwrap();
            bench.push("raw", force(x));
            bench.step_after(10u64.pow(decade)).unwrap();
            let y = bench.outputs::<Force>("filtered")[0].f[2];
            let rounding = 1e-12 * (x.abs() + before.abs());
            prop_assert!(
                y >= before.min(x) - rounding && y <= before.max(x) + rounding,
                "{before} became {y} at {x}"
            );
            before = y;
        }
    }
}
