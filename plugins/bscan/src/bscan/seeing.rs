//! What robot and tracker tell.
//!
//! Invariant: nothing is commanded here; what is taken in carries the time at which it was so.

use trocar_sdk::data::Distance;
use trocar_sdk::prelude::*;

use super::BScan;
use crate::depth::JUMP_M;
use crate::payloads::Phase;

/// Share of a new delay in their mean.
const DELAY_SHARE: f64 = 1.0 / 32.0;
/// Distances of one step at most.
const BURST: usize = 64;

impl BScan {
    /// Robot and surface as they are told.
    pub(super) fn look(&mut self, now: Stamp) {
        if let Ok(pose) = self.measured_cp.call(())
            && pose.is_valid()
            && pose.position.iter().all(|p| p.is_finite())
            && pose.stamp != self.pose.stamp
        {
            self.pose = pose;
            self.track.tip_at(pose);
            self.hop_s += DELAY_SHARE * (now.seconds_since(pose.stamp).max(0.0) - self.hop_s);
            self.since.robot = now;
            self.depth.tip_at(pose.stamp.ns(), pose.position, &pose.orientation);
            if let Some(line) = &self.line {
                self.gone.push(pose.stamp.ns(), line.along_m(&pose.position));
            }
        }
        if let Ok(state) = self.operating_state.call(()) {
            self.robot = state;
        }
        let mut newest = None;
        for _ in 0..BURST {
            let Some(seen) = self.distance.next() else { break };
            self.track.surface_at(seen);
            newest = Some(seen);
        }
        if let Some(seen) = newest.filter(|seen| seen.stamp != self.last.stamp) {
            self.see(seen, now);
        }
    }

    /// The newest distance is what the robot is led by.
    fn see(&mut self, seen: Distance, now: Stamp) {
        self.last = seen;
        self.progress.surface = seen.valid;
        let delay_s = now.seconds_since(seen.stamp);
        let share = if std::mem::replace(&mut self.since.delay_known, true) { DELAY_SHARE } else { 1.0 };
        self.progress.delay += share * (delay_s - self.progress.delay);
        self.progress.loop_delay = self.progress.delay + self.hop_s + self.cfg.robot_lag_s;
        if !seen.valid.get() {
            return;
        }
        // Before a scan the surface is wherever it is seen; in a scan another layer is none.
        self.since.jumped =
            self.progress.phase != Phase::IDLE && self.depth.jump_m(seen.stamp.ns(), seen.distance) > JUMP_M;
        if !self.since.jumped && self.depth.surface_at(seen.stamp.ns(), seen.distance, seen.velocity) {
            self.since.surface = now;
        }
    }
}
