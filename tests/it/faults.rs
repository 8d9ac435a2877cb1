//! A component that misbehaves in every entry it has.
//!
//! Promise: its fault stays its own: the host lives, the others miss no cycle, and Reset brings it back.

use serde_json::{Value, json};
use trocar_tests::{Bystander, Grpcurl, HostProcess, World, eventually};

/// Entries of the class table that the chaos fixture can be told to fail in.
const ENTRIES: [&str; 4] = ["start", "step", "command", "stop"];

struct Scene {
    grpc: Grpcurl,
    bystander: Bystander,
    _host: HostProcess,
    _world: World,
}

impl Scene {
    /// A host with a 1 kHz component beside which others may fail.
    fn new() -> Self {
        let world = World::with_plugins(&["sine", "fixture_chaos"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "chaos");
        let bystander = Bystander::start(&grpc, "s");
        Self { grpc, bystander, _host: host, _world: world }
    }

    fn remove(&self) {
        self.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }));
    }

    /// Brings the chaos component to the entry it is told to fail in.
    fn provoke(&self, entry: &str, config: Value) {
        self.grpc.create("host/c", "chaos", config);
        let start = self.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
        match entry {
            "command" => {
                start.unwrap();
                let _ = self.grpc.call("InteractService/Invoke", json!({ "path": "host/c/ctl/poke" }));
            }
            "stop" => {
                start.unwrap();
                let _ = self.grpc.call("GcmService/Stop", json!({ "path": "host/c" }));
            }
            _ => drop(start),
        }
    }
}

#[test]
fn a_panic_in_any_entry_faults_its_component_alone() {
    let scene = Scene::new();
    for entry in ENTRIES {
        scene.bystander.undisturbed_by(&format!("a panic in {entry}"), || {
            scene.provoke(entry, json!({ "panic_in": entry }));
            scene.grpc.await_state("host/c", "FAULT");
            let fault = scene.grpc.component("host/c")["fault"].to_string();
            assert!(fault.contains("panicked"), "panic in {entry}: {fault}");
            scene.remove();
        });
    }
}

#[test]
fn a_panic_while_it_is_made_leaves_nothing_behind() {
    let scene = Scene::new();
    scene.bystander.undisturbed_by("a panic in configure", || {
        let body = json!({ "path": "host/c", "class": "chaos", "config": { "panic_in": "configure" } });
        let refused = scene.grpc.refused("GcmService/Create", body);
        assert!(refused.message.contains("panicked"), "{refused}");
        let left = scene.grpc.refused("GcmService/GetState", json!({ "path": "host/c" }));
        assert_eq!(left.reason, "COMPONENT_NOT_FOUND", "nothing half made");
    });
}

#[test]
fn an_error_from_step_is_the_reason_of_the_fault() {
    let scene = Scene::new();
    scene.bystander.undisturbed_by("an error from step", || {
        scene.provoke("step", json!({ "error_in": "step" }));
        scene.grpc.await_state("host/c", "FAULT");
        let fault = scene.grpc.component("host/c")["fault"].to_string();
        assert!(fault.contains("chaos in step"), "the component's own words are kept: {fault}");
        scene.remove();
    });
}

#[test]
fn reset_leads_from_fault_to_a_working_component() {
    let scene = Scene::new();
    scene.provoke("step", json!({ "panic_in": "step" }));
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
