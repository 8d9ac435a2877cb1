//! Payloads of trackers, force sensors and input devices.
//!
//! Invariant: a part that is not seen or not there keeps stamp 0 or is absent from its list; nobody reads an
//! old value as a new one.
#![allow(
    missing_docs,
    reason = "the docs of fields go into every manifest: a field has one where name, type and unit do not say it all"
)]

use crate as trocar_sdk;
use trocar_sdk::data::Pose;
use trocar_sdk::{Flag, List, Payload, Stamp, Text, named_values};

/// Most tools of one `TrackedTools`.
pub const MAX_TOOLS: usize = 8;
/// Most axes of one `InputState`.
pub const MAX_AXES: usize = 16;
/// Most buttons of one `InputState`.
pub const MAX_BUTTONS: usize = 32;

named_values! {
    /// State of a tool as a tracker knows it.
    pub struct ToolStatus: u32 {
        /// Not in view; its pose is not valid.
        MISSING = 0,
        /// Measured.
        TRACKED = 1,
        /// Measured with some of its markers hidden: less exact than `error` promises.
        PARTLY_HIDDEN = 2,
        /// At the border of the measuring volume.
        AT_BORDER = 3,
    }
}

/// One tool as a tracker sees it.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ToolPose {
    /// The tool's name, as configured.
    pub tool: Text<16>,
    /// In the tracker's own frame; stamp 0 when the tool is not in view.
    pub pose: Pose,
    /// Root mean square distance of the markers from where the pose puts them.
    #[unit("m")]
    pub error: f64,
    pub status: ToolStatus,
    pub reserved: u32,
}

/// All tools of one measurement.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct TrackedTools {
    /// When the tracker measured.
    pub stamp: Stamp,
    /// Counts the tracker's measurements, from 0.
    pub index: u64,
    pub tools: List<ToolPose, MAX_TOOLS>,
}

impl TrackedTools {
    /// The pose of a named tool; none when it is not in view.
    pub fn pose(&self, tool: &str) -> Option<&Pose> {
        self.tools.iter().find(|t| t.tool == tool).map(|t| &t.pose).filter(|pose| pose.stamp.is_valid())
    }
}

/// What a force sensor can measure (`range`), each component to both sides; 0 = does not measure it.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ForceRange {
    #[unit("N")]
    pub force: [f64; 3],
    #[unit("N.m")]
    pub torque: [f64; 3],
    /// Standard deviation of one sample's force.
    #[unit("N")]
    pub force_noise: f64,
    /// Standard deviation of one sample's torque.
    #[unit("N.m")]
    pub torque_noise: f64,
    #[unit("Hz")]
    pub rate: f64,
}

/// Axes and buttons of an input device: pedal, joystick, gamepad.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct InputState {
    pub stamp: Stamp,
    /// -1 to 1, a pedal 0 to 1; 0 at rest.
    pub axes: List<f64, MAX_AXES>,
    /// True while pressed.
    pub buttons: List<Flag, MAX_BUTTONS>,
    /// The device answers; when it does not, every axis is 0 and no button is pressed.
    pub connected: Flag,
    pub reserved: [u8; 7],
}

/// A button of an input device changed.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct ButtonEvent {
    pub stamp: Stamp,
    /// Position in `InputState::buttons`.
    pub button: u32,
    pub pressed: Flag,
    pub reserved: [u8; 3],
}

/// Names of an input device's axes and buttons, in the order of `InputState`.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct InputLayout {
    pub axes: List<Text<16>, MAX_AXES>,
    pub buttons: List<Text<16>, MAX_BUTTONS>,
}
