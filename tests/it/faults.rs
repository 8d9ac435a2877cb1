//! A component that misbehaves in every entry it has.
//!
//! Promise: its fault stays its own: the host lives, the others miss no cycle, and Reset brings it back.

mod counted;
mod frozen;
mod hangs;
mod manners;
mod refusals;
mod timed;
mod ways;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually};

/// A host with the plugins of those who misbehave.
struct Scene {
    grpc: Grpcurl,
    host: HostProcess,
    world: World,
}

impl Scene {
    /// A host in which nothing runs.
    fn empty() -> Self {
        let world = World::with_plugins(&["sine", "fixture_chaos", "fixture_echo"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "chaos");
        Self { grpc, host, world }
    }

    /// A host with a running component, `host/s`, beside which others may fail.
    fn new() -> Self {
        let scene = Self::empty();
        scene.grpc.await_class("host", "sine");
        scene.grpc.create("host/s", "sine", json!({}));
        scene.grpc.start("host/s");
        scene
    }

    fn remove(&self) -> Value {
        self.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }))
    }

    /// Makes the chaos component and starts it, whatever comes of it.
    fn provoke(&self, config: Value) {
        self.grpc.create("host/c", "chaos", config);
        let _ = self.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
    }

    /// Waits until a line of the log names the component and has these words.
    fn await_logged(&self, path: &str, words: &str) {
        eventually(&format!("the log names {path} with: {words}"), || {
            let said = self.host.printed();
            let named = said.lines().any(|line| line.contains(path) && line.contains(words));
            if named { Ok(()) } else { Err(said) }
        });
    }

    /// That there is none of this path.
    #[track_caller]
    fn is_gone(&self, path: &str, why: &str) {
        let left = self.grpc.refused("GcmService/GetState", json!({ "path": path }));
        assert_eq!(left.reason, "COMPONENT_NOT_FOUND", "{why}: {left}");
    }
}

#[test]
fn reset_leads_from_fault_to_a_working_component() {
    let scene = Scene::new();
    scene.provoke(json!({ "panic_in": "step" }));
    scene.grpc.await_state("host/c", "FAULT");
    let refused = scene.grpc.refused("GcmService/Start", json!({ "path": "host/c" }));
    assert_eq!(refused.reason, "WRONG_STATE", "{refused}");
    scene.grpc.ok("GcmService/Reset", json!({ "path": "host/c" }));
    assert_eq!(scene.grpc.state("host/c"), "READY");
    scene.grpc.ok("GcmService/Configure", json!({ "path": "host/c", "config": { "panic_in": null } }));
    scene.grpc.start("host/c");
    assert_eq!(scene.grpc.state("host/c"), "ACTIVE");
}

#[test]
fn a_component_that_hangs_in_step_can_be_removed_by_force() {
    let scene = Scene::new();
    scene.grpc.create("host/c", "chaos", json!({ "hang_in": "step" }));
    let _ = scene.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
    let removed = scene.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }));
    assert!(removed["warnings"].to_string().contains("thread"), "it says that the thread stays: {removed}");
    let left = scene.grpc.refused("GcmService/GetState", json!({ "path": "host/c" }));
    assert_eq!(left.reason, "COMPONENT_NOT_FOUND");
}

#[test]
fn a_component_that_hangs_in_step_is_shown_as_unresponsive_or_in_fault() {
    let scene = Scene::new();
    scene.grpc.create("host/c", "chaos", json!({ "hang_in": "step" }));
    let _ = scene.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
    eventually("its health says that it does not answer", || {
        let component = scene.grpc.component("host/c");
        let health = component["health"].as_str().unwrap_or_default().to_owned();
        if health == "HEALTH_UNRESPONSIVE" || component["state"] == "COMPONENT_STATE_FAULT" {
            Ok(())
        } else {
            Err(health)
        }
    });
}
