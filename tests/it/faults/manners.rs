//! Bad manners of a component that neither fails nor hangs.
//!
//! Promise: each is named at the component that shows them, in its warnings and as an event, and at no other
//! one; `counted/manners.rs` says that nobody else misses a cycle.

use serde_json::{Value, json};
use trocar_tests::{Built, Stream, eventually};

use super::Scene;

impl Scene {
    /// Follows the warnings of a component that exists.
    pub(super) fn warnings_of(&self, path: &str) -> Stream {
        let selections =
            json!({ "selections": [{ "path": format!("{path}/system/warning") }, { "path": path }] });
        let mut stream = self.grpc.stream("InteractService/Subscribe", &selections);
        // The component's state is sent at once: from then on no event is missed.
        stream.until("the present state", |item| item["kind"] == "ITEM_KIND_STATE");
        stream
    }

    pub(super) fn await_warning(&self, path: &str, words: &str) {
        eventually(&format!("{path} is named with: {words}"), || {
            let component = self.grpc.component(path);
            let found = component["stats"]["warnings"].to_string().contains(words);
            if found { Ok(()) } else { Err(component.to_string()) }
        });
    }
}

pub(super) fn is_warning(item: &Value, words: &str) -> bool {
    item["kind"] == "ITEM_KIND_EVENT" && item["json"].to_string().contains(words)
}

#[test]
fn threads_of_one_that_is_removed_are_not_charged_to_the_next_of_its_name() {
    let scene = Scene::new();
    scene.provoke(json!({ "rude": "threads", "rude_in": "start" }));
    scene.grpc.stop("host/c");
    let words = "1 of its own threads still run";
    scene.await_warning("host/c", words);
    scene.remove();
    scene.grpc.create("host/c", "chaos", json!({}));
    scene.grpc.start("host/c");
    scene.grpc.stop("host/c");
    // Looked for when it is removed; by then the watchdog has looked, too, or never will.
    let removed = scene.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }));
    assert!(!removed["warnings"].to_string().contains("threads"), "those are of the one before: {removed}");
    // One that does it again is charged with its own alone.
    scene.provoke(json!({ "rude": "threads", "rude_in": "start" }));
    scene.grpc.stop("host/c");
    scene.await_warning("host/c", words);
}

#[test]
fn whoever_changes_the_environment_is_named_with_the_variables() {
    let scene = Scene::new();
    scene.provoke(json!({ "rude": "environment", "rude_in": "start" }));
    scene.await_warning("host/c", "start: it changed the environment of the process (LC_NUMERIC, PATH)");
    let others = scene.grpc.component("host/s")["stats"]["warnings"].to_string();
    assert!(!others.contains("environment"), "it did nothing: {others}");
    // A program the host starts has what the host was started with: a plugin that comes is tried out as ever.
    scene.world.drop_in(&Built::plugin("filters"));
    eventually("a plugin that comes later is offered", || {
        let classes = scene.grpc.ok("GcmService/Describe", json!({ "path": "host" }))["classes"].to_string();
        if classes.contains("filters") { Ok(()) } else { Err(classes) }
    });
    let said = scene.host.printed();
    assert_eq!(said.matches("changed the environment").count(), 1, "told once: {said}");
}
