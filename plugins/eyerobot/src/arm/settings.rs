//! Settings of an arm: geometry, limits, gains and times.
//!
//! Invariant: plain values, the same from `new` on.

use crate::admittance::Law;
use crate::joints::{Joints, Limits, per_kind};
use crate::kinematics::Kinematics;

/// Settings of an arm, set once. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Geometry.
    pub kinematics: Kinematics,
    /// Limits of each joint.
    pub limits: Limits,
    /// Gain of the position loop around the drive's velocity loop, 1/s.
    pub gain_per_s: f64,
    /// A motion by velocity or force that is not repeated for this long is braked by the drive, s.
    pub servo_timeout_s: f64,
    /// Largest allowed distance between setpoint and encoder, m and rad.
    pub following: Joints,
    /// Most that an encoder may stand outside a limit before it is a fault, m and rad.
    pub margin: Joints,
    /// Hands-on control.
    pub law: Law,
    /// Place to which `home` brings the joints, m and rad.
    pub home: Joints,
}

impl Default for Settings {
    /// Tool of 120 mm; velocities are braked after 8 ms without a new one, so that from 5 mm/s the arm stands
    /// 20 ms after a client was lost; 31.25 /s is the critically damped gain around a lag of 8 ms; faults at
    /// 0.5 mm and 1° of following error, 0.1 mm and 0.1° outside a limit.
    fn default() -> Self {
        Settings {
            kinematics: Kinematics { tool_length_m: 0.12 },
            limits: Limits::default(),
            gain_per_s: 31.25,
            servo_timeout_s: 0.008,
            following: per_kind(0.5e-3, 1f64.to_radians()),
            margin: per_kind(0.1e-3, 0.1f64.to_radians()),
            law: Law::default(),
            home: Joints::zeros(),
        }
    }
}
