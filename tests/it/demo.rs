//! The newcomer's first command.
//!
//! Promise: `trocar demo` runs the robot at 1 kHz and the video at 30 pairs/s from real plugins and real images, loses
//! nothing, and stops cleanly.

use std::ffi::OsString;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually, number, repository};

/// Periods of the robot in ten seconds, 1 kHz.
const PERIODS: u64 = 10_000;

#[test]
fn ten_seconds_of_demo_account_for_every_period_and_drop_no_frame() {
    let world = World::new();
    // The control run says how many periods this machine loses to others anyway.
    let control = skipped_by_a_lone_robot();
    let output = Trocar::new(&world)
        .in_dir(&repository())
        .run(&["demo", "--listen", "127.0.0.1:0", "--seconds", "10", "--json"])
        .ends_with(0);
    let figures = output.json();
    let (robot, video) = (&figures["robot"], &figures["video"]);

    let (executed, skipped) = (number(&robot["executed"]), number(&robot["skipped"]));
    assert!((executed + skipped).abs_diff(PERIODS) <= 1, "executed + skipped = periods elapsed: {figures}");
    let allowed = control + PERIODS / 1000;
    assert!(skipped <= allowed, "{skipped} periods skipped, {control} in the control run: {figures}");

    let pairs = number(&video["pairs"]);
    assert!(pairs.abs_diff(300) <= 3, "30 pairs/s for 10 s: {figures}");
    assert_eq!(number(&video["drops"]), 0, "{figures}");
}

#[test]
fn a_running_demo_answers_grpcurl_and_ends_cleanly_on_ctrl_c() {
    let world = World::new();
    let mut args: Vec<OsString> = ["demo", "--listen", "127.0.0.1:0", "--data"].map(OsString::from).to_vec();
    args.push(repository().join("tests/data/chessboard").into());
    let mut demo = HostProcess::spawn(&world, "demo", &args);
    let grpc = demo.grpcurl();
    let list = grpc.ok("GcmService/List", json!({}));
    let components = list["components"].as_array().cloned().unwrap_or_default();
    assert!(components.len() >= 5, "robot, client, source and filters: {list}");
    for component in &components {
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
    }
    assert!(demo.printed().contains("grpcurl"), "it prints lines to paste: {}", demo.printed());

    let status = demo.interrupt();
    assert!(status.success(), "a demo that was asked to end has succeeded: {status}\n{}", demo.printed());
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
