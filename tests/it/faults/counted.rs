//! Faults beside a 1 kHz component, whose cycles are counted.
//!
//! Promise: whatever another component does, it misses no cycle beyond those that a control run misses. The
//! counts judge what processors were given, so these tests have the machine for themselves.

mod entries;
mod hangs;
mod manners;
mod reads;
mod told;

use std::ops::{Deref, DerefMut};

use serde_json::json;
use trocar_tests::Bystander;

use super::Scene;

/// A host with a counted component, `host/s`, beside which others may fail.
struct Counted {
    scene: Scene,
    bystander: Bystander,
}

impl Counted {
    fn new() -> Self {
        let scene = Scene::empty();
        let bystander = Bystander::start(&scene.grpc, "s");
        Self { scene, bystander }
    }
}

impl Deref for Counted {
    type Target = Scene;

    fn deref(&self) -> &Scene {
        &self.scene
    }
}

impl DerefMut for Counted {
    fn deref_mut(&mut self) -> &mut Scene {
        &mut self.scene
    }
}

#[test]
fn an_error_from_step_is_the_reason_of_the_fault() {
    let scene = Counted::new();
    scene.bystander.undisturbed_by("an error from step", || {
        scene.provoke(json!({ "error_in": "step" }));
        scene.grpc.await_state("host/c", "FAULT");
        let fault = scene.grpc.component("host/c")["fault"].to_string();
        assert!(fault.contains("chaos in step"), "the component's own words are kept: {fault}");
        scene.remove();
    });
}

#[test]
fn a_component_that_hangs_in_step_blocks_neither_others_nor_the_control_plane() {
    let scene = Counted::new();
    let mut round = 0;
    scene.bystander.undisturbed_by("a hanging step", || {
        round += 1;
        let path = format!("host/hanging-{round}");
        scene.grpc.create(&path, "chaos", json!({ "hang_in": "step" }));
        let _ = scene.grpc.call("GcmService/Start", json!({ "path": path }));
    });
}
