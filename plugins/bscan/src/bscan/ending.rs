//! How a scan goes from phase to phase, and how it ends.
//!
//! Invariant: every way out ends with `hold`, without guard and retreat, and is told by exactly one event.

use trocar_oct_core::tip::axis_of;
use trocar_sdk::data::{Pose, Retreat, VirtualFixture};
use trocar_sdk::prelude::*;

use super::{BScan, ROBOT_LOST_S, is_ready};
use crate::payloads::{Phase, Progress, ScanDone};

impl BScan {
    pub(super) fn enter(&mut self, phase: Phase, now: Stamp) {
        self.progress.phase = phase;
        self.since.phase = now;
        self.since.near = Stamp::INVALID;
    }

    /// Ends a scan before its end.
    pub(super) fn give_up(&mut self, why: &str) {
        if self.progress.phase == Phase::IDLE {
            return;
        }
        self.go_away();
        self.bscan_aborted.emit(Text::new(why));
    }

    /// The robot is not led any more, and goes the rest of the way back.
    fn go_away(&mut self) {
        let told = self.now.seconds_since(self.since.robot) <= ROBOT_LOST_S;
        let axis = axis_of(&self.pose.orientation).filter(|_| told && is_ready(&self.robot));
        let left_m = self.left_m();
        self.rest();
        if let Some(axis) = axis.filter(|_| left_m > 0.0) {
            // One command, which the robot carries out to its end whatever becomes of this component.
            let position = axis.map(|a| -a * left_m);
            self.move_cr.send(Pose { stamp: self.now, position, ..Pose::default() });
        }
    }

    /// The robot stands, and is not commanded any more.
    fn rest(&mut self) {
        self.hold.send(());
        self.set_guard.send(VirtualFixture::default());
        self.set_retreat.send(Retreat::default());
        self.enter(Phase::IDLE, self.now);
        self.progress.error = 0.0;
        self.line = None;
    }

    /// The end of the line has been reached, and its A-scans have arrived.
    pub(super) fn finish(&mut self, now: Stamp) {
        self.end_column();
        self.progress.columns = self.scan.filled() as u32;
        self.send_scan(now);
        self.enter(Phase::RETRACT, now);
    }

    /// The tip is as far away as it is wanted.
    pub(super) fn end(&mut self) {
        self.rest();
        self.tell_done();
    }

    /// The tip cannot be led away any more: it goes the rest of the way unseen, and the image is there all the same.
    pub(super) fn end_early(&mut self) {
        self.go_away();
        self.tell_done();
    }

    fn tell_done(&mut self) {
        let Progress { scan, of, columns, .. } = self.progress;
        self.bscan_done.emit(ScanDone { scan, columns: of, empty: of - columns });
    }
}

#[cfg(test)]
#[path = "ending_tests.rs"]
mod tests;
