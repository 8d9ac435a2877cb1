//! A panic, and an error, in each entry of the class table.
//!
//! Promise: whoever fails is named with the entry and its own words, and nobody else misses a cycle.

use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, eventually};

use super::Scene;
use super::manners::is_warning;

/// Entries after Create that answer. An event handler has nobody to tell: it can only panic.
const ENTRIES: [&str; 6] = ["start", "step", "command", "stop", "resume", "make_safe"];

impl Scene {
    /// Makes the chaos component, brings it to the entry it is told to fail in, and answers what its caller was told.
    fn enter(&self, entry: &str, config: Value) -> Option<Failure> {
        let call = |verb: &str| self.grpc.call(verb, json!({ "path": "host/c" }));
        self.grpc.create("host/c", "chaos", config);
        if entry == "on_event" {
            self.grpc.create("host/peer", "chaos", json!({}));
            self.grpc.connect("host/c/peer", "host/peer/ctl");
            self.grpc.start("host/peer");
        }
        let started = call("GcmService/Start");
        let answer = match entry {
            "command" => self.grpc.call("InteractService/Invoke", json!({ "path": "host/c/ctl/poke" })),
            "on_event" => {
                self.grpc.invoke("host/peer/ctl/poke", Value::Null);
                started
            }
            "stop" | "make_safe" => call("GcmService/Stop"),
            "resume" => {
                call("GcmService/Stop").unwrap();
                call("GcmService/Resume")
            }
            _ => started,
        };
        answer.err()
    }

    fn clear(&self) {
        self.remove();
        let _ = self.grpc.call("GcmService/Remove", json!({ "path": "host/peer", "force": true }));
    }
}

#[test]
fn a_panic_in_any_entry_faults_its_component_alone() {
    let scene = Scene::new();
    for entry in ENTRIES.into_iter().chain(["on_event"]) {
        scene.bystander.undisturbed_by(&format!("a panic in {entry}"), || {
            scene.enter(entry, json!({ "panic_in": entry }));
            scene.grpc.await_state("host/c", "FAULT");
            let fault = scene.grpc.component("host/c")["fault"].to_string();
            assert!(fault.contains("panicked"), "panic in {entry}: {fault}");
            assert!(fault.contains(&format!("chaos in {entry}")), "its own words, panic in {entry}: {fault}");
            scene.clear();
        });
    }
}

#[test]
fn a_panic_in_a_read_is_its_caller_s_refusal_and_named_at_the_component() {
    let scene = Scene::new();
    scene.bystander.undisturbed_by("a panic in a read", || {
        scene.provoke(json!({ "panic_in": "read" }));
        let read = json!({ "path": "host/c/ctl/steps" });
        let refused = eventually("a read is refused", || {
            match scene.grpc.call("InteractService/Invoke", read.clone()) {
                Err(refused) => Ok(refused),
                Ok(answer) => Err(answer),
            }
        });
        assert!(refused.message.contains("chaos in read"), "{refused}");
        let component = scene.grpc.component("host/c");
        let said = component["stats"]["warnings"].to_string();
        assert!(said.contains("its reads panicked") && said.contains("chaos in read"), "{component}");
        // A read runs in its caller's thread and cannot have harmed the component.
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
        scene.clear();
    });
}

#[test]
fn an_error_in_a_read_is_its_caller_s_refusal_and_nothing_else() {
    let scene = Scene::new();
    scene.bystander.undisturbed_by("an error in a read", || {
        scene.provoke(json!({ "error_in": "read" }));
        let read = json!({ "path": "host/c/ctl/steps" });
        let refused = eventually("a read is refused", || {
            match scene.grpc.call("InteractService/Invoke", read.clone()) {
                Err(refused) => Ok(refused),
                Ok(answer) => Err(answer),
            }
        });
        assert_eq!(refused.reason, "COMMAND_FAILED", "{refused}");
        assert!(refused.message.contains("chaos in read"), "{refused}");
        let component = scene.grpc.component("host/c");
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
        assert_eq!(component["health"], "HEALTH_OK", "it did as it was written to: {component}");
        assert!(!component["stats"]["warnings"].to_string().contains("read"), "{component}");
        scene.clear();
    });
}

#[test]
fn an_error_in_any_entry_is_told_in_the_component_s_own_words() {
    let scene = Scene::new();
    scene.bystander.undisturbed_by("an error in each entry", || {
        for entry in ENTRIES {
            let told = scene.enter(entry, json!({ "error_in": entry }));
            let words = format!("chaos in {entry}");
            let component = eventually(&format!("the error in {entry} is told"), || {
                let component = scene.grpc.component("host/c");
                let said = format!("{told:?} {} {}", component["fault"], component["stats"]["warnings"]);
                if said.contains(&words) { Ok(component) } else { Err(format!("{told:?}, {component}")) }
            });
            let state = component["state"].as_str().unwrap_or_default();
            let expected =
                if entry == "command" { "COMPONENT_STATE_ACTIVE" } else { "COMPONENT_STATE_FAULT" };
            assert_eq!(state, expected, "an error in {entry}: {component}");
            scene.clear();
        }
    });
}

#[test]
fn a_panic_or_an_error_while_it_is_made_leaves_nothing_behind() {
    let scene = Scene::new();
    let cases = [
        ("chaos", json!({ "panic_in": "configure" }), "panicked"),
        ("chaos", json!({ "panic_in": "configure" }), "chaos in configure"),
        ("chaos", json!({ "error_in": "configure" }), "chaos in configure"),
        ("panics_in_create", json!({}), "panicked"),
        ("panics_in_create", json!({}), "chaos in create"),
    ];
    scene.bystander.undisturbed_by("failures in create and configure", || {
        for (class, config, words) in &cases {
            let body = json!({ "path": "host/c", "class": class, "config": config });
            let refused = scene.grpc.refused("GcmService/Create", body);
            assert!(refused.message.contains(words), "{class} {config}: {refused}");
            let left = scene.grpc.refused("GcmService/GetState", json!({ "path": "host/c" }));
            assert_eq!(left.reason, "COMPONENT_NOT_FOUND", "{class} {config}: nothing half made");
        }
    });
}

#[test]
fn a_hang_in_a_running_entry_is_named_with_the_entry_while_it_lasts() {
    let scene = Scene::new();
    let mut round = 0;
    for entry in ["step", "command"] {
        scene.bystander.undisturbed_by(&format!("a hang in {entry}"), || {
            // What hangs keeps its thread for good, so each round has a component of its own.
            round += 1;
            let path = format!("host/hanging-{round}");
            scene.grpc.create(&path, "chaos", json!({ "hang_in": entry }));
            let mut events = scene.warnings_of(&path);
            let (grpc, at) = (scene.grpc.clone(), path.clone());
            let caller = thread::spawn(move || {
                let call = |verb: &str, path: &str| drop(grpc.call(verb, json!({ "path": path })));
                call("GcmService/Start", &at);
                if entry == "command" {
                    call("InteractService/Invoke", &format!("{at}/ctl/poke"));
                }
            });
            let inside = if entry == "command" { "command ctl/poke, which may take" } else { entry };
            let words = format!("it has not come back out of its {inside}");
            events.until(&words, |item| is_warning(item, &words));
            scene.grpc.ok("GcmService/Remove", json!({ "path": path, "force": true }));
            caller.join().unwrap();
        });
    }
}

/// Brings a component of its own to the entry it never comes back out of; the last call waits for up to 60 s.
fn hang(grpc: &Grpcurl, path: &str, entry: &'static str) -> thread::JoinHandle<Result<Value, Failure>> {
    // grpcurl allows as much as the server does: 60 s.
    let patient = grpc.clone();
    let hanging = json!({ "hang_in": entry });
    let (verb, body) = match entry {
        "create" => ("Create", json!({ "path": path, "class": "hangs_in_create" })),
        "configure" => {
            grpc.create(path, "chaos", json!({}));
            ("Configure", json!({ "path": path, "config": hanging }))
        }
        _ => {
            grpc.create(path, "chaos", hanging);
            if entry == "stop" {
                grpc.start(path);
            }
            (if entry == "stop" { "Stop" } else { "Start" }, json!({ "path": path }))
        }
    };
    thread::spawn(move || patient.call(&format!("GcmService/{verb}"), body))
}

#[test]
fn a_hang_in_create_configure_start_or_stop_is_named_and_holds_up_nobody_else() {
    let scene = Scene::new();
    scene.grpc.create("host/peer", "chaos", json!({}));
    let mut round = 0;
    for entry in ["create", "configure", "start", "stop"] {
        scene.bystander.undisturbed_by(&format!("a hang in {entry}"), || {
            round += 1;
            let path = format!("host/hanging-{round}");
            let caller = hang(&scene.grpc, &path, entry);
            let words = format!("it has not come back out of its {entry}");
            eventually("the log names it with the entry", || {
                let said = scene.host.printed();
                let named = said.lines().any(|line| line.contains(&path) && line.contains(&words));
                if named { Ok(()) } else { Err(said) }
            });
            if entry != "create" {
                let component = scene.grpc.component(&path);
                assert_eq!(component["health"], "HEALTH_UNRESPONSIVE", "{component}");
                assert!(component["stats"]["warnings"].to_string().contains(&words), "{component}");
            }
            // The LCM answers, and others are changed, while the caller still waits.
            let other = format!("host/other-{round}");
            scene.grpc.create(&other, "chaos", json!({}));
            scene.grpc.connect(&format!("{other}/peer"), "host/peer/ctl");
            scene.grpc.start(&other);
            scene.grpc.stop(&other);
            scene.grpc.ok("GcmService/List", json!({}));
            scene.grpc.ok("GcmService/Remove", json!({ "path": other, "force": true }));
            let removed = scene.grpc.call("GcmService/Remove", json!({ "path": path, "force": true }));
            if entry == "create" {
                // It is not there as long as it is being made.
                assert_eq!(removed.unwrap_err().reason, "COMPONENT_NOT_FOUND");
            } else {
                let left = scene.grpc.refused("GcmService/GetState", json!({ "path": path }));
                assert_eq!(left.reason, "COMPONENT_NOT_FOUND", "{removed:?}");
                let refused = caller.join().unwrap().unwrap_err();
                assert!(!refused.reason.is_empty(), "{refused}");
            }
        });
    }
}
