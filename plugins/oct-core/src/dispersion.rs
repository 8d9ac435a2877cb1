//! The complex filter that takes dispersion out of a resampled line, and the windows it is cut with.
//!
//! Invariant: the sign follows the direction of wavenumbers along the line: bins of positive frequency become
//! sharp, those of negative frequency, which are not used, twice as blurred. With the other sign the peak
//! loses more than half.

use std::f64::consts::TAU;

use trocar_fft::num_complex::Complex;

use crate::grid::Grid;

/// `φ(x) = a2 x² + a3 x³`, rad, x from −1 at the smallest wavenumber to 1 at the largest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dispersion {
    pub a2_rad: f64,
    pub a3_rad: f64,
}

/// Window by which a line is multiplied so that its ends do not ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Window {
    Hann,
    Hamming,
    Blackman,
    /// None at all.
    Rectangle,
}

impl Window {
    /// Names as people write them, in the order of the variants.
    pub const NAMES: [&str; 4] = ["hann", "hamming", "blackman", "rectangle"];

    /// The window of a name of [`Window::NAMES`].
    pub fn named(name: &str) -> Option<Window> {
        let all = [Window::Hann, Window::Hamming, Window::Blackman, Window::Rectangle];
        Window::NAMES.iter().position(|n| *n == name).map(|at| all[at])
    }

    /// Returns the periodic window over `n` values (F. J. Harris, *On the use of windows for harmonic
    /// analysis with the DFT*, 1978).
    pub fn value(self, m: usize, n: usize) -> f64 {
        let turn = TAU * m as f64 / n as f64;
        match self {
            Window::Hann => 0.5 - 0.5 * turn.cos(),
            Window::Hamming => 0.54 - 0.46 * turn.cos(),
            Window::Blackman => 0.42 - 0.5 * turn.cos() + 0.08 * (2.0 * turn).cos(),
            Window::Rectangle => 1.0,
        }
    }
}

/// `exp(±jφ)` over the resampled line.
pub fn fill_filter(grid: &Grid, dispersion: Dispersion, filter: &mut [Complex<f32>]) {
    let sign = if grid.rises() { -1.0 } else { 1.0 };
    for (m, filter) in filter.iter_mut().enumerate() {
        let x = grid.place(m);
        let phase = sign * x * x * (dispersion.a2_rad + dispersion.a3_rad * x);
        let (sin, cos) = ((phase - TAU * (phase / TAU).round()) as f32).sin_cos();
        *filter = Complex::new(cos, sin);
    }
}
