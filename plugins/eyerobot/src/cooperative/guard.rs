//! The plane behind which a led tip stays: it follows the retina while that is seen, and is careful while it
//! is not.
//!
//! Invariant: pure arithmetic on its inputs. The plane comes towards the tip at once and goes away slowly, so
//! that one wrong distance (a deeper layer in the place of the surface) does not open the way. Units m and s,
//! everything in the robot's base frame.

use trocar_oct_core::tip::{TipTravel, axis_of};
use trocar_sdk::data::{Distance, FixtureKind, Pose, VirtualFixture};
use trocar_sdk::prelude::*;

use super::FURTHEST_M;
use crate::fixture::STIFFEST_PER_S;

/// A surface that was not seen for this long is not seen, s.
const LOST_S: f64 = 0.05;
/// The plane goes away from the tip at most so fast, m/s: as fast as a retina moves with pulse and breath and
/// falls off under a led tip.
const AWAY_M_S: f64 = 1e-3;
/// No surface moves faster by itself, m/s.
const FASTEST_M_S: f64 = 2e-3;
/// While the surface is not seen the plane rises by this part of the way to the side: a globe of 12 mm does
/// so 6 mm beside its apex.
const RISE: f64 = 0.5;
/// A tool that leans further from z than by 60° is not led: what it sees is not below it.
const LEAST_COSINE: f64 = 0.5;
/// The tip may be this far beyond the plane when that is set, m: the robot refuses planes further away, and
/// brings the tip back slowly.
const BEYOND_M: f64 = 50e-6;

/// Settings of the guard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    /// From the plane to the surface, m.
    pub(super) min_distance_m: f64,
    /// z of the plane while no surface was seen, m.
    pub(super) lowest_z_m: f64,
}

/// Knowledge of tip and surface.
#[derive(Clone, Debug, Default)]
pub(super) struct Guard {
    travel: TipTravel,
    pose: Pose,
    seen: Option<Seen>,
    /// Place of the plane on the tool's axis when it was last computed from a surface or a cone.
    border: Option<Border>,
    /// Place of the plane on the tool's axis when the surface was lost, m.
    lost: Option<[f64; 3]>,
}

/// The surface, in travel of the tip.
#[derive(Clone, Copy, Debug)]
struct Seen {
    stamp: Stamp,
    surface_m: f64,
    velocity_m_s: f64,
}

/// The plane, in travel of the tip.
#[derive(Clone, Copy, Debug)]
struct Border {
    stamp: Stamp,
    at_m: f64,
}

impl Guard {
    /// The robot's tip; poses have to come in their order.
    pub(super) fn tip_at(&mut self, pose: &Pose) {
        if self.travel.push(pose.stamp.ns(), pose.position, &pose.orientation) {
            self.pose = *pose;
        }
    }

    /// Takes a distance from the tip to the surface; one that is not valid or of a time without poses says
    /// nothing.
    pub(super) fn distance(&mut self, told: &Distance) {
        let is_one = told.valid.get() && told.distance > 0.0 && told.distance <= FURTHEST_M;
        let Some(travel_m) = self.travel.at(told.stamp.ns()).filter(|_| is_one) else { return };
        let velocity_m_s =
            if told.velocity.is_finite() { told.velocity.clamp(-FASTEST_M_S, FASTEST_M_S) } else { 0.0 };
        self.seen = Some(Seen { stamp: told.stamp, surface_m: travel_m + told.distance, velocity_m_s });
    }

    /// The surface was seen lately.
    pub(super) fn is_seen(&self, now: Stamp) -> bool {
        self.seen.is_some_and(|seen| now.seconds_since(seen.stamp).abs() <= LOST_S)
    }

    /// Returns the plane for this moment, and how far below the tip it lies, m; none if nothing says where it
    /// should be. It lies across z, as the retina does on the whole: under a tool that leans, one across the
    /// tool would let the tip go aside into it.
    pub(super) fn plane(&mut self, now: Stamp, bounds: &Bounds) -> Option<(VirtualFixture, f64)> {
        let axis = axis_of(&self.pose.orientation).filter(|axis| axis[2] > LEAST_COSINE)?;
        let travel_m = self.travel.at(self.pose.stamp.ns())?;
        if let Some(seen) = self.seen.filter(|_| self.is_seen(now)) {
            let surface_m = seen.surface_m + seen.velocity_m_s * now.seconds_since(seen.stamp).max(0.0);
            let mut at_m = surface_m - bounds.min_distance_m;
            if let Some(before) = self.border {
                at_m = at_m.min(before.at_m + AWAY_M_S * now.seconds_since(before.stamp).max(0.0));
            }
            self.border = Some(Border { stamp: now, at_m });
            self.lost = None;
            return Some(self.across_z(axis[2] * (at_m - travel_m)));
        }
        let lowest_m = bounds.lowest_z_m - self.pose.position[2];
        let Some(border) = self.border else {
            // Nothing is driven out of what was never seen: the tip has to be above the plane.
            return (lowest_m >= -BEYOND_M).then(|| self.across_z(lowest_m));
        };
        let apex = *self.lost.get_or_insert_with(|| {
            let before_m = border.at_m - travel_m;
            [0, 1, 2].map(|i| self.pose.position[i] + axis[i] * before_m)
        });
        let [x, y, z] = [0, 1, 2].map(|i| self.pose.position[i] - apex[i]);
        let below_m = -z - RISE * x.hypot(y);
        self.border = Some(Border { stamp: now, at_m: (travel_m + below_m / axis[2]).min(border.at_m) });
        // Both are safe, so the deeper one will do.
        Some(self.across_z(below_m.max(lowest_m)))
    }

    fn across_z(&self, below_m: f64) -> (VirtualFixture, f64) {
        let [x, y, z] = self.pose.position;
        let position = [x, y, z + below_m.max(-BEYOND_M)];
        // Half a turn about x: the allowed side is where z points.
        let frame = Pose { stamp: self.pose.stamp, position, orientation: [1.0, 0.0, 0.0, 0.0] };
        let kind = FixtureKind::PLANE;
        (VirtualFixture { kind, reserved: 0, frame, stiffness: STIFFEST_PER_S }, below_m)
    }
}
