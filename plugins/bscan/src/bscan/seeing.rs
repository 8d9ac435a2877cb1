//! Readings of robot and tracker.
//!
//! Invariant: nothing is commanded here; a reading that is taken in carries the time of its measurement.

use trocar_sdk::data::{Distance, Pose};
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
        // Stamp 0 is a robot that does not measure yet (CRTK).
        if let Ok(pose) = self.measured_cp.call(())
            && pose.is_valid()
            && pose.stamp != self.pose.stamp
        {
            self.follow(pose, now);
        }
        if let Ok(state) = self.operating_state.call(()) {
            self.robot = state;
        }
        let mut newest = None;
        for _ in 0..BURST {
            let Some(seen) = self.distance.next() else { break };
            if self.track.surface_at(seen, now) {
                newest = Some(seen);
            } else {
                self.refused_distances += 1;
            }
        }
        if let Some(seen) = newest.filter(|seen| seen.stamp != self.last.stamp) {
            self.see(seen, now);
        }
    }

    /// Takes the tip's pose as the robot tells it.
    fn follow(&mut self, pose: Pose, now: Stamp) {
        if !self.track.tip_at(pose, now) {
            self.refused_poses += 1;
            return;
        }
        self.pose = pose;
        self.hop_s += DELAY_SHARE * (now.seconds_since(pose.stamp).max(0.0) - self.hop_s);
        self.since.robot = now;
        self.depth.tip_at(pose.stamp.ns(), pose.position, &pose.orientation);
        let Some(line) = &self.line else { return };
        let gone_m = line.along_m(&pose.position);
        self.gone.push(pose.stamp.ns(), gone_m);
        let arrived = self.progress.phase == Phase::SCAN && gone_m >= line.length_m;
        if arrived && !self.since.end.is_valid() {
            self.since.end = pose.stamp;
        }
    }

    /// Returns the measured part of the loop's delay: from exposure to step and from robot to step, s. The
    /// robot's own lag is not in it.
    pub(super) fn measured_delay_s(&self) -> f64 {
        self.progress.delay + self.hop_s
    }

    /// The newest distance is what the robot is led by.
    fn see(&mut self, seen: Distance, now: Stamp) {
        self.last = seen;
        self.progress.surface = seen.valid;
        // A distance that comes a little before its time is on time: a delay below zero would hide that of
        // others in the mean.
        let delay_s = now.seconds_since(seen.stamp).max(0.0);
        let share = if std::mem::replace(&mut self.since.delay_known, true) { DELAY_SHARE } else { 1.0 };
        self.progress.delay += share * (delay_s - self.progress.delay);
        self.progress.loop_delay = self.measured_delay_s() + self.cfg.robot_lag_s;
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

#[cfg(test)]
#[path = "seeing_tests.rs"]
mod tests;
