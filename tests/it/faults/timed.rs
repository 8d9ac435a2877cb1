//! The time until a hung actuator is seen beside hundreds of components that come to rest.
//!
//! Promise: at most 60 ms from the begin of the step it does not come back from, or as long as alone on the
//! same machine. Both moments are stamps of the host's clock; only `./tests/run --times` runs these tests.

use std::cell::Cell;

use serde_json::json;
use trocar_tests::{Grpcurl, HostProcess, World, number};

const STOPPED: usize = 400;
/// Periods that an actuator runs before it hangs: the others are stopped meanwhile and come to rest 200 ms
/// later, and one of these is beside it.
const GOOD_STEPS: [u64; 12] = [5, 10, 15, 20, 24, 28, 32, 36, 40, 50, 60, 80];
/// Period of the actuator.
const PERIOD_NS: u64 = 10_000_000;
const SEEN_MS: f64 = 60.0;

/// A host with so many running components, `host/many-0` and on.
fn host_with(others: usize) -> (World, HostProcess) {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let slow = json!({ "class": "sine", "execution": { "model": "periodic", "rate_hz": 10 } });
    let components: serde_json::Map<_, _> =
        (0..others).map(|n| (format!("host/many-{n}"), slow.clone())).collect();
    let system = json!({
        "version": 1,
        "processes": { "host": { "trust": "dev", "plugins": ["plugins"] } },
        "components": components,
    });
    let file = world.write("system.json", system.to_string());
    let args = ["run", "--listen", "127.0.0.1:0"].map(Into::into);
    let host = HostProcess::spawn(&world, "run", &[&args[..], &[file.into()]].concat());
    (world, host)
}

/// Milliseconds from the begin of a step that hangs until the world is told, while all others are stopped.
fn seen_ms(grpc: &Grpcurl, others: bool, good_steps: u64) -> f64 {
    let path = format!("host/hangs-{good_steps}");
    if others {
        grpc.start("host/many-*");
    }
    // A real-time priority, where the machine grants one, keeps its own steps in time.
    let config = json!({ "hang_in": "step", "good_steps": good_steps });
    grpc.create_with(&path, "chaos", config, json!({ "priority": 80 }));
    let selections = json!({ "selections": [
        { "path": format!("{path}/system/state_changed") },
        { "path": format!("{path}/steps_out"), "max_rate_hz": 1000 },
        { "path": path },
    ] });
    let mut told = grpc.stream("InteractService/Subscribe", &selections);
    told.until("the present state", |item| item["kind"] == "ITEM_KIND_STATE");
    grpc.start(&path);
    if others {
        grpc.stop("host/many-*");
    }
    // A sample is told at the end of its step: the step that hangs begins one period after the last one told.
    let (hangs_ns, seen_ns) = (Cell::new(0), Cell::new(0));
    told.until("the last sample and the fault", |item| {
        if item["kind"] == "ITEM_KIND_STREAM" && number(&item["json"]) == good_steps {
            hangs_ns.set(number(&item["stampNs"]) + PERIOD_NS);
        }
        if item["kind"] == "ITEM_KIND_EVENT" && item["json"].to_string().contains("FAULT") {
            seen_ns.set(number(&item["stampNs"]));
        }
        hangs_ns.get() > 0 && seen_ns.get() > 0
    });
    grpc.ok("GcmService/Remove", json!({ "path": path, "force": true }));
    (seen_ns.get() - hangs_ns.get()) as f64 / 1e6
}

fn all_seen_ms(others: usize) -> Vec<f64> {
    let (_world, host) = host_with(others);
    let grpc = host.grpcurl();
    grpc.await_class("host", "chaos");
    GOOD_STEPS.map(|good_steps| seen_ms(&grpc, others > 0, good_steps)).to_vec()
}

#[test]
fn a_hung_actuator_is_seen_within_60_ms_while_400_others_come_to_rest() {
    let worst = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
    let control = all_seen_ms(0);
    let beside = all_seen_ms(STOPPED);
    eprintln!("alone {control:.1?} ms, beside {STOPPED} that come to rest {beside:.1?} ms");
    let allowed = SEEN_MS.max(worst(&control));
    assert!(worst(&beside) <= allowed, "alone {control:.1?} ms, beside {STOPPED} others {beside:.1?} ms");
}
