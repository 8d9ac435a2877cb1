//! Spectra of a simulated spectral-domain OCT: what a spectrometer counts when light from the tip meets the
//! retina.
//!
//! Invariant: a line is a function of optics, echoes, time and the line's number; which lines were made
//! before does not matter. `line` and `exact_line` share formula and noise and differ by rounding only. After
//! construction nothing here allocates but `exact_line`.
//!
//! `I(λ) = S(λ) · | 1 + Σ a κ(d) r(z) exp(j (2 k z + φ(k))) |²`, k = 2π/λ, z = n d the optical path to an
//! echo of amplitude a. `S` is Gaussian; `κ(d) = 1 / (1 + (d / 0.9 mm)²)` is what the lens of the tip couples
//! back; `r(z) = sinc(π/2 · ρ · z / z_max)` the roll-off of pixels of finite width, with `z_max = N λ0² / (4
//! Δλ)`, the depth whose fringes have two pixels; `φ = a2 x² + a3 x³` over x from −1 (smallest k) to 1 what
//! glass and water leave of dispersion. Scatterers of the tissue have the coupling and the roll-off of what
//! they hang on.

use std::f64::consts::{FRAC_PI_2, LN_2, TAU};

use crate::eye::VITREOUS_INDEX;
use crate::grain::{self, Bank, Scatterer};
use crate::noise::Noise;
use crate::phasor::{BLOCK, Field, RUN, Runs};
use crate::tissue::Echo;

/// Distance at which half of the light's amplitude comes back into the fibre, m.
const COUPLING_M: f64 = 0.9e-3;

/// Width of a pixel beside the pitch of pixels (ρ).
const PIXEL_FILL: f64 = 0.8;

/// The source's brightness wanders by 1 % to both sides, at most this fast, 1/s (1 % per minute).
const DRIFT_PER_S: f64 = 0.01 / 60.0;
const DRIFT: f64 = 0.01;

/// Light source, spectrometer and detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Pixels of the detector, a multiple of 128.
    pub samples: usize,
    /// Wavelength in the middle of the detector, m.
    pub centre_m: f64,
    /// From the first pixel's wavelength to the last one's, m.
    pub span_m: f64,
    /// Full width at half maximum of the source, m.
    pub fwhm_m: f64,
    /// a2 and a3 of the dispersion, rad.
    pub dispersion_rad: [f64; 2],
    /// Bits of the converter.
    pub bits: u32,
    /// Electrons at which a pixel is full, and the converter at its end.
    pub full_well_e: f64,
    /// Noise of reading a pixel, electrons.
    pub read_noise_e: f64,
    /// Part of the full well that the reference arm fills at the brightest pixel. Above 1 the detector is
    /// saturated.
    pub reference: f64,
    /// Amplitude of the light from an echo of amplitude 1 beside that of the reference arm. The signal.
    pub gain: f64,
    /// Brightness of the source; 0 is dark.
    pub light: f64,
}

impl Optics {
    /// Sample arm: the ILM gives back a thousandth of the reference's light. Chosen so that it stands 46 dB
    /// above the noise at 500 µm, and that with a fifth of the amplitude some 3 % of the lines show no
    /// surface or a deeper one.
    pub const GAIN: f64 = 0.032;

    /// 790 to 890 nm, linear in wavelength, 12 bit, with `samples` pixels.
    pub fn with_samples(samples: usize) -> Optics {
        Optics {
            samples,
            centre_m: 840e-9,
            span_m: 100e-9,
            fwhm_m: 50e-9,
            dispersion_rad: [18.0, 4.0],
            bits: 12,
            full_well_e: 150e3,
            read_noise_e: 60.0,
            reference: 0.55,
            gain: Optics::GAIN,
            light: 1.0,
        }
    }

    /// Wavelength of a pixel, m.
    pub fn wavelength_m(&self, pixel: usize) -> f64 {
        let last = (self.samples.max(2) - 1) as f64;
        self.centre_m + self.span_m * (pixel as f64 / last - 0.5)
    }

    /// Optical path whose fringes have two pixels each, m: `N λ0² / (4 Δλ)`. What lies deeper is seen folded
    /// back.
    pub fn z_max_m(&self) -> f64 {
        self.samples as f64 * self.centre_m * self.centre_m / (4.0 * self.span_m)
    }

    /// Amplitude of an echo in a spectrum, beside the reference arm's.
    fn amplitude(&self, echo: &Echo) -> f64 {
        let far = echo.path_m / VITREOUS_INDEX / COUPLING_M;
        let phase = FRAC_PI_2 * PIXEL_FILL * echo.path_m / self.z_max_m();
        let roll_off = if phase.abs() < 1e-9 { 1.0 } else { phase.sin() / phase };
        self.gain * echo.amplitude * roll_off / (1.0 + far * far)
    }

    fn largest_count(&self) -> f64 {
        ((1u64 << self.bits.min(16)) - 1) as f64
    }

    /// Brightness of the source at `t_s`.
    fn brightness(&self, t_s: f64) -> f64 {
        self.light * (1.0 + DRIFT * (t_s * DRIFT_PER_S / DRIFT).sin())
    }
}

/// Optics that cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BadOptics {
    /// Not a multiple of 128, or none at all.
    Samples(usize),
    /// Not 1 to 16.
    Bits(u32),
    /// The name of a value that is not finite, or below what makes sense, and the value.
    Value(&'static str, f64),
}

impl std::fmt::Display for BadOptics {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            BadOptics::Samples(n) => {
                write!(f, "samples: {n} is no multiple of 128 from 128 on: 1024 and 2048 are usual")
            }
            BadOptics::Bits(n) => write!(f, "bits: {n} is not from 1 to 16"),
            BadOptics::Value(name, value) => write!(f, "{name}: {value} is no finite number above its limit"),
        }
    }
}

impl std::error::Error for BadOptics {}

/// Makes the lines of one detector. Tables and buffers are made once.
#[derive(Clone, Debug)]
pub struct Spectrograph {
    optics: Optics,
    noise: Noise,
    /// 2π/λ of each pixel, rad/m.
    wavenumber: Vec<f64>,
    runs: Runs,
    /// The tissue between the echoes.
    bank: Bank,
    /// Source (1 at its brightest) and exp(jφ), as the field lies.
    source: Vec<f32>,
    dispersion: [Vec<f32>; 2],
    /// Sum over the echoes without dispersion.
    field: Field,
    /// Mean and standard deviation of the electrons, as the field lies.
    electrons: [Vec<f32>; 2],
}

impl Spectrograph {
    /// # Errors
    /// Optics that make no spectrum: which value, and what it may be.
    pub fn new(optics: Optics, noise: Noise) -> Result<Spectrograph, BadOptics> {
        let n = optics.samples;
        if n == 0 || !n.is_multiple_of(BLOCK) {
            return Err(BadOptics::Samples(n));
        }
        if !(1..=16).contains(&optics.bits) {
            return Err(BadOptics::Bits(optics.bits));
        }
        for (name, value, least) in [
            ("span_m", optics.span_m, 1e-12),
            ("centre_m", optics.centre_m, optics.span_m),
            ("fwhm_m", optics.fwhm_m, 1e-12),
            ("full_well_e", optics.full_well_e, 1.0),
            ("read_noise_e", optics.read_noise_e, 0.0),
            ("reference", optics.reference, 0.0),
            ("gain", optics.gain, 0.0),
            ("light", optics.light, 0.0),
            ("a2", optics.dispersion_rad[0], f64::MIN),
            ("a3", optics.dispersion_rad[1], f64::MIN),
        ] {
            if !(value >= least && value.is_finite()) {
                return Err(BadOptics::Value(name, value));
            }
        }
        let wavenumber: Vec<f64> = (0..n).map(|i| TAU / optics.wavelength_m(i)).collect();
        let runs = Runs::of(&wavenumber);
        let phase = |i: usize| phase_at(&optics, &wavenumber, i);
        let dispersion = [runs.lying(|i| phase(i).cos()), runs.lying(|i| phase(i).sin())];
        let source = runs.lying(|i| source_at(&optics, i));
        let zeros = || vec![0.0; n];
        let (field, electrons) = ([zeros(), zeros()], [zeros(), zeros()]);
        let bank = Bank::new(&runs, n);
        Ok(Spectrograph { optics, noise, wavenumber, runs, bank, source, dispersion, field, electrons })
    }

    pub fn optics(&self) -> &Optics {
        &self.optics
    }

    /// Brightness, signal and reference may change from line to line; the rest of the optics stays.
    pub fn set_light(&mut self, light: f64, gain: f64, reference: f64) {
        (self.optics.light, self.optics.gain, self.optics.reference) = (light, gain, reference);
    }

    /// Line `index` of the detector, taken at `t_s`, into `out` (as many as there are pixels, or the rest is
    /// left alone). Several echoes of one surface, each with its part of the amplitude, blur it as a motion
    /// during the exposure does.
    pub fn line(&mut self, echoes: &[Echo], t_s: f64, index: u64, out: &mut [u16]) {
        self.field.iter_mut().for_each(|part| part.fill(0.0));
        for echo in echoes {
            let amplitude = self.optics.amplitude(echo) as f32;
            match echo.tissue {
                None => {
                    let [re, im] = &mut self.field;
                    self.runs.add(re, im, 2.0 * echo.path_m, amplitude);
                }
                Some(tissue) => {
                    self.bank.add(&self.runs, &mut self.field, echo.path_m, tissue, amplitude);
                }
            }
        }
        self.count_electrons(self.scale(t_s) as f32);
        let noise = self.noise.part(index);
        let most = self.optics.largest_count() as f32;
        let counts = most / self.optics.full_well_e as f32;
        let [mean, spread] = &self.electrons;
        let rows = self.runs.rows();
        for (run, out) in out.chunks_mut(RUN).enumerate().take(rows) {
            for (i, out) in out.iter_mut().enumerate() {
                let at = i * rows + run;
                let noisy = mean[at] + spread[at] * noise.quick_normal((run * RUN + i) as u64);
                *out = (noisy * counts + 0.5).clamp(0.0, most) as u16;
            }
        }
    }

    /// From the field to electrons and their spread; `full` is what the reference arm has at its brightest.
    fn count_electrons(&mut self, full: f32) {
        let read = (self.optics.read_noise_e * self.optics.read_noise_e) as f32;
        let ([re, im], [cos, sin], [mean, spread]) = (&self.field, &self.dispersion, &mut self.electrons);
        let field = re.iter().zip(im).zip(cos.iter().zip(sin)).zip(&self.source);
        for ((((re, im), (cos, sin)), source), (mean, spread)) in field.zip(mean.iter_mut().zip(spread)) {
            let (a, b) = (1.0 + re * cos - im * sin, re * sin + im * cos);
            *mean = full * source * (a * a + b * b);
            *spread = (*mean + read).sqrt();
        }
    }

    /// The same line by the formula as it is written, in f64: slow, and what `line` is compared with.
    pub fn exact_line(&self, echoes: &[Echo], t_s: f64, index: u64) -> Vec<u16> {
        let noise = self.noise.part(index);
        let most = self.optics.largest_count();
        let pixel = |(i, electrons): (usize, f64)| {
            let spread = (electrons + self.optics.read_noise_e.powi(2)).sqrt();
            let noisy = electrons + spread * f64::from(noise.quick_normal(i as u64));
            (noisy * most / self.optics.full_well_e + 0.5).clamp(0.0, most) as u16
        };
        self.exact_electrons(echoes, t_s).into_iter().enumerate().map(pixel).collect()
    }

    /// Mean electrons of each pixel by the formula as it is written.
    pub fn exact_electrons(&self, echoes: &[Echo], t_s: f64) -> Vec<f64> {
        let full = self.scale(t_s);
        let pixel = |i: usize| {
            let (mut re, mut im) = (1.0, 0.0);
            let mut add = |path_m: f64, amplitude: f64| {
                let phase = 2.0 * self.wavenumber[i] * path_m + phase_at(&self.optics, &self.wavenumber, i);
                re += amplitude * phase.cos();
                im += amplitude * phase.sin();
            };
            for echo in echoes {
                let amplitude = self.optics.amplitude(echo);
                let Some(tissue) = echo.tissue else {
                    add(echo.path_m, amplitude);
                    continue;
                };
                for Scatterer { below_m, amplitude: part } in grain::scatterers(tissue) {
                    add(echo.path_m + below_m, amplitude * part);
                }
            }
            full * source_at(&self.optics, i) * (re * re + im * im)
        };
        (0..self.optics.samples).map(pixel).collect()
    }

    /// Electrons of the reference arm at the brightest pixel.
    fn scale(&self, t_s: f64) -> f64 {
        self.optics.full_well_e * self.optics.reference * self.optics.brightness(t_s)
    }
}

fn source_at(optics: &Optics, pixel: usize) -> f64 {
    let off = (optics.wavelength_m(pixel) - optics.centre_m) / optics.fwhm_m;
    (-4.0 * LN_2 * off * off).exp()
}

/// φ of a pixel, rad.
fn phase_at(optics: &Optics, wavenumber: &[f64], pixel: usize) -> f64 {
    let (first, last) = (wavenumber[0], wavenumber[wavenumber.len() - 1]);
    let (low, high) = (first.min(last), first.max(last));
    let x = 2.0 * (wavenumber[pixel] - low) / (high - low) - 1.0;
    let [a2, a3] = optics.dispersion_rad;
    x * x * (a2 + a3 * x)
}

#[cfg(test)]
#[path = "spectra_tests.rs"]
mod tests;
