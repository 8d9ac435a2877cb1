//! Kalman filter of a surface that moves: position and velocity along the tool, driven by an unknown
//! acceleration.
//!
//! Invariant: it lives on the time line of the measurements. A measurement is compared with the state at its
//! own time, never with an extrapolated one: that diverges from 5 ms of delay on. A caller that needs the
//! state now asks `ahead`.
//!
//! Model: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
//! 2001, ch. 6.3 (piecewise constant white acceleration).

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

    /// Returns the distance of a measurement from the state, m, and the standard deviation that is expected
    /// of it.
    pub fn innovation(&self, measured_m: f64, noises: &Noises) -> (f64, f64) {
        (measured_m - self.position_m, (self.covariance[0] + noises.measurement_m.powi(2)).sqrt())
    }

    /// Goes on with measurements of another noise, as sure beside them as before: a velocity made of noise is
    /// not trusted more because noise counts for more.
    pub fn other_noise(&mut self, from: &Noises, to: &Noises) {
        let part = (to.measurement_m / from.measurement_m).powi(2);
        if part.is_finite() {
            self.covariance = self.covariance.map(|c| c * part);
        }
    }

    /// Takes a measurement of the filter's own time.
    pub fn update(&mut self, measured_m: f64, noises: &Noises) {
        let [pp, pv, vv] = self.covariance;
        let noise = noises.measurement_m.powi(2);
        let expected = pp + noise;
        if expected.is_nan() || expected <= 0.0 {
            return;
        }
        let (gain_p, gain_v) = (pp / expected, pv / expected);
        let off = measured_m - self.position_m;
        self.position_m += gain_p * off;
        self.velocity_m_s += gain_v * off;
        // Differences of nearly equal numbers would become negative.
        let both = (pp * vv - pv * pv).max(0.0);
        self.covariance = [pp * noise / expected, pv * noise / expected, (both + vv * noise) / expected];
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

    #[test]
    fn a_velocity_that_noise_has_made_is_not_gone_on_with_when_the_noise_is_put_right() {
        let (small, large) = (Noises { measurement_m: 1e-8, ..Noises::default() }, Noises::default());
        let mut filter = Kalman::at(0, 0.0, &small);
        let mut state = 1u64;
        for n in 1..8000u64 {
            let noises = if n < 100 { &small } else { &large };
            if n == 100 {
                filter.other_noise(&small, &large);
            }
            filter.predict(n * 250_000, noises);
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            filter.update(6e-6 * ((state >> 40) as f64 / (1u64 << 24) as f64 - 0.5), noises);
            assert!(
                filter.position_m().abs() < 6e-6,
                "{:e} m at {n} out of noise within 3 µm",
                filter.position_m()
            );
        }
    }

    #[test]
    fn no_noise_makes_a_variance_negative() {
        let exact = Noises { measurement_m: 1e-8, acceleration_m_s2: 1e-5 };
        let mut filter = Kalman::at(0, 0.0, &Noises { measurement_m: 1e-3, acceleration_m_s2: 10.0 });
        for n in 1..1000u64 {
            filter.predict(n * n * 1000, &exact);
            filter.update(1e-3, &exact);
            assert!(filter.covariance[0] >= 0.0 && filter.covariance[2] >= 0.0, "{filter:?}");
        }
    }
}
