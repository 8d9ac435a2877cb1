//! A sine generator: the smallest source of data.
//!
//! Invariant: the value depends on the tick's deadline alone, so two generators with equal settings agree to
//! the bit.
#![forbid(unsafe_code)]

use std::f64::consts::TAU;
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;

#[derive(Config)]
pub struct SineConfig {
    /// Half of the way from trough to crest
    #[config(live, default = 1.0)]
    amplitude: f64,
    /// Frequency
    #[config(live, min = 0.0, max = 500.0, unit = "Hz", default = 1.0)]
    frequency_hz: f64,
    /// Phase at the first step
    #[config(live, unit = "rad", default = 0.0)]
    phase_rad: f64,
}

/// Writes amplitude · sin(2π · frequency · t + phase), t counted from Start.
#[derive(Component)]
#[component(rate_hz = 1000, provides("signal"))]
pub struct Sine {
    /// The generated signal
    #[output]
    value: Out<Scalar>,
    #[state]
    latest: Scalar,
    #[config]
    cfg: SineConfig,
    /// Deadline of the first step after Start.
    begin: Stamp,
}

#[provides("signal")]
impl Sine {
    /// The latest value.
    #[read]
    fn value(s: &SineState) -> f64 {
        s.latest.value
    }
}

impl Component for Sine {
    fn start(&mut self) -> Result {
        self.begin = Stamp::INVALID;
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        if !self.begin.is_valid() {
            self.begin = tick.deadline();
        }
        let t = tick.deadline().seconds_since(self.begin);
        let SineConfig { amplitude, frequency_hz, phase_rad } = &self.cfg;
        let value = amplitude * (TAU * frequency_hz * t + phase_rad).sin();
        self.latest = Scalar { stamp: tick.now(), value };
        self.value.write(&self.latest);
        Ok(())
    }
}

trocar_plugin!(Sine);

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use trocar_sdk::testing::Bench;

    #[test]
    fn a_one_hertz_sine_crests_after_a_quarter_of_a_second() {
        let mut bench = Bench::<Sine>::new(r#"{"amplitude": 2}"#);
        bench.step(251);
        let out = bench.outputs::<Scalar>("value");
        assert_eq!(out[0].value, 0.0);
        assert!((out[250].value - 2.0).abs() < 1e-9, "after 0.25 s the value is {}", out[250].value);
        assert_eq!(bench.read::<(), f64>("value", ()).unwrap(), out[250].value);
    }

    #[test]
    fn settings_change_while_it_runs() {
        let mut bench = Bench::<Sine>::new("{}");
        bench.step(10);
        bench.configure(r#"{"amplitude": 0.0}"#).unwrap();
        bench.step(1);
        assert_eq!(bench.state().latest.value, 0.0);
    }

    #[test]
    fn a_frequency_above_half_the_rate_is_refused() {
        let refused = Bench::<Sine>::created().configure(r#"{"frequency_hz": 501}"#).unwrap_err();
        assert_eq!(refused.reason, "frequency_hz: 501 Hz is above 500 Hz");
    }

    /// Amplitude, frequency and phase. Other settings are another sine of the same time, so that its value
    /// may jump.
    fn sines() -> impl Strategy<Value = (f64, f64, f64)> {
        let any_size = || prop_oneof![-1e3..1e3f64, -1e300..1e300f64, Just(f64::MAX)];
        (any_size(), 0.0..=500.0f64, any_size())
    }

    proptest! {
        #[test]
        fn a_value_is_a_number_within_the_amplitude_of_now_whatever_pace_and_settings(
            parts in prop::collection::vec((sines(), prop::collection::vec(prop::option::of(0..17u32), 1..10)), 1..4),
        ) {
            let config = |(amplitude, hz, phase): (f64, f64, f64)| {
                format!(r#"{{"amplitude": {amplitude:e}, "frequency_hz": {hz}, "phase_rad": {phase:e}}}"#)
            };
            let mut bench = Bench::<Sine>::new("{}");
            for (set, paces) in parts {
                bench.configure(config(set)).unwrap();
                for pace in paces {
                    match pace {
                        None => bench.step(1),
                        Some(e) => bench.step_after(if e == 0 { 0 } else { 10u64.pow(e) }).unwrap(),
                    }
                    let value = bench.outputs::<Scalar>("value")[0].value;
                    prop_assert!(value.abs() <= set.0.abs(), "{value} of {set:?}");
                    prop_assert_eq!(bench.state().latest.value, value);
                }
            }
        }
    }
}
