//! Connections between processes as the control plane shows and keeps them.
//!
//! Promise: both halves are seen wherever the connection is, with why they are not linked; they go with it,
//! and come back with what ended; whatever does not fit is refused before anything is made.

#[path = "links/away.rs"]
mod away;
#[path = "links/looking.rs"]
mod looking;
#[path = "links/refusals.rs"]
mod refusals;
#[path = "links/wakes.rs"]
mod wakes;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, eventually, number};

use crate::processes::system::{System, kill, pid};

const PLUGINS: [&str; 5] = ["sine", "example", "fixture_echo", "fixture_conform", "fixture_chaos"];

/// A stream, commands and events from `left` to `right`.
const PAIR: &str = r#"{
  "version": 1,
  "processes": { "left": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] } },
  "components": {
    "left/s": { "class": "sine/sine" }, "left/server": { "class": "example/Server" },
    "right/e": { "class": "echo" }, "right/client": { "class": "example/Client" }
  },
  "connections": [
    { "client": "right/client/Required", "server": "left/server/Provided" },
    { "client": "right/e/sample", "server": "left/s/value" }
  ]
}"#;

fn pair() -> System {
    System::up_with(&PLUGINS, PAIR, &[])
}

fn connections(grpc: &Grpcurl) -> Vec<Value> {
    grpc.ok("GcmService/List", json!({}))["connections"].as_array().cloned().unwrap_or_default()
}

fn connection(grpc: &Grpcurl, client: &str) -> Value {
    let all = connections(grpc);
    let found = all.iter().find(|c| c["client"] == client);
    found.cloned().unwrap_or_else(|| panic!("no connection of {client}: {all:#?}"))
}

/// Both halves: the client's, the server's.
fn halves(connection: &Value) -> [Value; 2] {
    let proxies = connection["proxies"].as_array().cloned().unwrap_or_default();
    proxies.try_into().unwrap_or_else(|other| panic!("not two halves: {other:?}"))
}

fn is_linked(connection: &Value) -> bool {
    halves(connection).iter().all(|half| half["linked"] == true)
}

fn epoch(connection: &Value) -> u64 {
    number(&halves(connection)[0]["epoch"])
}

/// Waits until it is linked, under a higher number than `before`, and both halves have the same.
fn await_linked(grpc: &Grpcurl, client: &str, before: u64) -> Value {
    eventually(&format!("{client} is linked"), || {
        let now = connection(grpc, client);
        let same = halves(&now)[0]["epoch"] == halves(&now)[1]["epoch"];
        if is_linked(&now) && same && epoch(&now) > before { Ok(now) } else { Err(now.to_string()) }
    })
}

/// Waits until samples, commands or events pass.
fn await_flow(grpc: &Grpcurl, client: &str) {
    let passed = |c: &Value| number(&c["passed"]);
    let before = passed(&connection(grpc, client));
    eventually(&format!("something passes to {client}"), || match passed(&connection(grpc, client)) {
        now if now != before => Ok(()),
        now => Err(format!("{now} passed")),
    });
}

#[test]
fn what_is_removed_by_force_takes_both_halves_along() {
    let two = pair();
    let used = two.grpc.refused("GcmService/Remove", json!({ "path": "left/server" }));
    assert_eq!(used.reason, "IN_USE", "{used}");
    assert!(used.message.contains("right/client/Required"), "{used}");
    two.grpc.ok("GcmService/Remove", json!({ "path": "left/server", "force": true }));
    let left = connections(&two.grpc);
    assert_eq!(left.len(), 1, "{left:#?}");
    let client = two.grpc.ok("GcmService/GetState", json!({ "path": "right/client" }));
    assert_eq!(client["connections"], json!([]), "{client}");
    assert_eq!(client["component"]["health"], "HEALTH_STALE_INPUT", "what it requires is gone: {client}");
    // The place is free on both sides.
    two.grpc.create("left/server", "example/Server", json!({}));
    two.grpc.start("left/server");
    two.grpc.connect("right/client/Required", "left/server/Provided");
    await_linked(&two.grpc, "right/client/Required", 0);
    await_flow(&two.grpc, "right/client/Required");
    two.grpc.ok("GcmService/Remove", json!({ "path": "right/e", "force": true }));
    assert_eq!(connections(&two.grpc).len(), 1);
    assert_eq!(two.grpc.state("left/s"), "ACTIVE");
}

#[test]
fn ports_that_change_keep_what_still_fits_and_the_rest_goes_on_both_sides() {
    let file = r#"{
      "version": 1,
      "processes": { "left": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] } },
      "components": {
        "left/shelf": { "class": "Shelf", "config": { "slots": ["low", "high"] } },
        "right/a": { "class": "echo" }, "right/b": { "class": "echo" }
      }
    }"#;
    let two = System::up_with(&PLUGINS, file, &[]);
    two.grpc.connect("right/a/peer", "left/shelf/slot_low");
    two.grpc.connect("right/b/peer", "left/shelf/slot_high");
    let kept = await_linked(&two.grpc, "right/b/peer", 0);
    two.grpc
        .ok("GcmService/Configure", json!({ "path": "left/shelf", "config": { "slots": ["new", "high"] } }));
    eventually("one connection is left", || match connections(&two.grpc) {
        now if now.len() == 1 => Ok(()),
        now => Err(format!("{now:?}")),
    });
    let now = connection(&two.grpc, "right/b/peer");
    assert_eq!((&now["id"], epoch(&now)), (&kept["id"], epoch(&kept)), "nothing happened to it: {now}");
    two.grpc.invoke("right/b/ctl/pass_on", json!(7.0));
    await_held(&two.grpc, 7.0);
    // Both ends of what went are free.
    two.grpc.connect("right/a/peer", "left/shelf/slot_new");
    await_linked(&two.grpc, "right/a/peer", 0);
    // A link that is made anew after that is made by the ports of now.
    let right = two.host("right");
    kill("-KILL", pid(&right));
    two.await_back("right", &right);
    await_linked(&two.grpc, "right/b/peer", epoch(&kept));
    two.grpc.invoke("right/b/ctl/pass_on", json!(8.0));
    await_held(&two.grpc, 8.0);
}

/// Waits until the slot that stayed has a value.
fn await_held(grpc: &Grpcurl, value: f64) {
    eventually(&format!("the slot has {value}"), || {
        match grpc.invoke("left/shelf/slot_high/held", json!(null)) {
            held if held.as_f64() == Some(value) => Ok(()),
            held => Err(held.to_string()),
        }
    });
}

#[test]
fn a_reset_of_one_end_leaves_the_connection_as_it_was() {
    let two = pair();
    two.grpc.stop("left/server");
    two.grpc.ok("GcmService/Reset", json!({ "path": "left/server" }));
    two.grpc.start("left/server");
    let now = connection(&two.grpc, "right/client/Required");
    assert!(is_linked(&now), "{now}");
    await_flow(&two.grpc, "right/client/Required");
    two.grpc.stop("right/client");
    two.grpc.ok("GcmService/Reset", json!({ "path": "right/client" }));
    two.grpc.start("right/client");
    await_flow(&two.grpc, "right/client/Required");
}

#[test]
fn another_thread_for_one_end_makes_the_connection_anew() {
    let two = pair();
    let before = await_linked(&two.grpc, "right/e/sample", 0);
    two.grpc.stop("left/s");
    two.grpc.ok("GcmService/Configure", json!({ "path": "left/s", "execution": { "rate_hz": 200 } }));
    two.grpc.start("left/s");
    let after = await_linked(&two.grpc, "right/e/sample", epoch(&before));
    assert_eq!(after["id"], before["id"], "{after}");
    await_flow(&two.grpc, "right/e/sample");
}
