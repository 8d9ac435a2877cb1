//! The CRTK convention: names of commands and events, and the operating state of a device.
//!
//! Invariant: names are spelt exactly as the convention spells them, so that tools of other frameworks find
//! them. Source: A. Su et al., "Collaborative Robotics Toolkit (CRTK): Open Software Framework for Surgical
//! Robotics Research", IEEE IRC 2020, and its API document; `measured_cs` and `configuration_js` are younger
//! additions of its reference robots.
//!
//! A name is `level_space+type`: level `measured`, `setpoint`, `goal` to ask, `servo` (direct, high rate),
//! `interpolate` (pre-emptive, low rate), `move` (a trajectory, watch `is_busy`) to move; space `j`oint or
//! `c`artesian; type `s`tate, `p`osition, `r`elative position, `v`elocity, `f`orce. Frames other than the
//! base are interfaces of their own: `local`, `spatial`, `body`, `compliance`.

mod in_time;
mod names;
mod operating;

pub use in_time::{OutOfTime, require_in_time};
pub use names::*;
pub use operating::{NotReady, OperatingStateMachine, Refused, STATE_COMMANDS, StateCommand};
