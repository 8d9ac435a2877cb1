//! Each way to fail, as whoever only looks hears of it: GetState, List, the events of the component.
//!
//! Promise: all of them tell one story: the state, the entry, the component's own words where it has a place
//! for them; and nobody else misses a cycle.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, Stream, eventually};

use super::super::ways::{clear, make, reach};
use super::Counted;

/// What its configuration says, the entry, and what is told of the fault.
const FAULTS: [(&str, &str, &str); 17] = [
    ("panic_in", "step", "step: panicked at"),
    ("error_in", "step", "step: chaos in step"),
    ("hang_in", "step", "it has not come back out of its step"),
    ("panic_in", "command", "command ctl/poke: panicked at"),
    ("hang_in", "command", "it has not come back out of its command ctl/poke"),
    ("panic_in", "start", "start: panicked at"),
    ("error_in", "start", "start: chaos in start"),
    ("panic_in", "stop", "stop: panicked at"),
    ("panic_in", "resume", "resume: panicked at"),
    ("panic_in", "make_safe", "make_safe: panicked at"),
    ("panic_in", "on_event", "on_event: panicked at"),
    ("hang_in", "on_event", "it has not come back out of its on_event"),
    ("panic_in", "on_service", "on_service: panicked (its words are in the log)"),
    ("hang_in", "on_service", "it has not come back out of its on_service"),
    ("hang_in", "callback", "it has not come back out of its callback"),
    ("panic_in", "describe", "describe: panicked (its words are in the log)"),
    ("panic_in", "bind", "bind: panicked at"),
];

/// What goes on as it was, what is told of it, and the events that tell it.
const MISHAPS: [(&str, &str, &str, &[&str]); 3] = [
    ("panic_in", "read", "its reads panicked and their callers got FAILED", &["error", "warning"]),
    ("error_in", "on_event", "the last one: chaos in on_event", &["warning"]),
    ("error_in", "on_service", "on_service: status -1 without a reason", &["error", "warning"]),
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

/// What of the story is in an item: an event by its name, or the state.
fn part(item: &Value, words: &str) -> Option<&'static str> {
    let path = item["path"].as_str().unwrap_or_default();
    if !item["json"].to_string().contains(words) {
        return None;
    }
    let in_fault = item["json"]["state"] == "FAULT";
    match path.rsplit('/').next() {
        Some("state_changed") => in_fault.then_some("state_changed"),
        Some("error") => Some("error"),
        Some("warning") => Some("warning"),
        _ => (item["kind"] == "ITEM_KIND_STATE" && in_fault).then_some("state"),
    }
}

/// Waits until all these parts were heard.
fn hear(items: &mut Stream, what: &str, words: &str, enough: impl Fn(&BTreeSet<&str>) -> bool) {
    let heard = RefCell::new(BTreeSet::new());
    items.until(what, |item| {
        heard.borrow_mut().extend(part(item, words));
        enough(&heard.borrow())
    });
}

/// All of them at the same time; paths differ from round to round, since a hang stays.
fn each_of<W: Sync>(scene: &Counted, ways: &[W], tell: impl Fn(&W, &str) + Sync) {
    let round = AtomicU32::new(0);
    scene.bystander.undisturbed_by("many ways to fail at once", || {
        let round = round.fetch_add(1, Ordering::Relaxed);
        thread::scope(|scope| {
            for (n, way) in ways.iter().enumerate() {
                let tell = &tell;
                scope.spawn(move || tell(way, &format!("host/c-{round}-{n}")));
            }
        });
    });
}

#[test]
fn state_list_and_events_tell_one_story_of_each_fault() {
    let scene = Counted::new();
    let grpc = &scene.grpc;
    each_of(&scene, &FAULTS, |(how, entry, words), path| {
        let (what, config) = (format!("the story of {how} {entry}: {words}"), json!({ *how: entry }));
        make(grpc, path, entry, &config);
        let mut items = follow(grpc, path);
        thread::scope(|scope| {
            // What it is told is the matter of other tests.
            scope.spawn(|| drop(reach(grpc, path, entry, &config)));
            hear(&mut items, &what, words, |heard| {
                let said = heard.contains("error") || heard.contains("warning");
                said && heard.contains("state") && heard.contains("state_changed")
            });
            let state = eventually(&format!("{path} is in FAULT"), || match grpc.component(path) {
                now if now["state"] == "COMPONENT_STATE_FAULT" => Ok(now),
                now => Err(now),
            });
            let list = grpc.ok("GcmService/List", json!({ "path": path }));
            let waited =
                grpc.ok("GcmService/WaitFor", json!({ "path": path, "states": ["COMPONENT_STATE_FAULT"] }));
            for shown in [&state, &list["components"][0], &waited["component"]] {
                assert_eq!(shown["path"], json!(path), "{shown}");
                assert_eq!(shown["state"], "COMPONENT_STATE_FAULT", "{what}: {shown}");
                assert!(shown["fault"].to_string().contains(words), "{what}: {shown}");
            }
            let health = if *how == "hang_in" { "HEALTH_UNRESPONSIVE" } else { "HEALTH_OK" };
            assert_eq!(state["health"], health, "{what}: {state}");
            clear(grpc, path).unwrap();
        });
    });
}

#[test]
fn what_is_no_fault_is_told_in_the_warnings_and_as_events() {
    let scene = Counted::new();
    let grpc = &scene.grpc;
    each_of(&scene, &MISHAPS, |(how, entry, words, events), path| {
        let (what, config) = (format!("the story of {how} {entry}: {words}"), json!({ *how: entry }));
        make(grpc, path, entry, &config);
        let mut items = follow(grpc, path);
        // A read is refused; nobody waits for the others.
        let _ = reach(grpc, path, entry, &config);
        hear(&mut items, &what, words, |heard| events.iter().all(|event| heard.contains(event)));
        scene.await_warning(path, words);
        let state = grpc.component(path);
        assert_eq!(state["state"], "COMPONENT_STATE_ACTIVE", "{what}: {state}");
        assert_eq!(state["health"], "HEALTH_OK", "{what}: {state}");
        scene.await_logged(path, &format!("chaos in {entry}"));
        clear(grpc, path).unwrap();
    });
}
