//! Phases of a scan, and its end.
//!
//! Invariant: every way out ends with `hold`, without guard and retreat, and is told by exactly one event,
//! which says what of it the robot did not take at once.

use std::io::Write;

use trocar_oct_core::tip::{along, axis_of};
use trocar_sdk::data::{Pose, Retreat, VirtualFixture};
use trocar_sdk::prelude::*;

use super::{BScan, ROBOT_LOST_S, is_ready};
use crate::payloads::{Phase, Progress, ScanDone};

/// Time for which commands that the robot did not take are sent again, s: as long as its last velocity can go
/// on. Later another client may lead it.
const AGAIN_S: f64 = 0.02;
/// Share of the way back by which the tip counts as gone: the way begins at the setpoint, and a tip that
/// moves is not there.
const DONE: f64 = 0.8;

/// Commands at the end of a scan that the robot has not taken.
#[derive(Clone, Copy, Default)]
pub(super) struct Owed {
    hold: bool,
    away: Option<Pose>,
}

impl Owed {
    fn said(&self) -> &'static str {
        match (self.hold, self.away.is_some()) {
            (false, false) => "",
            (true, false) => "; hold was not taken",
            (false, true) => "; move_cr was not taken",
            (true, true) => "; hold and move_cr were not taken",
        }
    }
}

impl BScan {
    pub(super) fn enter(&mut self, phase: Phase, now: Stamp) {
        self.progress.phase = phase;
        self.since.phase = now;
        (self.since.near, self.since.end) = (Stamp::INVALID, Stamp::INVALID);
    }

    /// Ends a scan before its end.
    pub(super) fn give_up(&mut self, why: &str) {
        if self.progress.phase == Phase::IDLE {
            return;
        }
        self.go_away();
        self.bscan_aborted.emit(joined(why, self.owed.said()));
    }

    /// The robot is not led any more, and goes the rest of the way back.
    fn go_away(&mut self) {
        let told = self.now.seconds_since(self.since.robot) <= ROBOT_LOST_S;
        let axis = axis_of(&self.pose.orientation).filter(|_| told && is_ready(&self.robot));
        let left_m = self.left_m();
        // One command, which the robot carries out to its end whatever becomes of this component.
        let away = axis.filter(|_| left_m > 0.0).map(|axis| Pose {
            stamp: self.now,
            position: axis.map(|a| -a * left_m),
            ..Pose::default()
        });
        self.rest(away);
        (self.from_m, self.way_m) = (self.pose.position, left_m);
        self.progress.stranded = (left_m > 0.0).into();
    }

    /// Checks whether the tip has been brought away after all, by its encoders: a robot on another thread
    /// takes what it may refuse later.
    pub(super) fn mind_the_way(&mut self) {
        if !self.progress.stranded.get() {
            return;
        }
        let back = [0, 1, 2].map(|i| self.from_m[i] - self.pose.position[i]);
        let gone_m = axis_of(&self.pose.orientation).map_or(0.0, |axis| along(&back, &axis));
        self.progress.stranded = (gone_m < DONE * self.way_m).into();
    }

    /// The robot stands, or goes `away` from there, and is not commanded any more.
    fn rest(&mut self, away: Option<Pose>) {
        self.ask(Owed { hold: true, away });
        let taken = self.set_guard.send(VirtualFixture::default());
        self.count(taken);
        let taken = self.set_retreat.send(Retreat::default());
        self.count(taken);
        self.enter(Phase::IDLE, self.now);
        self.progress.error = 0.0;
        self.line = None;
    }

    /// The end of the line has been reached, and its A-scans have arrived or were waited for.
    pub(super) fn finish(&mut self, now: Stamp) {
        self.end_column();
        self.progress.columns = self.scan.filled() as u32;
        self.send_last();
        self.enter(Phase::RETRACT, now);
    }

    /// The tip is as far away as it is wanted.
    pub(super) fn end(&mut self) {
        self.rest(None);
        self.tell_done();
    }

    /// Counts a command that the robot did not take; if nothing is connected, nothing refuses it. Tells
    /// whether it was taken.
    pub(super) fn count(&mut self, outcome: Outcome) -> bool {
        self.progress.refused += u64::from(!outcome.is_ok() && outcome != Outcome::Unbound);
        outcome.is_ok()
    }

    /// Asks the robot to hold, and then to go away; a command that is not taken stays owed. A way that is
    /// taken needs no hold, which would end it.
    fn ask(&mut self, owed: Owed) {
        let outcome = owed.hold.then(|| self.hold.send(()));
        let held = outcome.is_none_or(|outcome| self.count(outcome));
        let outcome = owed.away.map(|away| self.move_cr.send(away));
        let gone = outcome.is_some_and(|outcome| self.count(outcome));
        self.owed = Owed { hold: !held && !gone, away: owed.away.filter(|_| !gone) };
    }

    /// Sends once more what the robot did not take at the end of the scan.
    pub(super) fn settle(&mut self) {
        let owed = self.owed;
        if !owed.hold && owed.away.is_none() {
            return;
        }
        if self.progress.phase != Phase::IDLE || self.now.seconds_since(self.since.phase) > AGAIN_S {
            self.owed = Owed::default();
            return;
        }
        self.ask(owed);
    }

    /// Ends a scan whose tip cannot be led away any more: it goes the rest of the way unseen, and the image
    /// counts all the same.
    pub(super) fn end_early(&mut self) {
        self.go_away();
        self.tell_done();
    }

    fn tell_done(&mut self) {
        let Progress { scan, of, columns, .. } = self.progress;
        self.bscan_done.emit(ScanDone { scan, columns: of, empty: of - columns });
    }
}

/// Two texts as one, without allocating.
fn joined(first: &str, second: &str) -> Text<128> {
    let mut bytes = [0; 128];
    let mut room = &mut bytes[..];
    // Text that does not fit is cut.
    _ = write!(room, "{first}{second}");
    let left = room.len();
    Text::new(str::from_utf8(&bytes[..128 - left]).unwrap_or(first))
}

#[cfg(test)]
#[path = "ending_tests.rs"]
mod tests;
