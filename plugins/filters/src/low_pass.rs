//! First-order low-pass for a force sensor, with an overload event.
use trocar_sdk::prelude::*;

#[derive(Payload, Clone, Copy, Default)] #[repr(C)]
pub struct Force { pub stamp: Stamp, #[unit("N")] pub f: [f64; 3] }

#[derive(Config)]
struct Cfg {
    /// -3 dB corner of the filter
    #[config(live, min = 0.1, max = 400.0, unit = "Hz", default = 50.0)] cutoff_hz: f64,
    #[config(default = 8.0, unit = "N")] limit: f64,
}

/// First-order low-pass for a force sensor, with an overload event.
#[derive(Component)] #[component(rate_hz = 1000)]
struct LowPass {
    #[input] raw: In<Force>, #[output] filtered: Out<Force>,
    #[required] hold: Function<f64>,
    #[event("ctl")] overload: Event<f64>,
    #[state] y: Force, #[state] rejected: u64, // published after each step
    #[config] cfg: Cfg,
}

#[provides("ctl")]
impl LowPass {
    /// Forgets the past.
    #[command] fn clear(&mut self) { self.y = Force::default() }
    #[read] fn value(s: &LowPassState) -> Force { s.y }
}

impl Component for LowPass {
    fn step(&mut self, t: &Tick) -> Result {
        let Some(x) = self.raw.fresh() else { return Ok(()) };
        if !x.f.iter().all(|f| f.abs() < 1e9) { self.rejected += 1; return Ok(()) } // NaN would stay for ever
        let dt_s = x.stamp.seconds_after(self.y.stamp).unwrap_or(t.period_s()); // between samples, not steps
        let a = 1.0 - (-std::f64::consts::TAU * self.cfg.cutoff_hz * dt_s).exp();
        self.y = Force { stamp: x.stamp, f: [0, 1, 2].map(|i| self.y.f[i] + a * (x.f[i] - self.y.f[i])) };
        if self.y.f[2] > self.cfg.limit { self.overload.emit(self.y.f[2]); self.hold.send(0.0); }
        self.filtered.write(&self.y);
        Ok(())
    }
}

trocar_plugin!(LowPass);

#[cfg(test)] mod tests;
