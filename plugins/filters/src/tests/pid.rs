//! `pid`: a plant under control, limits, and what is controlled by nothing.

use super::*;

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
    let given = bench.outputs::<Scalar>("command");
    assert_eq!(given.len(), 3000);
    assert!(given.iter().all(|command| command.stamp.is_valid()), "a stamp of 0 would say that it is none");
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
fn what_is_older_than_allowed_is_controlled_by_no_more() {
    let mut bench = Bench::<Pid>::new(r#"{"kp": 0.5, "safe": 0.1}"#);
    let output_after = |bench: &mut Bench<Pid>, steps: u64| {
        bench.step(steps);
        (bench.state().output, bench.state().controls.get())
    };
    let give = |bench: &mut Bench<Pid>, inputs: &[&str]| {
        for input in inputs {
            bench.push(input, scalar(if *input == "setpoint" { 1.0 } else { 0.0 }));
        }
    };
    give(&mut bench, &["setpoint", "measured"]);
    assert_eq!(output_after(&mut bench, 99), (0.5, true), "99 ms old");
    give(&mut bench, &["measured"]);
    assert_eq!(output_after(&mut bench, 3), (0.1, false), "the setpoint is too old");
    give(&mut bench, &["setpoint"]);
    assert_eq!(output_after(&mut bench, 1), (0.5, true));
    assert_eq!(output_after(&mut bench, 110), (0.1, false), "the measurement is too old, too");
    bench.configure(r#"{"kp": 0.5, "safe": 0.1, "setpoint_max_age_s": 0}"#).unwrap();
    give(&mut bench, &["measured"]);
    assert_eq!(output_after(&mut bench, 1), (0.5, true), "a setpoint of any age");
    assert_eq!(output_after(&mut bench, 110), (0.1, false), "but no measurement");
}

#[test]
fn a_source_whose_clock_is_ahead_is_not_followed_for_longer_than_any_other() {
    let mut bench = Bench::<Pid>::new(r#"{"kp": 0.5, "safe": 0.1}"#);
    for input in ["setpoint", "measured"] {
        let stamp = Stamp::from_ns(bench.now().ns() + 900_000_000);
        bench.push_at(input, scalar(if input == "setpoint" { 1.0 } else { 0.0 }), stamp);
    }
    bench.step(90);
    assert_eq!((bench.state().output, bench.state().controls.get()), (0.5, true));
    bench.step(20);
    assert_eq!((bench.state().output, bench.state().controls.get()), (0.1, false), "silent for 110 ms");
}

#[test]
fn bad_measurements_alone_are_controlled_by_until_the_last_good_one_is_too_old() {
    let mut bench = Bench::<Pid>::new(r#"{"kp": 0.5, "safe": 0.1, "setpoint_max_age_s": 0}"#);
    bench.push("setpoint", scalar(1.0));
    bench.push("measured", scalar(0.0));
    for n in 0..120 {
        bench.step(1);
        let expected = if n < 100 { 0.5 } else { 0.1 };
        assert_eq!(bench.state().output, expected, "{n} ms");
        bench.push("measured", scalar(f64::NAN));
    }
    assert_eq!(bench.state().rejected, 119);
}

#[test]
fn another_smoothing_of_a_measurement_that_stands_still_gives_no_kick() {
    let config = |smooth: f64| {
        format!(
            r#"{{"kp": 0, "kd": 1, "smooth_s": {smooth}, "lowest": -1e6, "highest": 1e6, "max_age_s": 10}}"#
        )
    };
    let mut bench = Bench::<Pid>::new(config(1.0));
    let mut last = f64::INFINITY;
    for (n, smooth) in [1.0, 1.0, 0.0, 1.0, 0.01].into_iter().enumerate() {
        bench.configure(config(smooth)).unwrap();
        bench.push("setpoint", scalar(0.0));
        bench.push("measured", scalar(if n == 0 { 0.0 } else { 1.0 }));
        bench.step(1);
        let kick = bench.state().output.abs();
        assert!(kick <= if n < 2 { 1.0 } else { last }, "{kick} at {n}");
        last = kick;
    }
}

#[test]
fn an_integral_that_new_limits_hold_back_comes_off_them_at_once() {
    let config = |limit: f64| {
        format!(r#"{{"kp": 0, "ki": 100, "lowest": {}, "highest": {limit}, "max_age_s": 10}}"#, -limit)
    };
    let mut bench = Bench::<Pid>::new(config(10.0));
    let output = |bench: &mut Bench<Pid>, setpoint: f64, steps: u64| {
        bench.push("setpoint", scalar(setpoint));
        bench.push("measured", scalar(0.0));
        bench.step(steps);
        bench.state().output
    };
    assert!((output(&mut bench, 1.0, 90) - 9.0).abs() < 1e-9);
    bench.configure(config(1.0)).unwrap();
    assert_eq!(output(&mut bench, 0.0, 1), 1.0);
    assert!((output(&mut bench, -1.0, 1) - 0.9).abs() < 1e-9, "not after having wound back 8");
}
