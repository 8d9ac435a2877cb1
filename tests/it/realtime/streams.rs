//! A stream whose filters break, from a system file: one is bypassed, one stops its branch.
//!
//! Promise: both are in FAULT, named with the frame they broke at, in state, List and events; every frame is accounted for.

use std::cell::Cell;

use serde_json::json;
use trocar_tests::number;

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
