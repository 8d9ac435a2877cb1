//! Live settings that change while samples flow, class by class: what of the past goes on, and what may come
//! out.
//!
//! Invariant: every class of the plugin has its line in the table, with a law for any settings and any noise.
//!
//! | class | a change of settings | law |
//! |---|---|---|
//! | `low_pass` | the output goes on from where it is | it lies between itself before and the input |
//! | `biquad` | it rests on its last output or input; a step fades | `settings.rs`: continuity, noise |
//! | `moving_median` | the window grows by 1 or shrinks by 2 a sample | at most twice as fast as its input |
//! | `kalman` | the estimate goes on, as sure as before | between expected and measured; no runaway |
//! | `resampler` | only samples are remembered | the signal at the stamp it gives |
//! | `pid` | integral and slope go on; gains act at once | at rest nothing moves; no kick, no wind-up |
//! | `cartesian_transform` | no memory: poses jump to where they are put now | as if always set so |
//! | `watchdog` | the age goes on beside another limit | lost exactly while the age is above it |
//! | `add_latency` | samples under way keep their delay | all, in order, unaltered, none too early |

use proptest::prelude::*;
use trocar_sdk::data::Transform;

use super::*;

#[test]
fn the_table_names_every_class_of_the_plugin() {
    struct Named;
    impl Law for Named {
        fn of<C: Row>(&self) {
            let line = format!("//! | `{}` |", C::DESC.name);
            assert!(include_str!("changes.rs").contains(&line), "no law for {}", C::DESC.name);
        }
    }
    crate::low_pass::of_each(&Named);
}

/// Parts of a run, each with its settings and its inputs.
fn parts<T: std::fmt::Debug + 'static>(
    settings: BoxedStrategy<String>,
    input: impl Strategy<Value = T> + 'static,
) -> impl Strategy<Value = Vec<(String, Vec<T>)>> {
    prop::collection::vec((settings, prop::collection::vec(input, 1..60)), 2..6)
}

/// Numbers that move by 1 at most from one to the next.
fn walked(steps: &[f64], from: &mut f64) -> Vec<f64> {
    steps
        .iter()
        .map(|step| {
            *from += step;
            *from
        })
        .collect()
}

/// A number of the settings.
fn number(settings: &str, name: &str) -> f64 {
    let json: trocar_sdk::serde_json::Value = trocar_sdk::serde_json::from_str(settings).unwrap();
    json[name].as_f64().unwrap()
}

fn run<C: Class>(bench: &mut Bench<C>, value: f64) {
    let stamp = bench.now();
    bench.push("value", Scalar { stamp, value });
    bench.step(1);
}

proptest! {
    /// A window that slides or grows moves its median by one place at most, one that shrinks by two by
    /// another one. Neighbours in the window of such an input are 1 apart at most.
    #[test]
    fn a_median_moves_at_most_twice_as_fast_as_its_input_whatever_becomes_of_its_window(
        parts in parts(MovingMedian::settings(), -1.0..=1.0f64),
    ) {
        let mut bench = Bench::<MovingMedian>::new(&parts[0].0);
        let (mut x, mut given, mut before) = (0.0, Vec::new(), None);
        for (settings, steps) in &parts {
            bench.configure(settings).unwrap();
            for x in walked(steps, &mut x) {
                run(&mut bench, x);
                given.push(x);
                let y = bench.outputs::<Scalar>("filtered")[0].value;
                let recent = &given[given.len().saturating_sub(101)..];
                prop_assert!(recent.contains(&y), "{y} never came in");
                let before = before.replace(y).unwrap_or(y);
                prop_assert!((y - before).abs() <= 2.0 + 1e-9, "{before} then {y} at {}", given.len());
            }
        }
    }

    /// The estimate is the end of the curve with the least squares. The squares of the curve 0 are 1 each at
    /// most, so the root of their number is the most that a measurement is away from the better curve.
    #[test]
    fn noise_does_not_run_away_in_a_kalman_filter_whatever_becomes_of_its_settings(
        parts in parts(Kalman::settings(), (-1.0..=1.0f64, prop_oneof![2 => Just(6), 1 => 0..11u32])),
    ) {
        let mut bench = Bench::<Kalman>::new(&parts[0].0);
        let (mut count, mut before) = (0.0f64, None);
        for (settings, noise) in &parts {
            bench.configure(settings).unwrap();
            let ahead = number(settings, "predict_s");
            for (z, decade) in noise {
                let stamp = bench.now();
                bench.push("value", Scalar { stamp, value: *z });
                bench.step_after(10u64.pow(*decade)).unwrap();
                count += 1.0;
                // None while it takes them for outliers.
                let Some(e) = bench.outputs::<Estimate>("estimate").pop() else { continue };
                let at = e.value - ahead * e.rate;
                let expected = before.map_or(*z, |(at, rate, since)| at + rate * stamp.seconds_since(since));
                let rounding = 1e-9 * (1.0 + ahead * e.rate.abs() + expected.abs());
                prop_assert!(
                    at >= z.min(expected) - rounding && at <= z.max(expected) + rounding,
                    "{at} at {count}: {z} came, {expected} was expected: {settings}"
                );
                prop_assert!(at.abs() <= 1.0 + count.sqrt() + rounding, "{at} at {count}: {settings}");
                before = Some((at, e.rate, stamp));
            }
        }
    }

    /// Beyond the newest sample it goes on as from the one before: 2 in a period at most.
    #[test]
    fn a_resampler_gives_the_signal_at_its_stamp_whatever_was_set_before(
        parts in parts(Resampler::settings(), prop::option::of(-1.0..=1.0f64)),
    ) {
        let mut bench = Bench::<Resampler>::new(&parts[0].0);
        let mut given: Vec<(u64, f64)> = Vec::new();
        for (settings, values) in &parts {
            bench.configure(settings).unwrap();
            for value in values {
                if let Some(value) = value {
                    given.push((bench.now().ns(), *value));
                    run(&mut bench, *value);
                } else {
                    bench.step(1);
                }
                for y in bench.outputs::<Scalar>("resampled") {
                    let (newest, last) = *given.last().unwrap();
                    if y.stamp.ns() > newest {
                        // Its stamp is a whole number of ns.
                        let ahead_ns = (y.stamp.ns() - newest + 1) as f64;
                        prop_assert!((y.value - last).abs() <= 2e-6 * ahead_ns + 1e-9, "{y:?}: {settings}");
                    } else {
                        let at = given.partition_point(|(ns, _)| *ns < y.stamp.ns());
                        let (to_ns, to) = given[at];
                        let (from_ns, from) = if to_ns == y.stamp.ns() { given[at] } else { given[at - 1] };
                        let part = (y.stamp.ns() - from_ns) as f64 / (to_ns - from_ns).max(1) as f64;
                        let there = from + part * (to - from);
                        prop_assert!((y.value - there).abs() < 1e-6, "{y:?} is not {there}: {settings}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_controller_at_its_setpoint_gives_what_it_gave_whatever_becomes_of_its_gains(
        gains in prop::collection::vec((-1e3..1e3f64, -1e3..1e3f64, -1e3..1e3f64, 0.0..100.0f64), 2..6),
        error in -10.0..10.0f64,
    ) {
        let settings = |(kp, ki, kd, smooth): &(f64, f64, f64, f64)| {
            format!(r#"{{"kp": {kp}, "ki": {ki}, "kd": {kd}, "smooth_s": {smooth}, "lowest": -1e9, "highest": 1e9}}"#)
        };
        let mut bench = Bench::<Pid>::new(settings(&gains[0]));
        let give = |bench: &mut Bench<Pid>, error: f64| {
            bench.push("setpoint", scalar(3.0 + error));
            bench.push("measured", scalar(3.0));
            bench.step(1);
            bench.state().output
        };
        (0..20).for_each(|_| _ = give(&mut bench, error));
        let stays = give(&mut bench, 0.0);
        for gains in &gains {
            bench.configure(settings(gains)).unwrap();
            for _ in 0..5 {
                let output = give(&mut bench, 0.0);
                prop_assert!((output - stays).abs() <= 1e-9 * stays.abs(), "{stays} became {output}: {gains:?}");
            }
        }
    }

    /// A measurement that stands still has no slope of its own: what is left of the last one only fades.
    #[test]
    fn a_change_of_smoothing_is_no_motion_of_what_is_measured(
        moves in prop::collection::vec(-1.0..1.0f64, 1..20),
        smooth in prop::collection::vec(prop_oneof![Just(0.0), ten_to(-6.0, 2.0)], 2..6),
        paces in prop::collection::vec(
            prop_oneof![Just(None), Just(Some(0)), (0..10u32).prop_map(|e| Some(10u64.pow(e)))],
            30,
        ),
    ) {
        let settings = |smooth: f64| {
            format!(r#"{{"kp": 0, "kd": 1, "smooth_s": {smooth}, "lowest": -1e12, "highest": 1e12, "max_age_s": 3600}}"#)
        };
        let mut bench = Bench::<Pid>::new(settings(smooth[0]));
        let give = |bench: &mut Bench<Pid>, measured: f64, pace: Option<u64>| {
            bench.push("setpoint", scalar(0.0));
            bench.push("measured", scalar(measured));
            match pace {
                None => bench.step(1),
                Some(ns) => bench.step_after(ns).unwrap(),
            }
            bench.state().output.abs()
        };
        let mut last = 0.0;
        for measured in &moves {
            last = give(&mut bench, *measured, None);
        }
        let measured = moves[moves.len() - 1];
        for (n, pace) in paces.iter().enumerate() {
            bench.configure(settings(smooth[n % smooth.len()])).unwrap();
            let slope = give(&mut bench, measured, *pace);
            prop_assert!(slope <= last + 1e-9, "{last} per s became {slope} at {n}");
            last = slope;
        }
    }

    /// An integral beyond its limits would have to be wound back before the output leaves them.
    #[test]
    fn an_integral_alone_is_the_output_whatever_becomes_of_gain_and_limits(
        parts in prop::collection::vec(
            ((0.0..1e3f64, ten_to(-6.0, 6.0), -0.99..0.99f64), prop::collection::vec(-1.0..1.0f64, 1..20)),
            2..6,
        ),
    ) {
        let settings = |(ki, wide, middle): (f64, f64, f64)| {
            let (lowest, highest) = (wide * (middle - 1.0), wide * (middle + 1.0));
            let safe = wide * middle;
            format!(r#"{{"kp": 0, "ki": {ki}, "lowest": {lowest}, "highest": {highest}, "safe": {safe}}}"#)
        };
        let mut bench = Bench::<Pid>::new(settings(parts[0].0));
        let mut largest = 0.0f64;
        for (set, errors) in &parts {
            bench.configure(settings(*set)).unwrap();
            for error in errors {
                bench.push("setpoint", scalar(*error));
                bench.push("measured", scalar(0.0));
                bench.step(1);
                let (output, integral) = (bench.state().output, bench.state().integral);
                largest = largest.max(integral.abs());
                prop_assert!((output - integral).abs() <= 1e-12 * largest, "{output}, {integral}: {set:?}");
            }
        }
    }

    #[test]
    fn a_changed_transform_is_as_if_it_had_always_been_so_and_moves_a_pose_no_further_than_it_is_long(
        from in CartesianTransform::settings(), to in CartesianTransform::settings(),
        comes in prop::option::of(prop::array::uniform3(-1e3..1e3f64)),
        poses in prop::collection::vec((prop::array::uniform3(-1e6..1e6f64), rows::turns()), 1..10),
    ) {
        let [mut changed, mut always] = [from, to.clone()].map(Bench::<CartesianTransform>::new);
        let give = |bench: &mut Bench<CartesianTransform>| {
            for (position, orientation) in &poses {
                let stamp = Stamp::from_ns(bench.now().ns() + 1_000_000);
                if let Some(position) = comes {
                    let pose = Pose { stamp, position, ..Pose::default() };
                    bench.push_at("transform", Transform { pose, ..Transform::default() }, stamp);
                }
                bench.push("pose", Pose { stamp, position: *position, orientation: *orientation });
                bench.step(1);
            }
            bench.outputs::<Pose>("transformed")
        };
        let long = |p: [f64; 3]| nalgebra::Vector3::from(p).norm();
        give(&mut changed);
        give(&mut always);
        changed.configure(&to).unwrap();
        let (out, expected) = (give(&mut changed), give(&mut always));
        prop_assert_eq!(out.len(), poses.len());
        for ((y, expected), (position, _)) in out.iter().zip(&expected).zip(&poses) {
            prop_assert_eq!(y, expected);
            // Each of three coordinates is within 1000 m.
            prop_assert!(long(y.position) <= 1.000001 * (long(*position) + 1733.0), "{y:?}");
        }
    }

    #[test]
    fn data_are_lost_exactly_while_their_age_is_above_what_is_set_now(
        parts in parts(Watchdog::settings(), (any::<bool>(), (0..11u32).prop_map(|e| 10u64.pow(e)))),
    ) {
        let mut bench = Bench::<Watchdog>::new(&parts[0].0);
        let (mut newest, mut came, mut lost, mut holds) = (bench.now(), false, false, 0);
        for (settings, steps) in &parts {
            bench.configure(settings).unwrap();
            let limit_s = number(settings, "timeout_s");
            for (comes, ns) in steps {
                if *comes {
                    (newest, came) = (bench.now(), true);
                    bench.push("watched", scalar(1.0));
                }
                bench.step_after(*ns).unwrap();
                let age_s = bench.now().seconds_since(newest);
                let state = bench.state();
                prop_assert_eq!((state.age_s, state.data_lost.get()), (age_s, age_s > limit_s));
                prop_assert_eq!(state.alive.get(), came && age_s <= limit_s);
                // Told once each, in turn, with its number.
                let told = (bench.events::<f64>("ctl/lost"), bench.events::<f64>("ctl/found").len());
                let turns = (!lost && age_s > limit_s, lost && age_s <= limit_s);
                prop_assert_eq!(told, (if turns.0 { vec![age_s] } else { vec![] }, usize::from(turns.1)));
                lost = age_s > limit_s;
                prop_assert!(state.holds - holds <= u64::from(lost) && (!turns.0 || state.holds > holds));
                holds = state.holds;
            }
        }
    }

    #[test]
    fn samples_leave_in_order_and_none_before_the_delay_it_came_with_whatever_becomes_of_it(
        parts in parts(
            (prop_oneof![Just(0.0), 0.0..0.05f64], prop_oneof![Just(0.0), 0.0..0.02f64])
                .prop_map(|(delay, jitter)| format!(r#"{{"delay_s": {delay}, "jitter_s": {jitter}}}"#))
                .boxed(),
            any::<bool>(),
        ),
    ) {
        let mut bench = Bench::<AddLatency>::new(&parts[0].0);
        bench.connect_as::<Scalar>("delayed");
        // Number, and when it may leave and must have left.
        let (mut sent, mut left, mut latest) = (Vec::new(), 0, 0.0f64);
        let begun = bench.now();
        let mut look = |bench: &mut Bench<AddLatency>, sent: &[(f64, f64, f64)]| {
            let now_s = bench.now().seconds_since(begun);
            for sample in bench.outputs::<Scalar>("delayed") {
                let (value, earliest, _) = sent[left];
                prop_assert_eq!(sample.value, value);
                prop_assert!(now_s >= earliest - 1e-9, "{value} left {now_s} s after the begin, not {earliest} s");
                left += 1;
            }
            if let Some((value, _, by)) = sent.get(left) {
                prop_assert!(now_s < by + 1e-9, "{value} is still there after {now_s} s, not {by} s");
            }
            Ok(left)
        };
        for (settings, comes) in &parts {
            bench.configure(settings).unwrap();
            let [delay, jitter] = ["delay_s", "jitter_s"].map(|name| number(settings, name));
            for comes in comes {
                if *comes {
                    let (value, taken_s) = (sent.len() as f64, bench.now().seconds_since(begun) + 1e-3);
                    bench.push("sample", scalar(value));
                    latest = latest.max(taken_s + delay + jitter);
                    sent.push((value, taken_s + delay, latest + 1e-3));
                }
                bench.step(1);
                look(&mut bench, &sent)?;
            }
        }
        bench.step(100);
        prop_assert_eq!(look(&mut bench, &sent)?, sent.len());
    }
}
