//! A component that misbehaves in every entry it has.
//!
//! Promise: its fault stays its own: the host lives, the others miss no cycle, and Reset brings it back.

mod entries;
mod hangs;
mod manners;
mod reads;
mod refusals;
mod told;
mod ways;

use serde_json::{Value, json};
use trocar_tests::{Bystander, Grpcurl, HostProcess, World, eventually};

struct Scene {
    grpc: Grpcurl,
    bystander: Bystander,
    host: HostProcess,
    _world: World,
}

impl Scene {
    /// A host with a 1 kHz component beside which others may fail.
    fn new() -> Self {
        let world = World::with_plugins(&["sine", "fixture_chaos", "fixture_echo"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "chaos");
        let bystander = Bystander::start(&grpc, "s");
        Self { grpc, bystander, host, _world: world }
    }

    fn remove(&self) -> Value {
        self.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }))
    }

    /// Makes the chaos component and starts it, whatever comes of it.
    fn provoke(&self, config: Value) {
        self.grpc.create("host/c", "chaos", config);
        let _ = self.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
    }
}

#[test]
fn an_error_from_step_is_the_reason_of_the_fault() {
    let scene = Scene::new();
    scene.bystander.undisturbed_by("an error from step", || {
        scene.provoke(json!({ "error_in": "step" }));
        scene.grpc.await_state("host/c", "FAULT");
        let fault = scene.grpc.component("host/c")["fault"].to_string();
        assert!(fault.contains("chaos in step"), "the component's own words are kept: {fault}");
        scene.remove();
    });
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
fn a_component_that_hangs_in_step_blocks_neither_others_nor_the_control_plane() {
    let scene = Scene::new();
    let mut round = 0;
    scene.bystander.undisturbed_by("a hanging step", || {
        round += 1;
        let path = format!("host/hanging-{round}");
        scene.grpc.create(&path, "chaos", json!({ "hang_in": "step" }));
        let _ = scene.grpc.call("GcmService/Start", json!({ "path": path }));
    });
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
