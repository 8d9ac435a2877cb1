//! A plugin in C that has its thread take the smallest numbers for zero, as some libraries do for speed.
//!
//! Promise: that is put back before the code of anybody else runs on the thread, whichever entry did it, and
//! named at the component that did it.

use serde_json::{Value, json};

use super::household::{ENTRIES, Scene};

#[test]
fn small_numbers_flushed_to_zero_in_any_entry_are_put_back_for_all_on_the_thread_and_named() {
    let Some(scene) = Scene::new() else { return };
    for entry in ENTRIES {
        let what = format!("who flushes in {entry} is named");
        scene.grpc.create("host/u", "untidy", json!({ "does": "flush", "entry": entry }));
        // It steps on the same thread, after each step of the other.
        let behind = json!({
            "path": "host/behind", "class": "untidy", "execution": { "model": "exec_out", "inside": "host/u" },
        });
        scene.grpc.ok("GcmService/Create", behind);
        scene.grpc.start("host/behind");
        scene.grpc.start("host/u");
        scene.grpc.invoke("host/u/ctl/poke", Value::Null);
        let words = match entry {
            "command" => {
                "a command or event handler: it changed the rounding mode of its thread, which was put back"
            }
            "step" => "step: it changed the rounding mode of its thread, which was put back",
            _ => "start: it changed the rounding mode of its thread, which was put back",
        };
        scene.await_named(&what, &[words]);
        for path in ["host/u", "host/behind"] {
            let has = scene.answers(&format!("{path}/ctl/has_denormals"));
            assert_eq!(has, true, "{path} calculates as before, after a flush in {entry}");
        }
        let harmed = scene.answers("host/behind/ctl/stepped_without");
        assert_eq!(harmed, false, "host/behind stepped with the flush of {entry}");
        let said = scene.warnings("host/behind");
        assert!(!said.contains("rounding"), "host/behind did nothing: {said}");
        scene.grpc.ok("GcmService/Remove", json!({ "path": "host/behind", "force": true }));
        scene.remove();
    }
}

#[test]
fn a_command_that_flushes_small_numbers_to_zero_leaves_its_caller_as_it_was() {
    let Some(scene) = Scene::new() else { return };
    // One that runs in the threads of its callers.
    let passive = json!({
        "path": "host/u", "class": "untidy", "config": { "does": "flush", "entry": "command" },
        "execution": { "model": "none" },
    });
    scene.grpc.ok("GcmService/Create", passive);
    scene.grpc.create("host/caller", "untidy", json!({}));
    scene.grpc.connect("host/caller/other", "host/u/ctl");
    scene.grpc.start("host/u");
    scene.grpc.start("host/caller");
    let through = scene.answers("host/caller/ctl/through");
    assert_eq!(through, true, "the command ran inside the caller's, which still has small numbers");
    let words = "a command or event handler: it changed the rounding mode of its thread, which was put back";
    scene.await_named("who flushes in the thread of its caller is named", &[words]);
    let said = scene.warnings("host/caller");
    assert!(!said.contains("rounding"), "the caller did nothing: {said}");
    assert_eq!(scene.answers("host/caller/ctl/stepped_without"), false, "nor did its steps");
}
