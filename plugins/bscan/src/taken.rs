//! Time and place of an image's columns.
//!
//! Invariant: pose and distance of a column are those of one moment, that of its first A-scan, however late
//! either is told. A value that has no time, or one that is still to come, is not taken: it would make all
//! that follows too late.

use trocar_sdk::data::{Distance, Pose};
use trocar_sdk::prelude::*;

use crate::past::Past;
use crate::payloads::ScanColumn;

/// Poses and distances that are kept: 64 ms of 1000 and of 4000 in a second.
const POSES: usize = 64;
const DISTANCES: usize = 256;

/// Most that a time may lie ahead of the step that takes it, s: as far as the tip's time line can be asked.
pub const AHEAD_S: f64 = 0.005;

/// No tip and no surface is measured further away, m, or faster, m/s.
const MOST: f64 = 1000.0;

/// Can something have been told at `now` that was so at `stamp`?
pub fn can_be(stamp: Stamp, now: Stamp) -> bool {
    stamp.is_valid() && !stamp.is_ahead_of(now, AHEAD_S)
}

/// Readings of robot and tracker in the last moments.
#[derive(Clone, Debug, Default)]
pub struct Track {
    poses: Past<Pose, POSES>,
    distances: Past<Distance, DISTANCES>,
}

impl Track {
    /// Takes the tip's pose by the encoders, as it is told at `now`; false for a value that is no pose, or an
    /// impossible one.
    pub fn tip_at(&mut self, pose: Pose, now: Stamp) -> bool {
        let good = can_be(pose.stamp, now) && pose.position.iter().all(|p| p.abs() <= MOST);
        if good {
            self.poses.push(pose);
        }
        good
    }

    /// Takes the distance seen in one A-scan, as it is told at `now`; false if it cannot have been seen then.
    pub fn surface_at(&mut self, seen: Distance, now: Stamp) -> bool {
        // A velocity that is no number is not known.
        let moves = seen.velocity.is_nan() || seen.velocity.abs() <= MOST;
        let good = can_be(seen.stamp, now) && seen.distance.abs() <= MOST && moves;
        if good {
            self.distances.push(seen);
        }
        good
    }
}

/// The moment of a column's first A-scan.
#[derive(Clone, Copy, Debug, Default)]
pub struct Taken {
    stamp: Stamp,
    pose: Pose,
    distance_m: f64,
    /// Robot and tracker have told of this moment.
    complete: bool,
}

impl Taken {
    /// A column begins with the A-scan of `stamp`.
    pub fn begin(stamp: Stamp, track: &Track) -> Taken {
        let mut taken = Taken { stamp, ..Taken::default() };
        taken.complete(track);
        taken
    }

    /// An A-scan may be here before its distance is: asks again until that is told.
    pub fn complete(&mut self, track: &Track) {
        if self.complete {
            return;
        }
        self.complete = track.poses.knows(self.stamp) && track.distances.knows(self.stamp);
        self.pose = track.poses.at(self.stamp).unwrap_or_default();
        let seen = track.distances.at(self.stamp).filter(|seen| seen.valid.get());
        self.distance_m = seen.map_or(f64::NAN, |seen| seen.distance);
    }

    /// The column, when it has ended with `lines` A-scans.
    pub fn column(&self, scan: u64, column: u32, lines: u32) -> ScanColumn {
        ScanColumn { stamp: self.stamp, scan, column, lines, pose: self.pose, distance: self.distance_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(ns: u64, distance: f64) -> Distance {
        Distance { stamp: Stamp::from_ns(ns), distance, valid: true.into(), ..Distance::default() }
    }

    #[test]
    fn a_distance_that_comes_after_its_a_scan_is_the_columns_and_a_later_one_is_not() {
        let mut track = Track::default();
        let now = Stamp::from_ns(2_000_000);
        track.surface_at(seen(1_000_000, 1e-3), now);
        for ns in [500_000, 1_500_000] {
            track.tip_at(Pose { stamp: Stamp::from_ns(ns), ..Pose::default() }, now);
        }
        let mut taken = Taken::begin(Stamp::from_ns(1_250_000), &track);
        assert_eq!(taken.column(0, 0, 1).distance, 1e-3, "the last one until it is told");
        track.surface_at(seen(1_250_000, 2e-3), now);
        taken.complete(&track);
        track.surface_at(seen(1_500_000, 3e-3), now);
        taken.complete(&track);
        let column = taken.column(7, 3, 16);
        assert_eq!(
            (column.distance, column.stamp.ns(), column.pose.stamp.ns()),
            (2e-3, 1_250_000, 1_250_000)
        );
        assert_eq!((column.scan, column.column, column.lines), (7, 3, 16));
    }

    #[test]
    fn what_nobody_told_is_no_pose_and_no_distance() {
        let mut track = Track::default();
        let told = Pose { position: [f64::NAN; 3], stamp: Stamp::from_ns(5), ..Pose::default() };
        assert!(!track.tip_at(told, Stamp::from_ns(6)));
        let column = Taken::begin(Stamp::from_ns(5), &track).column(0, 0, 1);
        assert!(!column.pose.is_valid() && column.distance.is_nan() && column.stamp.ns() == 5);
    }

    #[test]
    fn what_is_still_to_come_is_not_taken_and_what_follows_it_is() {
        let now = Stamp::from_ns(1_000_000_000);
        for lie in [Stamp::INVALID, Stamp::from_ns(now.ns() + 5_000_001), Stamp::from_ns(u64::MAX)] {
            let mut track = Track::default();
            assert!(!track.surface_at(seen(lie.ns(), 1e-3), now), "{lie:?}");
            assert!(!track.tip_at(Pose { stamp: lie, ..Pose::default() }, now), "{lie:?}");
            assert!(track.surface_at(seen(now.ns(), 2e-3), now));
            assert!(track.tip_at(Pose { stamp: now, ..Pose::default() }, now));
            let column = Taken::begin(now, &track).column(0, 0, 1);
            assert_eq!((column.distance, column.pose.stamp), (2e-3, now), "{lie:?}");
        }
    }
}
