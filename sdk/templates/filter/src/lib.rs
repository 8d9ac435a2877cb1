//! A first-order low-pass for a signal: change it into what you need.
#![forbid(unsafe_code)]

use std::f64::consts::TAU;
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;

/// The settings; the host shows them as a form and checks them before the component sees them.
#[derive(Config)]
struct Settings {
    /// -3 dB corner of the filter
    #[config(live, min = 0.1, max = 400.0, unit = "Hz", default = 10.0)]
    cutoff_hz: f64,
}

/// Smooths a signal.
#[derive(Component)]
#[component(name = "{{crate}}", rate_hz = 1000, provides("control"))]
struct {{Name}} {
    /// Each sample once, also those of a moment in which this was late; `#[input]` alone has the newest.
    #[input(fifo = 16)]
    raw: In<Scalar>,
    #[output]
    filtered: Out<Scalar>,
    /// The latest output; published after each step.
    #[state]
    latest: Scalar,
    #[config]
    settings: Settings,
}

/// The commands and reads that others may call.
#[provides("control")]
impl {{Name}} {
    /// Forgets the past.
    #[command]
    fn clear(&mut self) {
        self.latest = Scalar::default();
    }

    /// The latest output.
    #[read]
    fn value(s: &{{Name}}State) -> f64 {
        s.latest.value
    }
}

impl Component for {{Name}} {
    fn start(&mut self) -> Result {
        self.latest = Scalar::default();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        while let Some(raw) = self.raw.next() {
            // By the samples' own times: a source may be slower than this component.
            let dt_s = raw.stamp.seconds_after(self.latest.stamp);
            let dt_s = dt_s.unwrap_or(tick.period_s());
            let a = 1.0 - (-TAU * self.settings.cutoff_hz * dt_s).exp();
            self.latest.stamp = raw.stamp;
            self.latest.value += a * (raw.value - self.latest.value);
            self.filtered.write(&self.latest);
        }
        Ok(())
    }
}

trocar_plugin!({{Name}});

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::testing::Bench;

    trocar_sdk::testing::count_allocations!();

    fn signal(value: f64) -> Scalar {
        Scalar {
            stamp: Stamp::INVALID,
            value,
        }
    }

    #[test]
    fn a_constant_signal_is_reached_in_the_end() {
        let mut bench = Bench::<{{Name}}>::new(r#"{"cutoff_hz": 20}"#);
        for _ in 0..1000 {
            bench.push("raw", signal(3.0));
            bench.step(1);
        }
        let out = bench.outputs::<Scalar>("filtered");
        let (first, last) = (out[0].value, out[999].value);
        bench.expect(first < 1.0, &format!("the first value jumps to {first}"));
        bench.expect(
            (last - 3.0).abs() < 1e-6,
            &format!("after 1 s it is at {last}"),
        );
    }

    #[test]
    fn nothing_new_gives_nothing_and_a_step_allocates_nothing() {
        let mut bench = Bench::<{{Name}}>::new("{}");
        bench.push("raw", signal(1.0));
        bench.assert_no_alloc(|bench| bench.step(100));
        assert_eq!(bench.outputs::<Scalar>("filtered").len(), 1);
    }
}
