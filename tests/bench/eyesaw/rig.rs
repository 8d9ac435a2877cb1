//! A running system: `trocar up` of a plan, and what is asked of it.
//!
//! Invariant: everything is asked between measurements, not in them: each question is a process of its own.

use std::fs;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually};

use super::plan::Plan;
use crate::lab::as_number;

/// Plugins of the systems.
const PLUGINS: [&str; 9] = [
    "bscan",
    "display",
    "eyerobot",
    "oct",
    "recorder",
    "stereo",
    "stereo_depth",
    "vision_filters",
    "fixture_ledger",
];
/// What a scan keeps, m.
pub(super) const OFFSET_M: f64 = 500e-6;

/// A world with all the plugins in it.
pub(super) fn world() -> World {
    World::with_plugins(&PLUGINS)
}

pub(super) struct Rig {
    plan: Plan,
    grpc: Grpcurl,
    up: HostProcess,
    // The last to go.
    _world: World,
}

/// What a component has done so far.
#[derive(Clone, Copy, Default)]
pub(super) struct Work {
    pub(super) steps: f64,
    pub(super) skipped: f64,
    /// Spent in its steps, ns.
    pub(super) ns: f64,
}

impl Rig {
    /// Starts it; `trocar up` says so when all of it runs.
    pub(super) fn up(world: World, plan: Plan) -> Rig {
        let file = world.write("system.json", plan.file().to_string());
        let args = ["up".into(), file.into(), "--listen".into(), "127.0.0.1:0".into(), "--json".into()];
        let up = HostProcess::spawn(&world, "up", &args);
        Rig { plan, grpc: up.grpcurl(), up, _world: world }
    }

    pub(super) fn await_active(&self, path: &str) {
        self.grpc.await_state(&self.plan.place(path), "ACTIVE");
    }

    /// Start, Stop, Resume of a component.
    pub(super) fn run(&self, path: &str, verb: &str) {
        self.grpc.ok(&format!("GcmService/{verb}"), json!({ "path": self.plan.place(path) }));
    }

    pub(super) fn connect(&self, client: &str, server: &str, fifo: usize) {
        let (client, server) = (self.plan.place(client), self.plan.place(server));
        let options = json!({ "queue": { "fifo": fifo } });
        self.grpc.ok("GcmService/Connect", json!({ "client": client, "server": server, "options": options }));
    }

    pub(super) fn disconnect(&self, client: &str, server: &str) {
        let (client, server) = (self.plan.place(client), self.plan.place(server));
        self.grpc.ok("GcmService/Disconnect", json!({ "client": client, "server": server }));
    }

    /// Calls a command of a component.
    pub(super) fn call(&self, path: &str, member: &str, arg: Value) -> Value {
        self.grpc.invoke(&format!("{}/{member}", self.plan.place(path)), arg)
    }

    pub(super) fn try_call(&self, path: &str, member: &str, arg: Value) -> Result<Value, String> {
        let path = format!("{}/{member}", self.plan.place(path));
        let body = if arg.is_null() { json!({ "path": path }) } else { json!({ "path": path, "json": arg }) };
        let answer = self.grpc.call("InteractService/Invoke", body).map_err(|refused| refused.to_string())?;
        Ok(answer["json"].clone())
    }

    pub(super) fn work(&self, path: &str) -> Work {
        let stats = self.grpc.component(&self.plan.place(path))["stats"].clone();
        let steps = as_number(&stats["executed"]);
        let ns = steps * as_number(&stats["compute"]["avgNs"]);
        Work { steps, skipped: as_number(&stats["skipped"]), ns }
    }

    /// A number of a component's state row.
    pub(super) fn number(&self, path: &str, field: &str) -> f64 {
        let answer = self.grpc.ok("InteractService/Read", json!({ "path": self.plan.place(path) }));
        as_number(&answer["json"][field])
    }

    /// What full queues have lost so far on the way into an input.
    pub(super) fn dropped(&self, client: &str) -> f64 {
        let (component, _) = client.rsplit_once('/').unwrap_or((client, ""));
        let body = json!({ "path": self.plan.place(component) });
        let answer = self.grpc.ok("GcmService/GetState", body);
        let client = self.plan.place(client);
        let all = answer["connections"].as_array().cloned().unwrap_or_default();
        let of = all.iter().find(|connection| connection["client"] == client.as_str());
        // A client that takes the newest only misses those, too.
        let missed =
            |connection: &Value| as_number(&connection["dropped"]) + as_number(&connection["skipped"]);
        of.map_or(f64::NAN, missed)
    }

    /// A process's number; 0 while there is none.
    pub(super) fn pid(&self, process: &str) -> i32 {
        let list = self.grpc.ok("GcmService/List", json!({ "brief": true }));
        let all = list["processes"].as_array().cloned().unwrap_or_default();
        let of = all.iter().find(|p| p["name"] == process && p["state"] == "PROCESS_STATE_ATTACHED");
        of.map_or(0, |process| as_number(&process["pid"]) as i32)
    }

    /// Processor time that the threads of a process whose names begin so have spent, s.
    pub(super) fn processor_s(&self, process: &str, threads: &str) -> f64 {
        let tasks = fs::read_dir(format!("/proc/{}/task", self.pid(process)));
        let tasks = tasks.unwrap_or_else(|e| panic!("threads of {process}: {e}"));
        let stats = tasks.flatten().filter_map(|task| fs::read_to_string(task.path().join("stat")).ok());
        let ticks: f64 = stats.filter_map(|stat| ticks(&stat, threads)).sum();
        ticks / rustix::param::clock_ticks_per_second() as f64
    }

    /// Waits until another incarnation of a process has all the former one had.
    pub(super) fn await_back(&self, process: &str, before: i32) {
        eventually(&format!("{process} is back"), || match self.pid(process) {
            now if now != 0 && now != before => Ok(()),
            now => Err(now),
        });
        let component = if process == "host" { "host/bscan" } else { "oct/source" };
        self.await_active(component);
    }

    /// Begins a scan of so many m, and another one where it was given up before it had so many columns;
    /// answers how often that was so.
    pub(super) fn scan_of(&self, length_m: f64, speed_m_s: f64, least: f64) -> usize {
        let mut given_up = 0;
        self.start_scan(length_m, speed_m_s);
        eventually("the scan has columns", || {
            let progress = self.progress();
            if is_phase(&progress, "IDLE", 0) {
                given_up += 1;
                self.start_scan(length_m, speed_m_s);
            }
            let there = is_phase(&progress, "SCAN", 2) && as_number(&progress["columns"]) >= least;
            if there { Ok(()) } else { Err(progress.to_string()) }
        });
        given_up
    }

    /// As soon as one can begin.
    fn start_scan(&self, length_m: f64, speed_m_s: f64) {
        // Across the fovea, wherever the tip stands: lines through the tip would go on where the last one was
        // broken off.
        let half_m = 0.5 * length_m;
        let request = json!({
            "from": [-half_m, 0, 0.121], "to": [half_m, 0, 0.121], "width": 0, "angle": 0, "speed": speed_m_s,
            "offset": OFFSET_M, "pitch": 6e-6,
        });
        eventually("a scan can begin", || self.try_call("host/bscan", "scan/start", request.clone()));
    }

    pub(super) fn progress(&self) -> Value {
        self.call("host/bscan", "scan/progress", Value::Null)
    }

    /// Waits until there is no scan; how far the last one went.
    pub(super) fn await_idle(&self) -> Value {
        eventually("the scan is over", || {
            let progress = self.progress();
            if is_phase(&progress, "IDLE", 0) { Ok(progress) } else { Err(progress.to_string()) }
        })
    }

    /// Ends it in order.
    pub(super) fn end(mut self) {
        self.up.terminate();
    }
}

/// Of a thread's line of figures, where its name begins so.
fn ticks(stat: &str, threads: &str) -> Option<f64> {
    let (head, rest) = stat.rsplit_once(") ")?;
    let (_, name) = head.split_once('(')?;
    let mut fields = rest.split(' ').skip(11).map_while(|field| field.parse::<f64>().ok());
    name.starts_with(threads).then(|| fields.next().unwrap_or(0.0) + fields.next().unwrap_or(0.0))
}

/// A phase by its name or its number.
pub(super) fn is_phase(progress: &Value, name: &str, number: u64) -> bool {
    progress["phase"] == name || progress["phase"] == number
}
