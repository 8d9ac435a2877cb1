//! Errors of a simulated force sensor: noise of each sample and a bias that wanders.
//!
//! Invariant: a function of the stream of random numbers and time alone; the bias stays bounded on a clock
//! that runs for days.

use nalgebra::Vector3;

use crate::noise::Noise;

/// Errors of a force sensor, the same on each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceErrors {
    /// Standard deviation of one sample, N.
    pub noise_n: f64,
    /// Samples per second: within one the noise keeps its value.
    pub rate_hz: f64,
    /// The bias wanders at most this fast, N/s.
    pub drift_n_s: f64,
    /// Period of the wandering, s.
    pub drift_period_s: f64,
}

/// Parts of the stream.
const BIAS: u64 = 3;

impl ForceErrors {
    /// Noise and bias at `t_s`, N.
    pub fn at(&self, noise: Noise, t_s: f64) -> Vector3<f64> {
        let sample = (t_s * self.rate_hz).round() as i64 as u64;
        let each = Vector3::from_fn(|axis, _| self.noise_n * noise.part(axis as u64).normal(sample));
        each + self.bias(noise, t_s)
    }

    /// Bias alone at `t_s`, N: along one direction to and fro.
    pub fn bias(&self, noise: Noise, t_s: f64) -> Vector3<f64> {
        let bias = noise.part(BIAS);
        let towards = Vector3::from_fn(|axis, _| bias.normal(axis as u64)).normalize();
        let turn = std::f64::consts::TAU;
        let wander = (turn * (t_s / self.drift_period_s + bias.uniform(3))).sin();
        towards * (self.largest_bias_n() * wander)
    }

    /// The bias never becomes larger, N.
    pub fn largest_bias_n(&self) -> f64 {
        self.drift_n_s * self.drift_period_s / std::f64::consts::TAU
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ERRORS: ForceErrors =
        ForceErrors { noise_n: 10e-3, rate_hz: 1000.0, drift_n_s: 5e-3 / 60.0, drift_period_s: 600.0 };

    #[test]
    fn noise_has_its_standard_deviation_on_each_axis() {
        let noise = Noise::new(2, 40);
        let (mut square, count) = (0.0, 20_000);
        for n in 0..count {
            let t = 100.0 + 1e-3 * f64::from(n);
            square += (ERRORS.at(noise, t) - ERRORS.bias(noise, t)).norm_squared() / 3.0;
        }
        let rms = (square / f64::from(count)).sqrt();
        assert!((rms / 10e-3 - 1.0).abs() < 0.03, "{rms} N");
    }

    #[test]
    fn the_bias_drifts_no_faster_than_said_and_stays_small_for_days() {
        let noise = Noise::new(2, 40);
        for n in 0..2_000 {
            let t = 137.0 * f64::from(n);
            let (now, later) = (ERRORS.bias(noise, t), ERRORS.bias(noise, t + 1.0));
            assert!(now.norm() <= ERRORS.largest_bias_n() * (1.0 + 1e-9), "{} N after {t} s", now.norm());
            assert!(
                (later - now).norm() <= 5e-3 / 60.0 * (1.0 + 1e-9),
                "{} N in a second",
                (later - now).norm()
            );
        }
        assert!(ERRORS.largest_bias_n() < 8e-3);
    }
}
