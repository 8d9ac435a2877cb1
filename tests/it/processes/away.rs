//! A process, or its GCM, that stands still for a while and then goes on.
//!
//! Promise: nothing in it was touched by that; but what somebody stopped meanwhile stands still from then on.

use std::collections::BTreeSet;

use serde_json::json;
use trocar_tests::{eventually, number};

use super::TWO;
use super::system::{System, connected, freeze, kill, pid};

#[test]
fn what_is_stopped_while_its_process_stands_still_is_stopped_when_that_goes_on() {
    let two = System::up(TWO, &[]);
    let before = two.hold("right");
    let refused = two.grpc.call("GcmService/Stop", json!({ "path": "right/c" })).unwrap_err();
    assert_eq!(refused.reason, "STOP_NOT_TOLD", "nobody could tell it: {refused}");
    let all = two.grpc.ok("GcmService/Stop", json!({ "paths": ["left/s", "right/c"] }));
    assert_eq!(all["failed"][0]["path"], "right/c", "the others are stopped: {all}");
    kill("-CONT", pid(&before));
    eventually("it is stopped", || {
        let actuator = two.grpc.component("right/c");
        let stopped = actuator["stopReason"] == "STOP_REASON_REQUESTED" && actuator["health"] == "HEALTH_OK";
        if stopped { Ok(()) } else { Err(actuator.to_string()) }
    });
    let steps = |path: &str| number(&two.grpc.component(path)["stats"]["executed"]);
    let (still, runs) = (steps("right/c"), steps("right/s"));
    eventually("the other one runs", || match steps("right/s") {
        now if now > runs => Ok(()),
        now => Err(now),
    });
    assert_eq!(steps("right/c"), still, "it moves on although it was stopped");
    two.grpc.ok("GcmService/Start", json!({ "path": "right/c" }));
    assert_eq!(two.grpc.state("right/c"), "ACTIVE");
}

#[test]
fn a_gcm_that_stood_still_has_its_processes_again_as_they_were() {
    let two = System::up(TWO, &[]);
    let before = (two.host("left"), two.host("right"));
    let paths = ["left/s", "right/s", "right/c"];
    let count = |path: &str| number(&two.grpc.component(path)["stats"]["executed"]);
    let steps = paths.map(count);
    let gcm = two.gcm_pid();
    for times in [1, 3] {
        let mut seen = [pid(&before.0), pid(&before.1)].map(|host| (host, connected(host), BTreeSet::new()));
        freeze(gcm);
        for (host, first, later) in &mut seen {
            eventually(&format!("it dials {times} times"), || {
                later.extend(connected(*host).difference(first).cloned());
                if later.len() >= times { Ok(()) } else { Err(format!("{later:?}")) }
            });
        }
        kill("-CONT", gcm);
        eventually(&format!("dialed {times} times, both are as they were"), || {
            let now = (two.host("left"), two.host("right"));
            if now == before { Ok(()) } else { Err(format!("{now:?}")) }
        });
    }
    for (path, before) in paths.iter().zip(steps) {
        assert_eq!(two.grpc.state(path), "ACTIVE", "{path}");
        assert!(count(path) > before, "{path} was made anew or stands still");
    }
}
