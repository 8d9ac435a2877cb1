//! From a file dropped into a directory to a class that can be created, and what is refused on that way.
//!
//! Promise: a good plugin is offered by itself; every bad file is refused with its sentence; the running system does not
//! notice either.

#[path = "plugin_loading/bad_files.rs"]
mod bad_files;
#[path = "plugin_loading/hardware.rs"]
mod hardware;

use std::fs;
use std::ops::Range;
use std::os::unix::fs::PermissionsExt;

use serde_json::{Value, json};
use trocar_tests::{Built, Bystander, Grpcurl, HostProcess, World, eventually, flip_bit, number};

/// Spoilt copies per kind.
const COPIES: usize = 200;

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
    let world = World::with_plugins(&["sine"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "sine");
    grpc.create("host/s", "sine", json!({}));
    grpc.start("host/s");
    fs::remove_file(world.plugins().join("libtrocar_sine.so")).unwrap();
    eventually("the class is gone", || match grpc.classes("host") {
        none if none.is_empty() => Ok(()),
        some => Err(some.join(", ")),
    });
    assert_advances(&grpc, "host/s");
}

#[test]
fn truncating_the_file_of_a_running_plugin_is_not_noticed_by_it() {
    let world = World::with_plugins(&["sine"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "sine");
    grpc.create("host/s", "sine", json!({}));
    grpc.start("host/s");
    let file = world.plugins().join("libtrocar_sine.so");
    fs::OpenOptions::new().write(true).open(&file).unwrap().set_len(4096).unwrap();
    eventually("the shortened file is refused", || refused_file(&grpc, "libtrocar_sine.so").map(|_| ()));
    assert_advances(&grpc, "host/s");
    assert_eq!(grpc.state("host/s"), "ACTIVE");
}

#[test]
fn two_hundred_truncations_are_refused_and_no_cycle_is_missed() {
    let world = World::with_plugins(&["sine"]);
    let good = fs::read(Built::plugin("eyerobot")).unwrap();
    let mut random = fastrand::Rng::with_seed(1);
    let cut = |n: usize, random: &mut fastrand::Rng| {
        let part: Range<usize> = n * good.len() / COPIES..(n + 1) * good.len() / COPIES;
        good[..random.usize(part)].to_vec()
    };
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    Bystander::start(&grpc, "s").undisturbed_by("truncated files", || {
        for n in 0..COPIES {
            drop_spoilt(&world, n, &cut(n, &mut random));
        }
        for file in &await_refusals(&grpc) {
            assert_eq!(file["refusedReason"], "PLUGIN_BAD_FILE", "{file}");
        }
        clear_spoilt(&world, &grpc);
    });
}

#[test]
fn two_hundred_bit_flips_are_refused_by_the_allow_list_and_no_cycle_is_missed() {
    let world = World::with_plugins(&["sine"]);
    // Under umask 002 copies are group-writable, which the allow list refuses.
    fs::set_permissions(world.plugins().join("libtrocar_sine.so"), fs::Permissions::from_mode(0o755))
        .unwrap();
    let list = world.write("allowed.json", allow_list(&world));
    let good = fs::read(Built::plugin("eyerobot")).unwrap();
    let mut random = fastrand::Rng::with_seed(2);
    let trust = format!("allowlist:{}", list.display());
    let host = HostProcess::start_with(&world, "host", &["--trust", &trust]);
    let grpc = host.grpcurl();
    Bystander::start(&grpc, "s").undisturbed_by("files with a flipped bit", || {
        for n in 0..COPIES {
            drop_spoilt(&world, n, &flip_bit(&good, random.usize(0..good.len() * 8)));
        }
        for file in &await_refusals(&grpc) {
            assert_eq!(file["refusedReason"], "PLUGIN_UNTRUSTED", "{file}");
        }
        assert_eq!(grpc.classes("host"), ["sine/sine"], "nothing but what the list names");
        clear_spoilt(&world, &grpc);
    });
}

fn drop_spoilt(world: &World, n: usize, bytes: &[u8]) {
    world.write(&format!("plugins/libtrocar_spoilt_{n:03}.so"), bytes);
}

/// Takes the spoilt copies away again, for the next round.
fn clear_spoilt(world: &World, grpc: &Grpcurl) {
    for n in 0..COPIES {
        fs::remove_file(world.plugins().join(format!("libtrocar_spoilt_{n:03}.so"))).unwrap();
    }
    eventually("the spoilt copies are gone from the list", || {
        let left = grpc.plugins().len();
        if left == 1 { Ok(()) } else { Err(format!("{left} files listed")) }
    });
}

/// Waits until every spoilt copy is listed as refused.
fn await_refusals(grpc: &Grpcurl) -> Vec<Value> {
    eventually("all spoilt copies are refused", || {
        let all = grpc.plugins();
        let spoilt = all.into_iter().filter(|p| file_name(p).starts_with("libtrocar_spoilt_"));
        let (refused, taken): (Vec<_>, Vec<_>) =
            spoilt.partition(|p| p["refused"].as_str().is_some_and(|r| !r.is_empty()));
        if refused.len() == COPIES {
            return Ok(refused);
        }
        Err(format!("{} refused, {} taken: {taken:#?}", refused.len(), taken.len()))
    })
}

fn allow_list(world: &World) -> String {
    let mut hashes = Vec::new();
    for entry in fs::read_dir(world.plugins()).unwrap() {
        let file = entry.unwrap().path();
        let printed = std::process::Command::new("sha256sum").arg(&file).output().unwrap();
        hashes.push(
            String::from_utf8_lossy(&printed.stdout).split_whitespace().next().unwrap_or_default().to_owned(),
        );
    }
    json!({ "sha256": hashes }).to_string()
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
