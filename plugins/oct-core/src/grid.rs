//! Which wavenumber falls on which pixel, and how a line is brought to equal steps of wavenumber.
//!
//! Invariant: a grid that exists is strictly monotone; every tap lies within the line.

use std::f64::consts::{PI, TAU};
use std::fmt;

/// Fewest and most pixels of a line.
pub const SAMPLES: std::ops::RangeInclusive<usize> = 64..=8192;

/// Method for values between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    Linear,
    /// Four points: E. Catmull, R. Rom, *A class of local interpolating splines*, 1974.
    Cubic,
}

/// The wavenumbers of a spectrometer's pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// 2π/λ of each pixel, rad/m.
    wavenumber: Vec<f64>,
}

/// Source of one value of the resampled line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tap {
    /// First of four pixels.
    pub first: u32,
    pub weights: [f32; 4],
}

impl Grid {
    /// Returns the grid for the polynomial of a spectrometer: wavelength (m) of pixel i is `Σ wavelength_m[k]
    /// x^k`, x from −1 to 1.
    ///
    /// # Errors
    /// Too few or too many pixels, a wavelength that is no positive number, a polynomial that turns back.
    pub fn from_wavelengths(samples: usize, wavelength_m: [f64; 4]) -> Result<Grid, BadGrid> {
        if !SAMPLES.contains(&samples) {
            return Err(BadGrid::Samples(samples));
        }
        let of = |pixel: usize| {
            let x = 2.0 * pixel as f64 / (samples - 1) as f64 - 1.0;
            TAU / wavelength_m.iter().rev().fold(0.0, |sum, c| sum * x + c)
        };
        Grid::from_wavenumbers((0..samples).map(of).collect())
    }

    /// From measured wavenumbers, rad/m, one per pixel.
    ///
    /// # Errors
    /// As [`Grid::from_wavelengths`].
    pub fn from_wavenumbers(wavenumber: Vec<f64>) -> Result<Grid, BadGrid> {
        if !SAMPLES.contains(&wavenumber.len()) {
            return Err(BadGrid::Samples(wavenumber.len()));
        }
        if let Some(pixel) = wavenumber.iter().position(|k| !(*k > 0.0 && k.is_finite())) {
            return Err(BadGrid::NoWavenumber { pixel, value: wavenumber[pixel] });
        }
        let rises = wavenumber[1] > wavenumber[0];
        let turns = wavenumber.windows(2).position(|w| w[0] == w[1] || (w[1] > w[0]) != rises);
        turns.map_or(Ok(Grid { wavenumber }), |pixel| Err(BadGrid::TurnsBack { pixel: pixel + 1 }))
    }

    /// Pixels of a line, and values of the resampled one.
    pub fn samples(&self) -> usize {
        self.wavenumber.len()
    }

    /// Bins of an A-scan: half of the pixels.
    pub fn bins(&self) -> usize {
        self.samples() / 2
    }

    fn ends(&self) -> (f64, f64) {
        (self.wavenumber[0], self.wavenumber[self.samples() - 1])
    }

    /// Step of wavenumber of the resampled line, rad/m; negative where wavenumbers fall along the line.
    fn step(&self) -> f64 {
        let (first, last) = self.ends();
        (last - first) / (self.samples() - 1) as f64
    }

    /// Do wavenumbers rise along the line?
    pub fn rises(&self) -> bool {
        self.step() > 0.0
    }

    /// Optical path from one bin of the A-scan to the next, m: `π / (N |Δk|)`.
    pub fn bin_m(&self) -> f64 {
        PI / (self.samples() as f64 * self.step().abs())
    }

    /// Returns the place of value `m` of the resampled line between the smallest (−1) and the largest (1)
    /// wavenumber.
    pub fn place(&self, m: usize) -> f64 {
        let along = 2.0 * m as f64 / (self.samples() - 1) as f64 - 1.0;
        if self.rises() { along } else { -along }
    }

    /// One tap for each value of the resampled line.
    pub fn taps(&self, how: Interpolation) -> Vec<Tap> {
        let (n, (first, _), step) = (self.samples(), self.ends(), self.step());
        let sign = step.signum();
        let mut pixel = 0;
        let tap = |m: usize| {
            let wanted = first + step * m as f64;
            while pixel + 2 < n && (wanted - self.wavenumber[pixel + 1]) * sign > 0.0 {
                pixel += 1;
            }
            let (a, b) = (self.wavenumber[pixel], self.wavenumber[pixel + 1]);
            // The four pixels around the value; at both ends the nearest four.
            let from = (pixel as i64 - 1).clamp(0, n as i64 - 4);
            let t = (wanted - a) / (b - a) + (pixel as i64 - 1 - from) as f64;
            Tap { first: from as u32, weights: weights(how, t).map(|w| w as f32) }
        };
        (0..n).map(tap).collect()
    }
}

/// Weights of pixels −1, 0, 1, 2 for a value at `t` of the way from pixel 0 to pixel 1.
fn weights(how: Interpolation, t: f64) -> [f64; 4] {
    match how {
        Interpolation::Linear if t < 0.0 => [-t, 1.0 + t, 0.0, 0.0],
        Interpolation::Linear if t > 1.0 => [0.0, 0.0, 2.0 - t, t - 1.0],
        Interpolation::Linear => [0.0, 1.0 - t, t, 0.0],
        Interpolation::Cubic => [
            0.5 * t * (-1.0 + t * (2.0 - t)),
            1.0 + 0.5 * t * t * (3.0 * t - 5.0),
            0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
            0.5 * t * t * (t - 1.0),
        ],
    }
}

impl Tap {
    /// The value that it takes from `line`; 0 from a line that is too short.
    #[inline]
    pub fn of(&self, line: &[f32]) -> f32 {
        let first = self.first as usize;
        let Some(four) = line.get(first..first + 4) else { return 0.0 };
        let w = &self.weights;
        (four[0] * w[0] + four[1] * w[1]) + (four[2] * w[2] + four[3] * w[3])
    }
}

/// Returns the values that four taps take from `line`, as [`Tap::of`]: products side by side, then the sums
/// of all four at once.
#[inline]
pub(crate) fn four(taps: &[Tap; 4], line: &[f32]) -> [f32; 4] {
    let products = taps.each_ref().map(|tap| {
        let first = tap.first as usize;
        let four: &[f32; 4] = line.get(first..).and_then(|rest| rest.first_chunk()).unwrap_or(&[0.0; 4]);
        std::array::from_fn::<f32, 4, _>(|i| four[i] * tap.weights[i])
    });
    let column = |i: usize| products.map(|p| p[i]);
    let (a, b, c, d) = (column(0), column(1), column(2), column(3));
    std::array::from_fn(|k| (a[k] + b[k]) + (c[k] + d[k]))
}

/// Why there is no grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BadGrid {
    /// Not in [`SAMPLES`].
    Samples(usize),
    /// No positive finite number.
    NoWavenumber { pixel: usize, value: f64 },
    /// Wavenumbers rise up to this pixel and fall then, or the other way round, or stand still.
    TurnsBack { pixel: usize },
}

impl fmt::Display for BadGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BadGrid::Samples(n) => {
                write!(f, "{n} pixels: a line has from {} to {}", SAMPLES.start(), SAMPLES.end())
            }
            BadGrid::NoWavenumber { pixel, value } => write!(
                f,
                "pixel {pixel} has the wavenumber {value} rad/m: give wavelengths of positive length, in m (840e-9)"
            ),
            BadGrid::TurnsBack { pixel } => write!(
                f,
                "wavenumbers turn back at pixel {pixel}: they must rise or fall along the whole line"
            ),
        }
    }
}

impl std::error::Error for BadGrid {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_as_deep_as_the_range_of_wavenumbers_says() {
        let grid = Grid::from_wavelengths(1024, [840e-9, 50e-9, 0.0, 0.0]).expect("a grid");
        let span = TAU * (1.0 / 790e-9 - 1.0 / 890e-9);
        assert!((grid.bin_m() - PI / span * 1023.0 / 1024.0).abs() < 1e-15);
        assert!(!grid.rises());
        assert_eq!((grid.place(0), grid.place(1023)), (1.0, -1.0));
    }

    #[test]
    fn a_line_that_is_linear_in_wavenumber_comes_out_with_equal_steps() {
        for wavelengths in [[840e-9, 50e-9, 0.0, 0.0], [840e-9, -50e-9, 2e-9, 0.0]] {
            let grid = Grid::from_wavelengths(1024, wavelengths).expect("a grid");
            let line: Vec<f32> = grid.wavenumber.iter().map(|k| (k * 1e-6) as f32).collect();
            for how in [Interpolation::Linear, Interpolation::Cubic] {
                for (m, tap) in grid.taps(how).iter().enumerate() {
                    let out = tap.of(&line);
                    let wanted = (grid.ends().0 + grid.step() * m as f64) * 1e-6;
                    assert!((f64::from(out) - wanted).abs() < 3e-6, "{how:?} {m}: {} for {wanted}", out);
                }
            }
        }
    }

    #[test]
    fn four_taps_at_once_take_what_each_takes_by_itself() {
        let grid = Grid::from_wavelengths(64, [840e-9, 50e-9, 3e-9, 0.0]).expect("a grid");
        let line: Vec<f32> = (0..64).map(|i| ((i * 37) % 64) as f32).collect();
        for taps in grid.taps(Interpolation::Cubic).as_chunks::<4>().0 {
            assert_eq!(four(taps, &line), taps.each_ref().map(|tap| tap.of(&line)));
            assert_eq!(four(taps, &line[..3]), [0.0; 4], "a line that is too short");
        }
    }

    #[test]
    fn what_is_no_grid_is_refused_with_its_pixel() {
        let refused =
            |samples, w| Grid::from_wavelengths(samples, w).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(refused(63, [840e-9, 50e-9, 0.0, 0.0]).starts_with("63 pixels: a line has from 64 to 8192"));
        assert!(refused(1024, [0.0, 50e-9, 0.0, 0.0]).starts_with("pixel 0 has the wavenumber -"));
        assert!(refused(1024, [840e-9, 0.0, 0.0, 0.0]).starts_with("wavenumbers turn back at pixel 1"));
        assert!(refused(1024, [840e-9, 0.0, 50e-9, 0.0]).contains("turn back"));
        assert!(refused(1024, [f64::NAN, 0.0, 0.0, 0.0]).contains("NaN"));
    }
}
