//! The motors, simulated: each joint follows its setpoint within some steps.
//!
//! CHANGE THIS: `exchange` sends the setpoint to the device and gives what its encoders say. Each step
//! calls it, so it must not wait. Open a device in `start`, never before.

use crate::Joints;

/// Part of the way to the setpoint that a joint goes in a step.
const FOLLOWS: f64 = 0.5;

#[derive(Clone, Copy, Default)]
pub(crate) struct Drive {
    /// m
    at: Joints,
}

impl Drive {
    /// Sends the setpoint, and gives where the joints are (m).
    pub(crate) fn exchange(&mut self, setpoint: &Joints) -> Joints {
        for (at, to) in self.at.iter_mut().zip(setpoint) {
            *at += FOLLOWS * (to - *at);
        }
        self.at
    }

    /// Stops at once; a real drive closes its brakes here.
    pub(crate) fn brake(&mut self) {}
}
