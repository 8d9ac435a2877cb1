//! The system most rows about processes use: `a` and `b` need each other in every way, `c` and `d` have
//! nothing to do with them.
//!
//! Invariant: everything `a` has of `b`, `b` has of `a`, so that either may be the one that is harmed.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use trocar_proto::v1::{ListResponse, Process, ProcessState};

use crate::clock::{eventually, now_ns};
use crate::json::number;
use crate::procfs;
use crate::program::Program;
use crate::rpc::{Answer, Rpc};
use crate::world::World;

/// `max_age` of the arms' set points, ms.
pub(crate) const MAX_AGE: u64 = 20;
/// Period of the arms, ms.
pub(crate) const PERIOD: f64 = 1.0;

/// Frames, and samples at the highest rate, that may wait: what a machine that stands still for a moment
/// makes late is not lost.
const FRAMES: u32 = 8;
const SAMPLES: u32 = 4096;

/// How much flows.
#[derive(Clone, Copy)]
pub(crate) struct Load {
    /// Of the sources, Hz.
    pub(crate) rate_hz: u32,
    /// Of the cameras, Hz; 0: none.
    pub(crate) frames_hz: u32,
    /// How long a screen has each frame in hand, ms.
    pub(crate) holds_ms: u32,
    /// Of another source and sink from `b` to `a`, Hz; 0: none.
    pub(crate) fast_hz: u32,
    /// `c` and `d`, which look on.
    pub(crate) bystanders: bool,
}

pub(crate) struct Rig {
    pub(crate) world: World,
    pub(crate) up: Program,
    pub(crate) rpc: Rpc,
}

/// What becomes the system file.
#[derive(Default)]
struct Plan {
    components: serde_json::Map<String, Value>,
    connections: Vec<Value>,
}

impl Plan {
    fn add(&mut self, path: String, class: &str, rate_hz: u32, config: Value) {
        let mut component = json!({ "class": format!("fixture-torture/{class}"), "config": config });
        if rate_hz > 0 {
            component["execution"] = json!({ "rate_hz": rate_hz });
        }
        self.components.insert(path, component);
    }

    fn tie(&mut self, client: String, server: String, more: Value) {
        let mut tie = json!({ "client": client, "server": server });
        for (key, value) in more.as_object().into_iter().flatten() {
            tie[key] = value.clone();
        }
        self.connections.push(tie);
    }

    /// The parts of `one` that use `other`.
    fn half(&mut self, world: &World, one: &str, other: &str, load: Load) {
        let at = |name: &str| format!("{one}/{name}");
        let of = |name: &str| format!("{other}/{name}");
        let nothing = || json!({});
        self.add(at("source"), "source", load.rate_hz, nothing());
        self.add(at("sink"), "sink", 0, nothing());
        self.add(at("spare"), "sink", 0, nothing());
        self.add(at("server"), "server", 0, nothing());
        self.add(at("caller"), "caller", 0, nothing());
        let book = world.text(&format!("{one}.book"));
        self.add(at("arm"), "arm", 0, json!({ "book": book, "max_age_ms": MAX_AGE }));
        self.tie(at("sink/value"), of("source/value"), nothing());
        let latest = json!({ "queue": "latest", "max_age_ms": MAX_AGE });
        self.tie(at("arm/set_point"), of("source/value"), latest);
        self.tie(at("arm/drive"), of("server/ctl"), nothing());
        self.tie(at("caller/peer"), of("server/ctl"), nothing());
        if load.frames_hz > 0 {
            self.add(at("camera"), "camera", load.frames_hz, json!({ "slots": FRAMES + 4 }));
            self.add(at("screen"), "screen", 0, json!({ "slow_step_ms": load.holds_ms }));
            let deep = json!({ "queue": { "fifo": FRAMES, "drop_oldest": true } });
            self.tie(at("screen/frame"), of("camera/frame"), deep);
        }
        if load.fast_hz > 0 {
            self.add(at("fast"), "source", load.fast_hz, nothing());
            self.add(at("fast_sink"), "sink", 0, nothing());
            let deep = json!({ "queue": { "fifo": SAMPLES } });
            self.tie(at("fast_sink/value"), of("fast/value"), deep);
        }
    }
}

/// A smaller system: `a` has a sink of what `b` sends, and a pair of its own that has nothing to do with it.
pub(crate) fn pair(restart: Value) -> Value {
    json!({
        "version": 1,
        "processes": {
            "a": { "plugins": ["plugins"] },
            "b": { "plugins": ["plugins"], "restart": restart },
        },
        "components": {
            "a/sink": { "class": "fixture-torture/sink" },
            "a/source": { "class": "fixture-torture/source" },
            "a/near": { "class": "fixture-torture/sink" },
            "b/source": { "class": "fixture-torture/source" },
        },
        "connections": [
            { "client": "a/sink/value", "server": "b/source/value" },
            { "client": "a/near/value", "server": "a/source/value" },
        ],
    })
}

impl Rig {
    /// All of it, running.
    pub(crate) fn up(load: Load) -> Result<Rig, String> {
        // Whoever looks on may be held against a like of it elsewhere.
        let plugins = ["fixture_torture", "fixture_chaos"];
        let world = World::new(&plugins[..if load.bystanders { 2 } else { 1 }])?;
        let restart = json!({ "max": 1000, "backoff_ms": 50, "most_backoff_ms": 50 });
        let process = json!({ "plugins": ["plugins"], "restart": restart });
        let mut plan = Plan::default();
        plan.half(&world, "a", "b", load);
        plan.half(&world, "b", "a", load);
        let mut names = vec!["a", "b"];
        if load.bystanders {
            names.extend(["c", "d"]);
            plan.add("c/source".into(), "source", 0, json!({}));
            plan.add("d/sink".into(), "sink", 0, json!({}));
            plan.tie("d/sink/value".into(), "c/source/value".into(), json!({}));
        }
        let processes: serde_json::Map<String, Value> =
            names.into_iter().map(|name| (name.to_owned(), process.clone())).collect();
        let Plan { components, connections } = plan;
        let system = json!({
            "version": 1, "processes": processes, "components": components, "connections": connections,
        });
        Rig::of(world, &system)
    }

    /// Any system file.
    pub(crate) fn of(world: World, system: &Value) -> Result<Rig, String> {
        let up = Program::up(&world, &system.to_string())?;
        let rpc = Rpc::at(&up.address);
        Ok(Rig { world, up, rpc })
    }

    pub(crate) fn list(&self) -> Answer<ListResponse> {
        self.rpc.brief()
    }

    /// A process as the GCM lists it.
    pub(crate) fn process(&self, name: &str) -> Result<Process, String> {
        let list = self.list()?;
        list.processes
            .into_iter()
            .find(|p| p.name == name)
            .ok_or_else(|| format!("there is no process {name}"))
    }

    /// Everything that runs below `up`, by name; the GCM is `:gcm`.
    pub(crate) fn pids(&self) -> Result<BTreeMap<String, u32>, String> {
        let list = self.list()?;
        let attached = list.processes.iter().filter(|p| p.state() == ProcessState::Attached);
        let mut all: BTreeMap<String, u32> = attached.map(|p| (p.name.clone(), p.pid)).collect();
        all.insert(":gcm".into(), self.gcm_pid()?);
        Ok(all)
    }

    pub(crate) fn gcm_pid(&self) -> Result<u32, String> {
        let is_gcm = |pid: &u32| procfs::command_line(*pid).iter().any(|arg| arg == "gcm");
        eventually("a GCM runs", || {
            procfs::children(self.up.pid()).into_iter().find(is_gcm).ok_or_else(|| "none".to_owned())
        })
    }

    /// A process's own port, which answers whatever became of the GCM.
    pub(crate) fn own_port(&self, name: &str) -> Result<Rpc, String> {
        Ok(Rpc::at(&self.process(name)?.endpoint))
    }

    /// Waits until another incarnation of a process has all the former one had.
    pub(crate) fn await_back(&self, name: &str, before: u32) -> Result<Process, String> {
        eventually(&format!("{name} is back"), || {
            let now = self.process(name)?;
            let back = now.state() == ProcessState::Attached && now.pid != before;
            if back { Ok(now) } else { Err(format!("{:?}, pid {}", now.state(), now.pid)) }
        })
    }

    /// Counts anew from now on.
    pub(crate) fn mark(&self, sink: &str) -> Result<u64, String> {
        let at = now_ns();
        mark_at(&self.rpc, sink, at)?;
        Ok(at)
    }

    /// What a sink or screen knows of all it was given.
    pub(crate) fn books(&self, sink: &str) -> Result<Value, String> {
        Ok(self.rpc.row(sink)?["books"].take())
    }

    /// A number of it.
    pub(crate) fn book(&self, sink: &str, what: &str) -> Result<u64, String> {
        Ok(number(&self.books(sink)?[what]))
    }

    /// When an arm was made safe, ns, in order.
    fn safed(&self, process: &str) -> Vec<u64> {
        let file = self.world.path(&format!("{process}.book"));
        let text = std::fs::read_to_string(file).unwrap_or_default();
        text.lines().filter_map(|line| line.parse().ok()).collect()
    }

    /// The first time it was made safe after a moment, ns.
    pub(crate) fn await_safed(&self, process: &str, after_ns: u64) -> Result<u64, String> {
        eventually(&format!("{process}/arm is made safe"), || {
            let first = self.safed(process).into_iter().find(|at| *at >= after_ns);
            first.ok_or_else(|| format!("{:?}", self.rpc.state(&format!("{process}/arm"))))
        })
    }

    /// Lets an arm go on that was made safe, and waits until it does.
    pub(crate) fn resume_arm(&self, process: &str) -> Result<(), String> {
        let path = format!("{process}/arm");
        eventually(&format!("{path} goes on"), || {
            if self.rpc.state(&path)? != "ACTIVE" {
                self.rpc.resume(&path)?;
            }
            match self.rpc.state(&path)? {
                state if state == "ACTIVE" => Ok(()),
                state => Err(state),
            }
        })
    }
}

/// Has a sink or screen count anew from a moment on.
pub(crate) fn mark_at(rpc: &Rpc, sink: &str, at_ns: u64) -> Result<(), String> {
    mark_by(rpc, &format!("{sink}/ctl/mark"), at_ns)
}

/// The same by the command's own name.
pub(crate) fn mark_by(rpc: &Rpc, command: &str, at_ns: u64) -> Result<(), String> {
    let mark = json!({ "at_ns": at_ns.to_string(), "late_limit": 0 });
    rpc.settle(command, &mark)?;
    Ok(())
}
