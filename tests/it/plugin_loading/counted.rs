//! Hundreds of spoilt files beside a 1 kHz component, whose cycles are counted.
//!
//! Promise: each is refused, and the component misses no cycle beyond those that a control run misses. The
//! counts judge what processors were given, so these tests have the machine for themselves.

use std::fs;
use std::ops::Range;
use std::os::unix::fs::PermissionsExt;

use serde_json::{Value, json};
use trocar_tests::{Built, Bystander, Grpcurl, HostProcess, World, eventually, flip_bit};

use super::file_name;

/// Spoilt copies per kind.
const COPIES: usize = 200;

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
