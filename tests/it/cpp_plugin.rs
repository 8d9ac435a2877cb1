//! A plugin written in C++ against the C header, beside those written in Rust.
//!
//! Promise: the host cannot tell the languages apart; the ABI has not grown Rust-shaped.

mod filters;

use std::env;
use std::process::Command;

use serde_json::{Value, json};
use trocar_tests::{Built, HostProcess, Trocar, World, eventually, number, repository};

#[test]
fn the_coordinates_its_manifest_names_at_a_port_are_those_of_the_ports_vectors() {
    let world = World::new();
    world.drop_in(&Built::cpp_plugin("cpp_filter"));
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = grpc.await_class("host", "cpp_low_pass");
    let ports = &grpc.ok("GcmService/Describe", json!({ "class": class }))["class"]["ports"];
    let frames = |ty: &Value| {
        let fields = ty["structure"]["fields"].as_array().unwrap_or_else(|| panic!("{ty}"));
        fields.iter().map(|f| f["frame"].as_str().unwrap_or_default().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(frames(&ports["outputs"][0]["type"]["plain"]), ["", "sensor"]);
    assert_eq!(frames(&ports["inputs"][0]["type"]["plain"]), ["", ""]);
    assert_eq!(frames(&ports["provided"][0]["commands"][1]["ret"]), ["", "sensor"], "{ports}");
}

#[test]
fn the_arms_of_its_configuration_are_interfaces_whose_commands_and_reads_reach_the_right_one() {
    let world = World::new();
    world.drop_in(&Built::cpp_plugin("cpp_arms"));
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = grpc.await_class("host", "cpp_arms");
    grpc.create("host/arms", &class, json!({ "arms": ["left", "right"] }));
    grpc.ok("GcmService/Start", json!({ "path": "host/arms" }));
    let moved = grpc.ok("InteractService/Invoke", json!({ "path": "host/arms/arm_right/move", "json": 0.5 }));
    assert_eq!(moved["json"], 100.5, "{moved}");
    for (arm, goal) in [("left", 0.0), ("right", 0.5)] {
        let path = format!("host/arms/arm_{arm}/goal");
        let said = grpc.ok("InteractService/Invoke", json!({ "path": path }));
        assert_eq!(said["json"].as_f64().unwrap_or_default(), goal, "{arm}: {said}");
    }
    grpc.ok("GcmService/Configure", json!({ "path": "host/arms", "config": { "arms": ["right"] } }));
    let moved = grpc.ok("InteractService/Invoke", json!({ "path": "host/arms/arm_right/move", "json": 1 }));
    assert_eq!(moved["json"].as_f64(), Some(1.0), "it is the first one now: {moved}");
    let gone = grpc.refused("InteractService/Invoke", json!({ "path": "host/arms/arm_left/goal" }));
    assert_eq!(gone.reason, "INTERFACE_NOT_FOUND");
}

#[test]
fn poses_of_the_payload_header_are_those_of_rust_in_both_directions() {
    let world = World::with_plugins(&["eyerobot", "filters"]);
    let compiled = Command::new(env::var_os("CXX").unwrap_or_else(|| "c++".into()))
        .args([
            "-std=c++17",
            "-O2",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-fPIC",
            "-shared",
            "-fvisibility=hidden",
            "-I",
        ])
        .args([repository().join("sdk/c"), repository().join("tests/it/cpp_plugin/poses.cpp")])
        .arg("-o")
        .arg(world.path("libtrocar_poses.so"))
        .output()
        .unwrap();
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    world.drop_in(&world.path("libtrocar_poses.so"));
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    for (path, class) in [("host/robot", "eyerobot"), ("host/poses", "poses"), ("host/after", "resampler")] {
        let class = grpc.await_class("host", class);
        grpc.create(path, &class, json!({}));
    }
    grpc.connect("host/poses/from", "host/robot/measured_cp");
    grpc.connect("host/after/pose", "host/poses/to");
    grpc.ok("GcmService/Start", json!({ "path": "host/**" }));
    let echoed = Trocar::at(&world, host.address()).run(&["echo", "host/after/resampled_pose", "-n", "1"]);
    echoed.ends_with(0).says("orientation");
}

#[test]
fn its_configuration_is_checked_and_changed_while_it_runs() {
    let world = World::new();
    world.drop_in(&Built::cpp_plugin("cpp_filter"));
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = grpc.await_class("host", "cpp_low_pass");
    grpc.create("host/f", &class, json!({}));
    let refused: Value = json!({ "path": "host/f", "config": { "cutoff_hz": 100_000 } });
    assert_eq!(grpc.refused("GcmService/Configure", refused).reason, "CONFIG_INVALID");
    grpc.ok("GcmService/Configure", json!({ "path": "host/f", "config": { "cutoff_hz": 20 } }));
    assert_eq!(number(&grpc.component("host/f")["config"]["cutoff_hz"]), 20);
    eventually("the class is listed by its plugin", || {
        let plugins = grpc.plugins();
        let found = plugins.iter().any(|p| p["name"] == "cpp_filter" && p["loaded"] == true);
        if found { Ok(()) } else { Err(format!("{plugins:#?}")) }
    });
}
