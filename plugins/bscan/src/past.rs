//! Values of the last moments: the place of the tip, and the distance of the surface.
//!
//! Invariant: a value between two others lies between them; times before those that are kept, or long after
//! them, have no value.

use trocar_sdk::data::{Distance, Pose};
use trocar_sdk::prelude::*;

/// A time this much later than the last value still has that, ns.
const LATEST_NS: u64 = 5_000_000;

/// A value of one moment.
pub trait Told: Copy + Default {
    /// Returns its time.
    fn stamp(&self) -> Stamp;
    /// Returns the value at `stamp`, `part` of the way from `self` to `late`.
    fn towards(&self, late: &Self, part: f64, stamp: Stamp) -> Self;
    /// Returns the value at a later `stamp`, for which none was told.
    fn kept_until(&self, stamp: Stamp) -> Self;
}

impl Told for Pose {
    fn stamp(&self) -> Stamp {
        self.stamp
    }

    fn towards(&self, late: &Pose, part: f64, stamp: Stamp) -> Pose {
        // q and −q are one turn: the nearer of both is taken, and along the chord, which within a millisecond
        // does not differ from the arc.
        let dot: f64 = (0..4).map(|i| self.orientation[i] * late.orientation[i]).sum();
        let side = if dot < 0.0 { -1.0 } else { 1.0 };
        let turn = [0, 1, 2, 3].map(|i| mix(self.orientation[i], side * late.orientation[i], part));
        let length = turn.iter().map(|q| q * q).sum::<f64>().sqrt();
        let orientation = if length > 0.5 { turn.map(|q| q / length) } else { late.orientation };
        let position = [0, 1, 2].map(|i| mix(self.position[i], late.position[i], part));
        Pose { stamp, position, orientation }
    }

    fn kept_until(&self, stamp: Stamp) -> Pose {
        Pose { stamp, ..*self }
    }
}

impl Told for Distance {
    fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Between a distance and none is none.
    fn towards(&self, late: &Distance, part: f64, stamp: Stamp) -> Distance {
        let valid = self.valid.get() && late.valid.get();
        let distance = mix(self.distance, late.distance, part);
        Distance { stamp, distance, valid: valid.into(), ..*self }
    }

    fn kept_until(&self, stamp: Stamp) -> Distance {
        Distance { stamp, ..*self }
    }
}

fn mix(a: f64, b: f64, part: f64) -> f64 {
    a + part * (b - a)
}

/// The last `KEPT` values.
#[derive(Clone, Debug)]
pub struct Past<T, const KEPT: usize> {
    ring: [T; KEPT],
    count: usize,
    newest: usize,
}

impl<T: Told, const KEPT: usize> Default for Past<T, KEPT> {
    fn default() -> Self {
        Past { ring: [T::default(); KEPT], count: 0, newest: 0 }
    }
}

impl<T: Told, const KEPT: usize> Past<T, KEPT> {
    /// Adds a value; one that is not later than the last one is left out.
    pub fn push(&mut self, value: T) {
        if self.knows(value.stamp()) {
            return;
        }
        self.newest = (self.newest + 1) % KEPT;
        self.ring[self.newest] = value;
        self.count = (self.count + 1).min(KEPT);
    }

    /// Something was told of this moment or of a later one.
    pub fn knows(&self, stamp: Stamp) -> bool {
        self.count > 0 && stamp <= self.ring[self.newest].stamp()
    }

    /// Returns the value at `stamp`; none if it is not known.
    pub fn at(&self, stamp: Stamp) -> Option<T> {
        let back = |n: usize| &self.ring[(self.newest + KEPT - n) % KEPT];
        if self.count > 0 && stamp > back(0).stamp() {
            let known = stamp.ns() - back(0).stamp().ns() <= LATEST_NS;
            return known.then(|| back(0).kept_until(stamp));
        }
        for n in 0..self.count {
            let early = back(n);
            if stamp == early.stamp() {
                return Some(*early);
            }
            if stamp > early.stamp() {
                let late = back(n - 1);
                let span_ns = late.stamp().ns() - early.stamp().ns();
                let part = (stamp.ns() - early.stamp().ns()) as f64 / span_ns as f64;
                return Some(early.towards(late, part, stamp));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn pose(ns: u64, x: f64, orientation: [f64; 4]) -> Pose {
        Pose { stamp: Stamp::from_ns(ns), position: [x, 0.0, 1.0], orientation }
    }

    fn distance(ns: u64, distance: f64, valid: bool) -> Distance {
        Distance { stamp: Stamp::from_ns(ns), distance, valid: valid.into(), ..Distance::default() }
    }

    #[test]
    fn between_two_poses_it_is_between_them_and_elsewhere_not_known() {
        let mut poses = Past::<Pose, 64>::default();
        assert_eq!(poses.at(Stamp::from_ns(5)), None);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        poses.push(pose(1_000_000, 1.0, [0.0, 0.0, 0.0, 1.0]));
        // A quarter turn about x, written as its negative.
        poses.push(pose(2_000_000, 2.0, [-half, 0.0, 0.0, -half]));
        poses.push(pose(2_000_000, 9.0, [0.0, 0.0, 0.0, 1.0]));
        let middle = poses.at(Stamp::from_ns(1_500_000)).unwrap();
        assert_eq!((middle.stamp.ns(), middle.position), (1_500_000, [1.5, 0.0, 1.0]));
        let eighth = std::f64::consts::PI / 8.0;
        assert!((middle.orientation[0] - eighth.sin()).abs() < 1e-12, "{middle:?}");
        assert!((middle.orientation[3] - eighth.cos()).abs() < 1e-12, "{middle:?}");
        assert_eq!(poses.at(Stamp::from_ns(7_000_000)).unwrap().position[0], 2.0);
        assert_eq!(poses.at(Stamp::from_ns(7_000_001)), None);
        assert_eq!(poses.at(Stamp::from_ns(999_999)), None);
    }

    #[test]
    fn only_as_many_as_are_kept_are_known() {
        let mut poses = Past::<Pose, 4>::default();
        (1..=6).for_each(|n| poses.push(pose(n, n as f64, [0.0, 0.0, 0.0, 1.0])));
        assert_eq!(poses.at(Stamp::from_ns(2)), None);
        assert!((3..=6).all(|n| poses.at(Stamp::from_ns(n)).unwrap().position[0] == n as f64));
        assert!(poses.knows(Stamp::from_ns(6)) && !poses.knows(Stamp::from_ns(7)));
    }

    #[test]
    fn between_a_distance_and_none_is_none_and_at_its_own_time_each_is_what_was_told() {
        let mut distances = Past::<Distance, 8>::default();
        distances.push(distance(100, 1e-3, true));
        distances.push(distance(200, 2e-3, true));
        distances.push(distance(300, 0.0, false));
        let at = |ns| {
            let told = distances.at(Stamp::from_ns(ns)).unwrap();
            told.valid.get().then_some(told.distance)
        };
        assert_eq!([at(100), at(150), at(200)], [Some(1e-3), Some(1.5e-3), Some(2e-3)]);
        assert_eq!([at(250), at(300), at(310)], [None; 3]);
    }
}
