//! Streams of frames from a system file: filters that break, a branch that takes nothing, wires replaced
//! while frames flow.
//!
//! Promise: who is in FAULT is named with the frame it broke at, in state, List and events; every frame is
//! accounted for, the camera never lacks a slot, and a connection says how old its frames were.

use std::cell::Cell;

use serde_json::{Value, json};
use trocar_tests::{eventually, number};

use super::{Scene, says};

/// The frame both filters break at.
const BREAKS_AT: u64 = 5;

/// host/camera → bypassed → seen; → stopped → unseen; → trunk.
fn broken() -> Scene {
    let filter = |on_failure: &str| {
        json!({
            "class": "brittle",
            "config": { "fails_at": BREAKS_AT },
            "execution": { "stream_of": "host/camera", "on_failure": on_failure },
        })
    };
    let screen = json!({ "class": "screen", "execution": { "stream_of": "host/camera" } });
    let components = json!({
        "host/camera": { "class": "camera", "execution": { "model": "stream", "rate_hz": 200 }, "start": false },
        "host/bypassed": filter("bypass"),
        "host/stopped": filter("stop_branch"),
        "host/seen": screen,
        "host/unseen": screen,
        "host/trunk": screen,
    });
    let connections = json!([
        { "client": "host/bypassed/frame", "server": "host/camera/frame" },
        { "client": "host/seen/frame", "server": "host/bypassed/frame_out" },
        { "client": "host/stopped/frame", "server": "host/camera/frame" },
        { "client": "host/unseen/frame", "server": "host/stopped/frame_out" },
        { "client": "host/trunk/frame", "server": "host/camera/frame" },
    ]);
    Scene::run(&components, &connections)
}

#[test]
fn a_filter_that_breaks_is_bypassed_or_stops_its_branch_as_the_system_file_says() {
    let scene = broken();
    let mut events = ["host/bypassed", "host/stopped"].map(|path| (path, scene.follow(path, "error")));
    let mut policies = [
        ("host/bypassed", "frames pass it unchanged until Reset (on_failure bypass)"),
        ("host/stopped", "its branch stands still until Reset (on_failure stop_branch)"),
    ]
    .map(|(path, words)| (words, scene.follow(path, "warning")));
    scene.grpc.start("host/camera");
    for (words, events) in &mut policies {
        events.until(words, |item| says(item, words));
    }
    let words = format!("broke at frame {BREAKS_AT}");
    for (path, events) in &mut events {
        let (told, stands) = (Cell::new(false), Cell::new(false));
        events.until("that it broke, and that it is in FAULT", |item| {
            told.set(told.get() || says(item, &words));
            stands.set(stands.get() || item["json"]["fault"].to_string().contains(&words));
            told.get() && stands.get()
        });
        let listed = scene.listed(path);
        assert_eq!(listed["state"], "COMPONENT_STATE_FAULT", "{listed}");
        assert!(listed["fault"].to_string().contains(&words), "{listed}");
        let policy = if *path == "host/bypassed" { "bypass" } else { "stop_branch" };
        assert_eq!(listed["execution"]["onFailure"], policy, "{listed}");
    }
    let so_far = scene.count("host/seen", "last");
    scene.until("host/seen", "last", so_far.max(BREAKS_AT) + 20);
    scene.grpc.stop("host/camera");

    let made = scene.count("host/camera", "frames");
    assert_eq!(scene.count("host/camera", "exhausted"), 0, "frames go back to their pool");
    let seen = |path: &str| ["frames", "first", "last"].map(|field| scene.count(path, field));
    assert_eq!(seen("host/trunk"), [made, 1, made], "the trunk misses none");
    assert_eq!(seen("host/seen"), [made - 1, 1, made], "all but the one it broke at");
    assert_eq!(seen("host/unseen"), [BREAKS_AT - 1, 1, BREAKS_AT - 1], "none after it broke");
    for filter in ["host/bypassed", "host/stopped"] {
        assert_eq!(scene.count(filter, "passed"), BREAKS_AT - 1, "{filter}");
        assert_eq!(number(&scene.stats(filter)["executed"]), BREAKS_AT, "{filter} steps no more");
    }
    for client in ["bypassed", "seen", "unseen", "trunk"] {
        let connection = scene.connection(&format!("host/{client}/frame"));
        assert_eq!(number(&connection["dropped"]), 0, "{connection}");
    }
    assert_eq!(number(&scene.connection("host/seen/frame")["passed"]), made - 1);
    assert_eq!(number(&scene.connection("host/unseen/frame")["passed"]), BREAKS_AT - 1);
}

#[test]
fn a_broken_filter_that_is_reset_works_on_the_running_stream_again() {
    let scene = broken();
    scene.grpc.start("host/camera");
    for path in ["host/bypassed", "host/stopped"] {
        scene.grpc.await_state(path, "FAULT");
        scene.grpc.ok("GcmService/Reset", json!({ "path": path }));
        scene.grpc.ok("GcmService/Configure", json!({ "path": path, "config": { "fails_at": 0 } }));
        scene.grpc.start(path);
        scene.until(path, "passed", 10);
    }
    let (seen, unseen) = (scene.count("host/seen", "last"), scene.count("host/unseen", "last"));
    scene.until("host/seen", "last", seen + 10);
    scene.until("host/unseen", "last", unseen.max(BREAKS_AT) + 10);
    scene.grpc.stop("host/camera");
    let made = scene.count("host/camera", "frames");
    assert_eq!(scene.count("host/seen", "last"), made);
    assert_eq!(scene.count("host/unseen", "last"), made, "its branch goes on");
    assert_eq!(scene.count("host/trunk", "frames"), made, "the trunk missed none of it");
}

/// A camera at 200 frames a second, not started, and what else there is.
fn filmed(others: &[(&str, Value)], connections: &Value) -> Scene {
    let camera = json!({ "model": "stream", "rate_hz": 200 });
    let mut components = json!({ "host/camera": { "class": "camera", "execution": camera, "start": false } });
    for (path, component) in others {
        components[*path] = component.clone();
    }
    Scene::run(&components, connections)
}

fn of_camera(class: &str) -> Value {
    json!({ "class": class, "execution": { "stream_of": "host/camera" } })
}

#[test]
fn a_branch_whose_screen_takes_no_frames_costs_the_trunk_none() {
    let wire = |screen: &str, drop_oldest: bool| {
        let queue = json!({ "fifo": 64, "drop_oldest": drop_oldest });
        json!({ "client": format!("host/{screen}/frame"), "server": "host/camera/frame", "queue": queue })
    };
    let apart =
        json!({ "class": "screen", "start": false, "execution": { "model": "periodic", "rate_hz": 500 } });
    let others =
        [("host/trunk", of_camera("screen")), ("host/oldest", apart.clone()), ("host/newest", apart)];
    let trunk = json!({ "client": "host/trunk/frame", "server": "host/camera/frame" });
    let scene = filmed(&others, &json!([wire("oldest", true), wire("newest", false), trunk]));
    scene.grpc.start("host/camera");
    scene.until("host/trunk", "last", 100);
    scene.grpc.stop("host/camera");
    let made = scene.count("host/camera", "frames");
    assert_eq!(scene.count("host/camera", "exhausted"), 0);
    assert_eq!(["frames", "first", "last"].map(|f| scene.count("host/trunk", f)), [made, 1, made]);
    let trunk = scene.connection("host/trunk/frame");
    assert_eq!((number(&trunk["passed"]), number(&trunk["dropped"])), (made, 0), "{trunk}");
    let [half, most] = ["latencyP50Ns", "latencyP99Ns"].map(|field| number(&trunk[field]));
    assert!(0 < half && half <= most, "how old its frames were: {trunk}");
    for (screen, ends_with) in [("host/oldest", made), ("host/newest", 3)] {
        scene.grpc.start(screen);
        let client = format!("{screen}/frame");
        let connection = eventually(&format!("{screen} has all that waits"), || {
            let now = scene.connection(&client);
            if ["passed", "dropped", "skipped"].iter().map(|f| number(&now[f])).sum::<u64>() == made {
                Ok(now)
            } else {
                Err(now)
            }
        });
        let frames = scene.until(screen, "frames", number(&connection["passed"]));
        assert_eq!(frames, number(&connection["passed"]), "{connection}");
        assert!(frames > 1, "a queue of several: {connection}");
        assert_eq!(
            (scene.count(screen, "disorder"), scene.count(screen, "last").min(ends_with)),
            (0, ends_with)
        );
    }
}

#[test]
fn wires_that_are_replaced_while_frames_flow_cost_nothing_but_a_gap_each() {
    let others = [("host/filter", of_camera("brittle")), ("host/screen", of_camera("screen"))];
    let wires = json!([
        { "client": "host/filter/frame", "server": "host/camera/frame" },
        { "client": "host/screen/frame", "server": "host/camera/frame" },
    ]);
    let scene = filmed(&others, &wires);
    scene.grpc.start("host/camera");
    for round in 1..=20 {
        let last = scene.count("host/screen", "last");
        scene.until("host/screen", "last", last + 5);
        let server = if round % 2 == 1 { "host/filter/frame_out" } else { "host/camera/frame" };
        let request =
            json!({ "client": "host/screen/frame", "server": server, "options": { "replace": true } });
        scene.grpc.ok("GcmService/Connect", request);
    }
    let last = scene.count("host/screen", "last");
    // More than the pool has slots: none was lost on the way.
    scene.until("host/screen", "last", last + 20);
    scene.grpc.stop("host/camera");
    let made = scene.count("host/camera", "frames");
    assert_eq!(scene.count("host/camera", "exhausted"), 0);
    assert_eq!(scene.count("host/filter", "passed"), made, "the filter's own wire was left alone");
    let [first, last, disorder, jumps] =
        ["first", "last", "disorder", "jumps"].map(|field| scene.count("host/screen", field));
    assert_eq!((first, last, disorder), (1, made, 0));
    assert!(jumps <= 20, "{jumps} gaps at 20 replacements");
}
