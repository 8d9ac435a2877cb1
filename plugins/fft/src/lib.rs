//! Plans of Fourier transforms.
//!
//! The crate rustfft is generic over its numbers, so that a crate that plans a transform compiles all of its
//! algorithms: 20 s of processor each time. This crate plans for all others, which only hold a plan.

use std::sync::Arc;

pub use rustfft::{Fft, num_complex};

use rustfft::FftPlanner;

/// Plans transforms of so many values from time to frequency, unscaled: the fastest that this machine can do.
///
/// Planning allocates; running a plan with room of its own does not. Any thread.
#[must_use]
pub fn forward(values: usize) -> Arc<dyn Fft<f32>> {
    FftPlanner::new().plan_fft_forward(values)
}

#[cfg(test)]
mod tests {
    use super::num_complex::Complex;

    #[test]
    fn a_tone_is_all_in_its_own_frequency_for_lengths_of_any_kind() {
        for values in [1, 2, 7, 96, 1000, 1024, 2048, 2053] {
            let tone = |n: usize| (n * 3 % values) as f64 / values as f64 * std::f64::consts::TAU;
            let mut line: Vec<Complex<f32>> =
                (0..values).map(|n| Complex::new(tone(n).cos() as f32, tone(n).sin() as f32)).collect();
            super::forward(values).process(&mut line);
            for (k, value) in line.iter().enumerate() {
                let expected = if k == 3 % values { values as f32 } else { 0.0 };
                assert!((value - expected).norm() < 1e-3 * values as f32, "{values} values, {k}: {value}");
            }
        }
    }
}
