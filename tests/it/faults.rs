//! A component that misbehaves in every entry it has.
//!
//! Promise: its fault stays its own: the host lives, the others miss no cycle, and Reset brings it back.

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually, number};

/// Entries of the class table that the chaos fixture can be told to fail in.
const ENTRIES: [&str; 4] = ["start", "step", "command", "stop"];

struct Bystander {
    grpc: Grpcurl,
    _host: HostProcess,
    _world: World,
}

impl Bystander {
    /// A host with a 1 kHz component beside which others may fail.
    fn new() -> Self {
        let world = World::with_plugins(&["sine", "fixture_chaos"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "sine");
        grpc.await_class("host", "chaos");
        grpc.create_with("host/s", "sine", json!({}), json!({ "model": "periodic", "rate_hz": 1000 }));
        grpc.start("host/s");
        Self { grpc, _host: host, _world: world }
    }

    fn counters(&self) -> (u64, u64) {
        let stats = self.grpc.component("host/s")["stats"].clone();
        (number(&stats["executed"]), number(&stats["skipped"]))
    }

    /// Checks that the bystander ran on: what it skipped stays within what this machine takes anyway.
    #[track_caller]
    fn assert_undisturbed(&self, before: (u64, u64)) {
        eventually("the bystander goes on", || {
            let now = self.counters();
            if now.0 > before.0 + 50 { Ok(()) } else { Err(format!("{before:?}, then {now:?}")) }
        });
        let now = self.counters();
        let (elapsed, skipped) = (now.0 - before.0, now.1 - before.1);
        assert!(skipped <= elapsed / 100 + 2, "the bystander skipped {skipped} of {elapsed} periods");
        assert_eq!(self.grpc.state("host/s"), "ACTIVE");
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
    let beside = Bystander::new();
    for entry in ENTRIES {
        let before = beside.counters();
        beside.provoke(entry, json!({ "panic_in": entry }));
        beside.grpc.await_state("host/c", "FAULT");
        let fault = beside.grpc.component("host/c")["fault"].to_string();
        assert!(fault.contains("panicked"), "panic in {entry}: {fault}");
        beside.assert_undisturbed(before);
        beside.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }));
    }
}

#[test]
fn a_panic_while_it_is_made_leaves_nothing_behind() {
    let beside = Bystander::new();
    let before = beside.counters();
    let body = json!({ "path": "host/c", "class": "chaos", "config": { "panic_in": "configure" } });
    let refused = beside.grpc.refused("GcmService/Create", body);
    assert!(refused.message.contains("panicked"), "{refused}");
    let left = beside.grpc.refused("GcmService/GetState", json!({ "path": "host/c" }));
    assert_eq!(left.reason, "COMPONENT_NOT_FOUND", "nothing half made");
    beside.assert_undisturbed(before);
}

#[test]
fn an_error_from_step_is_the_reason_of_the_fault() {
    let beside = Bystander::new();
    let before = beside.counters();
    beside.provoke("step", json!({ "error_in": "step" }));
    beside.grpc.await_state("host/c", "FAULT");
    let fault = beside.grpc.component("host/c")["fault"].to_string();
    assert!(fault.len() > 4, "the component's own words are kept: {fault}");
    beside.assert_undisturbed(before);
}

#[test]
fn reset_leads_from_fault_to_a_working_component() {
    let beside = Bystander::new();
    beside.provoke("step", json!({ "panic_in": "step" }));
    beside.grpc.await_state("host/c", "FAULT");
    let refused = beside.grpc.refused("GcmService/Start", json!({ "path": "host/c" }));
    assert_eq!(refused.reason, "WRONG_STATE", "{refused}");
    beside.grpc.ok("GcmService/Reset", json!({ "path": "host/c" }));
    assert_eq!(beside.grpc.state("host/c"), "READY");
    beside.grpc.ok("GcmService/Configure", json!({ "path": "host/c", "config": { "panic_in": null } }));
    beside.grpc.start("host/c");
    assert_eq!(beside.grpc.state("host/c"), "ACTIVE");
}

#[test]
fn a_component_that_hangs_in_step_blocks_neither_others_nor_the_control_plane() {
    let beside = Bystander::new();
    let before = beside.counters();
    beside.grpc.create("host/c", "chaos", json!({ "hang_in": "step" }));
    let _ = beside.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
    beside.assert_undisturbed(before);
    eventually("its health says that it does not answer", || {
        let component = beside.grpc.component("host/c");
        let health = component["health"].as_str().unwrap_or_default().to_owned();
        if health == "HEALTH_UNRESPONSIVE" || component["state"] == "COMPONENT_STATE_FAULT" {
            Ok(())
        } else {
            Err(health)
        }
    });
}
