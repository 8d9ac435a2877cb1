//! A source: writes a signal of its own, a value in each step. Change `signal` into what you need.
#![forbid(unsafe_code)]

use std::f64::consts::TAU;
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;

/// The settings; `live` ones may change while the source runs.
#[derive(Config)]
struct Settings {
    /// Half of the way from trough to crest
    #[config(live, default = 1.0)]
    amplitude: f64,
    /// Periods of the signal per second
    #[config(live, min = 0.0, max = 500.0, unit = "Hz", default = 1.0)]
    frequency_hz: f64,
}

/// Writes a signal, beginning at Start.
#[derive(Component)]
#[component(name = "{{crate}}", rate_hz = 1000, provides("control"))]
struct {{Name}} {
    #[output]
    value: Out<Scalar>,
    /// The latest value; published after each step.
    #[state]
    latest: Scalar,
    #[config]
    settings: Settings,
    /// Deadline of the first step since Start; not valid before it.
    begin: Stamp,
}

/// The commands and reads that others may call.
#[provides("control")]
impl {{Name}} {
    /// Begins the signal anew.
    #[command]
    fn restart(&mut self) {
        self.begin = Stamp::INVALID;
    }

    /// The latest value.
    #[read]
    fn value(s: &{{Name}}State) -> f64 {
        s.latest.value
    }
}

/// CHANGE THIS: the signal `t` seconds after its begin.
fn signal(settings: &Settings, t: f64) -> f64 {
    settings.amplitude * (TAU * settings.frequency_hz * t).sin()
}

impl Component for {{Name}} {
    fn start(&mut self) -> Result {
        self.begin = Stamp::INVALID;
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        // Deadlines lie on a grid; the time at which a step really begins has jitter.
        if !self.begin.is_valid() {
            self.begin = tick.deadline();
        }
        let t = tick.deadline().seconds_since(self.begin);
        self.latest = Scalar {
            stamp: tick.now(),
            value: signal(&self.settings, t),
        };
        self.value.write(&self.latest);
        Ok(())
    }
}

trocar_plugin!({{Name}});

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::testing::Bench;

    trocar_sdk::testing::count_allocations!();

    #[test]
    fn the_signal_crests_after_a_quarter_of_its_period_and_begins_anew_when_told() {
        let mut bench = Bench::<{{Name}}>::new(r#"{"amplitude": 2}"#);
        bench.step(251);
        let out = bench.outputs::<Scalar>("value");
        let (first, crest) = (out[0].value, out[250].value);
        bench.expect(first == 0.0, &format!("it begins with {first}"));
        bench.expect(
            (crest - 2.0).abs() < 1e-9,
            &format!("after 0.25 s it is at {crest}"),
        );
        bench.command::<(), ()>("restart", ()).unwrap();
        bench.step(1);
        assert_eq!(bench.outputs::<Scalar>("value")[0].value, 0.0);
    }

    #[test]
    fn a_step_allocates_nothing() {
        let mut bench = Bench::<{{Name}}>::new("{}");
        bench.assert_no_alloc(|bench| bench.step(100));
    }
}
