//! The real-time core as grpcurl sees it: rows, overruns, hangs, full queues, broken filters, every way to
//! get a thread.
//!
//! Promise: the host's figures are those that the components wrote down themselves; nothing is judged by how
//! long it took, but by what came before what.

mod counted;
mod made_for;
mod models;
mod phases;
mod priority;
mod queues;
mod refusals;
pub(crate) mod rights;
mod rows;
mod streams;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, HostProcess, Stream, World, eventually, number};

/// A host that knows the components which keep books on themselves.
struct Scene {
    grpc: Grpcurl,
    host: HostProcess,
    _world: World,
}

impl Scene {
    fn new() -> Self {
        let world = World::with_plugins(&["sine", "fixture_pace"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "pace");
        Self { grpc, host, _world: world }
    }

    /// `trocar run` of a system file with these components and connections.
    fn run(components: &Value, connections: &Value) -> Self {
        let world = World::with_plugins(&["fixture_pace"]);
        let system = json!({
            "version": 1,
            "processes": { "host": { "trust": "dev", "plugins": ["plugins"] } },
            "components": components,
            "connections": connections,
        });
        let file = world.write("system.json", system.to_string());
        let args = ["run", "--listen", "127.0.0.1:0"].map(Into::into);
        let host = HostProcess::spawn(&world, "run", &[&args[..], &[file.into()]].concat());
        Self { grpc: host.grpcurl(), host, _world: world }
    }

    /// A running `pace` with this period.
    fn pace(&self, path: &str, execution: Value, config: Value) {
        self.grpc.create_with(path, "pace", config, execution);
        self.grpc.start(path);
    }

    /// A row of a component's state as it was answered, or refused.
    fn ask(&self, path: &str, which: &str, value: u64) -> Result<Value, Failure> {
        self.grpc.call("InteractService/Read", json!({ "path": path, which: value.to_string() }))
    }

    /// The newest row with its stamp and number.
    fn newest(&self, path: &str) -> Value {
        self.grpc.ok("InteractService/Read", json!({ "path": path }))
    }

    /// A number of the newest row.
    fn count(&self, path: &str, field: &str) -> u64 {
        number(&self.newest(path)["json"][field])
    }

    fn stats(&self, path: &str) -> Value {
        self.grpc.component(path)["stats"].clone()
    }

    /// Waits until a number of its row is at least this.
    fn until(&self, path: &str, field: &str, least: u64) -> u64 {
        eventually(&format!("{field} of {path} is {least} or more"), || match self.count(path, field) {
            now if now >= least => Ok(now),
            now => Err(format!("{now}; {}", self.grpc.component(path))),
        })
    }

    fn until_health(&self, path: &str, health: &str) -> Value {
        eventually(&format!("{path} is {health}"), || match self.grpc.component(path) {
            now if now["health"] == format!("HEALTH_{health}") => Ok(now),
            now => Err(now),
        })
    }

    /// Follows what a component says of itself; from here on nothing is missed.
    fn follow(&self, path: &str, event: &str) -> Stream {
        let selections =
            json!({ "selections": [{ "path": format!("{path}/system/{event}") }, { "path": path }] });
        let mut stream = self.grpc.stream("InteractService/Subscribe", &selections);
        stream.until("the present state", |item| item["kind"] == "ITEM_KIND_STATE");
        stream
    }

    /// The connection with this client end.
    fn connection(&self, client: &str) -> Value {
        let list = self.grpc.ok("GcmService/List", json!({}));
        let all = list["connections"].as_array().cloned().unwrap_or_default();
        all.into_iter().find(|c| c["client"] == client).unwrap_or_else(|| panic!("none of {client}: {list}"))
    }

    /// A component as List shows it.
    fn listed(&self, path: &str) -> Value {
        let list = self.grpc.ok("GcmService/List", json!({}));
        let all = list["components"].as_array().cloned().unwrap_or_default();
        all.into_iter().find(|c| c["path"] == path).unwrap_or_else(|| panic!("no {path}: {list}"))
    }
}

fn says(item: &Value, words: &str) -> bool {
    item["kind"] == "ITEM_KIND_EVENT" && item["json"].to_string().contains(words)
}

/// Every period since its start was either executed or skipped, and the component counted the same.
#[track_caller]
fn accounts_for_every_period(scene: &Scene, path: &str) {
    let (row, stats) = (scene.newest(path), scene.stats(path));
    let (executed, skipped) = (number(&stats["executed"]), number(&stats["skipped"]));
    assert_eq!(executed, number(&row["json"]["steps"]), "executed steps of {path}: {stats} {row}");
    assert_eq!(executed + skipped, number(&row["json"]["cycle"]) + 1, "periods of {path}: {stats} {row}");
    assert_eq!(number(&row["seq"]), executed + skipped, "number of its row: {stats} {row}");
}
