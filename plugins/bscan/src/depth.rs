//! Keeps the tip at a constant distance from a surface that moves: PI control with the surface's own velocity
//! ahead of it.
//!
//! Invariant: the surface is placed where it was when it was seen, on the line of the tip's travel, and only
//! then brought to now. The speed it asks for never brings the tip nearer than `min_distance_m`, as far as
//! this can be predicted.

use trocar_oct_core::tip::TipTravel;

/// Gains and limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Speed per error, 1/s.
    pub kp_per_s: f64,
    /// Acceleration per error, 1/s².
    pub ki_per_s2: f64,
    /// Highest speed along the tool, m/s.
    pub max_speed_m_s: f64,
    /// Highest speed towards a surface that is still far, beside the surface's own, m/s.
    pub approach_m_s: f64,
    /// The tip never goes nearer than this, m.
    pub min_distance_m: f64,
    /// Delay of the whole loop, from the exposure to the tip's answer, s; bounds the gains.
    pub delay_s: f64,
    /// Without a new surface the tip follows the last velocity for this long, s; then it stands still.
    pub coast_s: f64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            kp_per_s: 30.0,
            ki_per_s2: 100.0,
            max_speed_m_s: 5e-3,
            approach_m_s: 0.5e-3,
            min_distance_m: 150e-6,
            delay_s: 0.0,
            coast_s: 0.015,
        }
    }
}

/// Highest gain times the loop's delay: 90° − 0.5 rad leave a margin of 61° to an integrator (Åström, Murray,
/// *Feedback Systems*, 2008, ch. 9.3).
const GAIN_DELAY: f64 = 0.5;
/// Highest commanded speed per distance to the forbidden region, 1/s: the drive brakes within a few ms. The
/// robot's own guard has another rate.
const BRAKE_PER_S: f64 = 40.0;
/// A surface that is further from where it was expected is not taken for one, m: no eye moves so far between
/// two looks, and the next layer with an echo of its own lies 67 µm below.
pub const JUMP_M: f64 = 60e-6;
/// Errors above this are on the way in, not to be integrated, m.
const SMALL_M: f64 = 20e-6;

/// A surface on the line of the tip's travel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    ns: u64,
    at_m: f64,
    velocity_m_s: f64,
}

/// Command for the next period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Advice {
    /// Along the tool, m/s.
    pub speed_m_s: f64,
    /// From tip to surface, m, now.
    pub distance_m: f64,
    /// Since the surface was seen, s.
    pub age_s: f64,
    /// The surface is too old to be followed: the speed is 0.
    pub blind: bool,
}

/// The controller.
#[derive(Clone, Debug, Default)]
pub struct Depth {
    tip: TipTravel,
    place: Option<Place>,
    integral_m_s: f64,
}

impl Depth {
    /// Forgets surface and integral; the tip's travel stays.
    pub fn begin(&mut self) {
        self.integral_m_s = 0.0;
    }

    /// Takes the place of the tip by the encoders.
    pub fn tip_at(&mut self, ns: u64, position_m: [f64; 3], orientation: &[f64; 4]) {
        self.tip.push(ns, position_m, orientation);
    }

    /// Takes a surface that was seen `distance_m` before the tip, moving at `velocity_m_s`. False if the
    /// tip's place at that time is unknown.
    pub fn surface_at(&mut self, ns: u64, distance_m: f64, velocity_m_s: f64) -> bool {
        let Some(tip_m) = self.tip.at(ns) else { return false };
        if !(distance_m.is_finite() && velocity_m_s.is_finite()) {
            return false;
        }
        if self.place.is_none_or(|place| ns > place.ns) {
            self.place = Some(Place { ns, at_m: tip_m + distance_m, velocity_m_s });
        }
        true
    }

    /// Returns the distance between a surface `distance_m` before the tip and the place to which the last one
    /// has gone meanwhile, m; 0 while none is known.
    pub fn jump_m(&self, ns: u64, distance_m: f64) -> f64 {
        let Some((place, tip_m)) = self.place.zip(self.tip.at(ns)) else { return 0.0 };
        let age_s = ns.saturating_sub(place.ns) as f64 * 1e-9;
        (tip_m + distance_m - place.at_m - place.velocity_m_s * age_s).abs()
    }

    /// The speed for the next `dt_s`; none while no surface or no tip is known.
    pub fn advise(&mut self, ns: u64, dt_s: f64, offset_m: f64, s: &Settings) -> Option<Advice> {
        let (place, tip_m) = (self.place?, self.tip.at(ns)?);
        let age_s = ns.saturating_sub(place.ns) as f64 * 1e-9;
        let distance_m = place.at_m + place.velocity_m_s * age_s - tip_m;
        if age_s > s.coast_s {
            return Some(Advice { speed_m_s: 0.0, distance_m, age_s, blind: true });
        }
        let error_m = distance_m - offset_m;
        // No loop is faster than none at all: a delay that cannot be has no gain.
        let fastest_per_s = match s.delay_s {
            delay_s if delay_s > 0.0 => GAIN_DELAY / delay_s,
            0.0 => f64::INFINITY,
            _ => 0.0,
        };
        let kp_per_s = s.kp_per_s.min(fastest_per_s);
        // Twice the same root: above it the sum would swing.
        let ki_per_s2 = s.ki_per_s2.min(0.25 * kp_per_s * kp_per_s);
        if error_m.abs() < SMALL_M {
            self.integral_m_s += ki_per_s2 * error_m * dt_s;
            // The integral makes up for what the prediction lacks, which is never much.
            self.integral_m_s = self.integral_m_s.clamp(-s.approach_m_s, s.approach_m_s);
        }
        // Away from the surface at any speed, towards it slowly.
        let towards = (kp_per_s * error_m).clamp(-s.max_speed_m_s, s.approach_m_s);
        let wanted = place.velocity_m_s + towards + self.integral_m_s;
        let allowed = place.velocity_m_s + BRAKE_PER_S.min(fastest_per_s) * (distance_m - s.min_distance_m);
        let speed_m_s = wanted.min(allowed).clamp(-s.max_speed_m_s, s.max_speed_m_s);
        Some(Advice { speed_m_s, distance_m, age_s, blind: false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

    fn seen(distance_m: f64, velocity_m_s: f64) -> Depth {
        let mut depth = Depth::default();
        for n in 0..10 {
            depth.tip_at(1_000_000 * n, [0.0, 0.0, 0.05], &UPRIGHT);
        }
        assert!(depth.surface_at(8_500_000, distance_m, velocity_m_s));
        depth
    }

    #[test]
    fn the_surface_is_brought_to_now_before_it_is_followed() {
        let s = Settings::default();
        let advice = seen(500e-6, 1e-3).advise(9_000_000, 1e-3, 500e-6, &s).expect("all is known");
        assert!((advice.distance_m - 500.5e-6).abs() < 1e-12 && (advice.age_s - 0.5e-3).abs() < 1e-12);
        let wanted = 1e-3 + (30.0 + 0.1) * 0.5e-6;
        assert!((advice.speed_m_s - wanted).abs() < 1e-9, "{} for {wanted}", advice.speed_m_s);
    }

    #[test]
    fn the_tip_never_goes_on_into_the_forbidden_region_and_leaves_it_at_once() {
        let s = Settings { approach_m_s: 5e-3, ..Settings::default() };
        let at =
            |distance: f64| seen(distance, 0.0).advise(9_000_000, 1e-3, 100e-6, &s).expect("known").speed_m_s;
        assert!(at(150e-6) <= 0.0 && at(120e-6) < -1e-3);
        assert!((at(200e-6) - 40.0 * 50e-6).abs() < 1e-9);
    }

    #[test]
    fn a_jump_is_measured_from_where_the_surface_has_gone_meanwhile() {
        let mut depth = seen(500e-6, 1e-3);
        for n in 10..20 {
            depth.tip_at(1_000_000 * n, [0.0, 0.0, 0.05 + 2e-6 * (n - 9) as f64], &UPRIGHT);
        }
        // 10 ms later the surface is 10 µm deeper, and the tip 19 µm.
        assert!(depth.jump_m(18_500_000, 491e-6) < 1e-12, "{:e}", depth.jump_m(18_500_000, 491e-6));
        assert!((depth.jump_m(18_500_000, 671e-6) - 180e-6).abs() < 1e-12);
        assert_eq!(Depth::default().jump_m(1, 1.0), 0.0);
    }

    #[test]
    fn the_gains_give_way_to_the_delay_of_the_loop() {
        let speed = |kp_per_s: f64, delay_s: f64| {
            let approach_m_s = 5e-3;
            let s = Settings { kp_per_s, delay_s, approach_m_s, ki_per_s2: 0.0, ..Settings::default() };
            seen(510e-6, 0.0).advise(9_000_000, 1e-3, 500e-6, &s).expect("known").speed_m_s
        };
        let gain = |kp_per_s: f64, delay_s: f64| speed(kp_per_s, delay_s) / 10e-6;
        assert!((gain(30.0, 0.0095) - 30.0).abs() < 1e-6, "the usual loop keeps its gain");
        assert!((gain(100.0, 0.020) - 25.0).abs() < 1e-6, "{}", gain(100.0, 0.020));
        assert!((gain(100.0, 0.0) - 100.0).abs() < 1e-6);
        for cannot_be in [-1e-9, -1.0, f64::NAN] {
            assert_eq!(gain(100.0, cannot_be), 0.0, "{cannot_be}");
        }
        // The sum, too: 2000 /s² with 25 /s would swing.
        let s = Settings { kp_per_s: 100.0, ki_per_s2: 2000.0, delay_s: 0.02, ..Settings::default() };
        let summed = seen(510e-6, 0.0).advise(9_000_000, 1e-3, 500e-6, &s).expect("known").speed_m_s;
        assert!((summed - 10e-6 * (25.0 + 156.25e-3)).abs() < 1e-12, "{summed}");
    }

    #[test]
    fn an_old_surface_is_followed_no_further() {
        let s = Settings::default();
        let mut depth = seen(600e-6, 1e-3);
        for n in 10..40 {
            depth.tip_at(1_000_000 * n, [0.0, 0.0, 0.05], &UPRIGHT);
        }
        let advice = depth.advise(39_000_000, 1e-3, 500e-6, &s).expect("known");
        assert!(advice.blind && advice.speed_m_s == 0.0);
    }

    #[test]
    fn nothing_is_advised_while_tip_or_surface_are_unknown() {
        let s = Settings::default();
        let mut depth = Depth::default();
        assert!(!depth.surface_at(1, 1e-3, 0.0));
        assert_eq!(depth.advise(1, 1e-3, 500e-6, &s), None);
        let mut depth = seen(500e-6, 0.0);
        assert!(!depth.surface_at(8_600_000, 500e-6, f64::NAN));
        assert_eq!(depth.advise(1_000_000_000, 1e-3, 500e-6, &s), None, "the robot is silent");
    }
}
