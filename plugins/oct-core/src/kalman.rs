//! Kalman filter of a surface that moves: position and velocity along the tool, driven by an unknown acceleration.
//!
//! Invariant: it lives on the time line of the measurements. A measurement is compared with the state at its own time, never
//! with an extrapolated one: that diverges from 5 ms of delay on. Whoever wants to know now asks `ahead`.
//!
//! Model: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, ch. 6.3
//! (piecewise constant white acceleration).

/// Noise of model and measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noises {
    /// Standard deviation of a measurement, m.
    pub measurement_m: f64,
    /// Standard deviation of the acceleration over one step, m/s².
    pub acceleration_m_s2: f64,
}

impl Default for Noises {
    fn default() -> Noises {
        Noises { measurement_m: 3e-6, acceleration_m_s2: 0.02 }
    }
}

/// Velocity that a new filter thinks possible, m/s.
const FIRST_SPEED_M_S: f64 = 1e-3;

/// Position and velocity with their covariance, at `at_ns`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kalman {
    at_ns: u64,
    position_m: f64,
    velocity_m_s: f64,
    /// Var(p), Cov(p, v), Var(v).
    covariance: [f64; 3],
}

impl Kalman {
    /// Begins at a measurement.
    pub fn at(ns: u64, position_m: f64, noises: &Noises) -> Kalman {
        let covariance = [noises.measurement_m.powi(2), 0.0, FIRST_SPEED_M_S.powi(2)];
        Kalman { at_ns: ns, position_m, velocity_m_s: 0.0, covariance }
    }

    pub fn at_ns(&self) -> u64 {
        self.at_ns
    }

    pub fn position_m(&self) -> f64 {
        self.position_m
    }

    pub fn velocity_m_s(&self) -> f64 {
        self.velocity_m_s
    }

    /// Standard deviation of the position, m.
    pub fn sigma_m(&self) -> f64 {
        self.covariance[0].max(0.0).sqrt()
    }

    /// Position at another time, m.
    pub fn ahead(&self, ns: u64) -> f64 {
        let dt = ns.wrapping_sub(self.at_ns).cast_signed() as f64 * 1e-9;
        self.position_m + self.velocity_m_s * dt
    }

    /// Goes on to the time of the next measurement; a time that is not later changes nothing.
    pub fn predict(&mut self, ns: u64, noises: &Noises) {
        if ns <= self.at_ns {
            return;
        }
        let dt = (ns - self.at_ns) as f64 * 1e-9;
        self.at_ns = ns;
        self.position_m += self.velocity_m_s * dt;
        let [pp, pv, vv] = self.covariance;
        let q = noises.acceleration_m_s2.powi(2);
        self.covariance = [
            pp + dt * (2.0 * pv + dt * vv) + q * dt.powi(4) / 4.0,
            pv + dt * vv + q * dt.powi(3) / 2.0,
            vv + q * dt * dt,
        ];
    }

    /// How far a measurement lies from the state, m, and the standard deviation that is expected of that.
    pub fn innovation(&self, measured_m: f64, noises: &Noises) -> (f64, f64) {
        (measured_m - self.position_m, (self.covariance[0] + noises.measurement_m.powi(2)).sqrt())
    }

    /// Takes a measurement of the filter's own time.
    pub fn update(&mut self, measured_m: f64, noises: &Noises) {
        let [pp, pv, vv] = self.covariance;
        let expected = pp + noises.measurement_m.powi(2);
        if expected.is_nan() || expected <= 0.0 {
            return;
        }
        let (gain_p, gain_v) = (pp / expected, pv / expected);
        let off = measured_m - self.position_m;
        self.position_m += gain_p * off;
        self.velocity_m_s += gain_v * off;
        self.covariance = [pp * (1.0 - gain_p), pv * (1.0 - gain_p), vv - gain_v * pv];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_at_constant_speed_is_followed_without_lag() {
        let noises = Noises::default();
        let mut filter = Kalman::at(0, 1e-3, &noises);
        for n in 1..8000u64 {
            let ns = n * 250_000;
            filter.predict(ns, &noises);
            filter.update(1e-3 + 0.4e-3 * ns as f64 * 1e-9, &noises);
        }
        let end = 1e-3 + 0.4e-3 * 7999.0 * 250e-6;
        assert!((filter.position_m() - end).abs() < 1e-9, "{:e}", filter.position_m() - end);
        assert!((filter.velocity_m_s() - 0.4e-3).abs() < 1e-9);
        assert!((filter.ahead(filter.at_ns() + 10_000_000) - end - 4e-6).abs() < 1e-9);
        assert!(filter.sigma_m() < 1e-6);
    }

    #[test]
    fn time_that_stands_still_or_runs_back_changes_nothing() {
        let noises = Noises::default();
        let mut filter = Kalman::at(1000, 1e-3, &noises);
        let before = filter;
        filter.predict(1000, &noises);
        filter.predict(10, &noises);
        assert_eq!(filter, before);
    }
}
