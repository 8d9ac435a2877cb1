//! From a file dropped into a directory to a class that can be created, and what is refused on that way.
//!
//! Promise: a good plugin is offered by itself; every bad file is refused with its sentence; the running
//! system does not notice either.

#[path = "plugin_loading/archive.rs"]
mod archive;
#[path = "plugin_loading/bad_files.rs"]
mod bad_files;
#[path = "plugin_loading/counted.rs"]
mod counted;
#[path = "plugin_loading/hardware.rs"]
mod hardware;
#[path = "plugin_loading/helps.rs"]
mod helps;
#[path = "plugin_loading/leaving.rs"]
mod leaving;
#[path = "plugin_loading/linker.rs"]
mod linker;
#[path = "plugin_loading/reasons.rs"]
mod reasons;

use std::fs;

use serde_json::{Value, json};
use trocar_tests::{Built, Grpcurl, HostProcess, World, eventually, number};

#[test]
fn an_empty_host_offers_a_class_after_its_file_was_copied_in() {
    let world = World::new();
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    assert_eq!(grpc.classes("host"), Vec::<String>::new(), "a host starts with nothing in it");
    let refused = grpc.refused("GcmService/Create", json!({ "path": "host/robot", "class": "eyerobot" }));
    assert_eq!(refused.reason, "CLASS_NOT_FOUND");

    world.drop_in(&Built::plugin("eyerobot"));

    grpc.await_class("host", "eyerobot/eyerobot");
    let listed = plugin(&grpc, "libtrocar_eyerobot.so").unwrap_or_default();
    assert_eq!(listed["loaded"], false, "listing runs no byte of it: {listed}");
    grpc.create("host/robot", "eyerobot/eyerobot", json!({}));
    let listed = plugin(&grpc, "libtrocar_eyerobot.so").unwrap_or_default();
    assert_eq!(listed["loaded"], true, "{listed}");
}

#[test]
fn a_removed_file_takes_its_class_away_but_not_its_components() {
    let (world, _host, grpc) = with_a_sine();
    grpc.start("host/s");
    remove_sine(&world, &grpc);
    assert_advances(&grpc, "host/s");
}

#[test]
fn truncating_the_file_of_a_running_plugin_is_not_noticed_by_it() {
    let (world, _host, grpc) = with_a_sine();
    grpc.start("host/s");
    let file = world.plugins().join("libtrocar_sine.so");
    fs::OpenOptions::new().write(true).open(&file).unwrap().set_len(4096).unwrap();
    eventually("the shortened file is refused", || refused_file(&grpc, "libtrocar_sine.so").map(|_| ()));
    assert_advances(&grpc, "host/s");
    assert_eq!(grpc.state("host/s"), "ACTIVE");
}

#[test]
fn a_reset_says_that_it_keeps_the_code_of_before() {
    let (world, _host, grpc) = with_a_sine();
    let reset = || grpc.ok("GcmService/Reset", json!({ "path": "host/s" })).to_string();
    assert!(!reset().contains("was created with"), "the file is the same one");

    replace_sine(&world, &grpc);

    let told = reset();
    assert!(told.contains("was created with") && told.contains("remove and create host/s"), "{told}");
}

#[test]
fn a_component_whose_file_was_replaced_or_removed_is_made_anew_of_its_own_code_for_another_thread() {
    let (world, _host, grpc) = with_a_sine();
    grpc.start("host/s");
    let hash = |path: &str| {
        let told = grpc.ok("GcmService/Describe", json!({ "path": path }));
        told["class"]["hash"].as_str().unwrap_or_else(|| panic!("no hash: {told}")).to_owned()
    };
    let before = hash("host/s");
    replace_sine(&world, &grpc);

    let goes_on_at = |rate_hz: u32| {
        grpc.stop("host/s");
        grpc.ok("GcmService/Configure", json!({ "path": "host/s", "execution": { "rate_hz": rate_hz } }));
        grpc.start("host/s");
        assert_eq!(hash("host/s"), before, "its code changed without anybody asking for that");
        assert_advances(&grpc, "host/s");
    };
    goes_on_at(250);
    grpc.create("host/t", "sine", json!({}));
    assert_ne!(hash("host/t"), before, "a new component is of the new file");
    remove_sine(&world, &grpc);
    goes_on_at(500);
}

/// A host with a component `host/s` of the plugin `sine`, which does not run yet.
fn with_a_sine() -> (World, HostProcess, Grpcurl) {
    let world = World::with_plugins(&["sine"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "sine");
    grpc.create("host/s", "sine", json!({}));
    (world, host, grpc)
}

/// Removes the file of the plugin `sine`, and waits until the host has seen that.
fn remove_sine(world: &World, grpc: &Grpcurl) {
    fs::remove_file(world.plugins().join("libtrocar_sine.so")).unwrap();
    eventually("the class is gone", || match grpc.classes("host") {
        none if none.is_empty() => Ok(()),
        some => Err(some.join(", ")),
    });
}

/// Puts the same code with a byte behind it, which is another file, in place of the plugin `sine`.
fn replace_sine(world: &World, grpc: &Grpcurl) {
    let hash = || plugin(grpc, "libtrocar_sine.so").map(|p| p["hash"].clone());
    let (file, before) = (world.plugins().join("libtrocar_sine.so"), hash());
    let (mut bytes, newer) = (fs::read(&file).unwrap(), world.plugins().join("newer"));
    bytes.push(0);
    fs::write(&newer, bytes).unwrap();
    fs::rename(&newer, &file).unwrap();
    eventually("the newer file is listed", || match hash() {
        now if now.is_some() && now != before => Ok(()),
        now => Err(format!("{now:?}")),
    });
    grpc.await_class("host", "sine");
}

fn plugin(grpc: &Grpcurl, name: &str) -> Option<Value> {
    grpc.plugins().into_iter().find(|p| file_name(p) == name)
}

/// The sentence and the listing of a refused file.
fn refused_file(grpc: &Grpcurl, name: &str) -> Result<(String, Value), String> {
    let all = grpc.plugins();
    let found =
        all.iter().find(|p| file_name(p) == name).ok_or_else(|| format!("{name} is not listed: {all:#?}"))?;
    match found["refused"].as_str() {
        Some(sentence) if !sentence.is_empty() => Ok((sentence.to_owned(), found.clone())),
        _ => Err(format!("{name} is taken: {found}")),
    }
}

fn file_name(plugin: &Value) -> String {
    plugin["file"].as_str().unwrap_or_default().rsplit('/').next().unwrap_or_default().to_owned()
}

fn assert_advances(grpc: &Grpcurl, path: &str) {
    let before = number(&grpc.component(path)["stats"]["executed"]);
    eventually(&format!("{path} goes on"), || {
        let now = number(&grpc.component(path)["stats"]["executed"]);
        if now > before + 100 { Ok(()) } else { Err(format!("{before} steps, then {now}")) }
    });
}
