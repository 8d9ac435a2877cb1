//! A class that opens a device, in a plugin that is listed, described, checked and vetted.
//!
//! Promise: no code of that class runs in any process before a component is made of it, and then only in its
//! host.

use std::fs;

use serde_json::{Value, json};
use trocar_tests::{Built, HostProcess, Trocar, World, eventually};

use super::plugin;

/// Marks that code of the class has left in the directory the host and its vetting child run in: entry and
/// process.
fn marks(world: &World) -> Vec<String> {
    let text = fs::read_to_string(world.path("device-marks")).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn no_code_of_a_hardware_class_runs_before_a_component_is_made_of_it() {
    let world = World::with_plugins(&["fixture_chaos"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = grpc.await_class("host", "device");
    let trocar = Trocar::at(&world, host.address());

    let described = grpc.ok("GcmService/Describe", json!({ "class": class }))["class"].clone();
    assert_eq!(described["hardware"], json!(true), "{described}");
    let other = grpc.ok("GcmService/Describe", json!({ "class": "wide" }))["class"].clone();
    assert_eq!(other["hardware"], json!(false), "{other}");
    let page = trocar.run(&["describe", &class]);
    assert!(page.stdout.contains("opens a device"), "{page:?}");
    assert_eq!(marks(&world), [""; 0], "described from its manifest");

    let file = Built::plugin("fixture_chaos").display().to_string();
    let checked = trocar.run(&["plugin", "check", &file]);
    assert_eq!(checked.code, 0, "{checked:?}");
    assert_eq!(marks(&world), [""; 0], "`plugin check` tries the file in a child process");

    grpc.create("host/wide", "wide", json!({}));
    grpc.start("host/wide");
    let loaded = plugin(&grpc, "libtrocar_fixture_chaos.so").unwrap_or_default();
    assert_eq!(loaded["loaded"], json!(true), "the file was tried in a child process and mapped: {loaded}");
    assert_eq!(marks(&world), [""; 0], "only the class that was asked for is made");

    // The mark is left when its code does run: in the host, and nowhere else.
    grpc.create("host/device", &class, json!({}));
    let described = grpc.ok("GcmService/Describe", json!({ "path": "host/device" }))["class"].clone();
    assert_eq!(described["hardware"], json!(true), "{described}");
    grpc.start("host/device");
    eventually("it steps", || {
        let left = marks(&world);
        if left.iter().any(|mark| mark.starts_with("step ")) { Ok(()) } else { Err(format!("{left:?}")) }
    });
    grpc.ok("GcmService/Remove", json!({ "path": "host/device", "force": true }));
    let in_host = |entry: &str| format!("{entry} {}", host.pid());
    let expected = ["create", "configure", "start", "step", "make_safe", "destroy"].map(in_host);
    assert_eq!(marks(&world), expected, "{}", Value::from(host.printed()));
}
