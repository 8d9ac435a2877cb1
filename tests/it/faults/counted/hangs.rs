//! A hang in each entry of the class table, and what others notice of it.
//!
//! Promise: whoever hangs is named with the entry while it lasts, the LCM answers, others are made, changed
//! and removed, and nobody else misses a cycle.

use std::thread;

use serde_json::{Value, json};

use super::super::hangs::{CHANGING, Names, RUNNING, each, hang};
use super::super::manners::is_warning;
use super::super::ways::{clear, make};
use super::Counted;

impl Counted {
    /// The LCM answers, and others are made, connected, run and removed.
    fn answers_beside(&self, path: &str) {
        let (one, other) = (format!("{path}-beside"), format!("{path}-its-peer"));
        for path in [&one, &other] {
            self.grpc.create(path, "chaos", json!({}));
        }
        self.grpc.connect(&format!("{one}/peer"), &format!("{other}/ctl"));
        self.grpc.start(&other);
        self.grpc.start(&one);
        self.grpc.invoke(&format!("{one}/ctl/poke"), Value::Null);
        self.grpc.stop(&one);
        self.grpc.ok("GcmService/List", json!({}));
        for path in [&one, &other] {
            clear(&self.grpc, path).unwrap();
        }
    }
}

#[test]
fn a_hang_in_a_running_entry_is_named_with_the_entry_and_holds_up_nobody_else() {
    let (scene, names) = (Counted::new(), Names::default());
    let hang_in = |entry: &'static str| {
        let path = names.next(entry);
        make(&scene.grpc, &path, entry, &json!({ "hang_in": entry }));
        let mut events = scene.warnings_of(&path);
        let caller = hang(&scene.grpc, &path, entry);
        let inside = if entry == "command" { "command ctl/poke, which may take 50 ms" } else { entry };
        let words = format!("it has not come back out of its {inside}");
        events.until(&words, |item| is_warning(item, &words));
        scene.grpc.await_state(&path, "FAULT");
        let component = scene.grpc.component(&path);
        assert_eq!(component["health"], "HEALTH_UNRESPONSIVE", "{component}");
        assert!(component["fault"].to_string().contains(&words), "{component}");
        scene.answers_beside(&path);
        let removed = clear(&scene.grpc, &path).unwrap();
        let said = format!("is removed, but its thread has not come back out of its own code ({entry})");
        assert!(removed["warnings"].to_string().contains(&said), "{removed}");
        scene.is_gone(&path, &removed.to_string());
        // Whatever it was told: it is not kept.
        drop(caller.join().unwrap());
    };
    scene.bystander.undisturbed_by("a hang in each entry of what runs", || each(&RUNNING, hang_in));
}

#[test]
fn a_hang_in_an_entry_somebody_waits_for_is_named_and_holds_up_nobody_else() {
    let (scene, names) = (Counted::new(), Names::default());
    let hang_in = |entry: &'static str| {
        let path = names.next(entry);
        let words = format!("it has not come back out of its {entry}");
        let events = (entry != "create").then(|| {
            make(&scene.grpc, &path, entry, &json!({ "hang_in": entry }));
            scene.warnings_of(&path)
        });
        let caller = hang(&scene.grpc, &path, entry);
        scene.await_logged(&path, &words);
        if let Some(mut events) = events {
            events.until(&words, |item| is_warning(item, &words));
            let component = scene.grpc.component(&path);
            assert_eq!(component["health"], "HEALTH_UNRESPONSIVE", "{component}");
            assert!(component["stats"]["warnings"].to_string().contains(&words), "{component}");
        }
        scene.answers_beside(&path);
        let removed = clear(&scene.grpc, &path);
        if entry == "create" {
            // The component is not there as long as it is being made.
            assert_eq!(removed.unwrap_err().reason, "COMPONENT_NOT_FOUND");
        } else {
            scene.is_gone(&path, &format!("{removed:?}"));
            let refused = caller.join().unwrap().unwrap_err();
            assert!(!refused.reason.is_empty(), "{refused}");
        }
    };
    scene.bystander.undisturbed_by("a hang in each entry that changes it", || each(&CHANGING, hang_in));
}

#[test]
fn a_make_safe_that_hangs_after_a_fault_is_named_beside_it() {
    let (scene, names) = (Counted::new(), Names::default());
    scene.bystander.undisturbed_by("a hang in make_safe after an error in step", || {
        let path = names.next("make_safe");
        scene.grpc.create(&path, "chaos", json!({ "error_in": "step", "hang_in": "make_safe" }));
        let mut events = scene.warnings_of(&path);
        let _ = scene.grpc.call("GcmService/Start", json!({ "path": path }));
        let words = "it has not come back out of its make_safe";
        events.until(words, |item| is_warning(item, words));
        scene.grpc.await_state(&path, "FAULT");
        let component = scene.grpc.component(&path);
        assert!(component["fault"].to_string().contains("step: chaos in step"), "{component}");
        assert_eq!(component["health"], "HEALTH_UNRESPONSIVE", "{component}");
        assert!(component["stats"]["warnings"].to_string().contains(words), "{component}");
        scene.answers_beside(&path);
        clear(&scene.grpc, &path).unwrap();
    });
}

#[test]
fn a_hang_while_it_is_destroyed_is_said_to_the_remover_who_does_not_wait_for_it() {
    let (scene, names) = (Counted::new(), Names::default());
    scene.bystander.undisturbed_by("a hang in destroy", || {
        let path = names.next("drop");
        scene.grpc.create(&path, "chaos", json!({ "hang_in": "drop" }));
        scene.grpc.start(&path);
        let removed = clear(&scene.grpc, &path).unwrap();
        let said = "is removed, but its thread has not come back out of its own code (destroy)";
        assert!(removed["warnings"].to_string().contains(said), "{removed}");
        scene.is_gone(&path, &removed.to_string());
        scene.answers_beside(&path);
        // The place is free again.
        scene.grpc.create(&path, "chaos", json!({}));
        scene.grpc.start(&path);
        clear(&scene.grpc, &path).unwrap();
    });
}

#[test]
fn a_reset_whose_old_instance_hangs_when_it_is_destroyed_is_named() {
    let (scene, names) = (Counted::new(), Names::default());
    scene.bystander.undisturbed_by("a hang in the destroy of a reset", || {
        let path = names.next("drop");
        scene.grpc.create(&path, "chaos", json!({ "hang_in": "drop", "error_in": "step" }));
        let mut events = scene.warnings_of(&path);
        let _ = scene.grpc.call("GcmService/Start", json!({ "path": path }));
        scene.grpc.await_state(&path, "FAULT");
        let (patient, at) = (scene.grpc.clone(), path.clone());
        let caller = thread::spawn(move || patient.call("GcmService/Reset", json!({ "path": at })));
        let words = "it has not come back out of its destroy";
        events.until(words, |item| is_warning(item, words));
        let component = scene.grpc.component(&path);
        assert_eq!(component["health"], "HEALTH_UNRESPONSIVE", "{component}");
        assert!(component["stats"]["warnings"].to_string().contains(words), "{component}");
        scene.answers_beside(&path);
        clear(&scene.grpc, &path).unwrap();
        let refused = caller.join().unwrap().unwrap_err();
        assert!(!refused.reason.is_empty(), "{refused}");
    });
}
