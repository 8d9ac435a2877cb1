//! The systems that are measured: the demo's B-scan, `host/demo/bscan.json`, and what is changed of it.
//!
//! Invariant: a plan is a whole system file at any time; what is not said to change stays as the file has it.

use std::fs;
use std::path::Path;
use std::thread;

use serde_json::{Map, Value, json};
use trocar_tests::repository;

/// The file that is changed.
const FILE: &str = "host/demo/bscan.json";
/// Of cameras that both look at the apex through lenses, as a microscope's do.
const CALIBRATION: &str = "tests/data/calibration/phantom-toed-in.json";
/// What in it only writes pictures, and the depth, which is no part of the load.
const ASIDE: [&str; 5] = ["host/console", "host/oct_image", "host/depth_map", "host/tracking", "host/depth"];
/// What shows the eye.
const VIDEO: [&str; 4] = ["host/camera", "host/overlay", "host/pip", "host/display"];
/// Of the displayed path and the one beside it, as in the file; and of the three threads of 1 kHz there.
pub(super) const VIDEO_PRIORITY: i32 = 40;
pub(super) const FAST_PRIORITIES: [i32; 3] = [80, 70, 75];
/// What records, where there is one.
pub(super) const RECORDER: &str = "host/rec";
/// Heads of streams, and components with a thread of their own.
const FAST: [&str; 3] = ["robot/robot", "oct/source", "host/bscan"];
const SLOW: [&str; 3] = ["host/camera", "host/overlay", RECORDER];
/// Processes of the file.
const HOST: &str = "host";
const STREAM: &str = "host/rectify";
/// Filters between source and sink, in the displayed path and in the one beside it that does nothing.
pub(super) const HOPS: usize = 4;
/// Width and height of an image of the canonical load, px.
const SIZE: [f64; 2] = [1024.0, 768.0];

pub(super) struct Plan {
    components: Map<String, Value>,
    connections: Vec<Value>,
    one: bool,
}

impl Plan {
    /// The file without what is aside of the load; and nobody looks at its display: browsers are no part of
    /// it.
    pub(super) fn new() -> Plan {
        let file = repository().join(FILE);
        let text = fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let mut all: Value =
            serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let Value::Object(components) = all["components"].take() else { panic!("no components") };
        let Value::Array(connections) = all["connections"].take() else { panic!("no connections") };
        let mut plan = Plan { components, connections, one: false };
        plan.remove(&ASIDE);
        plan.component("host/display")["config"] = json!({});
        plan
    }

    /// With their connections.
    fn remove(&mut self, paths: &[&str]) {
        self.components.retain(|path, _| !paths.contains(&path.as_str()));
        self.connections.retain(|connection| {
            let of_them = |key: &str| {
                let end = connection[key].as_str().unwrap_or_default();
                paths.iter().any(|path| end.strip_prefix(path).is_some_and(|rest| rest.starts_with('/')))
            };
            !of_them("client") && !of_them("server")
        });
    }

    fn component(&mut self, path: &str) -> &mut Value {
        self.components.get_mut(path).unwrap_or_else(|| panic!("{FILE} has no {path}"))
    }

    fn add(&mut self, path: &str, class: &str, execution: Value, config: Value) {
        let component = json!({ "class": class, "execution": execution, "config": config });
        self.components.insert(path.to_owned(), component);
    }

    /// In the place of what the client was connected to.
    fn connect(&mut self, client: &str, server: &str) {
        self.connections.retain(|connection| connection["client"] != client);
        self.connections.push(json!({ "client": client, "server": server }));
    }

    /// Frames are rectified, and have a picture in them: source, rectify, overlay, pip, sink. The sink keeps
    /// account, and gives them to the display.
    pub(super) fn with_whole_display_path(mut self) -> Plan {
        let member = || json!({ "stream_of": STREAM });
        let config = json!({ "calibration": repository().join(CALIBRATION) });
        self.add(
            STREAM,
            "vision-filters/rectify",
            json!({ "model": "stream", "priority": VIDEO_PRIORITY }),
            config,
        );
        self.component("host/camera")["config"]["rig"] = json!("toed_in");
        self.component("host/overlay")["execution"] = member();
        self.component("host/display")["execution"] = member();
        self.add("host/pip", "vision-filters/pip", member(), json!({}));
        self.add("host/seen", "fixture-ledger/frame_ledger", member(), json!({}));
        let inset = json!({ "width": 341, "height": 256 });
        let slow = json!({ "model": "stream", "rate_hz": 15 });
        self.add("host/inset", "fixture-ledger/blank_source", slow, inset);
        self.connect("host/rectify/image", "host/camera/image");
        self.connect("host/overlay/image", "host/rectify/rectified");
        self.connect("host/pip/image", "host/overlay/overlaid");
        self.connect("host/pip/inset", "host/inset/image");
        self.connect("host/seen/image", "host/pip/composed");
        self.connect("host/display/image", "host/seen/seen");
        for connection in &mut self.connections {
            if connection["client"] == "host/rectify/image" {
                connection["queue"] = json!({ "fifo": 2 });
            }
        }
        self
    }

    /// A path of the same shape with the same frames, in which nothing is done.
    pub(super) fn with_blank_path(mut self) -> Plan {
        let source = json!({ "model": "stream", "rate_hz": 30, "priority": VIDEO_PRIORITY });
        self.add("host/blank", "fixture-ledger/blank_source", source, json!({}));
        for hop in 0..HOPS {
            let path = format!("host/blank{hop}");
            let head = json!({ "model": "stream", "priority": VIDEO_PRIORITY });
            let execution = if hop == 0 { head } else { json!({ "stream_of": "host/blank0" }) };
            self.add(&path, "fixture-ledger/frame_ledger", execution, json!({}));
            let from = match hop {
                0 => "host/blank/image".to_owned(),
                _ => format!("host/blank{}/seen", hop - 1),
            };
            self.connect(&format!("{path}/image"), &from);
        }
        self
    }

    /// Accounts of lines and distances at the end of the stream that makes them, and of the robot.
    pub(super) fn with_accounts(mut self) -> Plan {
        let member = || json!({ "stream_of": "oct/source" });
        self.add("oct/edge", "fixture-ledger/edge", member(), json!({}));
        self.add("oct/ledger", "fixture-ledger/line_ledger", member(), json!({}));
        self.add("robot/rest", "fixture-ledger/rest_ledger", json!({}), json!({}));
        self.connect("oct/edge/spectra", "oct/source/spectra");
        self.connect("oct/ascan/spectra", "oct/edge/through");
        self.connect("oct/ledger/begun", "oct/edge/begun");
        self.connect("oct/ledger/ascan", "oct/ascan/ascan");
        self.connect("oct/ledger/distance", "oct/surface/distance");
        self.connect("oct/ledger/truth", "oct/source/true_distance");
        self.connect("oct/ledger/column", "host/bscan/column");
        self.connect("robot/rest/tip", "robot/robot/tip");
        self.connect("robot/rest/robot", "robot/robot/arm");
        self
    }

    /// Accounts of how long each step of these takes, `…-ends`.
    pub(super) fn with_steps_timed(mut self, paths: &[&str]) -> Plan {
        for path in paths {
            let (begins, ends) = (format!("{path}-begins"), format!("{path}-ends"));
            let inside = |model: &str| json!({ "model": model, "inside": path });
            self.add(&begins, "fixture-ledger/step_begins", inside("exec_in"), json!({}));
            self.add(&ends, "fixture-ledger/step_ends", inside("exec_out"), json!({}));
            self.connect(&format!("{ends}/begun"), &format!("{begins}/begun"));
        }
        self
    }

    /// Without what keeps account of the robot at rest, a thread of 1 kHz.
    pub(super) fn without_rest(mut self) -> Plan {
        self.remove(&["robot/rest"]);
        self
    }

    /// Components with steps of microseconds are on one processor; pictures and the recorder are on the one
    /// that the disk interrupts.
    pub(super) fn placed(mut self, interrupted: usize) -> Plan {
        let last = thread::available_parallelism().map_or(1, usize::from) - 1;
        let quiet = usize::from(interrupted == 0).min(last);
        for (paths, processor) in [(FAST, quiet), (SLOW, interrupted)] {
            for path in paths {
                self.component(path)["execution"]["cpus"] = json!([processor]);
            }
        }
        self
    }

    /// A recorder in the process of the camera, with the priority that `trocar record` gives it, and nothing
    /// connected to it. It looks when the fast are done, as they go one after the other in the file.
    pub(super) fn recorder(mut self, directory: &Path) -> Plan {
        let execution = json!({ "priority": 1, "phase_us": 700 });
        self.add(RECORDER, "recorder/recorder", execution, json!({ "directory": directory }));
        self
    }

    /// A rectified camera of the eye alone, whose maps are compared with the truth: no tool, no display.
    pub(super) fn of_depth() -> Plan {
        let mut plan = Plan { components: Map::new(), connections: Vec::new(), one: true };
        let source = json!({ "width": SIZE[0], "height": SIZE[1], "disparity_every": 1 });
        let slow = json!({ "model": "stream", "rate_hz": 2 });
        plan.add("host/camera", "stereo/phantom_source", slow, source);
        for (matcher, config) in [("bm", json!({ "method": "bm" })), ("sgm", json!({ "method": "sgm" }))] {
            let (path, ledger) = (format!("host/{matcher}"), format!("host/{matcher}-ledger"));
            plan.add(&path, "stereo-depth/stereo_depth", json!({ "model": "on_signal" }), config);
            plan.add(&ledger, "fixture-ledger/depth_ledger", json!({ "model": "on_signal" }), json!({}));
            plan.connect(&format!("{path}/rectified"), "host/camera/image");
            plan.connect(&format!("{ledger}/disparity"), &format!("{path}/disparity"));
            plan.connect(&format!("{ledger}/truth"), "host/camera/disparity");
        }
        plan
    }

    /// Robot, OCT and control only.
    pub(super) fn without_video(mut self) -> Plan {
        self.remove(&VIDEO);
        self
    }

    /// The tracker beside the controller: robot, OCT and tracker are three processes.
    pub(super) fn with_tracker_apart(mut self) -> Plan {
        let Some(mut tracker) = self.components.remove("oct/surface") else {
            panic!("{FILE} has no oct/surface");
        };
        tracker["execution"] = json!({ "model": "stream" });
        self.components.insert("host/surface".into(), tracker);
        for connection in &mut self.connections {
            for key in ["client", "server"] {
                let end = connection[key].as_str().unwrap_or_default();
                if let Some(port) = end.strip_prefix("oct/surface/") {
                    connection[key] = json!(format!("host/surface/{port}"));
                }
            }
        }
        self
    }

    /// Other settings of a component.
    pub(super) fn configured(mut self, path: &str, config: Value) -> Plan {
        let component = self.component(path);
        for (key, value) in config.as_object().into_iter().flatten() {
            component["config"][key] = value.clone();
        }
        self
    }

    /// Another rate of a component's steps.
    pub(super) fn at_rate(mut self, path: &str, rate_hz: f64) -> Plan {
        self.component(path)["execution"]["rate_hz"] = json!(rate_hz);
        self
    }

    /// Everything in one process.
    pub(super) fn in_one(mut self) -> Plan {
        self.one = true;
        self
    }

    pub(super) fn is_in_one(&self) -> bool {
        self.one
    }

    /// Where a component of the file is in this plan.
    pub(super) fn place(&self, path: &str) -> String {
        match path.split_once('/') {
            Some((_, rest)) if self.one => format!("{HOST}/{rest}"),
            _ => path.to_owned(),
        }
    }

    /// The system file.
    pub(super) fn file(&self) -> Value {
        let restart = json!({ "max": 1000, "backoff_ms": 50, "most_backoff_ms": 50 });
        let process = json!({ "plugins": ["plugins"], "restart": restart });
        let names: &[&str] = if self.one { &[HOST] } else { &[HOST, "robot", "oct"] };
        let processes: Map<String, Value> =
            names.iter().map(|name| ((*name).to_owned(), process.clone())).collect();
        let mut components = Map::new();
        for (path, component) in &self.components {
            let mut component = component.clone();
            if let Some(head) = component["execution"]["stream_of"].as_str() {
                component["execution"]["stream_of"] = json!(self.place(head));
            }
            if let Some(other) = component["execution"]["inside"].as_str() {
                component["execution"]["inside"] = json!(self.place(other));
            }
            components.insert(self.place(path), component);
        }
        let moved = |connection: &Value| {
            let mut connection = connection.clone();
            for key in ["client", "server"] {
                connection[key] = json!(self.place(connection[key].as_str().unwrap_or_default()));
            }
            connection
        };
        let connections: Vec<Value> = self.connections.iter().map(moved).collect();
        json!({ "version": 1, "processes": processes, "components": components, "connections": connections })
    }
}
