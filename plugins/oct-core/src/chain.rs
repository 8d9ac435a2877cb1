//! From one raw line to one A-scan: subtract the background, bring to equal steps of wavenumber, window, take
//! dispersion out, transform, and take the logarithm.
//!
//! Invariant: `line` allocates nothing. A line that is dark or saturated gives silence over all bins, so no
//! surface is found in it, and does not touch the background.

use std::fmt;
use std::sync::Arc;

use trocar_fft::Fft;
use trocar_fft::num_complex::Complex;

use crate::background::Background;
use crate::decibel::{SILENT_DB, decibel};
use crate::dispersion::{Dispersion, Window, fill_filter};
use crate::grid::{Grid, Interpolation, Tap, four};
use crate::surface::{Rule, first_surface};

/// A surface in these bins has fringes that the smoothed background does not leave out: nearer ones are not
/// told from what the reference arm itself leaves.
const NEAR: std::ops::Range<usize> = 8..48;
/// So many dB above the noise it is one.
const NEAR_DB: f32 = 10.0;

/// Values that are multiplied side by side.
const TOGETHER: usize = 64;

/// Levels by which the light of a line is judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    /// Bits of a count.
    pub bits: u32,
    /// A line whose mean is below this part of the largest count is dark.
    pub dark: f32,
    /// A line with more than this part of its pixels at the largest count is saturated.
    pub full: f32,
}

impl Default for Levels {
    fn default() -> Levels {
        Levels { bits: 12, dark: 0.01, full: 1.0 / 256.0 }
    }
}

/// Light of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    Good,
    Dark,
    Saturated,
}

/// The processing of one spectrometer's lines.
#[derive(Clone)]
pub struct Chain {
    grid: Grid,
    levels: Levels,
    taps: Vec<Tap>,
    window: Vec<f32>,
    /// Window and dispersion in one: a line reads from as few places as possible, since at 4 kHz caches are
    /// cold.
    filter: Vec<Complex<f32>>,
    dispersion: Dispersion,
    pub(crate) transform: Transform,
    background: Background,
    /// The line as it came, then without its background, counts.
    line: Vec<f32>,
}

/// A Fourier transform with the room it needs.
#[derive(Clone)]
pub(crate) struct Transform {
    fft: Arc<dyn Fft<f32>>,
    pub(crate) buffer: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

impl Transform {
    fn new(samples: usize) -> Transform {
        let fft = trocar_fft::forward(samples);
        let scratch = vec![Complex::default(); fft.get_inplace_scratch_len()];
        Transform { fft, buffer: vec![Complex::default(); samples], scratch }
    }

    /// Transforms the values of `from` times `filter` into `buffer`.
    pub(crate) fn run<T>(&mut self, from: &[T], values: impl Fn(&[T], &mut [f32]), filter: &[Complex<f32>]) {
        let mut some = [0.0; TOGETHER];
        let parts = self.buffer.chunks_mut(TOGETHER).zip(filter.chunks(TOGETHER));
        for ((out, filter), from) in parts.zip(from.chunks(TOGETHER)) {
            values(from, &mut some[..from.len()]);
            for ((out, x), f) in out.iter_mut().zip(&some).zip(filter) {
                *out = Complex::new(x * f.re, x * f.im);
            }
        }
        self.fft.process_with_scratch(&mut self.buffer, &mut self.scratch);
    }
}

impl Chain {
    /// A chain without a known background and without dispersion, with a Hann window.
    pub fn new(grid: Grid, how: Interpolation, levels: Levels) -> Chain {
        let n = grid.samples();
        let mut chain = Chain {
            taps: grid.taps(how),
            window: vec![0.0; n],
            filter: vec![Complex::default(); n],
            dispersion: Dispersion::default(),
            transform: Transform::new(n),
            background: Background::new(n),
            line: vec![0.0; n],
            grid,
            levels,
        };
        chain.set_window(Window::Hann);
        chain
    }

    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    pub fn dispersion(&self) -> Dispersion {
        self.dispersion
    }

    pub fn background(&mut self) -> &mut Background {
        &mut self.background
    }

    pub fn set_dispersion(&mut self, dispersion: Dispersion) {
        self.dispersion = dispersion;
        fill_filter(&self.grid, dispersion, &mut self.filter);
        for (f, window) in self.filter.iter_mut().zip(&self.window) {
            *f *= *window;
        }
    }

    pub fn set_window(&mut self, window: Window) {
        let n = self.window.len();
        for (m, w) in self.window.iter_mut().enumerate() {
            *w = window.value(m, n) as f32;
        }
        self.set_dispersion(self.dispersion);
    }

    /// The last line of good light without background, at equal steps of wavenumber, windowed.
    pub fn linear(&self) -> impl Iterator<Item = f32> {
        self.taps.iter().zip(&self.window).map(|(tap, window)| window * tap.of(&self.line))
    }

    /// Turns one line of counts (`u16` in the machine's byte order) into its A-scan in dB re one count
    /// squared, `samples / 2` bins.
    ///
    /// # Errors
    /// The line or the room for the A-scan has another length; nothing is written then.
    pub fn line(&mut self, raw: &[u8], ascan: &mut [f32]) -> Result<Light, BadLine> {
        let (n, bins) = (self.grid.samples(), self.grid.bins());
        if raw.len() != 2 * n || ascan.len() != bins {
            return Err(BadLine { bytes: raw.len(), wants: 2 * n, bins: ascan.len(), gives: bins });
        }
        let light = self.read(raw);
        if light != Light::Good {
            ascan.fill(SILENT_DB);
            return Ok(light);
        }
        self.background.see(&self.line);
        for (x, b) in self.line.iter_mut().zip(self.background.counts()) {
            *x -= b;
        }
        let line = &self.line;
        let resample = |from: &[Tap], to: &mut [f32]| {
            let (fours, rest) = from.as_chunks::<4>();
            let (to_fours, to_rest) = to.as_chunks_mut::<4>();
            to_fours.iter_mut().zip(fours).for_each(|(to, taps)| *to = four(taps, line));
            to_rest.iter_mut().zip(rest).for_each(|(to, tap)| *to = tap.of(line));
        };
        self.transform.run(&self.taps, resample, &self.filter);
        for (db, x) in ascan.iter_mut().zip(&self.transform.buffer) {
            *db = decibel(x.re * x.re + x.im * x.im);
        }
        if self.background.is_due() {
            let rule = Rule { first_bin: NEAR.start, above_db: NEAR_DB, ..Rule::default() };
            let near = first_surface(ascan, &rule).is_some_and(|surface| surface.bin < NEAR.end as f32);
            self.background.freeze(near);
        }
        Ok(light)
    }

    /// Counts to numbers, and how much light they mean.
    fn read(&mut self, raw: &[u8]) -> Light {
        let most = ((1u32 << self.levels.bits.min(16)) - 1) as u16;
        let (mut full, mut sum) = (0u32, 0u32);
        for (x, bytes) in self.line.iter_mut().zip(raw.as_chunks::<2>().0) {
            let count = u16::from_ne_bytes(*bytes);
            full += u32::from(count >= most);
            sum += u32::from(count);
            *x = f32::from(count);
        }
        let n = self.line.len() as f32;
        if full as f32 > self.levels.full * n {
            Light::Saturated
        } else if (sum as f32) < self.levels.dark * n * f32::from(most) {
            Light::Dark
        } else {
            Light::Good
        }
    }
}

/// A line or an A-scan of the wrong length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadLine {
    pub bytes: usize,
    pub wants: usize,
    pub bins: usize,
    pub gives: usize,
}

impl fmt::Display for BadLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let BadLine { bytes, wants, bins, gives } = self;
        write!(f, "a line of {bytes} B into {bins} bins: this chain takes {wants} B and gives {gives} bins")
    }
}

impl std::error::Error for BadLine {}

#[cfg(test)]
#[path = "chain_tests.rs"]
mod tests;
