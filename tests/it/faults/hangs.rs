//! A hang in each entry of the class table.
//!
//! Promise: a component that hangs is named with the entry, and its host ends all the same;
//! `counted/hangs.rs` says what others notice of it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

use serde_json::json;
use trocar_tests::Grpcurl;

use super::Scene;
use super::ways::{Told, make, reach};

/// Entries of a component that runs: nobody need wait for them, and what moves something is in FAULT.
pub(super) const RUNNING: [&str; 5] = ["step", "command", "on_event", "on_service", "callback"];
/// Entries that make, start or end it; somebody waits for them.
pub(super) const CHANGING: [&str; 8] =
    ["create", "configure", "describe", "bind", "start", "stop", "make_safe", "resume"];

/// Numbers components, since what hangs keeps its thread, and what is said of it, for good.
#[derive(Default)]
pub(super) struct Names(AtomicU32);

impl Names {
    pub(super) fn next(&self, entry: &str) -> String {
        let number = self.0.fetch_add(1, Ordering::Relaxed);
        format!("host/hangs-in-{}-{number}", entry.replace('_', "-"))
    }
}

/// Does it for all of them at the same time.
pub(super) fn each(entries: &[&'static str], f: impl Fn(&'static str) + Sync) {
    thread::scope(|scope| {
        for entry in entries {
            scope.spawn(|| f(entry));
        }
    });
}

/// Brings it to the entry it never comes back out of; the last request may wait for 60 s.
pub(super) fn hang(grpc: &Grpcurl, path: &str, entry: &'static str) -> thread::JoinHandle<Told> {
    let (grpc, path) = (grpc.clone(), path.to_owned());
    thread::spawn(move || match entry {
        "create" => grpc.call("GcmService/Create", json!({ "path": path, "class": "hangs_in_create" })),
        _ => reach(&grpc, &path, entry, &json!({ "hang_in": entry })),
    })
}

#[test]
fn a_host_in_which_a_component_hangs_in_each_entry_ends_when_it_is_told_to() {
    let (mut scene, names) = (Scene::new(), Names::default());
    let callers = Mutex::new(Vec::new());
    let hang_in = |entry: &'static str| {
        let path = names.next(entry);
        if entry != "create" {
            make(&scene.grpc, &path, entry, &json!({ "hang_in": entry }));
        }
        callers.lock().unwrap().push(hang(&scene.grpc, &path, entry));
        scene.await_logged(&path, &format!("it has not come back out of its {entry}"));
    };
    each(&[&RUNNING[..], &CHANGING].concat(), hang_in);
    let path = names.next("drop");
    scene.grpc.create(&path, "chaos", json!({ "hang_in": "drop" }));
    let status = scene.host.terminate();
    assert_eq!(status.code(), Some(0), "{}", scene.host.printed());
    for caller in callers.into_inner().unwrap() {
        // Answered, or cut off with the host.
        drop(caller.join());
    }
}
