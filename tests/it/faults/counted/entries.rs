//! A panic, and an error, in each entry of the class table.
//!
//! Promise: whoever fails is named with the entry and its own words, and nobody else misses a cycle.

use serde_json::json;
use trocar_tests::eventually;

use super::super::ways::{clear, make, reach};
use super::Counted;

const PATH: &str = "host/c";

/// Entries in which a panic is the end of trust, and what is said of them. Two have no place for a sentence.
const PANICS: [(&str, &str); 10] = [
    ("start", "start: panicked at"),
    ("step", "step: panicked at"),
    ("command", "command ctl/poke: panicked at"),
    ("stop", "stop: panicked at"),
    ("resume", "resume: panicked at"),
    ("make_safe", "make_safe: panicked at"),
    ("on_event", "on_event: panicked at"),
    ("on_service", "on_service: panicked (its words are in the log)"),
    ("describe", "describe: panicked (its words are in the log)"),
    ("bind", "bind: panicked at"),
];

/// Entries whose errors have a sentence, and how the component stands after one.
const ERRORS: [(&str, &str); 7] = [
    ("start", "FAULT"),
    ("step", "FAULT"),
    ("command", "ACTIVE"),
    ("stop", "FAULT"),
    ("resume", "FAULT"),
    ("make_safe", "FAULT"),
    ("on_event", "ACTIVE"),
];

#[test]
fn a_panic_in_any_entry_faults_its_component_alone() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("a panic in each entry", || {
        for (entry, words) in PANICS {
            let config = json!({ "panic_in": entry });
            make(&scene.grpc, PATH, entry, &config);
            // Its caller may be told of it, or of nothing where nobody waits; the state says it in any case.
            let _ = reach(&scene.grpc, PATH, entry, &config);
            scene.grpc.await_state(PATH, "FAULT");
            let fault = scene.grpc.component(PATH)["fault"].to_string();
            assert!(fault.contains(words), "panic in {entry}: {fault}");
            let own = format!("chaos in {entry}");
            if words.ends_with("in the log)") {
                scene.await_logged(PATH, &own);
            } else {
                assert!(fault.contains(&own), "its own words, panic in {entry}: {fault}");
            }
            clear(&scene.grpc, PATH).unwrap();
        }
    });
}

#[test]
fn a_panic_in_a_read_is_its_caller_s_refusal_and_named_at_the_component() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("a panic in a read", || {
        let config = json!({ "panic_in": "read" });
        make(&scene.grpc, PATH, "read", &config);
        let refused = reach(&scene.grpc, PATH, "read", &config).unwrap_err();
        assert!(refused.message.contains("chaos in read"), "{refused}");
        let component = scene.grpc.component(PATH);
        let said = component["stats"]["warnings"].to_string();
        assert!(said.contains("its reads panicked") && said.contains("chaos in read"), "{component}");
        // A read runs in its caller's thread and cannot have harmed the component.
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
        clear(&scene.grpc, PATH).unwrap();
    });
}

#[test]
fn an_error_in_a_read_is_its_caller_s_refusal_and_nothing_else() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("an error in a read", || {
        let config = json!({ "error_in": "read" });
        make(&scene.grpc, PATH, "read", &config);
        let refused = reach(&scene.grpc, PATH, "read", &config).unwrap_err();
        assert_eq!(refused.reason, "COMMAND_FAILED", "{refused}");
        assert!(refused.message.contains("chaos in read"), "{refused}");
        let component = scene.grpc.component(PATH);
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
        assert_eq!(component["health"], "HEALTH_OK", "it did as it was written to: {component}");
        assert!(!component["stats"]["warnings"].to_string().contains("read"), "{component}");
        clear(&scene.grpc, PATH).unwrap();
    });
}

#[test]
fn an_error_in_any_entry_is_told_in_the_component_s_own_words() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("an error in each entry", || {
        for (entry, state) in ERRORS {
            let config = json!({ "error_in": entry });
            make(&scene.grpc, PATH, entry, &config);
            let told = reach(&scene.grpc, PATH, entry, &config).err();
            let words = format!("chaos in {entry}");
            let component = eventually(&format!("the error in {entry} is told"), || {
                let component = scene.grpc.component(PATH);
                let said = format!("{told:?} {} {}", component["fault"], component["stats"]["warnings"]);
                if said.contains(&words) { Ok(component) } else { Err(format!("{told:?}, {component}")) }
            });
            let expected = format!("COMPONENT_STATE_{state}");
            assert_eq!(component["state"], expected, "an error in {entry}: {component}");
            clear(&scene.grpc, PATH).unwrap();
        }
    });
}

#[test]
fn a_panic_or_an_error_while_it_is_made_leaves_nothing_behind() {
    let scene = Counted::new();
    let cases = [
        ("chaos", json!({ "panic_in": "configure" }), "panicked"),
        ("chaos", json!({ "panic_in": "configure" }), "chaos in configure"),
        ("chaos", json!({ "error_in": "configure" }), "chaos in configure"),
        ("panics_in_create", json!({}), "panicked"),
        ("panics_in_create", json!({}), "chaos in create"),
        ("shifty", json!({ "panic_in": "describe" }), "describe: panicked (its words are in the log)"),
        ("shifty", json!({ "panic_in": "bind" }), "chaos in bind"),
    ];
    scene.bystander.undisturbed_by("failures while components are made", || {
        for (class, config, words) in &cases {
            let body = json!({ "path": PATH, "class": class, "config": config });
            let refused = scene.grpc.refused("GcmService/Create", body);
            assert!(refused.message.contains(words), "{class} {config}: {refused}");
            scene.is_gone(PATH, &format!("nothing half made of {class} {config}"));
        }
    });
    scene.await_logged(PATH, "chaos in describe");
}

#[test]
fn a_panic_while_it_is_destroyed_is_named_in_the_log_and_keeps_nobody() {
    let scene = Counted::new();
    let fresh = |verb: &str| scene.grpc.ok(&format!("GcmService/{verb}"), json!({ "path": PATH }));
    let mut panics = 0;
    let mut logged = || {
        panics += 1;
        eventually("the log names it once for each instance that was destroyed", || {
            let said = scene.host.printed();
            let named = said.lines().filter(|line| line.contains(PATH) && line.contains("chaos in drop"));
            if named.count() == panics { Ok(()) } else { Err(said) }
        });
    };
    scene.bystander.undisturbed_by("panics while components are destroyed", || {
        scene.grpc.create(PATH, "chaos", json!({ "panic_in": "drop", "error_in": "step" }));
        fresh("Start");
        scene.grpc.await_state(PATH, "FAULT");
        // The instance that failed panics when it goes; the one after it is as good as new.
        fresh("Reset");
        assert_eq!(scene.grpc.state(PATH), "READY");
        logged();
        let well = json!({ "path": PATH, "config": { "error_in": null } });
        scene.grpc.ok("GcmService/Configure", well);
        fresh("Start");
        assert_eq!(scene.grpc.state(PATH), "ACTIVE");
        let removed = scene.grpc.ok("GcmService/Remove", json!({ "path": PATH, "force": true }));
        scene.is_gone(PATH, &removed.to_string());
        logged();
    });
}

#[test]
fn a_panic_of_a_device_s_thread_inside_a_callback_is_named_in_the_log_and_leaves_the_component_open() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("a panic in a callback", || {
        scene.grpc.create(PATH, "panics_in_callback", json!({}));
        scene.grpc.start(PATH);
        scene.await_logged(PATH, "chaos in callback");
        // The thread was the device's and is gone; nobody is inside any more.
        scene.grpc.stop(PATH);
        scene.grpc.start(PATH);
        assert_eq!(scene.grpc.state(PATH), "ACTIVE");
        let removed = scene.remove();
        assert_eq!(removed["warnings"], json!([]), "{removed}");
    });
}
