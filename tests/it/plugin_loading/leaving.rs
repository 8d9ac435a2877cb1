//! Libraries whose manifest says `unload` leave the process when nothing of them is left.
//!
//! Promise: not before: neither under a component nor under a thread.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use serde_json::json;
use trocar_tests::{Built, HostProcess, World, eventually, replace_in, skip};

use super::bad_files::filter_with;
use super::plugin;

/// A C++ plugin that may be unloaded; `extra` makes it another one.
fn unloadable(world: &World, extra: &str) -> Option<PathBuf> {
    let file = filter_with(world, "leaving.so", extra, &["-fno-gnu-unique", "-pthread"])?;
    let allows = b"\"unload\":true       ";
    let bytes = replace_in(&fs::read(&file).unwrap(), b"\"built_with\":\"C++17\"", allows);
    fs::write(&file, bytes).unwrap();
    Some(file)
}

/// The copies of it that are mapped into the host.
fn mapped(host: &HostProcess) -> BTreeSet<String> {
    let maps = fs::read_to_string(format!("/proc/{}/maps", host.pid())).unwrap();
    let files = maps.lines().filter_map(|line| line.split_whitespace().nth(5));
    files.filter(|file| file.ends_with("/cpp_filter.so")).map(str::to_owned).collect()
}

#[test]
fn a_version_that_was_replaced_leaves_the_process_with_its_last_component() {
    let world = World::new();
    let Some(first) = unloadable(&world, "") else { return skip("the plugin is made with a C++ compiler") };
    world.drop_in(&first);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = eventually("it is listed", || grpc.classes("host").pop().ok_or("not yet"));
    grpc.create("host/f", &class, json!({}));
    let old = mapped(&host);
    assert_eq!(old.len(), 1, "{old:?}");
    let hash = || plugin(&grpc, "leaving.so").unwrap_or_default()["hash"].clone();
    let before = hash();

    world.drop_in(&unloadable(&world, "int another_version = 2;").unwrap());

    eventually("the new version is listed", || if hash() != before { Ok(()) } else { Err("not yet") });
    grpc.create("host/g", &class, json!({}));
    assert_eq!(mapped(&host).len(), 2, "a component of the old version is there");
    grpc.ok("GcmService/Remove", json!({ "path": "host/f" }));
    eventually("the old version is gone", || match mapped(&host) {
        left if left.is_disjoint(&old) => Ok(()),
        left => Err(format!("{left:?}\n{}", host.printed())),
    });
    // A listed version stays, so that the next component finds it.
    grpc.ok("GcmService/Remove", json!({ "path": "host/g" }));
    assert_eq!(mapped(&host).len(), 1);
    fs::remove_file(world.plugins().join("leaving.so")).unwrap();
    eventually("nothing of it is left", || match mapped(&host) {
        none if none.is_empty() => Ok(()),
        left => Err(format!("{left:?}\n{}", host.printed())),
    });
}

#[test]
fn a_library_stays_as_long_as_a_thread_of_it_runs() {
    let world = World::new();
    let code = "#include <thread>\n#include <unistd.h>\n\
                __attribute__((constructor)) static void begin() { std::thread([] { for (;;) pause(); }).detach(); }";
    let Some(file) = unloadable(&world, code) else { return skip("the plugin is made with a C++ compiler") };
    world.drop_in(&file);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = eventually("it is listed", || grpc.classes("host").pop().ok_or("not yet"));
    grpc.create("host/f", &class, json!({}));
    grpc.ok("GcmService/Remove", json!({ "path": "host/f", "force": true }));
    fs::remove_file(world.plugins().join("leaving.so")).unwrap();
    // Each new class proves that the host has looked, and could have closed it.
    for (plugin, class) in [("sine", "sine"), ("example", "Server")] {
        world.drop_in(&Built::plugin(plugin));
        grpc.await_class("host", class);
    }
    assert_eq!(mapped(&host).len(), 1, "{}", host.printed());
}
