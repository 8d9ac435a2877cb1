//! Drives turn commanded joint velocities into motion. The trait is the slot for hardware; `simulated` fills
//! it without any.
//!
//! Invariant: `cycle` is called once per control period from one thread and never blocks; after `make_safe`
//! the joints brake and stand whatever was commanded before.

mod simulated;

use std::fmt;

use crate::joints::Joints;

pub use simulated::{SimulatedDrive, Simulation};

/// Measurement of a drive at the end of a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Encoder positions, m or rad.
    pub position: Joints,
    /// Joint velocities, m/s or rad/s.
    pub velocity: Joints,
}

/// The motors and encoders of five joints.
pub trait Drive {
    /// One control period of `dt_s` seconds: commands joint velocities (m/s, rad/s) and measures.
    ///
    /// # Errors
    /// The device lost a joint; the arm stops and shows a CRTK fault.
    fn cycle(&mut self, velocity: &Joints, dt_s: f64) -> Result<Measured, Lost>;

    /// Brakes all joints from now on, as hard as they can, and holds them: without waiting for the next
    /// cycle, and without needing one. Cycles measure the braking; a velocity counts again when all joints
    /// stand.
    fn make_safe(&mut self);
}

/// A drive lost a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost {
    /// Index of the joint in `joints::NAMES`.
    pub joint: usize,
    /// Message of the device.
    pub why: &'static str,
}

impl fmt::Display for Lost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "drive of joint {}: {}", crate::joints::NAMES[self.joint], self.why)
    }
}
