//! Losses of a demo on a machine that has nothing else to do.
//!
//! Promise: it misses no more periods than a robot alone does, and no picture.

use serde_json::{Value, json};
use trocar_tests::{HostProcess, World, eventually, number};

use super::measured;

/// Periods of the robot in ten seconds, 1 kHz.
const PERIODS: u64 = 10_000;

#[test]
fn ten_seconds_of_demo_miss_no_period_and_drop_no_frame_in_one_process_and_in_three() {
    // The control run says how many periods this machine loses to others anyway.
    let control = skipped_by_a_lone_robot();
    for processes in ["1", "3"] {
        let figures = measured(processes, "10");
        let (skipped, allowed) = (number(&figures["robot"]["skipped"]), control + PERIODS / 1000);
        assert!(skipped <= allowed, "{skipped} periods skipped, {control} in the control run: {figures}");
        // A processor that stands still for 33 ms costs a picture that nobody can take; what is taken is not
        // lost on its way.
        let video = &figures["video"];
        assert!(number(&video["left_out"]) <= 3, "pictures that were never taken: {figures}");
        assert_eq!(number(&video["drops"]), 0, "{figures}");
    }
}

/// Skipped periods of one robot alone for as many periods as the demo runs.
fn skipped_by_a_lone_robot() -> u64 {
    let world = World::with_plugins(&["eyerobot"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "eyerobot");
    grpc.create("host/robot", "eyerobot/eyerobot", json!({}));
    grpc.start("host/robot");
    let figures: Value = eventually("ten seconds of a robot alone", || {
        let stats = grpc.component("host/robot")["stats"].clone();
        let elapsed = number(&stats["executed"]) + number(&stats["skipped"]);
        if elapsed >= PERIODS { Ok(stats) } else { Err(format!("{elapsed} periods elapsed")) }
    });
    number(&figures["skipped"])
}
