//! Room for an eye that comes up: the robot's way back when this component dies, and the tip's way back
//! otherwise.
//!
//! Invariant: while a scan runs, offset and way back leave `eye_motion_m` beside `min_distance_m`, whatever
//! is set.

use trocar_sdk::data::Retreat;

use trocar_oct_core::tip::axis_of;

use super::BScan;
use super::control::LEAST_COSINE;
use crate::payloads::Phase;

/// The robot's way back by itself: faster than an eye comes up, and only after a silence that is more than a
/// hiccup, m/s and s.
const RETREAT_M_S: f64 = 2e-3;
const RETREAT_AFTER_S: f64 = 0.02;

impl BScan {
    /// Tells the robot what to do should this component die, which has to leave the eye its room.
    pub(super) fn leave_room(&mut self, offset_m: f64) -> Result<(), String> {
        self.goes_back = self.set_retreat.send(self.retreat()).is_ok();
        self.require_room(offset_m).inspect_err(|_| _ = self.set_retreat.send(Retreat::default()))
    }

    /// The same after a change of the settings while a scan runs.
    pub(super) fn keep_room(&mut self) -> Result<(), String> {
        let Some(line) = &self.line else { return Ok(()) };
        self.require_room(line.offset_m)?;
        let taken = self.set_retreat.send(self.retreat());
        self.count(taken);
        Ok(())
    }

    fn retreat(&self) -> Retreat {
        Retreat { distance: self.cfg.retract_m, speed: RETREAT_M_S, delay: RETREAT_AFTER_S }
    }

    fn require_room(&self, offset_m: f64) -> Result<(), String> {
        let back_m = if self.goes_back { self.cfg.retract_m } else { 0.0 };
        // Along the tool: the eye comes up along z.
        let cosine = axis_of(&self.pose.orientation).map_or(1.0, |axis| axis[2].max(LEAST_COSINE));
        let needed_m = (self.cfg.min_distance_m + self.cfg.eye_motion_m) / cosine;
        // To whole nanometres, so that a refusal reads well.
        let nearest_um = ((needed_m - back_m) * 1e9).round() / 1e3;
        if offset_m * 1e6 >= nearest_um - 1e-3 {
            return Ok(());
        }
        let how = if self.goes_back {
            "retract_m is too short for less"
        } else {
            "for less, connect axis to a robot that goes back by itself (set_retreat) when this component dies"
        };
        Err(format!(
            "offset: {:.0} µm leaves no room for an eye that comes up by {:.0} µm: give {nearest_um:.0} µm or more; {how}",
            1e6 * offset_m,
            1e6 * self.cfg.eye_motion_m
        ))
    }

    /// Returns the rest of `retract_m` that the tip has still to go, m: on the way back, the rest from where
    /// the surface was last near.
    pub(super) fn left_m(&self) -> f64 {
        let gone_m = match &self.line {
            Some(line) if self.progress.phase == Phase::RETRACT => self.near_m - line.offset_m,
            _ => 0.0,
        };
        (self.cfg.retract_m - gone_m).clamp(0.0, self.cfg.retract_m)
    }
}
