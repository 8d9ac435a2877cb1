//! Each class of the plugin as a row: its settings, a way to feed it, and all numbers that come out of it.
//!
//! Invariant: a class that the plugin registers without a row here does not compile; each live setting is
//! varied.

use proptest::prelude::*;
use trocar_sdk::data::{CartesianState, Transform};
use trocar_sdk::testing::numbers;

use super::*;

/// A test of one class after the other.
pub(crate) trait Law {
    fn of<C: Row>(&self);
}

/// A class of the plugin. The row of `low_pass` is in its own tests.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is a class of the plugin without a row",
    note = "write its row in `tests/rows.rs`, its law in `tests/changes.rs`"
)]
pub(crate) trait Row: Class {
    /// Settings that the class takes: all live ones, over their whole range.
    fn settings() -> BoxedStrategy<String>;

    /// Gives each input that takes numbers a sample.
    fn feed(bench: &mut Bench<Self>, given: &Given);

    /// All numbers of outputs, events and calls since the last asking.
    fn told(bench: &mut Bench<Self>) -> Vec<f64>;
}

/// One sample for each input.
#[derive(Clone, Debug)]
pub(crate) struct Given {
    pub(crate) stamp: Stamp,
    pub(crate) numbers: [f64; 6],
    /// x, y, z, w of an orientation.
    pub(crate) turn: [f64; 4],
}

impl Given {
    fn scalar(&self, n: usize) -> Scalar {
        Scalar { stamp: self.stamp, value: self.numbers[n] }
    }

    fn wrench(&self) -> Wrench {
        let [a, b, c, d, e, f] = self.numbers;
        Wrench { stamp: self.stamp, force: [a, b, c], torque: [d, e, f] }
    }

    fn pose(&self, n: usize) -> Pose {
        let [a, b, c, d, e, f] = self.numbers;
        Pose { stamp: self.stamp, position: [[a, b, c], [d, e, f]][n], orientation: self.turn }
    }
}

/// All numbers that an output gave since the last asking.
pub(crate) fn told<C: Class, T: Payload>(bench: &mut Bench<C>, output: &str) -> Vec<f64> {
    bench.outputs::<T>(output).iter().flat_map(numbers).collect()
}

/// Evenly over the decades from one power of ten to another.
pub(crate) fn ten_to(lowest: f64, highest: f64) -> impl Strategy<Value = f64> {
    (lowest..=highest).prop_map(move |e| 10f64.powf(e).clamp(10f64.powf(lowest), 10f64.powf(highest)))
}

/// Seconds up to the most that a setting takes, 0 among them.
fn seconds(highest: f64) -> impl Strategy<Value = f64> {
    prop_oneof![1 => Just(0.0), 4 => ten_to(-9.0, highest)]
}

impl Row for Biquad {
    fn settings() -> BoxedStrategy<String> {
        let kind = prop::sample::select(vec!["low_pass", "high_pass", "band_pass", "notch"]);
        (kind, ten_to(-3.0, 6.0), ten_to(-1.3, 2.0))
            .prop_map(|(kind, hz, q)| format!(r#"{{"kind": "{kind}", "frequency_hz": {hz}, "q": {q}}}"#))
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.push_at("value", given.scalar(0), given.stamp);
        bench.push_at("wrench", given.wrench(), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        [told::<_, Scalar>(bench, "filtered"), told::<_, Wrench>(bench, "filtered_wrench")].concat()
    }
}

impl Row for MovingMedian {
    fn settings() -> BoxedStrategy<String> {
        (0..=50usize).prop_map(|half| format!(r#"{{"window": {}}}"#, 2 * half + 1)).boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.push_at("value", given.scalar(0), given.stamp);
        bench.push_at("wrench", given.wrench(), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        [told::<_, Scalar>(bench, "filtered"), told::<_, Wrench>(bench, "filtered_wrench")].concat()
    }
}

impl Row for Kalman {
    fn settings() -> BoxedStrategy<String> {
        let gate = prop_oneof![2 => Just(0.0), 1 => ten_to(-3.0, 3.0)];
        (ten_to(-12.0, 12.0), ten_to(-24.0, 24.0), gate, seconds(0.0), ten_to(-3.0, 3.556))
            .prop_map(|(sigma, acceleration, gate, ahead, forget)| {
                format!(
                    r#"{{"sigma": {sigma}, "acceleration": {acceleration}, "gate": {gate}, "predict_s": {ahead}, "forget_s": {forget}}}"#
                )
            })
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.push_at("value", given.scalar(0), given.stamp);
        bench.push_at("pose", given.pose(0), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        [told::<_, Estimate>(bench, "estimate"), told::<_, CartesianState>(bench, "moving")].concat()
    }
}

impl Row for Resampler {
    fn settings() -> BoxedStrategy<String> {
        let method = prop::sample::select(vec!["linear", "hold"]);
        (method, seconds(1.0), seconds(1.0), ten_to(-4.0, 3.556))
            .prop_map(|(method, delay, ahead, age)| {
                format!(
                    r#"{{"method": "{method}", "delay_s": {delay}, "ahead_s": {}, "max_age_s": {age}}}"#,
                    ahead.min(age)
                )
            })
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.push_at("value", given.scalar(0), given.stamp);
        bench.push_at("pose", given.pose(0), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        [told::<_, Scalar>(bench, "resampled"), told::<_, Pose>(bench, "resampled_pose")].concat()
    }
}

impl Row for Pid {
    fn settings() -> BoxedStrategy<String> {
        let gain = || prop_oneof![Just(0.0), -1e12..=1e12f64, -10.0..10.0f64];
        let limits = prop_oneof![ten_to(-3.0, 308.0), ten_to(-3.0, 12.0)];
        let safe = -1.0..=1.0f64;
        (gain(), gain(), gain(), seconds(2.0), limits, safe, ten_to(-4.0, 3.556), seconds(3.556))
            .prop_map(|(kp, ki, kd, smooth, limit, safe, age, setpoint_age)| {
                let gains = format!(r#""kp": {kp}, "ki": {ki}, "kd": {kd}, "smooth_s": {smooth}"#);
                let ages = format!(r#""max_age_s": {age}, "setpoint_max_age_s": {setpoint_age}"#);
                format!(
                    r#"{{{gains}, {ages}, "lowest": {}, "highest": {limit}, "safe": {}}}"#,
                    -limit,
                    limit * safe
                )
            })
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.push_at("setpoint", given.scalar(0), given.stamp);
        bench.push_at("measured", given.scalar(1), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        told::<_, Scalar>(bench, "command")
    }
}

impl Row for CartesianTransform {
    fn settings() -> BoxedStrategy<String> {
        let side = prop::sample::select(vec!["before", "behind"]);
        let translation = [-1000.0..=1000.0, -1000.0..=1000.0, -1000.0..=1000.0f64];
        (translation, turns(), any::<bool>(), side, seconds(3.556))
            .prop_map(|(translation, rotation, inverse, side, age)| {
                let place = format!(r#""translation_m": {translation:?}, "rotation": {rotation:?}"#);
                format!(r#"{{{place}, "inverse": {inverse}, "side": "{side}", "max_age_s": {age}}}"#)
            })
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        // A transform comes before some of the poses only, so that the configured one is in use, too.
        if given.numbers[0] > 1.0 {
            let transform = Transform { pose: given.pose(1), ..Transform::default() };
            bench.push_at("transform", transform, given.stamp);
        }
        bench.push_at("pose", given.pose(0), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        told::<_, Pose>(bench, "transformed")
    }
}

impl Row for Watchdog {
    fn settings() -> BoxedStrategy<String> {
        (ten_to(-4.0, 3.556), ten_to(-3.0, 3.556))
            .prop_map(|(timeout, repeat)| format!(r#"{{"timeout_s": {timeout}, "repeat_s": {repeat}}}"#))
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.push_at("watched", given.scalar(0), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        [bench.events::<f64>("ctl/lost"), bench.events::<f64>("ctl/found")].concat()
    }
}

impl Row for AddLatency {
    fn settings() -> BoxedStrategy<String> {
        let most = 1.778;
        (seconds(most), seconds(most))
            .prop_map(|(delay, jitter)| format!(r#"{{"delay_s": {delay}, "jitter_s": {jitter}}}"#))
            .boxed()
    }
    fn feed(bench: &mut Bench<Self>, given: &Given) {
        bench.connect_as::<Wrench>("delayed");
        bench.push_at("sample", given.wrench(), given.stamp);
    }
    fn told(bench: &mut Bench<Self>) -> Vec<f64> {
        bench.connect_as::<Wrench>("delayed");
        told::<_, Wrench>(bench, "delayed")
    }
}

/// Orientations.
pub(super) fn turns() -> impl Strategy<Value = [f64; 4]> {
    [-4.0..4.0, -4.0..4.0, -4.0..4.0f64].prop_map(|axis| {
        let q = nalgebra::UnitQuaternion::from_scaled_axis(nalgebra::Vector3::from(axis));
        q.coords.into()
    })
}

#[test]
fn the_settings_of_each_row_are_all_that_are_live() {
    struct AllLive;
    impl Law for AllLive {
        fn of<C: Row>(&self) {
            let mut runner = proptest::test_runner::TestRunner::deterministic();
            let settings = C::settings().new_tree(&mut runner).unwrap().current();
            let given: trocar_sdk::serde_json::Map<String, trocar_sdk::serde_json::Value> =
                trocar_sdk::serde_json::from_str(&settings).unwrap();
            let live: Vec<&str> = C::DESC.config.iter().filter(|f| f.live).map(|f| f.name).collect();
            for name in &live {
                assert!(given.contains_key(*name), "{}: its row does not vary `{name}`", C::DESC.name);
            }
            assert_eq!(given.len(), live.len(), "{}: {settings}", C::DESC.name);
        }
    }
    crate::low_pass::of_each(&AllLive);
}
