//! Agents: processes of a system on other machines.
//!
//! Promise: `trocar up` brings them up and takes them down as its own; an agent starts again what ends,
//! whether `up` is heard or not; what nobody wants any more ends.

use std::ffi::OsString;
use std::net::TcpListener;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Trocar, World, eventually, number};

use crate::processes::system::{freeze, gone, kill, pid};

/// A machine with an agent, and another with a system file; both are this one.
struct Two {
    agent: HostProcess,
    world: World,
}

/// An agent's arguments, with plugin directory and state of its own.
fn agent_args(world: &World, listen: &str, more: &[&str]) -> Vec<OsString> {
    let (plugins, state) = (world.path("elsewhere"), world.state().join("agent"));
    let mut args: Vec<OsString> = ["agent", "--listen", listen, "--plugins"].map(Into::into).to_vec();
    args.extend([plugins.into(), "--state".into(), state.into()]);
    args.extend(more.iter().map(OsString::from));
    args
}

impl Two {
    /// The agent's machine has no plugin files.
    fn new() -> Two {
        let world = World::with_plugins(&["sine", "example", "fixture_chaos"]);
        std::fs::create_dir(world.path("elsewhere")).unwrap();
        let agent = HostProcess::spawn(&world, "agent", &agent_args(&world, "127.0.0.1:0", &[]));
        Two { agent, world }
    }

    /// A file with a process here and one on the other machine.
    fn file(&self) -> String {
        self.file_of(json!({ "machine": "cart", "plugins": ["plugins"] }))
    }

    fn file_of(&self, far: Value) -> String {
        let agent = self.agent.address();
        let file = json!({
            "version": 1,
            "machines": { "cart": { "agent": agent } },
            "processes": { "near": { "plugins": ["plugins"] }, "far": far },
            "components": {
                "near/server": { "class": "Server" },
                "far/s": { "class": "sine" },
                "far/c": { "class": "chaos" },
                "far/client": { "class": "Client" }
            },
            "connections": [{ "client": "far/client/Required", "server": "near/server/Provided" }]
        });
        file.to_string()
    }

    fn up(&self) -> Up {
        let file = self.world.write("system.json", self.file());
        let args = ["up".into(), file.into(), "--listen".into(), "127.0.0.1:0".into(), "--json".into()];
        Up { process: HostProcess::spawn(&self.world, "up", &args) }
    }

    /// The systems of which the agent keeps processes.
    fn kept(&self) -> Value {
        self.agent.grpcurl().ok("AgentService/ListSystems", json!({}))["systems"].clone()
    }

    fn await_none(&self, what: &str) {
        eventually(what, || match self.kept() {
            kept if kept.as_array().is_none_or(Vec::is_empty) => Ok(()),
            kept => Err(kept),
        });
    }

    /// The process id of `far`, as the agent has it.
    fn far(&self) -> u64 {
        number(&self.kept()[0]["statuses"][0]["pid"])
    }
}

struct Up {
    process: HostProcess,
}

impl Up {
    fn grpc(&self) -> Grpcurl {
        self.process.grpcurl()
    }

    fn host(&self, name: &str) -> Value {
        let list = self.grpc().ok("GcmService/List", json!({ "brief": true }));
        let all = list["processes"].as_array().cloned().unwrap_or_default();
        all.into_iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name}: {list}"))
    }

    /// Waits until another incarnation of `far` has all it had.
    fn await_back(&self, before: u64) -> Value {
        eventually("far is back with all it had", || {
            let now = self.host("far");
            let is_back = now["state"] == "PROCESS_STATE_ATTACHED" && pid(&now) != before;
            let s = self.grpc().component("far/s");
            match is_back && s["state"] == "COMPONENT_STATE_ACTIVE" && s["health"] == "HEALTH_OK" {
                true => Ok(now),
                false => Err(format!("{}: {s}", now["state"])),
            }
        })
    }
}

#[test]
fn processes_of_two_machines_come_up_and_go_down_together() {
    let two = Two::new();
    let mut up = two.up();
    let grpc = up.grpc();
    for (path, state) in [("near/server", "ACTIVE"), ("far/s", "ACTIVE"), ("far/client", "ACTIVE")] {
        assert_eq!(grpc.state(path), state, "{path}");
    }
    let kept = two.kept();
    let of_it = (kept[0]["system"].as_str(), kept[0]["heard"].as_bool(), &kept[0]["statuses"][0]["process"]);
    assert_eq!(of_it, (Some("system"), Some(true), &json!("far")), "{kept}");
    let far = two.far();
    assert_eq!(pid(&up.host("far")), far);
    let printed = up.process.printed();
    let status = up.process.interrupt();
    assert!(status.success(), "{status}: {printed}");
    assert!(gone(far), "it answers when all have ended");
    two.await_none("the agent keeps nothing any more");
}

#[test]
fn plugin_files_go_along_by_their_hash_and_only_once() {
    let two = Two::new();
    let files = |two: &Two| {
        let dir = std::fs::read_dir(two.world.state().join("agent/files")).unwrap();
        let mut all: Vec<_> =
            dir.flatten().map(|e| (e.file_name(), e.metadata().unwrap().modified().unwrap())).collect();
        all.sort();
        all
    };
    drop(two.up());
    let brought = files(&two);
    assert_eq!(brought.len(), 3, "{brought:?}");
    two.await_none("the first system has gone");
    let up = two.up();
    assert_eq!(up.grpc().state("far/s"), "ACTIVE");
    assert_eq!(files(&two), brought, "nothing was brought again");
}

#[test]
fn an_agent_starts_again_what_ends_while_nobody_is_heard() {
    let two = Two::new();
    let up = two.up();
    let before = two.far();
    freeze(u64::from(up.process.pid()));
    kill("-KILL", before);
    let again = eventually("the agent has started it again", || match two.far() {
        now if now == before || now == 0 => Err(now),
        now => Ok(now),
    });
    kill("-CONT", u64::from(up.process.pid()));
    let now = up.await_back(before);
    assert_eq!((pid(&now), number(&now["restarts"])), (again, 1), "{now}");
    let chaos = up.grpc().component("far/c");
    assert_eq!(chaos["stopReason"], "STOP_REASON_RESTARTED", "what moves something waits: {chaos}");
}

#[test]
fn an_agent_that_is_killed_takes_along_what_it_keeps_and_the_next_one_starts_it_again() {
    let mut two = Two::new();
    let (up, before, listen) = (two.up(), two.far(), two.agent.address().to_owned());
    two.agent.kill();
    eventually("what it kept has ended", || if gone(before) { Ok(()) } else { Err("it runs") });
    two.agent = HostProcess::spawn(&two.world, "agent2", &agent_args(&two.world, &listen, &[]));
    let now = eventually("far is back", || match up.host("far") {
        now if now["state"] == "PROCESS_STATE_ATTACHED" && pid(&now) != before => Ok(now),
        now => Err(now),
    });
    assert!(number(&now["restarts"]) >= 1, "{now}");
    // A process that has lost its keeper ends in order, so that its components were stopped.
    let s = up.grpc().component("far/s");
    assert_eq!(s["stopReason"], "STOP_REASON_REQUESTED", "{s}");
    up.grpc().start("far/s");
    up.grpc().start("far/client");
    assert_eq!(up.grpc().state("far/s"), "ACTIVE");
    assert_eq!(up.grpc().state("near/server"), "ACTIVE", "nobody else was touched");
    up.grpc().invoke("near/server/Provided/Write", json!(3));
}

#[test]
fn what_an_up_that_was_killed_has_brought_up_ends() {
    let two = Two::new();
    let mut up = two.up();
    let far = two.far();
    up.process.kill();
    eventually("it ends", || if gone(far) { Ok(()) } else { Err(two.kept()) });
    two.await_none("the agent keeps nothing any more");
}

#[test]
fn another_run_of_a_system_takes_its_place_only_where_the_first_is_not_heard() {
    let two = Two::new();
    let up = two.up();
    let far = two.far();
    let another = json!({ "hello": { "system": "system", "run": "another" } });
    let refused = two.agent.grpcurl().refused("AgentService/Keep", another.clone());
    assert_eq!((refused.code, refused.reason.as_str()), ("ALREADY_EXISTS", "SYSTEM_KEPT"), "{refused}");
    assert!(refused.message.contains("user "), "it says for whom: {refused}");
    freeze(u64::from(up.process.pid()));
    eventually("it is silent for long enough", || {
        match two.agent.grpcurl().call("AgentService/Keep", another.clone()) {
            Ok(_) => Ok(()),
            Err(refused) => Err(refused.reason),
        }
    });
    assert!(gone(far), "what the first run had ends before another one has its place");
    kill("-CONT", u64::from(up.process.pid()));
}

#[test]
fn what_cannot_be_is_said_before_anything_is_started() {
    let two = Two::new();
    let trocar = Trocar::new(&two.world);
    let up = |far: Value| {
        let file = two.world.write("wrong.json", two.file_of(far)).display().to_string();
        trocar.run(&["up", &file, "--listen", "127.0.0.1:0"])
    };
    up(json!({ "machine": "crat" }))
        .ends_with(1)
        .says("machine \"crat\" is not in \"machines\"")
        .says("\"cart\"");
    let exec = json!({ "machine": "cart", "plugins": ["plugins"], "allow_exec": true });
    up(exec).says("without --allow-exec").says("process far did not come up");
    // Its machine has no plugin files.
    up(json!({ "machine": "cart" })).says("has no class `");
    up(json!({ "machine": "cart", "plugins": ["missing"] })).says("missing cannot be read");
    let mut nobody = two.file().replace(two.agent.address(), "127.0.0.1:1");
    let file = two.world.write("nobody.json", &nobody).display().to_string();
    let said = trocar.run(&["up", &file, "--listen", "127.0.0.1:0"]);
    said.says("the agent of the machine cart")
        .says("Connection refused")
        .says("trocar agent --listen 127.0.0.1:1");
    nobody = two.file().replace(two.agent.address(), "https://127.0.0.1:1");
    let file = two.world.write("nobody.json", &nobody).display().to_string();
    trocar.run(&["up", &file]).ends_with(2).says("--identity FILE");
    two.await_none("the agent keeps nothing");
}

#[test]
fn over_tls_each_shows_who_it_is_and_a_role_does_what_it_may() {
    let world = World::with_plugins(&["sine", "example", "fixture_chaos"]);
    std::fs::create_dir(world.path("elsewhere")).unwrap();
    let trocar = Trocar::new(&world);
    trocar.run(&["ca", "init"]).ends_with(0);
    for line in [
        "ca issue or1 --role gcm --process near --address 127.0.0.1",
        "ca issue cart --role host --process far --address 127.0.0.1",
        "ca issue vera --role viewer",
        "ca issue anna --role operator",
    ] {
        trocar.run(&line.split(' ').collect::<Vec<_>>()).ends_with(0);
    }
    let cart = world.path("cart.pem").display().to_string();
    let more = ["--identity", &cart, "--listen-tls", "127.0.0.1:0"];
    let agent = HostProcess::spawn(&world, "agent", &agent_args(&world, "127.0.0.1:0", &more));
    let secured = eventually("it says where other machines reach it", || {
        let printed = agent.printed();
        let behind = printed.split_once("https://").map(|(_, behind)| behind.to_owned());
        let found = behind.and_then(|behind| behind.split_whitespace().next().map(str::to_owned));
        found.ok_or(printed)
    });
    let two = Two { agent, world };
    let file = two.file().replace(two.agent.address(), &format!("https://{secured}"));
    let file = two.world.write("system.json", file);
    // A port that was free a moment ago.
    let free = TcpListener::bind("127.0.0.1:0").and_then(|held| held.local_addr()).unwrap().to_string();
    let or1 = two.world.path("or1.pem");
    let mut args: Vec<OsString> =
        ["up", "--listen", "127.0.0.1:0", "--json", "--listen-tls"].map(Into::into).to_vec();
    args.extend([free.into(), "--identity".into(), or1.into(), file.into()]);
    let up = Up { process: HostProcess::spawn(&two.world, "up", &args) };
    assert_eq!(up.grpc().state("far/client"), "ACTIVE");
    up.grpc().invoke("near/server/Provided/Write", json!(3));
    let as_who = |who: &str| Grpcurl::showing(&secured, &two.world.path(&format!("{who}.pem")));
    let kept = as_who("vera").ok("AgentService/ListSystems", json!({}));
    assert!(kept["systems"][0]["caller"].as_str().is_some_and(|by| by.contains("gcm or1")), "{kept}");
    let hello = json!({ "hello": { "system": "other", "run": "another" } });
    for who in ["vera", "anna", "cart"] {
        let refused = as_who(who).refused("AgentService/Keep", hello.clone());
        assert_eq!(refused.reason, "ROLE_FORBIDDEN", "{who}: {refused}");
    }
}
