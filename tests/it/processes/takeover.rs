//! A GCM takes the place of the one that runs.
//!
//! Promise: whatever stands in the way is told, and then the one that runs goes on as it was. What happens to
//! changes meanwhile is a row of `tests/torture`.

use std::fs;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually, number};

use super::system::{System, pid};

/// Exit code of a command line that cannot be meant.
const USAGE: i32 = 2;

fn take_over(world: &World, state: &str) -> HostProcess {
    HostProcess::spawn(world, "next", &["gcm", "--takeover", "--state", state].map(Into::into))
}

/// Refuses to take over, and says why.
#[track_caller]
fn refused(world: &World, state: &str, reason: &str, words: &[&str]) {
    let refused = Trocar::new(world).run(&["gcm", "--takeover", "--json", "--state", state]);
    assert_ne!(refused.code, 0);
    let said = refused.json();
    assert_eq!(said["reason"], reason, "{said}");
    let text = said.to_string();
    for word in words {
        assert!(text.contains(word), "it does not say {word:?}: {text}");
    }
}

fn brief(gcm: &HostProcess) -> Value {
    gcm.grpcurl().ok("GcmService/List", json!({ "brief": true }))
}

#[test]
fn hosts_run_on_and_find_the_next_gcm_at_the_address_of_the_one_before() {
    let world = World::with_plugins(&["sine"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let mut host = HostProcess::start_with(&world, "a", &["--gcm", gcm.address()]);
    let grpc = gcm.grpcurl();
    grpc.await_class("a", "sine");
    grpc.create("a/one", "sine", json!({}));
    grpc.start("a/one");
    let before = brief(&gcm);
    let state = world.state().join("gcm").display().to_string();
    let next = take_over(&world, &state);
    assert_eq!(next.address(), gcm.address());
    assert!(!gcm.is_alive(), "it has ended before the next one listens");
    let after = eventually("the host is attached", || {
        let list = brief(&next);
        if list["processes"][0]["state"] == "PROCESS_STATE_ATTACHED" { Ok(list) } else { Err(list) }
    });
    assert_eq!(after["revision"], before["revision"]);
    assert_eq!(after["components"][0]["state"], "COMPONENT_STATE_ACTIVE", "{after}");
    assert_eq!(after["processes"][0]["epoch"], before["processes"][0]["epoch"], "it is the same incarnation");
    assert!(number(&after["term"]) > number(&before["term"]), "an order of the one before is refused");
    assert!(host.is_alive());
}

#[test]
fn without_anybody_to_take_over_from_it_just_starts() {
    let world = World::new();
    let state = world.path("alone").display().to_string();
    let args = ["gcm", "--takeover", "--listen", "127.0.0.1:0", "--state", &state];
    let gcm = HostProcess::spawn(&world, "alone", &args.map(Into::into));
    assert_eq!(brief(&gcm)["term"], "1");
    // A script that always says the same is told where it would lead hosts astray.
    let again = Trocar::new(&world).run(&["gcm", "--takeover", "--listen", "127.0.0.1:1", "--state", &state]);
    again.ends_with(USAGE).says(gcm.address()).says("leave --listen out");
}

#[test]
fn a_host_is_not_ended_for_it() {
    let world = World::new();
    let mut host = HostProcess::start(&world);
    let state = world.state().join("host").display().to_string();
    refused(&world, &state, "NOT_TAKEN_OVER", &["no GCM by itself", &host.pid().to_string(), "kill"]);
    assert!(host.is_alive());
}

#[test]
fn one_that_is_started_again_by_its_keeper_goes_on() {
    let file = r#"{ "version": 1, "processes": { "a": {} }, "components": {} }"#;
    let system = System::up(file, &[]);
    let state = fs::read_dir(system.world.path("xdg-state/trocar/up")).unwrap().next().unwrap().unwrap();
    let gcm = state.path().join("gcm").display().to_string();
    let before = pid(&system.host("a"));
    refused(&system.world, &gcm, "NOT_TAKEN_OVER", &["kept by `trocar up`", "trocar up --gcm"]);
    assert_eq!(pid(&system.host("a")), before);
}

#[test]
fn one_whose_journal_this_program_cannot_read_goes_on() {
    let world = World::with_plugins(&["sine"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let state = world.state().join("gcm");
    let journal = state.join("journal.redb");
    let bytes = fs::read(&journal).unwrap();
    fs::rename(&journal, state.join("kept.redb")).unwrap();
    fs::write(&journal, &bytes[..bytes.len() / 2]).unwrap();
    refused(&world, &state.display().to_string(), "JOURNAL_DAMAGED", &["journal.redb"]);
    assert!(gcm.is_alive());
}
