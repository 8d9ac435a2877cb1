//! Processes of one machine that mean ill, and a machine that has nothing to give, against built hosts.
//!
//! Promise: whatever a stranger says at the socket, whatever a peer writes, says or hands over, the host
//! lives, its other connections go on, nothing is left behind, and the log tells of it once, not per message.
//! A component that cannot be made is refused with a sentence.

#[path = "hostile/counted.rs"]
mod counted;
#[path = "hostile/elsewhere.rs"]
mod elsewhere;
#[path = "hostile/impostor.rs"]
mod impostor;
#[path = "hostile/limits.rs"]
mod limits;
#[path = "hostile/other_user.rs"]
mod other_user;
#[path = "hostile/peer.rs"]
mod peer;
#[path = "hostile/silent.rs"]
mod silent;
#[path = "hostile/stranger.rs"]
mod stranger;
#[path = "hostile/timed.rs"]
mod timed;

use std::fs;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, HostProcess, World, eventually, number};

/// What a process holds: files, threads, mappings of memory shared with others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Holds {
    files: usize,
    threads: usize,
    shared: usize,
}

fn holds(pid: u32) -> Holds {
    let count = |what: &str| fs::read_dir(format!("/proc/{pid}/{what}")).map_or(0, Iterator::count);
    let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
    let shared = maps.lines().filter(|line| line.contains("/memfd:trocar")).count();
    Holds { files: count("fd"), threads: count("task"), shared }
}

/// Waits until it holds no more than `before`.
fn await_nothing_left(host: &HostProcess, before: Holds) {
    eventually("nothing is left of it", || {
        let now = holds(host.pid());
        let within =
            now.files <= before.files && now.threads <= before.threads && now.shared <= before.shared;
        if within { Ok(()) } else { Err(format!("{now:?}, before {before:?}")) }
    });
}

/// A GCM and hosts attached to it.
struct Lab {
    grpc: Grpcurl,
    gcm: HostProcess,
    world: World,
}

impl Lab {
    fn new() -> Lab {
        let world = World::with_plugins(&["sine", "example", "fixture_echo"]);
        let gcm = HostProcess::start_gcm(&world);
        Lab { grpc: gcm.grpcurl(), gcm, world }
    }

    fn host(&self, name: &str) -> HostProcess {
        HostProcess::start_with(&self.world, name, &["--gcm", self.gcm.address()])
    }

    /// Asks until the process is there: on a busy machine it may be thought lost for a moment.
    fn ask(&self, method: &str, body: &Value) {
        let mut lost = false;
        eventually(method, || match self.grpc.call(method, body.clone()) {
            Err(refused) if refused.reason == "PROCESS_LOST" => {
                lost = true;
                Err(refused.to_string())
            }
            // Lost in the middle of making it: what it comes back with may be half made.
            Err(refused) if refused.reason == "COMPONENT_EXISTS" && lost => {
                let _ = self.grpc.call("GcmService/Remove", json!({ "path": body["path"] }));
                Err(refused.to_string())
            }
            Err(refused) => panic!("{method} {body}: {refused}"),
            Ok(_) => Ok(()),
        });
    }

    /// The refusal of a Connect once both processes are heard: on a busy machine one may be thought lost for
    /// a moment.
    fn refused(&self, body: &Value) -> Failure {
        self.grpc.refused_when_heard("GcmService/Connect", body)
    }

    /// A generator, a server, their counterparts.
    fn furnish(&self, process: &str) {
        for (name, class) in
            [("s", "sine/sine"), ("server", "example/Server"), ("e", "echo"), ("client", "example/Client")]
        {
            self.grpc.await_class(process, class.rsplit('/').next().unwrap_or(class));
            let body = json!({ "path": format!("{process}/{name}"), "class": class, "config": {} });
            self.ask("GcmService/Create", &body);
        }
    }

    /// The stream, the commands and events from `server` to `client`.
    fn connect(&self, client: &str, server: &str) {
        for (to, from) in [("e/sample", "s/value"), ("client/Required", "server/Provided")] {
            let (to, from) = (format!("{client}/{to}"), format!("{server}/{from}"));
            self.ask("GcmService/Connect", &json!({ "client": to, "server": from }));
        }
    }

    /// Those that need nobody.
    fn start(&self, process: &str) {
        for name in ["s", "server", "e"] {
            self.ask("GcmService/Start", &json!({ "path": format!("{process}/{name}") }));
        }
    }

    /// All of it, connected before.
    fn start_all(&self, process: &str) {
        self.start(process);
        self.ask("GcmService/Start", &json!({ "path": format!("{process}/client") }));
    }

    fn connections(&self) -> Vec<Value> {
        self.grpc.ok("GcmService/List", json!({}))["connections"].as_array().cloned().unwrap_or_default()
    }

    /// The connection of this client.
    fn connection(&self, client: &str) -> Value {
        let all = self.connections();
        let found = all.iter().find(|c| c["client"] == client);
        found.cloned().unwrap_or_else(|| panic!("no connection of {client}: {all:#?}"))
    }

    /// Waits until more has passed on the connection of this client.
    fn await_flow(&self, client: &str) {
        let passed = || number(&self.connection(client)["passed"]);
        let before = passed();
        eventually(&format!("something passes to {client}"), || match passed() {
            now if now > before => Ok(()),
            now => Err(now.to_string()),
        });
    }

    /// Waits until a component has stepped some more.
    fn await_steps(&self, path: &str, more: u64) {
        let steps = || number(&self.grpc.component(path)["stats"]["executed"]);
        let before = steps();
        eventually(&format!("{path} goes on"), || match steps() {
            now if now >= before + more => Ok(()),
            now => Err(format!("{now} steps, {before} before")),
        });
    }
}

/// How many lines of its output say that.
fn lines(host: &HostProcess, part: &str) -> usize {
    host.printed().lines().filter(|line| line.contains(part)).count()
}
