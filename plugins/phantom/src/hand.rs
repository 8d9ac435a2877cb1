//! The surgeon's hand: what it means to do, its tremor, and what a force sensor at the handle makes of both.
//!
//! Invariant: every function is one of seed and time alone. Forces and displacements are in the axes of the
//! world. A free hand trembles by [`TREMOR_RMS_M`]; on a handle the same tremor is a force through the hand's
//! stiffness.

use nalgebra::Vector3;

use crate::noise::Noise;
use crate::sensor::ForceErrors;
use crate::world::streams;

/// Tremor of a free hand, RMS of the displacement's length, m: 182 µm (PMC10723823).
pub const TREMOR_RMS_M: f64 = 182e-6;

/// Middle of the tremor's band, Hz.
pub const TREMOR_HZ: f64 = 10.0;

/// Damping ratio of the resonator that shapes the tremor: half the power lies within 2ζ of its middle, 8.5 to
/// 11.5 Hz.
const DAMPING: f64 = 0.15;

/// Ends of the spectrum that is kept, Hz; beyond them the resonator has less than a third of its peak's
/// power.
const BAND_HZ: [f64; 2] = [7.0, 13.0];

/// Sinusoids per axis; a quarter of a Hz apart they repeat only after minutes.
const TONES: usize = 24;

/// Stiffness with which a hand holds a handle, N/m (2 N/mm).
pub const STIFFNESS_N_M: f64 = 2_000.0;

/// Part of a push along the axis of the eye against the parts across it: nobody means to push into the
/// retina.
const ALONG: f64 = 0.2;

/// A hand and the sensor it pushes on.
#[derive(Clone, Debug, PartialEq)]
pub struct Hand {
    noise: Noise,
    tremor: [[Tone; TONES]; 3],
    /// Movements the hand means to make.
    pub intent: Intent,
    /// Errors of the handle's force sensor.
    pub sensor: ForceErrors,
}

/// Movements to and fro, each a push in the shape of a minimum-jerk velocity (Flash and Hogan, *The
/// coordination of arm movements*, 1985): on a robot that turns force into velocity the tip makes a
/// minimum-jerk movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intent {
    /// Largest peak of a push, N; the smallest is half of it.
    pub peak_n: f64,
    /// Length of a push, s.
    pub push_s: f64,
    /// From the beginning of one push to the next, s.
    pub every_s: f64,
}

/// `amplitude · sin(2π f t + phase)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tone {
    frequency_hz: f64,
    phase_rad: f64,
}

/// Parts of the hand's stream of random numbers.
mod parts {
    pub(super) const TONES: u64 = 0;
    pub(super) const PHASES: u64 = 8;
    pub(super) const PUSHES: u64 = 16;
    pub(super) const SENSOR: u64 = 24;
}

impl Hand {
    /// The hand of the world `seed`: pushes up to 1.5 N each 2 s, a sensor of 10 mN RMS that drifts 5 mN/min
    /// at most.
    pub fn new(seed: u64) -> Hand {
        let noise = Noise::new(seed, streams::HAND);
        let tremor =
            [0u64, 1, 2].map(|axis| tones(noise.part(parts::TONES + axis), noise.part(parts::PHASES + axis)));
        Hand {
            noise,
            tremor,
            intent: Intent { peak_n: 1.5, push_s: 1.2, every_s: 2.0 },
            sensor: ForceErrors {
                noise_n: 10e-3,
                rate_hz: 1000.0,
                drift_n_s: 5e-3 / 60.0,
                drift_period_s: 600.0,
            },
        }
    }

    /// Displacement of a free hand by its tremor at `t_s`, m: the "no robot" baseline.
    pub fn tremor_m(&self, t_s: f64) -> Vector3<f64> {
        // Each axis has a third of the power, each of its tones the same part of that.
        let amplitude_m = TREMOR_RMS_M * (2.0 / (3.0 * TONES as f64)).sqrt();
        Vector3::from_fn(|axis, _| {
            amplitude_m * self.tremor[axis].iter().map(|tone| tone.at(t_s)).sum::<f64>()
        })
    }

    /// Force of the movement the hand means to make at `t_s`, N. Each second push takes the one before back.
    pub fn intended_n(&self, t_s: f64) -> Vector3<f64> {
        let Intent { peak_n, push_s, every_s } = self.intent;
        let number = (t_s / every_s).floor();
        let share = (t_s - number * every_s) / push_s;
        if !(0.0..1.0).contains(&share) {
            return Vector3::zeros();
        }
        let pushes = self.noise.part(parts::PUSHES).part((number / 2.0).floor() as i64 as u64);
        let side = |axis: u64| pushes.normal(axis);
        let towards = Vector3::new(side(0), side(1), ALONG * side(2)).normalize();
        let peak = peak_n * (0.5 + 0.5 * pushes.uniform(3));
        let back = if number.rem_euclid(2.0) == 0.0 { 1.0 } else { -1.0 };
        // 16 s²(1 − s)² is 1 in the middle.
        let bell = 4.0 * share * (1.0 - share);
        towards * (back * peak * bell * bell)
    }

    /// Force of the hand on a handle that does not give way, at `t_s`, N.
    pub fn force_n(&self, t_s: f64) -> Vector3<f64> {
        self.intended_n(t_s) + self.tremor_m(t_s) * STIFFNESS_N_M
    }

    /// The force as the handle's sensor gives it at `t_s`, N: with bias and noise.
    pub fn sensed_n(&self, t_s: f64) -> Vector3<f64> {
        self.force_n(t_s) + self.sensor_error_n(t_s)
    }

    /// Bias and noise of the sensor at `t_s`, N: what it gives when nobody touches the handle.
    pub fn sensor_error_n(&self, t_s: f64) -> Vector3<f64> {
        self.sensor.at(self.noise.part(parts::SENSOR), t_s)
    }
}

impl Tone {
    fn at(&self, t_s: f64) -> f64 {
        (std::f64::consts::TAU * self.frequency_hz * t_s + self.phase_rad).sin()
    }
}

/// Tones of equal power whose frequencies lie as densely as the resonator's spectrum is high: one in each of
/// as many parts of equal power, at a random place of it.
fn tones(places: Noise, phases: Noise) -> [Tone; TONES] {
    const BINS: u32 = 2_000;
    let width_hz = (BAND_HZ[1] - BAND_HZ[0]) / f64::from(BINS);
    let middle_hz = |bin: u32| BAND_HZ[0] + (f64::from(bin) + 0.5) * width_hz;
    let total: f64 = (0..BINS).map(|bin| power(middle_hz(bin))).sum();
    let phase = |tone: usize| std::f64::consts::TAU * phases.uniform(tone as u64);
    let mut tones = std::array::from_fn(|tone| Tone { frequency_hz: TREMOR_HZ, phase_rad: phase(tone) });
    let (mut sum, mut next) = (0.0, 0);
    for bin in 0..BINS {
        sum += power(middle_hz(bin));
        while next < TONES && sum * TONES as f64 >= total * (next as f64 + places.uniform(next as u64)) {
            tones[next].frequency_hz = middle_hz(bin);
            next += 1;
        }
    }
    tones
}

/// Power of a second-order resonator driven by white noise, relative to that at rest.
fn power(frequency_hz: f64) -> f64 {
    let r = frequency_hz / TREMOR_HZ;
    let off = 1.0 - r * r;
    1.0 / (off * off + 4.0 * DAMPING * DAMPING * r * r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_free_hand_trembles_by_182_micrometres_whatever_the_seed() {
        for seed in 0..20 {
            let hand = Hand::new(seed);
            let samples = 6_000;
            let square: f64 = (0..samples).map(|n| hand.tremor_m(0.0107 * f64::from(n)).norm_squared()).sum();
            let rms = (square / f64::from(samples)).sqrt();
            assert!((rms / TREMOR_RMS_M - 1.0).abs() < 0.05, "seed {seed}: {rms:e} m");
        }
    }

    #[test]
    fn most_of_the_tremor_lies_between_8_and_12_hertz_around_10() {
        for seed in 0..20 {
            let tones = Hand::new(seed).tremor.concat();
            let inside = tones.iter().filter(|tone| (8.0..12.0).contains(&tone.frequency_hz)).count();
            let share = inside as f64 / tones.len() as f64;
            assert!((0.75..0.95).contains(&share), "seed {seed}: {share}");
            let mean = tones.iter().map(|tone| tone.frequency_hz).sum::<f64>() / tones.len() as f64;
            assert!((mean - 10.0).abs() < 0.4, "seed {seed}: {mean} Hz");
            assert!(tones.iter().all(|tone| (BAND_HZ[0]..=BAND_HZ[1]).contains(&tone.frequency_hz)));
        }
    }

    #[test]
    fn a_push_is_smooth_bounded_and_taken_back_by_the_next() {
        let hand = Hand::new(5);
        let dt = 1e-3;
        for pair in 0..10 {
            let begin = 4.0 * f64::from(pair);
            let (mut sum, mut highest, mut before) = (Vector3::zeros(), 0.0_f64, Vector3::zeros());
            for n in 0..4_000 {
                let force = hand.intended_n(begin + dt * f64::from(n));
                assert!((force - before).norm() < 0.01, "a jump of {} N", (force - before).norm());
                (sum, highest, before) = (sum + force * dt, highest.max(force.norm()), force);
            }
            assert!((0.7..=1.5).contains(&highest), "{highest} N");
            assert!(sum.norm() < 1e-6, "{} N·s are left", sum.norm());
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_hand_in_any_order_of_asking() {
        let (one, other) = (Hand::new(9), Hand::new(9));
        let late = one.sensed_n(7.25);
        assert_eq!(one.sensed_n(0.5), other.sensed_n(0.5));
        assert_eq!(late, other.sensed_n(7.25));
        assert_ne!(late, Hand::new(10).sensed_n(7.25));
    }
}
