//! Where the tip was, at any time of the last moments.
//!
//! Invariant: between two poses it is between them; nothing is said of times before those that are kept, or long after them.

use trocar_sdk::data::Pose;
use trocar_sdk::prelude::*;

/// Poses that are kept.
const KEPT: usize = 64;
/// A time this much later than the last pose still has that, ns.
const LATEST_NS: u64 = 5_000_000;

/// The last poses of a tip.
#[derive(Clone, Debug)]
pub struct Poses {
    ring: [Pose; KEPT],
    count: usize,
    newest: usize,
}

impl Default for Poses {
    fn default() -> Poses {
        Poses { ring: [Pose::default(); KEPT], count: 0, newest: 0 }
    }
}

impl Poses {
    /// Adds a pose; one that is not later than the last one is left out.
    pub fn push(&mut self, pose: Pose) {
        if self.count > 0 && pose.stamp <= self.ring[self.newest].stamp {
            return;
        }
        self.newest = (self.newest + 1) % KEPT;
        self.ring[self.newest] = pose;
        self.count = (self.count + 1).min(KEPT);
    }

    /// The pose at `stamp`, and with that stamp; with stamp 0 where it is not known.
    pub fn at(&self, stamp: Stamp) -> Pose {
        let back = |n: usize| &self.ring[(self.newest + KEPT - n) % KEPT];
        if self.count > 0 && stamp >= back(0).stamp {
            let known = stamp.ns() - back(0).stamp.ns() <= LATEST_NS;
            return if known { Pose { stamp, ..*back(0) } } else { Pose::default() };
        }
        for n in 1..self.count {
            let (early, late) = (back(n), back(n - 1));
            if stamp >= early.stamp {
                let span_ns = late.stamp.ns() - early.stamp.ns();
                let part = (stamp.ns() - early.stamp.ns()) as f64 / span_ns as f64;
                return between(early, late, part, stamp);
            }
        }
        Pose::default()
    }
}

/// The pose `part` of the way from one to the next.
fn between(early: &Pose, late: &Pose, part: f64, stamp: Stamp) -> Pose {
    let mix = |a: f64, b: f64| a + part * (b - a);
    // q and −q are one turn: the nearer of both, and along the chord, which a millisecond does not tell from the arc.
    let dot: f64 = (0..4).map(|i| early.orientation[i] * late.orientation[i]).sum();
    let side = if dot < 0.0 { -1.0 } else { 1.0 };
    let turn = [0, 1, 2, 3].map(|i| mix(early.orientation[i], side * late.orientation[i]));
    let length = turn.iter().map(|q| q * q).sum::<f64>().sqrt();
    let orientation = if length > 0.5 { turn.map(|q| q / length) } else { late.orientation };
    Pose { stamp, position: [0, 1, 2].map(|i| mix(early.position[i], late.position[i])), orientation }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(ns: u64, x: f64, orientation: [f64; 4]) -> Pose {
        Pose { stamp: Stamp::from_ns(ns), position: [x, 0.0, 1.0], orientation }
    }

    #[test]
    fn between_two_poses_it_is_between_them_and_elsewhere_not_known() {
        let mut poses = Poses::default();
        assert!(!poses.at(Stamp::from_ns(5)).is_valid());
        let half = std::f64::consts::FRAC_1_SQRT_2;
        poses.push(pose(1_000_000, 1.0, [0.0, 0.0, 0.0, 1.0]));
        // A quarter turn about x, written as its negative.
        poses.push(pose(2_000_000, 2.0, [-half, 0.0, 0.0, -half]));
        poses.push(pose(2_000_000, 9.0, [0.0, 0.0, 0.0, 1.0]));
        let middle = poses.at(Stamp::from_ns(1_500_000));
        assert_eq!((middle.stamp.ns(), middle.position), (1_500_000, [1.5, 0.0, 1.0]));
        let eighth = std::f64::consts::PI / 8.0;
        assert!((middle.orientation[0] - eighth.sin()).abs() < 1e-12, "{middle:?}");
        assert!((middle.orientation[3] - eighth.cos()).abs() < 1e-12, "{middle:?}");
        assert_eq!(poses.at(Stamp::from_ns(7_000_000)).position[0], 2.0);
        assert!(
            !poses.at(Stamp::from_ns(7_000_001)).is_valid() && !poses.at(Stamp::from_ns(999_999)).is_valid()
        );
    }
}
