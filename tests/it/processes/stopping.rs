//! Stop, whatever else is under way and whoever does not answer.
//!
//! Promise: what a Stop was answered with OK for stands still, and nothing that was asked before it sets
//! that in motion again.

use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, eventually, number};

use super::TWO;
use super::system::{System, freeze, kill, pid};

/// Steps that the actuator counts itself.
fn steps(two: &System, path: &str) -> u64 {
    number(&two.grpc.ok("InteractService/Read", json!({ "path": path }))["value"]["steps"])
}

fn stands(two: &System, path: &str, reason: &str) {
    eventually(&format!("{path} stands still"), || {
        let component = two.grpc.component(path);
        let stands = component["stopReason"] == reason && component["health"] == "HEALTH_OK";
        if stands { Ok(()) } else { Err(component.to_string()) }
    });
}

/// Nothing of it moves while another component steps on.
fn does_not_move(two: &System, path: &str) {
    let executed = || number(&two.grpc.component("right/s")["stats"]["executed"]);
    let (before, began) = (steps(two, path), executed());
    eventually("others run", || match executed() {
        now if now > began + 50 => Ok(()),
        now => Err(now),
    });
    assert_eq!(steps(two, path), before, "{path} moves");
}

#[test]
fn a_start_under_way_in_a_process_that_stands_still_sets_nothing_in_motion_afterwards() {
    let two = System::up(TWO, &[]);
    two.grpc.ok("GcmService/Stop", json!({ "path": "right/c" }));
    two.grpc.ok("GcmService/Configure", json!({ "path": "right/c", "config": { "slow_start_ms": 2000 } }));
    let before = steps(&two, "right/c");
    thread::scope(|scope| {
        let starting = scope.spawn(|| two.grpc.call("GcmService/Start", json!({ "path": "right/c" })));
        eventually("it is being started", || match two.grpc.component("right/c")["health"].as_str() {
            Some("HEALTH_UNRESPONSIVE") => Ok(()),
            other => Err(format!("{other:?}")),
        });
        let held = two.hold("right");
        starting.join().unwrap().unwrap_err();
        // It was READY when it was seen last, and nobody knows what became of the Start.
        let answer = two.grpc.ok("GcmService/Stop", json!({ "path": "right/**" }));
        let failed = answer["failed"].as_array().unwrap().iter();
        let failed: Vec<&str> = failed.filter_map(|f| f["path"].as_str()).collect();
        assert_eq!(failed, ["right/c", "right/s"], "{answer}");
        assert!(answer["failed"][0]["why"].to_string().contains("may be moving"), "{answer}");
        kill("-CONT", pid(&held));
    });
    eventually("the process is back", || match two.host("right") {
        now if now["state"] == "PROCESS_STATE_ATTACHED" => Ok(()),
        now => Err(now.to_string()),
    });
    stands(&two, "right/s", "STOP_REASON_REQUESTED");
    eventually("its start has come back", || match two.grpc.component("right/c")["health"].as_str() {
        Some("HEALTH_OK") => Ok(()),
        other => Err(format!("{other:?}")),
    });
    two.grpc.ok("GcmService/Start", json!({ "path": "right/s" }));
    does_not_move(&two, "right/c");
    assert_eq!(steps(&two, "right/c"), before, "it moved after the Stop");
    assert_eq!(two.grpc.state("right/c"), "READY");
    two.grpc.ok("GcmService/Start", json!({ "path": "right/c" }));
    assert_eq!(two.grpc.state("right/c"), "ACTIVE", "somebody who asks later starts it");
}

#[test]
fn names_that_are_not_there_keep_nothing_from_being_stopped() {
    let two = System::up(TWO, &[]);
    let paths = ["right/typo", "right/c", "wrong/c", "left/x*", "robot"];
    let answer = two.grpc.ok("GcmService/Stop", json!({ "paths": paths, "request_id": "one" }));
    let failed: Vec<&str> =
        answer["failed"].as_array().unwrap().iter().filter_map(|f| f["path"].as_str()).collect();
    assert_eq!(failed, ["right/typo", "wrong/c", "left/x*", "robot"], "{answer}");
    stands(&two, "right/c", "STOP_REASON_REQUESTED");
    // The same request once more is no answer from memory.
    two.grpc.ok("GcmService/Start", json!({ "path": "right/c" }));
    two.grpc.ok("GcmService/Stop", json!({ "paths": paths, "request_id": "one" }));
    stands(&two, "right/c", "STOP_REASON_REQUESTED");
    two.grpc.ok("GcmService/Start", json!({ "path": "right/c" }));
    two.trocar().run(&["stop", "right/c", "right/typo"]).ends_with(5).says("right/typo");
    stands(&two, "right/c", "STOP_REASON_REQUESTED");
    does_not_move(&two, "right/c");
}

#[test]
fn a_stop_at_the_host_counts_at_a_gcm_that_stood_still_meanwhile() {
    let two = System::up(TWO, &[]);
    let at_host = Grpcurl::new(two.host("right")["endpoint"].as_str().unwrap());
    let gcm = two.gcm_pid();
    freeze(gcm);
    let answer = at_host.ok("GcmService/Stop", json!({ "paths": ["right/typo", "right/c", "robot"] }));
    let failed: Vec<&str> =
        answer["failed"].as_array().unwrap().iter().filter_map(|f| f["path"].as_str()).collect();
    assert_eq!(failed, ["robot", "right/typo"], "{answer}");
    assert!(answer["warnings"].to_string().contains("past the GCM"), "{answer}");
    kill("-CONT", gcm);
    stands(&two, "right/c", "STOP_REASON_REQUESTED");
    does_not_move(&two, "right/c");
    // The GCM has answered it with a Stop of its own as soon as this is not refused any more.
    let mut said = Value::Null;
    eventually("it may be started again", || {
        said = match two.grpc.call("GcmService/Start", json!({ "path": "right/c" })) {
            Ok(_) => return Ok(()),
            Err(refused) => refused.to_string().into(),
        };
        Err(said.to_string())
    });
    assert_eq!(two.grpc.state("right/c"), "ACTIVE");
}

#[test]
fn a_process_is_there_for_a_stop_while_a_configuration_of_it_takes_long() {
    let two = System::up(TWO, &[]);
    two.grpc.ok("GcmService/Stop", json!({ "path": "right/c" }));
    thread::scope(|scope| {
        let hangs = json!({ "path": "right/c", "config": { "hang_in": "configure" } });
        let grpc = two.grpc.clone();
        let configuring = scope.spawn(move || grpc.call("GcmService/Configure", hangs));
        eventually("it hangs", || match two.grpc.component("right/c")["health"].as_str() {
            Some("HEALTH_UNRESPONSIVE") => Ok(()),
            other => Err(format!("{other:?}")),
        });
        kill("-KILL", two.gcm_pid());
        configuring.join().unwrap().unwrap_err();
    });
    eventually("the new GCM has the process", || match two.trocar().run(&["stop", "right/s"]) {
        stopped if stopped.code == 0 => Ok(()),
        refused => Err(refused.stderr),
    });
    stands(&two, "right/s", "STOP_REASON_REQUESTED");
}
