//! Virtual fixtures: where the tip may go and how the tool may turn, as half-spaces of joint velocities.
//!
//! Invariant: a fixture only bounds velocities. While the arm stands inside, zero velocity is allowed, and a
//! bound on the way out falls with the distance that is left, so that the arm brakes before the border and
//! never needs to jump back. Frames are in the arm's kinematic base, SI units. Source: A. Kapoor, M. Li, R.
//! H. Taylor, ICRA 2006 (plane, line, remote centre of motion as linear constraints of one least-squares
//! problem).

use std::fmt;

use nalgebra::{Isometry3, SMatrix, Vector3};

use crate::joints::{COUNT, Joints};
use crate::kinematics::{Kinematics, tool_axis};
use crate::least_squares::HalfSpaces;

/// Most fixtures at a time.
pub const MOST_FIXTURES: usize = 8;

/// Stiffness where none is given, 1/s: from 10 mm/s the arm brakes with 0.2 m/s², less than its drives can.
pub const STIFFNESS_PER_S: f64 = 20.0;

/// Largest stiffness that is taken, 1/s: above it the arm's own lag lets the tip cross the border.
pub const STIFFEST_PER_S: f64 = 30.0;

/// Half of the width of lines and remote centres, m: less than a step of the encoders.
const SLACK_M: f64 = 0.2e-6;

/// Highest speed at which an arm outside comes back, m/s: faster than a retina moves with pulse and breath,
/// should a plane follow it.
const RETURN_M_S: f64 = 1e-3;

/// A fixture that the arm is further outside of than this is refused, m.
pub const FAR_M: f64 = 0.1e-3;

/// Constraint of a fixture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The tip stays on the side of the frame's xy plane to which z points.
    Plane,
    /// The tip stays on the frame's z axis.
    Line,
    /// The tool's shaft passes through the frame's origin (remote centre of motion).
    Rcm,
}

/// One fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fixture {
    /// Its constraint.
    pub kind: Kind,
    /// Its place, in the kinematic base of the arm, m.
    pub frame: Isometry3<f64>,
    /// The tip nears the border at most at this times the distance that is left, 1/s.
    pub stiffness_per_s: f64,
}

/// State of an arm, as fixtures see it.
#[derive(Clone, Copy, Debug)]
pub struct Stance {
    /// Pose of the tip.
    pub tip: Isometry3<f64>,
    /// Its Jacobian.
    pub jacobian: SMatrix<f64, 6, COUNT>,
    /// Direction of the tool.
    pub axis: Vector3<f64>,
}

impl Stance {
    /// Returns the stance of the arm with joints `q` (m, rad).
    pub fn of(kinematics: &Kinematics, q: &Joints) -> Stance {
        Stance { tip: kinematics.forward(q), jacobian: kinematics.jacobian(q), axis: tool_axis(q) }
    }

    fn tip_m(&self) -> Vector3<f64> {
        self.tip.translation.vector
    }

    /// Returns how much of a velocity along `direction` each joint gives to the tool's point `from_tip` (m)
    /// away from the tip.
    fn along(&self, direction: &Vector3<f64>, from_tip: &Vector3<f64>) -> Joints {
        let lever = from_tip.cross(direction);
        let rows = self.jacobian.fixed_rows::<3>(0).tr_mul(direction)
            + self.jacobian.fixed_rows::<3>(3).tr_mul(&lever);
        Joints::from_column_slice(rows.as_slice())
    }
}

impl Fixture {
    /// Returns the distance to the border, m: for a plane positive on the allowed side; for a line and a
    /// remote centre the distance of the tip or the shaft beside it, with a minus sign.
    pub fn distance_m(&self, at: &Stance) -> f64 {
        match self.kind {
            Kind::Plane => self.normal().dot(&(at.tip_m() - self.origin())),
            Kind::Line => {
                let off = at.tip_m() - self.origin();
                -(off - self.normal() * off.dot(&self.normal())).norm()
            }
            Kind::Rcm => -self.beside(at).0.norm(),
        }
    }

    /// Adds what this fixture allows to `set`. `at` is where the arm is sent, `measured` where it is: to a
    /// plane the nearer of both counts. `at_rest` arms are not made to come back from outside.
    pub fn restrict(&self, at: &Stance, measured: &Stance, at_rest: bool, set: &mut HalfSpaces) {
        let bound = |distance_m: f64| {
            let speed = (self.stiffness_per_s * distance_m).max(-RETURN_M_S);
            if at_rest { speed.max(0.0) } else { speed }
        };
        let mut band = |direction: Vector3<f64>, off_m: f64, from_tip: Vector3<f64>| {
            let row = at.along(&direction, &from_tip);
            set.push(row, bound(SLACK_M - off_m));
            set.push(-row, bound(SLACK_M + off_m));
        };
        match self.kind {
            Kind::Plane => {
                let distance_m = self.distance_m(at).min(self.distance_m(measured));
                set.push(-at.along(&self.normal(), &Vector3::zeros()), bound(distance_m));
            }
            Kind::Line => {
                let off = at.tip_m() - self.origin();
                for direction in [Vector3::x(), Vector3::y()].map(|side| self.frame.rotation * side) {
                    band(direction, off.dot(&direction), Vector3::zeros());
                }
            }
            Kind::Rcm => {
                let (off, from_tip) = self.beside(at);
                for direction in [Vector3::x(), Vector3::y()].map(|side| at.tip.rotation * side) {
                    band(direction, off.dot(&direction), from_tip);
                }
            }
        }
    }

    /// Tells whether it can be in force for an arm with this stance.
    fn fits(&self, place: usize, at: &Stance) -> Result<(), FixtureRefused> {
        let stiffness = self.stiffness_per_s;
        if !(stiffness > 0.0 && stiffness <= STIFFEST_PER_S) {
            return Err(FixtureRefused::Stiffness { place, stiffness });
        }
        let distance_m = self.distance_m(at);
        if distance_m < -FAR_M {
            return Err(FixtureRefused::Outside { place, kind: self.kind, distance_m });
        }
        Ok(())
    }

    fn origin(&self) -> Vector3<f64> {
        self.frame.translation.vector
    }

    fn normal(&self) -> Vector3<f64> {
        self.frame.rotation * Vector3::z()
    }

    /// From the origin to the nearest point of the shaft's line, and from the tip to that point, m.
    fn beside(&self, at: &Stance) -> (Vector3<f64>, Vector3<f64>) {
        let from_tip = at.axis * (self.origin() - at.tip_m()).dot(&at.axis);
        (at.tip_m() + from_tip - self.origin(), from_tip)
    }
}

/// The fixtures in force.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fixtures {
    all: [Option<Fixture>; MOST_FIXTURES],
    guard: Option<Fixture>,
    port: Option<Fixture>,
}

impl Fixtures {
    /// These fixtures, whose frames are those of `list` seen through `to_local`.
    ///
    /// # Errors
    /// More than there is room for, a stiffness out of its range, or one that the arm stands outside of: with
    /// the fixture's place in the list.
    pub fn checked<'a>(
        list: impl Iterator<Item = &'a Fixture>,
        to_local: &Isometry3<f64>,
        at: &Stance,
    ) -> Result<Fixtures, FixtureRefused> {
        let mut fixtures = Fixtures::default();
        for (place, fixture) in list.enumerate() {
            if place == MOST_FIXTURES {
                return Err(FixtureRefused::TooMany);
            }
            let fixture = Fixture { frame: to_local * fixture.frame, ..*fixture };
            fixture.fits(place, at)?;
            fixtures.all[place] = Some(fixture);
        }
        Ok(fixtures)
    }

    /// These fixtures unchecked, as they were in force before; what does not fit is left out.
    pub fn restored(list: impl Iterator<Item = Fixture>) -> Fixtures {
        let mut fixtures = Fixtures::default();
        for (place, fixture) in fixtures.all.iter_mut().zip(list) {
            *place = Some(fixture);
        }
        fixtures
    }

    /// The same with another guard, whose frame is seen through `to_local`.
    ///
    /// # Errors
    /// As [`Fixtures::checked`], as fixture 0.
    pub fn guarded(
        self,
        guard: Option<Fixture>,
        to_local: &Isometry3<f64>,
        at: &Stance,
    ) -> Result<Fixtures, FixtureRefused> {
        let guard = guard.map(|guard| Fixture { frame: to_local * guard.frame, ..guard });
        guard.map_or(Ok(()), |guard| guard.fits(0, at))?;
        Ok(self.with_guard(guard))
    }

    /// The same with this guard, unchecked.
    pub fn with_guard(self, guard: Option<Fixture>) -> Fixtures {
        Fixtures { guard, ..self }
    }

    /// The same list with guard and port of `before`.
    pub fn beside(self, before: &Fixtures) -> Fixtures {
        Fixtures { guard: before.guard, port: before.port, ..self }
    }

    /// The same with this remote centre, which no command takes away.
    pub fn with_port(self, port: Option<Fixture>) -> Fixtures {
        Fixtures { port, ..self }
    }

    /// The one that a controller moves, apart from the list.
    pub fn guard(&self) -> Option<&Fixture> {
        self.guard.as_ref()
    }

    /// The fixtures of the list in their order.
    pub fn listed(&self) -> impl Iterator<Item = &Fixture> {
        self.all.iter().flatten()
    }

    /// All of them, guard and port too.
    pub fn iter(&self) -> impl Iterator<Item = &Fixture> {
        self.listed().chain(&self.guard).chain(&self.port)
    }

    /// None is in force.
    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }

    /// A remote centre is in force: the tool turns as the tip's motion wants it.
    pub fn turn_the_tool(&self) -> bool {
        self.iter().any(|fixture| fixture.kind == Kind::Rcm)
    }
}

/// Why fixtures were not taken; those before stay in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixtureRefused {
    /// More than [`MOST_FIXTURES`].
    TooMany,
    /// Not a plane, a line or a remote centre.
    Kind {
        /// Place in the list, from 0.
        place: usize,
        /// Value that came.
        kind: u32,
    },
    /// Not above 0 and at most [`STIFFEST_PER_S`].
    Stiffness {
        /// Place in the list, from 0.
        place: usize,
        /// Value that came, 1/s.
        stiffness: f64,
    },
    /// The arm stands further than [`FAR_M`] outside of it.
    Outside {
        /// Place in the list, from 0.
        place: usize,
        /// Constraint that it would hold.
        kind: Kind,
        /// See [`Fixture::distance_m`].
        distance_m: f64,
    },
}

impl fmt::Display for FixtureRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FixtureRefused::TooMany => {
                write!(f, "more fixtures than there is room for: give {MOST_FIXTURES} at most")
            }
            FixtureRefused::Kind { place, kind } => {
                write!(f, "fixture {place}: kind {kind} is none; there are PLANE = 1, LINE = 2, RCM = 3")
            }
            FixtureRefused::Stiffness { place, stiffness } => write!(
                f,
                "fixture {place}: a stiffness of {stiffness} /s is outside 0 … {STIFFEST_PER_S} /s; 0 stands for {STIFFNESS_PER_S} /s"
            ),
            FixtureRefused::Outside { place, kind, distance_m } => {
                let what = match kind {
                    Kind::Plane => "the tip is beyond the plane",
                    Kind::Line => "the tip is beside the line",
                    Kind::Rcm => "the shaft passes beside the centre",
                };
                let (far, most) = (-distance_m * 1e3, FAR_M * 1e3);
                write!(f, "fixture {place}: {what} by {far:.3} mm; bring it within {most} mm first")
            }
        }
    }
}

impl std::error::Error for FixtureRefused {}

#[cfg(test)]
#[path = "fixture_tests.rs"]
mod tests;
