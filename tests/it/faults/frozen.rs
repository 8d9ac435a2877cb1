//! Processes that stand still (SIGSTOP: a debugger, a paused machine) while commands wait in them.
//!
//! Promise: what waited longer than its deadline is not carried out when the process goes on, and its caller
//! hears so.

use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Trocar, World, eventually, number};

use crate::processes::system::{System, freeze, kill, pid};

/// Exit codes of the command line: no GCM answers, or not in time.
const NO_GCM: i32 = 3;
const TIMED_OUT: i32 = 4;
/// Deadline of the commands that wait.
const DEADLINE: Duration = Duration::from_millis(300);
/// Commands of each kind that wait.
const WAITING: u64 = 4;
/// The number that is written while nothing stands still; older commands write others.
const NOW: f64 = 7.0;
/// Functions and ways of the client `conform/Client`: it sends, or calls.
const WRITE: u32 = 1;
const SEND: u32 = 0;
const CALL: u32 = 1;
/// Places of its tally, which counts outcomes.
const QUEUED: usize = 0;
const EXECUTED: usize = 1;
const EXPIRED: usize = 8;

/// Stands still for twice the deadline, once `meanwhile` has begun what waits.
fn frozen<R>(pid: u64, meanwhile: impl FnOnce() -> R) -> R {
    freeze(pid);
    let answer = meanwhile();
    let since = Instant::now();
    eventually("the deadline is over", || {
        let waited = since.elapsed();
        if waited > 2 * DEADLINE { Ok(()) } else { Err(format!("{waited:?}")) }
    });
    answer
}

/// The client's tally of `times` calls in as many threads, or sends in one.
fn perform(grpc: &Grpcurl, client: &str, how: u32, first: u32, times: u64) -> Value {
    let (threads, times) = if how == CALL { (times, 1) } else { (0, times) };
    let order = json!({
        "what": WRITE, "how": how, "threads": threads, "times": times, "arg": first, "deadline_ns": DEADLINE.as_nanos() as u64
    });
    let body = json!({ "path": format!("{client}/run/perform"), "json": order, "deadline": "40s" });
    grpc.ok("InteractService/Invoke", body)["json"].clone()
}

/// Commands that ended with this outcome.
fn count(tally: &Value, outcome: usize) -> u64 {
    number(&tally["counts"][outcome])
}

/// This figure of all connections together.
fn figure(grpc: &Grpcurl, name: &str) -> u64 {
    let list = grpc.ok("GcmService/List", json!({}));
    let all = list["connections"].as_array().cloned().unwrap_or_default();
    all.iter().map(|connection| number(&connection[name])).sum()
}

/// The numbers a server was given and has carried out, in order.
fn seen(grpc: &Grpcurl, server: &str) -> Vec<f64> {
    let row = grpc.ok("InteractService/Read", json!({ "path": server }));
    let seen = row["json"]["seen"].as_array().cloned().unwrap_or_default();
    seen.iter().filter_map(Value::as_f64).collect()
}

/// A number that is written now comes through, and no other one did.
fn only_what_comes_now_is_carried_out(grpc: &Grpcurl, [client, server]: [&str; 2]) {
    eventually("a command of now is carried out", || match perform(grpc, client, CALL, NOW as u32, 1) {
        tally if count(&tally, EXECUTED) == 1 => Ok(()),
        tally => Err(tally),
    });
    let seen = seen(grpc, server);
    assert!(seen.iter().all(|value| *value == NOW), "an old command was carried out: {seen:?}");
}

#[test]
fn commands_that_waited_in_a_frozen_process_beyond_their_deadline_are_answered_and_never_carried_out() {
    let world = World::with_plugins(&["fixture_conform"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    let gate = world.path("gate");
    let config = json!({ "gate": gate });
    let stepping = json!({ "model": "on_signal" });
    grpc.create_with("host/server", "fixture-conform/Server", config, stepping);
    for client in ["host/sends", "host/calls"] {
        grpc.create(client, "fixture-conform/Client", json!({}));
        grpc.connect(&format!("{client}/peer"), "host/server/ctl");
    }
    for path in ["host/server", "host/sends", "host/calls"] {
        grpc.start(path);
    }
    thread::scope(|scope| {
        // The server is held up, so that what is asked of it waits.
        let hold = json!({ "path": "host/server/ctl/hold", "deadline": "40s" });
        scope.spawn(|| grpc.call("InteractService/Invoke", hold));
        eventually("the server is held up", || {
            let waiting = world.path("gate.waiting");
            if waiting.exists() { Ok(()) } else { Err("nobody waits at the gate") }
        });
        let sent = perform(&grpc, "host/sends", SEND, 20, WAITING);
        assert_eq!(count(&sent, QUEUED), WAITING, "{sent}");
        let called = scope.spawn(|| perform(&grpc, "host/calls", CALL, 30, WAITING));
        eventually("all of them wait", || match figure(&grpc, "passed") {
            n if n >= 2 * WAITING => Ok(()),
            n => Err(n),
        });
        frozen(u64::from(host.pid()), || world.write("gate", ""));
        kill("-CONT", u64::from(host.pid()));
        let called = called.join().expect("the client answers");
        assert_eq!(count(&called, EXPIRED), WAITING, "{called}");
    });
    only_what_comes_now_is_carried_out(&grpc, ["host/calls", "host/server"]);
    // A send has no answer: the connection counts what never ran.
    eventually("they are counted", || match figure(&grpc, "unexecuted") {
        WAITING => Ok(()),
        n => Err(n),
    });
}

/// A server in one process and who asks it in another.
const PAIR: &str = r#"{
  "version": 1,
  "processes": { "left": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] } },
  "components": {
    "left/server": { "class": "fixture-conform/Server", "execution": { "model": "on_signal" } },
    "right/client": { "class": "fixture-conform/Client" }
  },
  "connections": [{ "client": "right/client/peer", "server": "left/server/ctl" }]
}"#;

#[test]
fn commands_sent_to_a_frozen_process_are_not_carried_out_when_it_goes_on() {
    let system = System::up_with(&["fixture_conform"], PAIR, &[]);
    let grpc = &system.grpc;
    only_what_comes_now_is_carried_out(grpc, ["right/client", "left/server"]);
    let left = pid(&system.host("left"));
    let (sent, called) = frozen(left, || {
        let sent = perform(grpc, "right/client", SEND, 20, WAITING);
        (sent, perform(grpc, "right/client", CALL, 30, WAITING))
    });
    kill("-CONT", left);
    // A process that stands still is lost after a few heartbeats: its callers hear the one or the other.
    assert_eq!(count(&called, EXECUTED), 0, "{called}");
    assert_eq!(count(&sent, EXECUTED), 0, "{sent}");
    only_what_comes_now_is_carried_out(grpc, ["right/client", "left/server"]);
}

#[test]
fn a_host_that_stands_still_is_told_by_whoever_asks_it_and_nobody_waits_for_ever() {
    let world = World::with_plugins(&["sine"]);
    let host = HostProcess::start(&world);
    host.grpcurl().create("host/s", "sine", json!({}));
    let trocar = Trocar::at(&world, host.address());
    freeze(u64::from(host.pid()));
    let asked: [(&[&str], i32, &str); 4] = [
        (&["ls"], NO_GCM, "takes connections, and has said nothing"),
        (&["call", "host/s/system/get_state"], NO_GCM, "takes connections, and has said nothing"),
        (&["stop", "host/s"], NO_GCM, "takes connections, and has said nothing"),
        (
            &["wait", "host/s", "--state", "ACTIVE", "--deadline", "1s"],
            TIMED_OUT,
            "did not answer in the time",
        ),
    ];
    thread::scope(|scope| {
        for (args, exit, said) in asked {
            let trocar = &trocar;
            scope.spawn(move || trocar.run(args).ends_with(exit).says(said).says("kill -CONT"));
        }
    });
    kill("-CONT", u64::from(host.pid()));
    trocar.run(&["ls"]).ends_with(0).says("host/s");
}
