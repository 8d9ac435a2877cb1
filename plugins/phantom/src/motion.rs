//! Motion of the eye: pulse and breathing along the axis, and, where asked for, a step and a saccade.
//!
//! Invariant: a function of time alone, smooth but for the step and the ends of a saccade.

use nalgebra::Vector3;

/// Motion of the eye. Amplitudes are plausible defaults, larger than those of a patient who fixates; none is
/// published.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Along the axis, with the heart.
    pub pulse: Swing,
    /// Along the axis, with the lungs.
    pub breathing: Swing,
    /// Along the axis, at once.
    pub step: Option<Step>,
    /// To the side.
    pub saccade: Option<Saccade>,
    /// Step and saccade are undone after half of this time and begin again after all of it, before their
    /// `at_s`, too, s; none: they happen once.
    pub again_s: Option<f64>,
}

/// `amplitude_m · sin(2π · frequency_hz · t + phase_rad)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swing {
    pub amplitude_m: f64,
    pub frequency_hz: f64,
    pub phase_rad: f64,
}

/// From `at_s` on the retina stands `by_m` deeper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    pub at_s: f64,
    pub by_m: f64,
}

/// From `at_s` on the eye goes along x at `speed_m_s` until it stands `by_m` away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saccade {
    pub at_s: f64,
    pub by_m: f64,
    /// Positive; the way has its sign from `by_m`.
    pub speed_m_s: f64,
}

impl Motion {
    /// 60 µm at 1.1 Hz and 100 µm at 0.25 Hz, beginning at these phases.
    pub fn plausible(pulse_phase_rad: f64, breathing_phase_rad: f64) -> Self {
        Motion {
            pulse: Swing { amplitude_m: 60e-6, frequency_hz: 1.1, phase_rad: pulse_phase_rad },
            breathing: Swing { amplitude_m: 100e-6, frequency_hz: 0.25, phase_rad: breathing_phase_rad },
            step: None,
            saccade: None,
            again_s: None,
        }
    }

    /// An eye at rest.
    pub fn none() -> Self {
        let still = Swing { amplitude_m: 0.0, frequency_hz: 0.0, phase_rad: 0.0 };
        Motion { pulse: still, breathing: still, step: None, saccade: None, again_s: None }
    }

    /// Distance of the eye from its place at `t_s`, m, in the world.
    pub fn shift(&self, t_s: f64) -> Vector3<f64> {
        let step = self.step.map_or(0.0, |step| {
            let (since_s, there) = self.since(step.at_s, t_s);
            if there && since_s >= 0.0 { step.by_m } else { 0.0 }
        });
        let aside = self.saccade.map_or(0.0, |s| {
            let (since_s, there) = self.since(s.at_s, t_s);
            let gone = (s.speed_m_s * since_s).clamp(0.0, s.by_m.abs());
            if there { gone } else { s.by_m.abs() - gone }.copysign(s.by_m)
        });
        Vector3::new(aside, 0.0, self.pulse.at(t_s) + self.breathing.at(t_s) + step)
    }

    /// Velocity of the eye at `t_s`, m/s; that of the step itself is left out.
    pub fn velocity(&self, t_s: f64) -> Vector3<f64> {
        let aside = self.saccade.map_or(0.0, |s| {
            let (since_s, there) = self.since(s.at_s, t_s);
            let moves = (0.0..s.by_m.abs()).contains(&(s.speed_m_s * since_s));
            let speed = if moves { s.speed_m_s.copysign(s.by_m) } else { 0.0 };
            if there { speed } else { -speed }
        });
        Vector3::new(aside, 0.0, self.pulse.slope(t_s) + self.breathing.slope(t_s))
    }

    /// Time since what began at `at_s` happened last, or was undone last (false), s.
    fn since(&self, at_s: f64, t_s: f64) -> (f64, bool) {
        let Some(again_s) = self.again_s else { return (t_s - at_s, true) };
        let in_turn_s = (t_s - at_s).rem_euclid(again_s);
        let half_s = 0.5 * again_s;
        if in_turn_s < half_s { (in_turn_s, true) } else { (in_turn_s - half_s, false) }
    }
}

impl Swing {
    fn turn(&self, t_s: f64) -> f64 {
        std::f64::consts::TAU * self.frequency_hz * t_s + self.phase_rad
    }

    fn at(&self, t_s: f64) -> f64 {
        self.amplitude_m * self.turn(t_s).sin()
    }

    fn slope(&self, t_s: f64) -> f64 {
        self.amplitude_m * std::f64::consts::TAU * self.frequency_hz * self.turn(t_s).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_is_the_slope_of_the_shift() {
        let mut motion = Motion::plausible(0.4, 1.3);
        motion.saccade = Some(Saccade { at_s: 1.0, by_m: -0.3e-3, speed_m_s: 1e-3 });
        let h = 1e-6;
        for n in 0..400 {
            let t = 0.0137 * f64::from(n);
            if (t - 1.0).abs() < 2.0 * h || (t - 1.3).abs() < 2.0 * h {
                continue;
            }
            let slope = (motion.shift(t + h) - motion.shift(t - h)) / (2.0 * h);
            assert!((slope - motion.velocity(t)).norm() < 1e-9, "at {t} s");
        }
    }

    #[test]
    fn a_step_stays_and_a_saccade_ends_where_it_was_sent() {
        let motion = Motion {
            step: Some(Step { at_s: 2.0, by_m: 50e-6 }),
            saccade: Some(Saccade { at_s: 1.0, by_m: -0.3e-3, speed_m_s: 1e-3 }),
            ..Motion::none()
        };
        assert_eq!(motion.shift(0.999), Vector3::zeros());
        assert!((motion.shift(1.1).x + 0.1e-3).abs() < 1e-12);
        assert_eq!(motion.shift(9.0), Vector3::new(-0.3e-3, 0.0, 50e-6));
    }

    #[test]
    fn what_happens_again_is_undone_after_half_of_the_time_whenever_one_looks() {
        let motion = Motion {
            step: Some(Step { at_s: 0.5, by_m: 50e-6 }),
            saccade: Some(Saccade { at_s: 1.0, by_m: -0.3e-3, speed_m_s: 1e-3 }),
            again_s: Some(4.0),
            ..Motion::none()
        };
        for begin in [-4_000.0, 0.0, 80_000.0] {
            let at = |t: f64| motion.shift(begin + t);
            let near = |t: f64, x: f64, z: f64| {
                let off = (at(t) - Vector3::new(x, 0.0, z)).norm();
                assert!(off < 1e-12, "{t} s after {begin} s: {}", at(t));
            };
            near(0.4, 0.0, 0.0);
            near(0.6, 0.0, 50e-6);
            near(1.1, -0.1e-3, 50e-6);
            near(2.4, -0.3e-3, 50e-6);
            near(2.6, -0.3e-3, 0.0);
            near(3.2, -0.1e-3, 0.0);
            near(3.9, 0.0, 0.0);
            assert_eq!(motion.velocity(begin + 1.1).x, -1e-3);
            assert_eq!(motion.velocity(begin + 3.1).x, 1e-3);
            assert_eq!(motion.velocity(begin + 2.0).x, 0.0);
        }
    }
}
