//! Why an arm went to FAULT, and why it did not take a command.
//!
//! Invariant: variants hold values, the sentences are made here: what was asked, what is wrong, what to do.

use std::fmt;

use trocar_sdk::GeometryError;
use trocar_sdk::crtk::{NotReady, OutOfTime, Refused};

use crate::drive::Lost;
use crate::fixture::FixtureRefused;
use crate::joints::{KINDS, NAMES, Refusal};
use crate::kinematics::Unreachable;

/// Why the arm went to FAULT. `joint` is an index into `joints::NAMES`; values in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// A joint left its limits.
    Limit {
        /// Which joint.
        joint: usize,
        /// Its position, m or rad.
        value: f64,
        /// The limit that it left, m or rad.
        limit: f64,
    },
    /// A joint does not follow its setpoint.
    Following {
        /// Which joint.
        joint: usize,
        /// Setpoint minus encoder, m or rad.
        error: f64,
        /// Largest one that is none, m or rad.
        limit: f64,
    },
    /// The drive lost a joint.
    Drive(Lost),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            // The payload has room for 128 bytes.
            Fault::Limit { joint, value, limit } => {
                let (name, unit) = (NAMES[joint], KINDS[joint].unit());
                write!(
                    f,
                    "joint {name} left its limit {limit:.6} {unit}, it is at {value:.6} {unit}: send \"enable\", then move_jp inside"
                )
            }
            Fault::Following { joint, error, limit } => {
                let (name, unit) = (NAMES[joint], KINDS[joint].unit());
                write!(
                    f,
                    "joint {name} is {error:.6} {unit} behind its setpoint, limit {limit:.6} {unit}: see what holds it, send \"enable\""
                )
            }
            Fault::Drive(lost) => lost.fmt(f),
        }
    }
}

/// Why the arm did not take a command; the running motion goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ArmError {
    /// Not enabled and homed.
    NotReady(NotReady),
    /// A command that lay in wait.
    OutOfTime(OutOfTime),
    /// A payload that is no geometry.
    Geometry(GeometryError),
    /// A joint goal outside what the joint may do.
    Joints(Refusal),
    /// A pose out of reach.
    Pose(Unreachable),
    /// A value above what the tip may do.
    Above {
        /// Quantity that is too large: "linear speed".
        what: &'static str,
        /// Its size.
        value: f64,
        /// Largest size that is taken.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// A gain of hands-on control that is negative, not finite, or too large.
    Gain {
        /// Place in x, y, z, about x, y, z.
        place: usize,
        /// Value that came.
        value: f64,
        /// Largest one that is taken.
        limit: f64,
    },
    /// A number of the retreat that is not finite, or not within its limits.
    Retreat {
        /// Which one: "distance".
        what: &'static str,
        /// Value that came.
        value: f64,
        /// Smallest one that is taken.
        least: f64,
        /// Largest one that is taken.
        limit: f64,
        /// Unit of value and limits.
        unit: &'static str,
    },
    /// A virtual fixture that cannot be.
    Fixture(FixtureRefused),
    /// A state command that is unknown or not allowed now.
    State(Refused),
}

macro_rules! from {
    ($($variant:ident($ty:ty);)*) => {$(
        impl From<$ty> for ArmError {
            fn from(why: $ty) -> Self {
                ArmError::$variant(why)
            }
        }
    )*};
}
from! {
    NotReady(NotReady);
    OutOfTime(OutOfTime);
    Geometry(GeometryError);
    Joints(Refusal);
    Pose(Unreachable);
    Fixture(FixtureRefused);
    State(Refused);
}

impl fmt::Display for ArmError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ArmError::NotReady(why) => why.fmt(f),
            ArmError::OutOfTime(why) => why.fmt(f),
            ArmError::Geometry(why) => why.fmt(f),
            ArmError::Joints(why) => why.fmt(f),
            ArmError::Pose(why) => why.fmt(f),
            ArmError::Above { what, value, limit, unit } => {
                write!(f, "{what} of the tip: {value} {unit} is above its limit of {limit} {unit}")
            }
            ArmError::Gain { place, value, limit } => {
                let unit = if *place < 3 { "m/(s·N)" } else { "rad/(s·N·m)" };
                write!(f, "gain[{place}]: {value} {unit} is outside 0 … {limit} {unit}")
            }
            ArmError::Retreat { what, value, least, limit, unit } => {
                write!(f, "{what} of the retreat: {value} {unit} is outside {least} … {limit} {unit}")
            }
            ArmError::Fixture(why) => why.fmt(f),
            ArmError::State(why) => why.fmt(f),
        }
    }
}

impl std::error::Error for ArmError {}
