//! Bad manners of a component that neither fails nor hangs, beside one whose cycles are counted.
//!
//! Promise: each is named at whoever shows them, in its warnings and as an event, and nobody else misses a
//! cycle.

use serde_json::{Value, json};
use trocar_tests::{eventually, number};

use super::super::manners::is_warning;
use super::Counted;

impl Counted {
    fn silent_about(&self, path: &str) {
        let said = self.grpc.component(path)["stats"]["warnings"].to_string();
        for word in ["signal mask", "rounding mode", "working directory", "threads", "services", "flooded"] {
            assert!(!said.contains(word), "{path} did nothing: {said}");
        }
    }
}

#[test]
fn whoever_changes_its_thread_or_process_or_asks_from_its_step_is_named_and_nobody_else() {
    let scene = Counted::new();
    let cases = [
        (
            json!({ "rude": "rounding", "rude_in": "start" }),
            "start: it changed the rounding mode of its thread",
        ),
        (
            json!({ "rude": "rounding", "rude_in": "step" }),
            "step: it changed the rounding mode of its thread",
        ),
        (json!({ "rude": "sigmask", "rude_in": "start" }), "start: it changed the signal mask of its thread"),
        (json!({ "rude": "sigmask", "rude_in": "step" }), "the signal mask of its thread was changed"),
        (
            json!({ "rude": "cwd", "rude_in": "start" }),
            "start: it changed the working directory of the process",
        ),
        (
            json!({ "services_from_step": true }),
            "its step asked for services: refused, ask from a command or an event",
        ),
    ];
    scene.bystander.undisturbed_by("each of these manners", || {
        for (config, words) in &cases {
            scene.grpc.create("host/c", "chaos", config.clone());
            let mut events = scene.warnings_of("host/c");
            scene.grpc.start("host/c");
            scene.await_warning("host/c", words);
            events.until(words, |item| is_warning(item, words));
            assert_eq!(scene.grpc.state("host/c"), "ACTIVE", "it is named, not punished: {config}");
            scene.remove();
            scene.silent_about("host/s");
        }
    });
}

#[test]
fn a_step_that_changes_the_working_directory_is_named_and_the_directory_put_back() {
    let scene = Counted::new();
    let directory = || std::fs::read_link(format!("/proc/{}/cwd", scene.host.pid())).unwrap();
    let before = directory();
    scene.bystander.undisturbed_by("a step that changes the directory", || {
        scene.grpc.create("host/c", "chaos", json!({ "rude": "cwd", "rude_in": "step" }));
        let mut events = scene.warnings_of("host/c");
        scene.grpc.start("host/c");
        let words = "the working directory of the process was changed, which was put back";
        scene.await_warning("host/c", words);
        events.until(words, |item| is_warning(item, words));
        assert_eq!(directory(), before);
        assert_eq!(scene.grpc.state("host/c"), "ACTIVE", "it is named, not punished");
        scene.remove();
    });
}

#[test]
fn threads_that_ignore_stop_are_counted_and_named() {
    let scene = Counted::new();
    let mut round = 0;
    scene.bystander.undisturbed_by("a thread begun in each of three entries", || {
        for entry in ["start", "step", "command"] {
            // Another name each time: the threads stay, and they bear the name of whoever began them.
            round += 1;
            let path = format!("host/brood-{round}");
            scene.grpc.create(&path, "chaos", json!({ "rude": "threads", "rude_in": entry }));
            let mut events = scene.warnings_of(&path);
            scene.grpc.start(&path);
            if entry == "command" {
                scene.grpc.invoke(&format!("{path}/ctl/poke"), Value::Null);
            }
            eventually("it steps", || {
                let stats = scene.grpc.component(&path)["stats"].clone();
                if number(&stats["executed"]) > 1 { Ok(()) } else { Err(stats) }
            });
            scene.grpc.stop(&path);
            let words = "1 of its own threads still run after it was stopped: brood";
            scene.await_warning(&path, words);
            events.until(words, |item| is_warning(item, words));
            let removed = scene.grpc.ok("GcmService/Remove", json!({ "path": path, "force": true }));
            let said = removed["warnings"].to_string();
            assert!(said.contains("1 of its own threads still run"), "Remove says that it stays: {removed}");
            scene.silent_about("host/s");
        }
    });
}

#[test]
fn whoever_floods_a_peer_is_named_at_both_ends() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("a flood", || {
        scene.grpc.create("host/peer", "chaos", json!({}));
        scene.grpc.create("host/c", "chaos", json!({ "flood": 10_000 }));
        scene.grpc.connect("host/c/peer", "host/peer/ctl");
        let mut events = scene.warnings_of("host/c");
        scene.grpc.start("host/peer");
        scene.grpc.start("host/c");
        scene.await_warning("host/c", "it flooded host/peer with commands");
        scene.await_warning("host/peer", "its queue for commands from host/c was full");
        events.until("the flood", |item| is_warning(item, "it flooded host/peer with commands"));
        let peer = scene.grpc.component("host/peer");
        assert_eq!(peer["state"], "COMPONENT_STATE_ACTIVE", "who is flooded goes on: {peer}");
        scene.remove();
        scene.grpc.ok("GcmService/Remove", json!({ "path": "host/peer", "force": true }));
    });
}

#[test]
fn a_step_of_three_periods_is_overrun_in_health_and_as_an_event_and_counted() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("steps of three periods", || {
        scene.grpc.create("host/c", "chaos", json!({ "slow_step_ms": 30 }));
        let mut events = scene.warnings_of("host/c");
        scene.grpc.start("host/c");
        let words = "a cycle takes longer than its period (10 ms)";
        events.until(words, |item| is_warning(item, words));
        eventually("its health is OVERRUN and its overruns are counted", || {
            let component = scene.grpc.component("host/c");
            let counted = number(&component["stats"]["overruns"]) > 0;
            let shown =
                component["health"] == "HEALTH_OVERRUN" && component["state"] == "COMPONENT_STATE_ACTIVE";
            if counted && shown { Ok(()) } else { Err(component) }
        });
        scene.remove();
    });
}

#[test]
fn an_actuator_whose_step_takes_ten_periods_is_stuck_and_in_fault() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("steps of ten periods", || {
        // Five periods without progress are as good as no answer at all for what moves something.
        scene.grpc.create("host/c", "chaos", json!({ "slow_step_ms": 100 }));
        let mut events = scene.warnings_of("host/c");
        let _ = scene.grpc.call("GcmService/Start", json!({ "path": "host/c" }));
        scene.grpc.await_state("host/c", "FAULT");
        let fault = scene.grpc.component("host/c")["fault"].to_string();
        assert!(fault.contains("step") && fault.contains("ms"), "which entry, and for how long: {fault}");
        events.until("that it does not answer", |item| is_warning(item, "step"));
        scene.remove();
    });
}
