//! Kalman filter of what moves at a nearly constant velocity: a number, or the position of a pose.
//!
//! Invariant: time is that of the samples' stamps: samples that are late or missing are no error, those that
//! go back in time are left out. The prediction is an extrapolation of the estimate and never fed back. With
//! another `sigma` the estimate stays as sure beside a measurement as it was: a rate made of noise is not
//! trusted more because noise counts for more. No variance is negative.
use trocar_sdk::data::{CartesianState, Pose, Scalar, Twist};
use trocar_sdk::prelude::*;

use crate::good;

#[derive(Config)]
struct KalmanConfig {
    /// Standard deviation of a measurement, in its unit
    #[config(live, min = 1e-12, max = 1e12, default = 0.001)]
    sigma: f64,
    /// Noise of the acceleration, as spectral density: (unit/s²)²/Hz
    #[config(live, min = 1e-24, max = 1e24, default = 0.02)]
    acceleration: f64,
    /// A measurement that lies so many standard deviations beside the expected value is an outlier and left
    /// out; 0 takes all
    #[config(live, min = 0.0, max = 1000.0, default = 0.0)]
    gate: f64,
    /// Time ahead of the stamp to which the estimate is carried: the delay of what follows
    #[config(live, min = 0.0, max = 1.0, unit = "s", default = 0.0)]
    predict_s: f64,
    /// After a gap this long, or so many outliers' time, the filter begins anew
    #[config(live, min = 0.001, max = 3600.0, unit = "s", default = 0.5)]
    forget_s: f64,
}

/// Estimate of a number.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Estimate {
    /// Stamp of the measurement; the value is `predict_s` later.
    pub stamp: Stamp,
    pub value: f64,
    /// Per second.
    pub rate: f64,
    /// Standard deviation of the value.
    pub sigma: f64,
    /// Measurement less the expected value.
    pub innovation: f64,
}

/// Estimates position and velocity of a number, and of the three coordinates of a pose; its orientation
/// passes.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
pub struct Kalman {
    #[input(fifo = 64, optional)]
    value: In<Scalar>,
    #[input(fifo = 64, optional)]
    pose: In<Pose>,
    #[output]
    estimate: Out<Estimate>,
    /// Pose and linear velocity
    #[output]
    moving: Out<CartesianState>,
    /// Samples left out: no number or pose, without a stamp, back in time or from far ahead, or outliers.
    #[state]
    rejected: u64,
    #[config]
    cfg: KalmanConfig,
    of_value: Track<1>,
    of_pose: Track<3>,
}

#[provides("ctl")]
impl Kalman {
    /// Forgets the past.
    #[command]
    fn clear(&mut self) {
        (self.of_value, self.of_pose) = (Track::default(), Track::default());
    }
}

impl Component for Kalman {
    fn start(&mut self) -> Result {
        self.rejected = 0;
        self.clear();
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let now = t.now();
        let ahead = self.cfg.predict_s;
        while let Some(sample) = self.value.next_sample() {
            let good = good::number(sample.value.value) && good::stamp(sample.stamp, now);
            let track = &mut self.of_value;
            let taken = good.then(|| track.measure([sample.value.value], sample.stamp, &self.cfg)).flatten();
            let Some([innovation]) = taken else {
                self.rejected += 1;
                continue;
            };
            let track = &self.of_value;
            let (value, rate) = (track.at[0] + ahead * track.rate[0], track.rate[0]);
            let sigma = track.variance_ahead(ahead).sqrt();
            self.estimate.write(&Estimate { stamp: sample.stamp, value, rate, sigma, innovation });
        }
        while let Some(sample) = self.pose.next_sample() {
            let stamp = sample.stamp;
            let good = good::pose(&sample.value).is_some() && good::stamp(stamp, now);
            if !good || self.of_pose.measure(sample.value.position, stamp, &self.cfg).is_none() {
                self.rejected += 1;
                continue;
            }
            let Track { at, rate, .. } = self.of_pose;
            let position = [0, 1, 2].map(|i| at[i] + ahead * rate[i]);
            let pose = Pose { stamp, position, ..sample.value };
            let twist = Twist { stamp, linear: rate, ..Twist::default() };
            self.moving.write(&CartesianState { stamp, pose, twist, ..CartesianState::default() });
        }
        Ok(())
    }
}

/// `N` numbers that are measured together, so they share their covariance.
struct Track<const N: usize> {
    at: [f64; N],
    rate: [f64; N],
    /// Covariance of value and rate: variance, covariance, variance.
    p: [f64; 3],
    /// Variance of a measurement that `p` goes with.
    r: f64,
    /// Stamp of the last measurement taken; invalid before the first one.
    stamp: Stamp,
}

impl<const N: usize> Default for Track<N> {
    fn default() -> Self {
        Track { at: [0.0; N], rate: [0.0; N], p: [0.0; 3], r: 1.0, stamp: Stamp::INVALID }
    }
}

impl<const N: usize> Track<N> {
    /// Takes a measurement that is good; returns its distance from the expected value, or `None` if it is
    /// left out. White-noise acceleration: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to
    /// Tracking and Navigation*, 2001, 6.2.
    fn measure(&mut self, z: [f64; N], stamp: Stamp, cfg: &KalmanConfig) -> Option<[f64; N]> {
        let r = cfg.sigma * cfg.sigma;
        let dt = stamp.seconds_since(self.stamp);
        if self.stamp.is_valid() && dt <= 0.0 {
            return None;
        }
        if !self.stamp.is_valid() || dt > cfg.forget_s {
            // The rate is unknown: it may be what the acceleration makes of it until it is forgotten.
            let unknown = (cfg.acceleration * cfg.forget_s).max(r / (cfg.forget_s * cfg.forget_s));
            *self = Track { at: z, rate: [0.0; N], p: [r, 0.0, 1e4 * unknown], r, stamp };
            return Some([0.0; N]);
        }
        let [a, b, c] = self.p.map(|p| p * (r / self.r));
        let q = cfg.acceleration;
        let p = [
            a + dt * (2.0 * b + dt * c) + q * dt * dt * dt / 3.0,
            b + dt * c + q * dt * dt / 2.0,
            c + q * dt,
        ];
        let expected: [f64; N] = std::array::from_fn(|i| self.at[i] + dt * self.rate[i]);
        let beside: [f64; N] = std::array::from_fn(|i| z[i] - expected[i]);
        let s = p[0] + r;
        if cfg.gate > 0.0 && beside.iter().any(|v| v * v > cfg.gate * cfg.gate * s) {
            return None;
        }
        let gain = [p[0] / s, p[1] / s];
        for i in 0..N {
            self.at[i] = expected[i] + gain[0] * beside[i];
            self.rate[i] += gain[1] * beside[i];
        }
        // Differences of nearly equal numbers would become negative.
        let both = (p[0] * p[2] - p[1] * p[1]).max(0.0);
        self.p = [p[0] * r / s, p[1] * r / s, (both + p[2] * r) / s];
        (self.r, self.stamp) = (r, stamp);
        Some(beside)
    }

    /// Variance of a value carried so far ahead.
    fn variance_ahead(&self, ahead: f64) -> f64 {
        let [a, b, c] = self.p;
        (a + ahead * (2.0 * b + ahead * c)).max(0.0)
    }
}
