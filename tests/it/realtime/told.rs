//! Each way to fail, as whoever only looks hears of it: GetState, List, the events of the component.
//!
//! Promise: all of them tell one story: the state, the entry, the component's own words.

use std::cell::RefCell;
use std::collections::BTreeSet;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Stream, World, eventually};

/// Configuration, what is called after Start, and what is told of it.
const WAYS: [(&str, &str, &str, &str); 7] = [
    ("panic_in", "step", "", "step: panicked"),
    ("error_in", "step", "", "step: chaos in step"),
    ("hang_in", "step", "", "it has not come back out of its step"),
    ("panic_in", "command", "poke", "command ctl/poke: panicked"),
    ("hang_in", "command", "poke", "it has not come back out of its command ctl/poke"),
    ("panic_in", "start", "", "start: panicked"),
    ("error_in", "start", "", "start: chaos in start"),
];

/// Follows all that a component says; from here on nothing is missed.
fn follow(grpc: &Grpcurl, path: &str) -> Stream {
    let events =
        ["state_changed", "error", "warning"].map(|e| json!({ "path": format!("{path}/system/{e}") }));
    let selections = [&events[..], &[json!({ "path": path })]].concat();
    let mut stream = grpc.stream("InteractService/Subscribe", &json!({ "selections": selections }));
    stream.until("the present state", |item| item["kind"] == "ITEM_KIND_STATE");
    stream
}

/// What of the story is in an item.
fn part(item: &Value, words: &str) -> Option<&'static str> {
    let (path, what) = (item["path"].as_str().unwrap_or_default(), item["json"].to_string());
    let told = what.contains(words);
    match path.rsplit('/').next() {
        Some("state_changed") if told && item["json"]["state"] == "FAULT" => Some("event state_changed"),
        Some("error" | "warning") if told => Some("event error or warning"),
        _ if item["kind"] == "ITEM_KIND_STATE" && told && item["json"]["state"] == "FAULT" => Some("state"),
        _ => None,
    }
}

#[test]
fn state_list_and_events_tell_one_story_of_each_fault() {
    let world = World::with_plugins(&["fixture_chaos"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "chaos");
    for (round, (how, entry, command, words)) in WAYS.into_iter().enumerate() {
        let path = format!("host/c-{round}");
        grpc.create(&path, "chaos", json!({ how: entry }));
        let mut items = follow(&grpc, &path);
        let _ = grpc.call("GcmService/Start", json!({ "path": path }));
        if !command.is_empty() {
            let called = json!({ "path": format!("{path}/ctl/{command}"), "deadline": "0.2s" });
            let _ = grpc.call("InteractService/Invoke", called);
        }
        let heard = RefCell::new(BTreeSet::new());
        items.until(&format!("the whole story of {how} {entry}: {words}"), |item| {
            heard.borrow_mut().extend(part(item, words));
            heard.borrow().len() == 3
        });
        let state = eventually(&format!("{path} is in FAULT"), || match grpc.component(&path) {
            now if now["state"] == "COMPONENT_STATE_FAULT" => Ok(now),
            now => Err(now),
        });
        let list = grpc.ok("GcmService/List", json!({ "path": path }));
        let waited =
            grpc.ok("GcmService/WaitFor", json!({ "path": path, "states": ["COMPONENT_STATE_FAULT"] }));
        for shown in [&state, &list["components"][0], &waited["component"]] {
            assert_eq!(shown["path"], json!(path), "{shown}");
            assert_eq!(shown["state"], "COMPONENT_STATE_FAULT", "{how} {entry}: {shown}");
            assert!(shown["fault"].to_string().contains(words), "{how} {entry}, {words}: {shown}");
        }
        let health = if how == "hang_in" { "HEALTH_UNRESPONSIVE" } else { "HEALTH_OK" };
        assert_eq!(state["health"], health, "{how} {entry}: {state}");
        grpc.ok("GcmService/Remove", json!({ "path": path, "force": true }));
    }
}
