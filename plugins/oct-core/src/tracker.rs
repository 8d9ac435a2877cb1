//! Follows the surface from A-scan to A-scan: detection, plausibility, prediction.
//!
//! Invariant: a reading is valid only when this very A-scan shows a surface where one can be. A jump that no
//! eye makes is left out until it has stayed for a while; then the surface counts as lost, and the filter
//! begins anew. A filter that gets no measurements is forgotten, whether it was believed or not.

use crate::kalman::{Kalman, Noises};
use crate::surface::{Rule, first_surface};
use crate::tip::TipTravel;

/// Settings of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Nothing is looked for nearer than this, m.
    pub min_depth_m: f64,
    /// Refractive index between tip and surface.
    pub index: f64,
    /// Standard deviations and dB above the noise.
    pub sigmas: f64,
    pub above_db: f64,
    pub noises: Noises,
    /// A measurement further from the prediction than this is left out, m.
    pub gate_m: f64,
    /// When they have been left out for this long, the surface is where they say, s.
    pub patience_s: f64,
    /// A surface not seen for this long is lost, s.
    pub lost_after_s: f64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            min_depth_m: 100e-6,
            index: 1.336,
            sigmas: 4.0,
            above_db: 3.0,
            noises: Noises::default(),
            gate_m: 60e-6,
            patience_s: 0.01,
            lost_after_s: 0.05,
        }
    }
}

/// Measurements after which a new filter is believed.
const BELIEVED_AFTER: u32 = 8;

/// Result of one A-scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time of the A-scan.
    pub ns: u64,
    /// From the tip to the surface, filtered, m.
    pub distance_m: f64,
    /// The same as this A-scan alone has it, m; NaN where it shows no surface.
    pub measured_m: f64,
    /// Velocity of the surface along the tool, away from the tip positive, m/s. If the robot is known:
    /// against its base; else against the tip.
    pub velocity_m_s: f64,
    /// Standard deviation of the distance, m.
    pub sigma_m: f64,
    /// Peak above the noise, dB; 0 without a surface.
    pub snr_db: f64,
    pub valid: bool,
    /// The surface was lost or found with this A-scan.
    pub change: Change,
}

/// Change of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    None,
    Lost,
    Found,
}

/// The tracker.
#[derive(Clone, Debug)]
pub struct Tracker {
    settings: Settings,
    tip: TipTravel,
    /// A robot tells the tip's place; without, the tip counts as standing still.
    has_robot: bool,
    filter: Option<Kalman>,
    accepted: u32,
    /// Since when measurements are left out.
    off_since_ns: Option<u64>,
    last_valid_ns: Option<u64>,
    /// When a measurement last went into the filter.
    last_taken_ns: u64,
    found: bool,
    /// The filter has begun anew elsewhere with this A-scan.
    elsewhere: bool,
}

impl Tracker {
    pub fn new(settings: Settings) -> Tracker {
        Tracker {
            settings,
            tip: TipTravel::default(),
            has_robot: false,
            filter: None,
            accepted: 0,
            off_since_ns: None,
            last_valid_ns: None,
            last_taken_ns: 0,
            found: false,
            elsewhere: false,
        }
    }

    /// Takes other settings from the next A-scan on; the followed surface stays.
    pub fn set(&mut self, settings: Settings) {
        if let Some(filter) = &mut self.filter {
            filter.other_noise(&self.settings.noises, &settings.noises);
        }
        self.settings = settings;
    }

    /// Takes the tip's position (m) and the tool's orientation.
    pub fn tip_at(&mut self, ns: u64, position_m: [f64; 3], orientation: &[f64; 4]) {
        self.has_robot |= self.tip.push(ns, position_m, orientation);
    }

    /// Has a robot told where it is?
    pub fn has_robot(&self) -> bool {
        self.has_robot
    }

    /// One A-scan in dB, whose bins are `bin_m` apart and begin at `first_m` (optical path).
    pub fn see(&mut self, ns: u64, ascan: &[f32], bin_m: f64, first_m: f64) -> Reading {
        let s = self.settings;
        let per_bin = bin_m / s.index;
        let mut reading = Reading {
            ns,
            distance_m: f64::NAN,
            measured_m: f64::NAN,
            velocity_m_s: f64::NAN,
            sigma_m: f64::INFINITY,
            snr_db: 0.0,
            valid: false,
            change: Change::None,
        };
        let first_bin = ((s.min_depth_m * s.index - first_m) / bin_m).ceil().max(1.0);
        let rule =
            Rule { first_bin: first_bin as usize, sigmas: s.sigmas as f32, above_db: s.above_db as f32 };
        let usable = per_bin > 0.0 && per_bin.is_finite() && first_m.is_finite();
        let surface = if usable { first_surface(ascan, &rule) } else { None };
        let tip = if self.has_robot { self.tip.at(ns) } else { Some(0.0) };
        if let (Some(surface), Some(tip)) = (surface, tip) {
            reading.measured_m = first_m / s.index + f64::from(surface.bin) * per_bin;
            reading.snr_db = f64::from(surface.peak_db - surface.noise_db);
            reading.valid = self.take(ns, tip + reading.measured_m);
        } else if let Some(filter) = &mut self.filter {
            filter.predict(ns, &s.noises);
        }
        if let (Some(filter), Some(tip)) = (&self.filter, tip) {
            reading.distance_m = filter.ahead(ns) - tip;
            reading.velocity_m_s = filter.velocity_m_s();
            reading.sigma_m = filter.sigma_m();
        }
        reading.change = self.judge(ns, reading.valid);
        reading
    }

    /// Takes a surface at `place_m` on the tool's line; false when it cannot be there.
    fn take(&mut self, ns: u64, place_m: f64) -> bool {
        let s = self.settings;
        let Some(filter) = &mut self.filter else {
            self.begin(ns, place_m);
            return false;
        };
        filter.predict(ns, &s.noises);
        let (off, expected) = filter.innovation(place_m, &s.noises);
        if off.abs() > s.gate_m.max(4.0 * expected) {
            let since = *self.off_since_ns.get_or_insert(ns);
            if ns.saturating_sub(since) as f64 * 1e-9 >= s.patience_s {
                self.begin(ns, place_m);
                self.elsewhere = true;
            }
            return false;
        }
        filter.update(place_m, &s.noises);
        (self.off_since_ns, self.last_taken_ns) = (None, ns);
        self.accepted = self.accepted.saturating_add(1);
        self.accepted >= BELIEVED_AFTER
    }

    fn begin(&mut self, ns: u64, place_m: f64) {
        self.filter = Some(Kalman::at(ns, place_m, &self.settings.noises));
        (self.accepted, self.off_since_ns, self.last_taken_ns) = (1, None, ns);
    }

    fn judge(&mut self, ns: u64, valid: bool) -> Change {
        if valid {
            self.last_valid_ns = Some(ns);
            return if std::mem::replace(&mut self.found, true) { Change::None } else { Change::Found };
        }
        let since = *self.last_valid_ns.get_or_insert(ns);
        let is_old = |since: u64| ns.saturating_sub(since) as f64 * 1e-9 > self.settings.lost_after_s;
        if is_old(self.last_taken_ns) {
            // The filter's state is too old to go on with.
            (self.filter, self.off_since_ns, self.accepted) = (None, None, 0);
        }
        let lost = std::mem::take(&mut self.elsewhere) || is_old(since);
        if lost && std::mem::replace(&mut self.found, false) { Change::Lost } else { Change::None }
    }
}

#[cfg(test)]
#[path = "tracker_tests.rs"]
mod tests;
