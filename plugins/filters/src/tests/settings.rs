//! Settings that change while samples flow: nothing comes out that was not in the signal.
//!
//! Invariant: laws for any two settings; `PROPTEST_CASES=1000000` asks more of them than the gate does.

use proptest::prelude::*;

use super::*;

/// Kinds of a biquad that let a constant through, and all, with whether they do.
const THROUGH: &[(&str, bool)] = &[("low_pass", true), ("notch", true)];
const ALL: &[(&str, bool)] =
    &[("low_pass", true), ("notch", true), ("high_pass", false), ("band_pass", false)];

/// Settings of a biquad, and whether they let a constant through.
fn biquads(kinds: &'static [(&'static str, bool)]) -> impl Strategy<Value = (String, bool)> {
    let kinds = prop::sample::select(kinds);
    // Up to nearly half of the rate, 1 kHz, evenly over the decades.
    let (hz, q) = ((-2.0..2.698f64).prop_map(|e| 10f64.powf(e)), (-1.3..2.0f64).prop_map(|e| 10f64.powf(e)));
    (kinds, hz, q).prop_map(|((kind, through), hz, q)| {
        (format!(r#"{{"kind": "{kind}", "frequency_hz": {hz}, "q": {q}}}"#), through)
    })
}

fn medians() -> impl Strategy<Value = String> {
    (0..=50usize).prop_map(|half| format!(r#"{{"window": {}}}"#, 2 * half + 1))
}

fn kalmans() -> impl Strategy<Value = String> {
    (-6.0..6.0f64, -6.0..6.0f64, 0.0..1.0f64).prop_map(|(sigma, acceleration, ahead)| {
        let (sigma, acceleration) = (10f64.powf(sigma), 10f64.powf(acceleration));
        format!(r#"{{"sigma": {sigma}, "acceleration": {acceleration}, "predict_s": {ahead}}}"#)
    })
}

fn resamplers() -> impl Strategy<Value = String> {
    (prop::sample::select(vec!["linear", "hold"]), 0.0..0.04f64, 0.0..0.1f64).prop_map(
        |(method, delay, ahead)| {
            format!(r#"{{"method": "{method}", "delay_s": {delay}, "ahead_s": {ahead}}}"#)
        },
    )
}

/// The outputs of a class for these samples at 1 kHz, with other settings from the middle on.
fn changed<C: Class, T: Payload>(
    settings: [&str; 2],
    output: &str,
    signal: &[f64],
    number: impl Fn(&T) -> f64,
) -> [Vec<f64>; 2] {
    let mut bench = Bench::<C>::new(settings[0]);
    let halves = signal.split_at(signal.len() / 2);
    let half = |bench: &mut Bench<C>, values: &[f64]| -> Vec<f64> {
        for value in values {
            let stamp = bench.now();
            bench.push("value", Scalar { stamp, value: *value });
            bench.step(1);
        }
        bench.outputs::<T>(output).iter().map(&number).collect()
    };
    let before = half(&mut bench, halves.0);
    bench.configure(settings[1]).unwrap();
    [before, half(&mut bench, halves.1)]
}

/// A constant comes out as it went in, before the change and after it.
fn passes<C: Class, T: Payload>(
    settings: [&str; 2],
    output: &str,
    constant: f64,
    number: impl Fn(&T) -> f64,
) -> Result<(), TestCaseError> {
    let [before, after] = changed::<C, T>(settings, output, &[constant; 80], number);
    prop_assert!(!before.is_empty() && !after.is_empty(), "nothing came out: {settings:?}");
    for (n, y) in before.iter().chain(&after).enumerate() {
        prop_assert!(
            (y - constant).abs() <= 1e-9 * constant.abs(),
            "{constant} became {y} at {n}: {settings:?}"
        );
    }
    Ok(())
}

proptest! {
    #[test]
    fn a_biquad_lets_a_constant_through_whatever_it_is_set_to(
        (from, _) in biquads(THROUGH), (to, _) in biquads(THROUGH), constant in -1e6..1e6f64,
    ) {
        passes::<Biquad, Scalar>([&from, &to], "filtered", constant, |s| s.value)?;
    }

    #[test]
    fn a_biquad_between_any_settings_leads_a_constant_without_a_jump_to_what_becomes_of_it(
        (from, through) in biquads(ALL), (to, still) in biquads(ALL), constant in -1e6..1e6f64,
    ) {
        let [before, after] = changed::<Biquad, Scalar>([&from, &to], "filtered", &[constant; 80], |s| s.value);
        let [is, becomes] = [through, still].map(|through| if through { constant } else { 0.0 });
        let mut last = before[before.len() - 1];
        prop_assert!((last - is).abs() <= 1e-9 * constant.abs(), "{last} is not {is}: {from}");
        for y in after {
            // Nearer to it each time, and never beyond.
            let way = (y - last) * (becomes - last).signum();
            prop_assert!(way >= -1e-9 * constant.abs(), "{last} then {y} on the way to {becomes}: {from} {to}");
            prop_assert!((y - becomes).abs() <= (last - becomes).abs() + 1e-9 * constant.abs(), "{y}: {from} {to}");
            last = y;
        }
    }

    #[test]
    fn noise_comes_out_of_a_changed_biquad_no_larger_than_the_designs_can_make_it(
        (from, _) in biquads(ALL), (to, _) in biquads(ALL), seed: u64,
    ) {
        let mut random = fastrand::Rng::with_seed(seed);
        let noise: Vec<f64> = (0..2000).map(|_| 2.0 * random.f64() - 1.0).collect();
        let [before, after] = changed::<Biquad, Scalar>([&from, &to], "filtered", &noise, |s| s.value);
        let [old, new] = [&from, &to].map(|settings| most(settings));
        let most_before = before.iter().fold(0.0, |m: f64, y| m.max(y.abs()));
        prop_assert!(most_before <= 1.0 + 2.0 * old, "{most_before}: {from}");
        // The seat is as large as the old design can make it; the new one adds its part of the difference,
        // and the fading step.
        let seat = (1.0 + 2.0 * old).max(1.0);
        let bound = seat + new * (1.0 + seat) + 2.0 * seat;
        let most_after = after.iter().fold(0.0, |m: f64, y| m.max(y.abs()));
        prop_assert!(most_after <= bound, "{most_after} > {bound}: {from} {to}");
    }

    #[test]
    fn a_median_lets_a_constant_through_whatever_it_is_set_to(
        from in medians(), to in medians(), constant in -1e6..1e6f64,
    ) {
        passes::<MovingMedian, Scalar>([&from, &to], "filtered", constant, |s| s.value)?;
    }

    #[test]
    fn a_kalman_filter_lets_a_constant_through_whatever_it_is_set_to(
        from in kalmans(), to in kalmans(), constant in -1e6..1e6f64,
    ) {
        passes::<Kalman, Estimate>([&from, &to], "estimate", constant, |e| e.value)?;
    }

    #[test]
    fn a_resampler_lets_a_constant_through_whatever_it_is_set_to(
        from in resamplers(), to in resamplers(), constant in -1e6..1e6f64,
    ) {
        passes::<Resampler, Scalar>([&from, &to], "resampled", constant, |s| s.value)?;
    }
}

/// Gains and limits of a controller.
fn controllers() -> impl Strategy<Value = String> {
    let gain = || prop_oneof![Just(0.0), -1e12..1e12f64, -10.0..10.0f64];
    let smooth = prop_oneof![Just(0.0), 0.0..100.0f64, 0.0..1e-3f64];
    (gain(), gain(), gain(), smooth, 0.001..1e12f64).prop_map(|(kp, ki, kd, smooth, limit)| {
        format!(
            r#"{{"kp": {kp}, "ki": {ki}, "kd": {kd}, "smooth_s": {smooth}, "lowest": {}, "highest": {limit}, "max_age_s": 3600}}"#,
            -limit
        )
    })
}

/// Steps on the grid (none), or so long after the one before, ns; 0 in the same instant.
fn paces() -> impl Strategy<Value = Option<u64>> {
    prop_oneof![Just(None), Just(Some(0)), (0..10u32).prop_map(|e| Some(10u64.pow(e)))]
}

proptest! {
    #[test]
    fn a_controller_gives_numbers_within_its_limits_at_any_pace_and_settings(
        settings in [controllers(), controllers()],
        steps in prop::collection::vec((paces(), -1e100..1e100f64, -1e100..1e100f64), 1..20),
    ) {
        let mut bench = Bench::<Pid>::new(&settings[0]);
        for (n, (pace, setpoint, measured)) in steps.iter().enumerate() {
            if n == 10 {
                bench.configure(&settings[1]).unwrap();
            }
            let stamp = bench.now();
            bench.push("setpoint", Scalar { stamp, value: *setpoint });
            bench.push("measured", Scalar { stamp, value: *measured });
            match pace {
                None => bench.step(1),
                Some(ns) => bench.step_after(*ns).unwrap(),
            }
            let state = bench.state();
            for (what, number) in [("output", state.output), ("integral", state.integral), ("error", state.error)] {
                prop_assert!(number.is_finite(), "{what} is {number} at {n}: {settings:?} {steps:?}");
            }
        }
        for command in bench.outputs::<Scalar>("command") {
            prop_assert!(command.value.abs() <= 1e12, "{command:?}");
        }
    }
}

/// The most that becomes of a signal within ±1: the sum of what a design makes of an impulse.
fn most(settings: &str) -> f64 {
    let mut bench = Bench::<Biquad>::new(settings);
    // The first sample finds it at rest, the second one is the impulse.
    let impulse: Vec<f64> = (0..4000).map(|n| f64::from(u8::from(n == 1))).collect();
    for value in impulse {
        bench.push("value", scalar(value));
        bench.step(1);
    }
    bench.outputs::<Scalar>("filtered").iter().map(|s| s.value.abs()).sum()
}
