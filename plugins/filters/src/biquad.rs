//! Second-order sections: low-pass, high-pass, band-pass, notch.
//!
//! Invariant: nothing comes out that was not in the signal. The filter begins at rest on its first sample.
//! With other settings it begins at rest on its last output, or on its last input if the old or the new
//! settings let nothing constant through; the rest of a step fades as fast as the new settings follow.
use std::f64::consts::TAU;

use trocar_sdk::data::{Scalar, Wrench};
use trocar_sdk::prelude::*;

use crate::lanes;
use crate::pace::Pace;

/// Lowest frequency of a design, as part of the rate of samples: below it rounding moves the output.
const NARROWEST: f64 = 1e-5;

/// Samples after which stamps that have said nothing will say nothing.
const ENOUGH: u32 = 16;

#[derive(Config)]
struct BiquadConfig {
    /// Kind of filter: what passes
    #[config(live, one_of = ["low_pass", "high_pass", "band_pass", "notch"], default = "low_pass")]
    kind: String,
    /// -3 dB corner, or the middle of band and notch
    #[config(live, min = 0.001, max = 1e6, unit = "Hz", default = 20.0)]
    frequency_hz: f64,
    /// Quality: 0.7071 is Butterworth's; bands are frequency_hz / q wide
    #[config(live, min = 0.05, max = 100.0, default = 0.7071067811865476)]
    q: f64,
}

/// Filters each number of scalars and wrenches, at the rate their stamps say; while these say nothing, at the
/// rate of the component (R. Bristow-Johnson, *Cookbook formulae for audio EQ biquad filter coefficients*).
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
pub struct Biquad {
    #[input(fifo = 64, optional)]
    value: In<Scalar>,
    #[input(fifo = 64, optional)]
    wrench: In<Wrench>,
    #[output]
    filtered: Out<Scalar>,
    #[output]
    filtered_wrench: Out<Wrench>,
    /// Samples left out: not finite, or beyond 1e100.
    #[state]
    rejected: u64,
    /// Samples a second that the filter of `value` is made for, Hz; 0 before the first one.
    #[state]
    value_hz: f64,
    /// Likewise of `wrench`, Hz.
    #[state]
    wrench_hz: f64,
    #[config]
    cfg: BiquadConfig,
    of_value: Lane<1>,
    of_wrench: Lane<6>,
}

#[provides("ctl")]
impl Biquad {
    /// Forgets the past: the next sample is the first one.
    #[command]
    fn clear(&mut self) {
        (self.of_value.memory, self.of_wrench.memory) = (None, None);
    }
}

impl Component for Biquad {
    fn configure(&mut self) -> Result {
        let Biquad { cfg, of_value, of_wrench, .. } = self;
        cfg.fits(of_value.hz)?;
        cfg.fits(of_wrench.hz)?;
        of_value.design_for(cfg);
        of_wrench.design_for(cfg);
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.rejected = 0;
        (self.of_value, self.of_wrench) = (Lane::default(), Lane::default());
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let Biquad { cfg, of_value, of_wrench, .. } = self;
        let own_hz = if t.period_s() > 0.0 { 1.0 / t.period_s() } else { 0.0 };
        self.rejected +=
            lanes::pass(&mut self.value, &self.filtered, |n, s| of_value.each(n, s.stamp, own_hz, cfg));
        self.rejected += lanes::pass(&mut self.wrench, &self.filtered_wrench, |n, s| {
            of_wrench.each(n, s.stamp, own_hz, cfg)
        });
        (self.value_hz, self.wrench_hz) = (of_value.hz, of_wrench.hz);
        cfg.fits(of_value.sure_hz())?;
        cfg.fits(of_wrench.sure_hz())
    }
}

impl BiquadConfig {
    /// # Errors
    /// There is no such filter for samples of this rate.
    fn fits(&self, hz: f64) -> Result {
        let frequency_hz = self.frequency_hz;
        if hz > 0.0 && frequency_hz >= 0.5 * hz {
            return Err(format!(
                "frequency_hz: {frequency_hz} Hz is not below half the rate of the samples, {} Hz: choose less than {} Hz",
                round(hz),
                round(0.5 * hz)
            )
            .into());
        }
        if frequency_hz < NARROWEST * hz {
            return Err(format!(
                "frequency_hz: {frequency_hz} Hz is below 1/100000 of the rate of the samples, {} Hz, which numbers do not resolve: filter slower samples",
                round(hz)
            )
            .into());
        }
        Ok(())
    }
}

/// With the four digits that matter to people.
fn round(hz: f64) -> f64 {
    let last = 10f64.powf(hz.log10().floor() - 3.0);
    (hz / last).round() * last
}

/// The filter of one input's numbers.
#[derive(Default)]
struct Lane<const N: usize> {
    pace: Pace,
    /// Rate the design is made for, Hz; 0: nothing is known yet.
    hz: f64,
    /// Samples so far, up to [`ENOUGH`].
    seen: u32,
    design: Design,
    memory: Option<[Memory; N]>,
}

impl<const N: usize> Lane<N> {
    /// Returns the rate, Hz, once it is certain: the stamps say it, or have said nothing for long enough; 0
    /// before that.
    fn sure_hz(&self) -> f64 {
        if self.pace.is_known() || self.seen >= ENOUGH { self.hz } else { 0.0 }
    }

    /// Makes the design these settings ask for; the memory goes on under it.
    fn design_for(&mut self, cfg: &BiquadConfig) {
        if self.hz <= 0.0 || cfg.fits(self.hz).is_err() {
            return;
        }
        let design = Design::of(cfg, self.hz);
        if design != self.design {
            for memory in self.memory.iter_mut().flatten() {
                design.take_over(&self.design, memory);
            }
            self.design = design;
        }
    }

    /// Filters one sample of all numbers; the first one finds the filters at rest on it.
    fn each(&mut self, mut numbers: [f64; N], stamp: Stamp, own_hz: f64, cfg: &BiquadConfig) -> [f64; N] {
        self.seen = (self.seen + 1).min(ENOUGH);
        let hz = match self.pace.note(stamp.ns()) {
            Some(hz) => hz,
            None if self.hz > 0.0 => self.hz,
            None => own_hz,
        };
        if hz != self.hz {
            self.hz = hz;
            self.design_for(cfg);
        }
        let design = &self.design;
        let memory = self.memory.get_or_insert_with(|| numbers.map(|x| design.at_rest(x)));
        for (number, memory) in numbers.iter_mut().zip(memory) {
            *number = design.step(*number, memory);
        }
        numbers
    }
}

/// `H(z) = (b0 + b1 z⁻¹ + b2 z⁻²) / (1 + a1 z⁻¹ + a2 z⁻²)`.
#[derive(PartialEq)]
struct Design {
    b: [f64; 3],
    a: [f64; 2],
    /// `H(1)`: what becomes of a constant, 1 or 0.
    constant: f64,
    /// Part of a fading step that a sample leaves.
    fades: f64,
}

impl Default for Design {
    /// Returns the design for an unknown rate: everything passes unchanged.
    fn default() -> Self {
        Design { b: [1.0, 0.0, 0.0], a: [0.0; 2], constant: 1.0, fades: 0.0 }
    }
}

/// Memory of a number's filter.
#[derive(Clone, Copy, Default)]
struct Memory {
    /// Transposed direct form II.
    past: [f64; 2],
    /// Last input and last output.
    last: [f64; 2],
    /// Rest of the step that a change of settings would have made.
    step: f64,
}

impl Design {
    fn of(cfg: &BiquadConfig, hz: f64) -> Design {
        let turn = TAU * cfg.frequency_hz / hz;
        let (sine, cosine) = turn.sin_cos();
        // 1 − cos, without the digits that the difference loses.
        let rise = 2.0 * (0.5 * turn).sin().powi(2);
        let alpha = sine / (2.0 * cfg.q);
        let (b, constant) = match cfg.kind.as_str() {
            "high_pass" => ([0.5 * (1.0 + cosine), -1.0 - cosine, 0.5 * (1.0 + cosine)], 0.0),
            "band_pass" => ([alpha, 0.0, -alpha], 0.0),
            "notch" => ([1.0, -2.0 * cosine, 1.0], 1.0),
            _ => ([0.5 * rise, rise, 0.5 * rise], 1.0),
        };
        let a0 = 1.0 + alpha;
        let a = [-2.0 * cosine / a0, (1.0 - alpha) / a0];
        Design { b: b.map(|b| b / a0), a, constant, fades: (-turn).exp() }
    }

    /// Returns the memory of a filter that has seen `x` for ever.
    fn at_rest(&self, x: f64) -> Memory {
        let y = self.constant * x;
        let second = self.b[2] * x - self.a[1] * y;
        Memory { past: [self.b[1] * x - self.a[0] * y + second, second], last: [x, y], step: 0.0 }
    }

    /// Goes on from where another design was, without a jump and without what it was swinging in.
    fn take_over(&self, from: &Design, memory: &mut Memory) {
        let last @ [x, y] = memory.last;
        // The output of a design that lets constants through is the better guess of the constant part.
        let seat = if from.constant * self.constant == 1.0 { y } else { x };
        *memory = Memory { last, step: y - self.constant * seat, ..self.at_rest(seat) };
    }

    fn step(&self, x: f64, memory: &mut Memory) -> f64 {
        let past = memory.past;
        let y = self.b[0] * x + past[0];
        memory.past = [self.b[1] * x - self.a[0] * y + past[1], self.b[2] * x - self.a[1] * y];
        memory.step *= self.fades;
        memory.last = [x, y + memory.step];
        memory.last[1]
    }
}
