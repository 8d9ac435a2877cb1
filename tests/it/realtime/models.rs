//! One system file with every way to get a thread, run by `trocar run`.
//!
//! Promise: List says where each component runs, and its figures are those of its model.

use serde_json::{Value, json};
use trocar_tests::{eventually, number};

use super::{Scene, accounts_for_every_period};

/// Calls of the device's thread after each start.
const RINGS: u64 = 40;

fn every_model() -> Scene {
    let pace = |execution: Value| json!({ "class": "pace", "execution": execution });
    let inside = |model: &str| pace(json!({ "model": model, "inside": "host/periodic" }));
    let components = json!({
        "host/periodic": pace(json!({ "model": "periodic", "rate_hz": 200 })),
        "host/before": inside("exec_in"),
        "host/after": inside("exec_out"),
        // Patience enough for a machine on which others run, too.
        "host/continuous": pace(json!({ "model": "continuous", "max_step_ms": 10_000 })),
        "host/on_signal": pace(json!({ "model": "on_signal" })),
        "host/on_callback": { "class": "phone", "config": { "rings": RINGS }, "execution": { "model": "on_callback" } },
        "host/stream": { "class": "camera", "execution": { "model": "stream", "rate_hz": 100 } },
        "host/filter": { "class": "brittle", "execution": { "stream_of": "host/stream" } },
        "host/screen": { "class": "screen", "execution": { "stream_of": "host/stream" } },
        "host/none": { "class": "key", "execution": { "model": "none" } },
    });
    let connections = json!([
        { "client": "host/filter/frame", "server": "host/stream/frame" },
        { "client": "host/screen/frame", "server": "host/filter/frame_out" },
    ]);
    Scene::run(&components, &connections)
}

#[test]
fn list_says_of_each_model_where_it_runs_and_each_has_its_figures() {
    let scene = every_model();
    for (name, thread) in [
        ("periodic", "own thread"),
        ("before", "inside host/periodic"),
        ("after", "inside host/periodic"),
        ("continuous", "own thread"),
        ("on_signal", "own thread"),
        ("on_callback", "threads of its device"),
        ("stream", "own thread"),
        ("filter", "stream of host/stream"),
        ("screen", "stream of host/stream"),
        ("none", "callers' threads"),
    ] {
        let listed = scene.listed(&format!("host/{name}"));
        assert_eq!(listed["stats"]["thread"], thread, "{listed}");
        assert_eq!(listed["state"], "COMPONENT_STATE_ACTIVE", "{listed}");
        scene.until_health(&format!("host/{name}"), "OK");
    }
    for path in ["host/periodic", "host/before", "host/after", "host/continuous"] {
        scene.until(path, "steps", 50);
    }
    scene.until("host/screen", "frames", 50);
    scene.grpc.stop("host/**");

    for path in ["host/periodic", "host/before", "host/after"] {
        accounts_for_every_period(&scene, path);
    }
    let executed = |name: &str| number(&scene.listed(&format!("host/{name}"))["stats"]["executed"]);
    let continuous = scene.listed("host/continuous")["stats"].clone();
    assert_eq!(executed("continuous"), scene.count("host/continuous", "steps"), "{continuous}");
    assert_eq!((number(&continuous["skipped"]), number(&continuous["overruns"])), (0, 0), "{continuous}");
    assert_eq!(executed("stream"), scene.count("host/stream", "frames"), "a frame in each step");
    assert_eq!(executed("filter"), scene.count("host/filter", "passed"), "a step for each frame");
    assert_eq!(executed("screen"), scene.count("host/screen", "frames"), "a step for each frame");
    assert_eq!(executed("on_signal"), 0, "nothing was there for it");
    assert_eq!(executed("none"), 0, "nobody called");
}

#[test]
fn whoever_runs_inside_another_steps_before_and_after_it_in_each_of_its_cycles() {
    let scene = every_model();
    let members = ["host/before", "host/periodic", "host/after"];
    let standing = || {
        // When the one around them stands still they do.
        scene.grpc.stop("host/periodic");
        members.map(|path| (number(&scene.stats(path)["executed"]), scene.count(path, "ticket")))
    };
    scene.until("host/after", "steps", 20);
    let first = standing();
    let around = scene.listed("host/before")["stats"]["thread"].clone();
    assert_eq!(around, "inside host/periodic, which is not ACTIVE: no steps");
    scene.grpc.ok("GcmService/Resume", json!({ "path": "host/periodic" }));
    scene.until("host/after", "steps", first[2].0 + 20);
    let second = standing();
    for cycle in [first, second] {
        assert!(cycle[0].1 < cycle[1].1 && cycle[1].1 < cycle[2].1, "before, in, after: {cycle:?}");
    }
    let steps = [0, 1, 2].map(|at| second[at].0 - first[at].0);
    assert!(steps[0] == steps[1] && steps[1] == steps[2], "as many steps each: {steps:?}");
}

#[test]
fn on_signal_steps_once_for_each_thing_that_is_there_and_none_never_steps() {
    let scene = every_model();
    for round in 1..=10 {
        scene.grpc.invoke("host/on_signal/ctl/poke", json!(1));
        scene.until("host/on_signal", "steps", round);
        assert_eq!(scene.count("host/on_signal", "steps"), round, "it sleeps until there is something");
        let turned = scene.grpc.invoke("host/none/ctl/release", Value::Null);
        assert_eq!(number(&turned), round, "run in its caller's thread");
    }
    // A step is counted when its cycle is over, which is after its row is there.
    scene.grpc.stop("host/on_signal");
    let stats = scene.listed("host/on_signal")["stats"].clone();
    assert_eq!((number(&stats["executed"]), number(&stats["commands"])), (10, 10), "{stats}");
    assert_eq!((number(&stats["skipped"]), number(&stats["overruns"])), (0, 0), "{stats}");
    let none = scene.listed("host/none")["stats"].clone();
    assert_eq!((number(&none["executed"]), number(&none["commands"])), (0, 10), "{none}");
}

#[test]
fn on_callback_steps_once_for_each_call_of_its_device() {
    let scene = every_model();
    let executed = || number(&scene.listed("host/on_callback")["stats"]["executed"]);
    let called = |rings: u64| {
        eventually("the device has called", || match executed() {
            now if now == rings => Ok(()),
            now => Err(format!("{now} of {rings}")),
        });
    };
    let rung = || number(&scene.grpc.invoke("host/on_callback/ctl/rung", Value::Null));
    called(RINGS);
    assert_eq!(rung(), RINGS);
    scene.grpc.stop("host/on_callback");
    scene.grpc.start("host/on_callback");
    // Figures are those since Start.
    called(RINGS);
    assert_eq!(rung(), 2 * RINGS);
    let sample = scene.grpc.ok("InteractService/Read", json!({ "path": "host/on_callback" }));
    assert_eq!(number(&sample["json"]["answered"]), 2, "{sample}");
    let stats = scene.listed("host/on_callback")["stats"].clone();
    assert_eq!((number(&stats["skipped"]), number(&stats["overruns"])), (0, 0), "{stats}");
    assert!(
        !stats["warnings"].to_string().contains("threads"),
        "its thread ended when it was stopped: {stats}"
    );
}
