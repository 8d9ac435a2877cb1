//! Behaviours of the demo: for each one a system file, and the calls to the running system.
//!
//! Invariant: a behaviour is an ordinary system file of three processes and ordinary calls; the layout
//! decides how many processes there are.

use clap::ValueEnum;
use serde_json::{Value, json};

use super::layout::Layout;

/// Tasks of the surgeon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Behavior {
    /// The tool in a hand, without a robot.
    FreeHand,
    /// A hand leads the tool through the robot.
    Cooperative,
    /// The robot goes along a line at a constant distance from the retina.
    Bscan,
}

/// A call of a command.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ask {
    pub(super) path: String,
    pub(super) arg: Value,
}

/// A picture the running system can write.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Picture {
    /// The command that writes it.
    pub(super) save: String,
    /// Name of the picture's file.
    pub(super) name: &'static str,
}

/// Paths by which a scan is started and observed.
pub(super) struct Scanning {
    /// Start commands, there and back.
    pub(super) starts: [Ask; 2],
    pub(super) progress: String,
    /// Path of the ground truth.
    pub(super) truth: String,
    /// Distance from the tip to the surface, m.
    pub(super) offset_m: f64,
}

/// 500 µm above the retina.
const OFFSET_M: f64 = 500e-6;
/// 3 mm across the fovea.
const HALF_LINE_M: f64 = 1.5e-3;
/// Position of the retina's apex in the robot's base frame: its tool and the standoff at home above z = 0, m.
const APEX_Z_M: f64 = 0.121;

impl Behavior {
    pub(super) fn name(self) -> &'static str {
        match self {
            Behavior::FreeHand => "free-hand",
            Behavior::Cooperative => "cooperative",
            Behavior::Bscan => "bscan",
        }
    }

    /// Returns its system file.
    pub(super) fn system(self) -> &'static str {
        match self {
            Behavior::FreeHand => include_str!("../../../demo/free-hand.json"),
            Behavior::Cooperative => include_str!("../../../demo/cooperative.json"),
            Behavior::Bscan => include_str!("../../../demo/bscan.json"),
        }
    }

    /// The component at 1 kHz that says where the tool is.
    pub(super) fn leader(self) -> &'static str {
        match self {
            Behavior::FreeHand => "hand/hand",
            Behavior::Cooperative | Behavior::Bscan => "robot/robot",
        }
    }

    /// The component that commands the robot; none where there is no robot.
    pub(super) fn commander(self) -> Option<&'static str> {
        match self {
            Behavior::FreeHand => None,
            Behavior::Cooperative => Some("host/lead"),
            Behavior::Bscan => Some("host/bscan"),
        }
    }

    /// Returns a command of the leader, for the user to try.
    pub(super) fn command(self) -> &'static str {
        match self {
            Behavior::FreeHand => "truth/measured_cp",
            Behavior::Cooperative | Behavior::Bscan => "arm/measured_js",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Behavior::FreeHand => "FREE HAND",
            Behavior::Cooperative => "COOPERATIVE CONTROL",
            Behavior::Bscan => "ROBOT-ASSISTED B-SCAN",
        }
    }

    /// Returns the calls that are made once when the system is up.
    pub(super) fn begin(self, layout: Layout) -> Vec<Ask> {
        let all =
            [text(0, self.title(), 24, [255, 255, 255, 255]), text(1, "SIMULATED", 16, [255, 200, 80, 255])];
        all.into_iter().map(|ask| Ask { path: layout.place(&ask.path), ..ask }).collect()
    }

    /// The scan that is made again and again.
    pub(super) fn scanning(self, layout: Layout) -> Option<Scanning> {
        let start = |from: f64, to: f64| Ask {
            path: layout.place("host/bscan/scan/start"),
            arg: json!({ "from": [from, 0, APEX_Z_M], "to": [to, 0, APEX_Z_M], "width": 0, "angle": 0, "speed": 5e-4,
                         "offset": OFFSET_M, "pitch": 6e-6 }),
        };
        (self == Behavior::Bscan).then(|| Scanning {
            starts: [start(-HALF_LINE_M, HALF_LINE_M), start(HALF_LINE_M, -HALF_LINE_M)],
            progress: layout.place("host/bscan/scan/progress"),
            truth: layout.place("oct/source/truth/distance"),
            offset_m: OFFSET_M,
        })
    }

    /// Returns the pictures of the behaviour.
    pub(super) fn pictures(self, layout: Layout) -> Vec<Picture> {
        let of =
            |component: &str, name| Picture { save: layout.place(&format!("{component}/ctl/save")), name };
        vec![
            // First, as its time goes on.
            of("host/tracking", "demo-tracking.png"),
            of("host/console", "demo.png"),
            of("host/oct_image", if self == Behavior::Bscan { "demo-bscan.png" } else { "demo-mscan.png" }),
            of("host/depth_map", "demo-depth.png"),
        ]
    }
}

/// A line of text at the upper edge of the picture.
fn text(item: u32, text: &str, size: u32, color: [u8; 4]) -> Ask {
    let y = if item == 0 { 12 } else { 36 };
    Ask {
        path: "host/overlay/items/set_text".to_owned(),
        arg: json!({ "text": text, "item": item, "x": 16, "y": y, "size": size, "color": color, "eye": 0,
                     "disparity": 0, "reserved": 0 }),
    }
}
