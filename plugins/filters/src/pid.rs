//! A PID controller of one number.
//!
//! Invariant: the output lies within its limits, and the integral does not grow while it is held there.
//! Without a setpoint and a measurement that are young enough the output is the safe one.
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;

use crate::good;

#[derive(Config)]
struct PidConfig {
    /// Output per error
    #[config(live, min = -1e12, max = 1e12, default = 1.0)]
    kp: f64,
    /// Output per error and second
    #[config(live, min = -1e12, max = 1e12, unit = "1/s", default = 0.0)]
    ki: f64,
    /// Output per change of the measurement in a second
    #[config(live, min = -1e12, max = 1e12, unit = "s", default = 0.0)]
    kd: f64,
    /// Time constant of the low-pass before the derivative
    #[config(live, min = 0.0, max = 100.0, unit = "s", default = 0.005)]
    smooth_s: f64,
    /// Lowest output
    #[config(live, default = -1.0)]
    lowest: f64,
    /// Highest output
    #[config(live, default = 1.0)]
    highest: f64,
    /// Output while setpoint or measurement are missing or too old
    #[config(live, default = 0.0)]
    safe: f64,
    /// Oldest measurement that is controlled by
    #[config(live, min = 0.0001, max = 3600.0, unit = "s", default = 0.1)]
    max_age_s: f64,
    /// Oldest setpoint that is controlled to; 0: it holds until another one comes
    #[config(live, min = 0.0, max = 3600.0, unit = "s", default = 0.1)]
    setpoint_max_age_s: f64,
}

/// Output = kp · error + ki · ∫ error − kd · d(measured)/dt, within limits, at the component's rate.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
pub struct Pid {
    #[input]
    setpoint: In<Scalar>,
    #[input]
    measured: In<Scalar>,
    #[output]
    command: Out<Scalar>,
    /// The output came to a limit (true) or left it.
    #[event("ctl")]
    saturated: Event<Flag>,
    #[state]
    output: f64,
    #[state]
    error: f64,
    /// The integral's part of the output.
    #[state]
    integral: f64,
    /// Whether it controls; false while it gives the safe output.
    #[state]
    controls: Flag,
    #[state]
    at_limit: Flag,
    /// Samples left out: not finite, beyond 1e100, or from far ahead. The one before holds until it is too
    /// old.
    #[state]
    rejected: u64,
    #[config]
    cfg: PidConfig,
    #[host]
    host: Host,
    /// Last measurement, and its slope behind the low-pass, per s; none before the first one.
    moving: Option<(f64, f64)>,
    wanted: Held,
    is: Held,
}

#[provides("ctl")]
impl Pid {
    /// Forgets the past: integral and derivative begin anew.
    #[command]
    fn clear(&mut self) {
        (self.integral, self.moving) = (0.0, None);
    }
    #[read]
    fn output(s: &PidState) -> f64 {
        s.output
    }
}

impl Component for Pid {
    fn configure(&mut self) -> Result {
        let PidConfig { lowest, highest, safe, .. } = self.cfg;
        if lowest >= highest {
            return Err(format!("lowest, highest: {lowest} is not below {highest}: exchange them").into());
        }
        if !(lowest..=highest).contains(&safe) {
            return Err(
                format!("safe: {safe} is not between lowest, {lowest}, and highest, {highest}").into()
            );
        }
        if self.controls.get() {
            // New limits hold back the output, and the integral with it: it would have to wind back first.
            let above = (self.integral.min(self.output) - highest).max(0.0);
            let below = (self.integral.max(self.output) - lowest).min(0.0);
            self.integral -= above + below;
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.rejected = 0;
        (self.wanted, self.is) = (Held::default(), Held::default());
        self.clear();
        Ok(())
    }

    fn make_safe(&mut self) -> Result {
        self.clear();
        self.give(self.cfg.safe, self.host.now());
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let PidConfig { max_age_s, setpoint_max_age_s, .. } = self.cfg;
        let forever = setpoint_max_age_s == 0.0;
        let oldest_setpoint_s = if forever { f64::INFINITY } else { setpoint_max_age_s };
        let rejected = &mut self.rejected;
        let wanted = self.wanted.newest(&mut self.setpoint, t.now(), oldest_setpoint_s, rejected);
        let is = self.is.newest(&mut self.measured, t.now(), max_age_s, rejected);
        let (Some(wanted), Some(is)) = (wanted, is) else {
            self.controls = Flag::FALSE;
            self.clear();
            self.give(self.cfg.safe, t.now());
            return Ok(());
        };
        self.controls = Flag::TRUE;
        let dt = t.period_s();
        self.error = wanted - is;
        let (before, slope) = self.moving.unwrap_or((is, 0.0));
        let smooth_s = self.cfg.smooth_s;
        // The slope of the measurement and not of the error: a setpoint that jumps gives no kick. Another
        // time constant gives none either, as the slope is smoothed. In no time, unsmoothed, the slope stays,
        // and so does `before`.
        let moving @ (_, slope) = if dt + smooth_s > 0.0 {
            (is, (slope * smooth_s + (is - before)) / (dt + smooth_s))
        } else {
            (before, slope)
        };
        self.moving = Some(moving);
        let PidConfig { kp, ki, kd, lowest, highest, .. } = self.cfg;
        let others = kp * self.error - kd * slope;
        let more = self.integral + ki * self.error * dt;
        let wished = others + more;
        // The integral grows up to the limit and not beyond; it may always go back.
        self.integral = if wished > highest {
            more.min((highest - others).max(self.integral))
        } else if wished < lowest {
            more.max((lowest - others).min(self.integral))
        } else {
            more
        };
        let output = (others + self.integral).clamp(lowest, highest);
        let at_limit = wished != wished.clamp(lowest, highest);
        if at_limit != self.at_limit.get() {
            self.at_limit = at_limit.into();
            self.saturated.emit(self.at_limit);
        }
        self.give(output, t.now());
        Ok(())
    }
}

/// The newest good sample of an input, and when it was measured: when it came at the latest.
#[derive(Default)]
struct Held(Option<(f64, Stamp)>);

impl Held {
    /// Its value, unless it is older than `max_age_s` or than the connection allows.
    fn newest(
        &mut self,
        input: &mut In<Scalar>,
        now: Stamp,
        max_age_s: f64,
        rejected: &mut u64,
    ) -> Option<f64> {
        match input.sample() {
            Some(s) if s.stale => self.0 = None,
            Some(s) if good::number(s.value.value) && good::stamp(s.stamp, now) => {
                let known = self.0.filter(|_| !s.fresh).map(|(_, at)| at);
                self.0 = Some((s.value.value, known.unwrap_or(s.stamp.min(now))));
            }
            Some(s) => *rejected += u64::from(s.fresh),
            None => self.0 = None,
        }
        self.0.filter(|(_, stamp)| now.seconds_since(*stamp) <= max_age_s).map(|(value, _)| value)
    }
}

impl Pid {
    fn give(&mut self, output: f64, stamp: Stamp) {
        self.output = output;
        self.command.write(&Scalar { stamp, value: output });
    }
}
