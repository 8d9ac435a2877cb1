//! Hands-on control: turns the force of a hand into a velocity of the tip.
//!
//! Invariant: nothing below the dead band moves anything, and three times the dead band counts in full; the
//! law between is continuous, so no force makes the velocity jump. A force that is too strong or no number
//! lets go and leaves nothing behind. Wrenches and twists are in the frame of the tip. Source: R. H. Taylor
//! et al., *A steady-hand robotic system for microsurgical augmentation*, IJRR 18 (1999): velocity in
//! proportion to the force on the handle.

use nalgebra::{Vector3, Vector6};

/// Settings of hands-on control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Velocity per force along x, y, z, m/(s·N), and per torque about them, rad/(s·N·m).
    pub gain: Vector6<f64>,
    /// Forces below this do not count, N.
    pub dead_band_n: f64,
    /// Torques below this do not count, N·m.
    pub dead_band_n_m: f64,
    /// -6 dB corner of the filter in front of the law, Hz.
    pub corner_hz: f64,
    /// A stronger force lets go, N.
    pub limit_n: f64,
}

/// Largest gain that is taken: m/(s·N) and rad/(s·N·m). With a hand of 2 N/mm the loop through the hand then
/// has a gain of 10 /s, which filter and arm leave a phase margin of 50°.
pub const HIGHEST_GAIN: [f64; 2] = [0.005, 10.0];

/// A stronger torque lets go, N·m: twice what `compliance/servo_cf` may ask for.
const LIMIT_N_M: f64 = 2.0;

/// Part of the limit below which a force that was too strong counts again.
const AGAIN: f64 = 0.9;

impl Default for Law {
    /// 1 N is 1 mm/s and 1 N·m is 1 rad/s; 30 mN and 1 mN·m do not count; 5 Hz; 20 N.
    fn default() -> Self {
        Law {
            gain: Vector6::new(1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0),
            dead_band_n: 0.03,
            dead_band_n_m: 1e-3,
            corner_hz: 5.0,
            limit_n: 20.0,
        }
    }
}

/// The law with its filter.
#[derive(Clone, Copy, Debug, Default)]
pub struct Admittance {
    /// Its settings.
    pub law: Law,
    first: Vector6<f64>,
    second: Vector6<f64>,
    too_strong: bool,
}

impl Admittance {
    /// A law whose filter is empty.
    pub fn new(law: Law) -> Self {
        Admittance { law, ..Admittance::default() }
    }

    /// One period of `dt_s` with this `wrench` (N, N·m): the twist of the tip that follows it, m/s and rad/s.
    pub fn step(&mut self, wrench: &Vector6<f64>, dt_s: f64) -> Vector6<f64> {
        if wrench.iter().any(|part| !part.is_finite()) {
            self.let_go();
            return Vector6::zeros();
        }
        let strength_n = wrench.fixed_rows::<3>(0).norm();
        let torque_n_m = wrench.fixed_rows::<3>(3).norm();
        let part = if self.too_strong { AGAIN } else { 1.0 };
        self.too_strong = strength_n > self.law.limit_n * part || torque_n_m > LIMIT_N_M * part;
        if self.too_strong {
            self.let_go();
            return Vector6::zeros();
        }
        // Two equal low-passes in a row: critically damped, so a hand that lets go is not followed by a swing
        // back.
        let share = 1.0 - (-std::f64::consts::TAU * self.law.corner_hz * dt_s).exp();
        self.first += (wrench - self.first) * share;
        self.second += (self.first - self.second) * share;
        let force = beyond(&self.second.fixed_rows::<3>(0).into_owned(), self.law.dead_band_n);
        let torque = beyond(&self.second.fixed_rows::<3>(3).into_owned(), self.law.dead_band_n_m);
        let counted = Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z);
        counted.component_mul(&self.law.gain)
    }

    /// Empties the filter: a blow would be followed long after it is over.
    fn let_go(&mut self) {
        (self.first, self.second) = (Vector6::zeros(), Vector6::zeros());
    }

    /// The force is, or was and is still nearly, above the limit.
    pub fn is_too_strong(&self) -> bool {
        self.too_strong
    }
}

/// `v` without what lies in the dead band: nothing below `band`, all of it above three times that.
fn beyond(v: &Vector3<f64>, band: f64) -> Vector3<f64> {
    let length = v.norm();
    if length <= band {
        return Vector3::zeros();
    }
    v * (1.5 * (length - band) / length).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;

    fn settled(law: Law, wrench: Vector6<f64>) -> Vector6<f64> {
        let mut admittance = Admittance::new(law);
        (0..2_000).map(|_| admittance.step(&wrench, DT)).last().expect("steps")
    }

    #[test]
    fn one_newton_is_one_millimetre_per_second_and_one_newtonmetre_a_radian() {
        let twist = settled(Law::default(), Vector6::new(0.0, 0.6, 0.8, 0.0, 0.0, 0.1));
        assert!((twist - Vector6::new(0.0, 0.6e-3, 0.8e-3, 0.0, 0.0, 0.1)).norm() < 1e-9, "{twist:?}");
    }

    #[test]
    fn nothing_in_the_dead_band_moves_and_the_law_is_continuous_beyond_it() {
        let at = |force: f64| settled(Law::default(), Vector6::new(force, 0.0, 0.0, 0.0, 0.0, 0.0))[0];
        assert_eq!((at(0.03), at(-0.03)), (0.0, 0.0));
        let mut before = 0.0;
        for n in 0..400 {
            let force = 0.5e-3 * f64::from(n);
            let v = at(force);
            assert!((0.0..=0.8e-6).contains(&(v - before)), "from {before} to {v} at {force} N");
            before = v;
        }
        assert!((at(0.09) - 0.09e-3).abs() < 1e-9);
    }

    #[test]
    fn a_force_beyond_the_limit_lets_go_until_it_is_clearly_below() {
        let mut admittance = Admittance::new(Law { limit_n: 5.0, ..Law::default() });
        let push = |n: f64| Vector6::new(0.0, 0.0, n, 0.0, 0.0, 0.0);
        for _ in 0..500 {
            admittance.step(&push(4.9), DT);
        }
        assert!(admittance.step(&push(4.9), DT)[2] > 4e-3);
        assert_eq!(admittance.step(&push(5.1), DT), Vector6::zeros());
        assert_eq!(admittance.step(&push(4.6), DT), Vector6::zeros());
        assert!(admittance.step(&push(4.4), DT)[2] < 0.1e-3, "it is followed from rest");
        (0..500).for_each(|_| _ = admittance.step(&push(4.4), DT));
        assert!(admittance.step(&push(4.4), DT)[2] > 4e-3);
    }

    #[test]
    fn a_blow_or_a_wrench_that_is_no_number_leaves_nothing_behind() {
        let least = Vector6::new(0.0, 0.0, 0.5, 0.0, 0.0, 0.0);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, 500.0, f64::MAX] {
            for place in 0..3 {
                let mut admittance = Admittance::new(Law::default());
                (0..100).for_each(|_| _ = admittance.step(&least, DT));
                let mut blow = least;
                blow[place] = bad;
                assert_eq!(admittance.step(&blow, DT), Vector6::zeros());
                for _ in 0..1000 {
                    let v = admittance.step(&least, DT);
                    assert!(v.iter().all(|v| v.is_finite()) && v.norm() <= 0.5e-3 + 1e-9, "{bad}: {v:?}");
                }
                assert!(
                    (admittance.step(&least, DT)[2] - 0.5e-3).abs() < 1e-6,
                    "{bad}: it is followed again"
                );
            }
        }
        // A torque that is no number, too.
        let mut admittance = Admittance::new(Law::default());
        for bad in [f64::NAN, 1e300, 3.0] {
            admittance.step(&Vector6::new(0.0, 0.0, 0.0, bad, 0.0, 0.0), DT);
            assert_eq!(admittance.step(&Vector6::zeros(), DT), Vector6::zeros());
        }
    }

    #[test]
    fn a_force_of_10_hertz_loses_14_decibel_in_the_filter() {
        let mut admittance = Admittance::new(Law { dead_band_n: 0.0, ..Law::default() });
        let mut highest = 0.0_f64;
        for n in 0..5_000 {
            let push = (std::f64::consts::TAU * 10.0 * DT * f64::from(n)).sin();
            let v = admittance.step(&Vector6::new(push, 0.0, 0.0, 0.0, 0.0, 0.0), DT)[0];
            if n > 2_000 {
                highest = highest.max(v.abs());
            }
        }
        let db = -20.0 * (highest / 1e-3).log10();
        assert!((db - 14.0).abs() < 0.3, "{db} dB");
    }
}
