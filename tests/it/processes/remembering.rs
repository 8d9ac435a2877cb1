//! A GCM that ends and is started again goes on where it was.
//!
//! Promise: what was answered with OK is there afterwards, what was not decided is not; a journal that cannot
//! be gone on with is not guessed at.

use std::fs;
use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Trocar, World, eventually, number};

/// A GCM with the state of the one before it, at the same address.
fn gcm_again(world: &World, address: &str) -> HostProcess {
    let state = world.state().join("gcm");
    let args = ["gcm", "--listen", address, "--state", state.to_str().unwrap()];
    HostProcess::spawn(world, "gcm", &args.map(Into::into))
}

fn host_of(world: &World, name: &str, gcm: &HostProcess) -> HostProcess {
    HostProcess::start_with(world, name, &["--gcm", gcm.address()])
}

fn list(grpc: &Grpcurl) -> Value {
    grpc.ok("GcmService/List", json!({ "brief": true }))
}

fn paths(list: &Value) -> Vec<String> {
    let all = list["components"].as_array().cloned().unwrap_or_default();
    all.iter().map(|c| c["path"].as_str().unwrap().to_owned()).collect()
}

fn attached(grpc: &Grpcurl, names: &[&str]) -> Value {
    eventually(&format!("{names:?} are attached"), || {
        let list = list(grpc);
        let processes = list["processes"].as_array().cloned().unwrap_or_default();
        let is_there = |name: &&str| {
            processes.iter().any(|p| p["name"] == *name && p["state"] == "PROCESS_STATE_ATTACHED")
        };
        if names.iter().all(is_there) { Ok(list) } else { Err(list["processes"].to_string()) }
    })
}

#[test]
fn what_was_answered_is_known_to_the_next_gcm_and_runs_on() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let _host = host_of(&world, "a", &gcm);
    let grpc = gcm.grpcurl();
    attached(&grpc, &["a"]);
    let make = json!({ "path": "a/one", "class": "sine", "requestId": "make-one" });
    let made = grpc.ok("GcmService/Create", make.clone());
    for name in ["two", "three"] {
        grpc.ok("GcmService/Create", json!({ "path": format!("a/{name}"), "class": "sine" }));
    }
    grpc.ok("GcmService/Start", json!({ "path": "a/two" }));
    let before = list(&grpc);
    let executed = |grpc: &Grpcurl| number(&grpc.component("a/two")["stats"]["executed"]);
    gcm.kill();
    let gcm = gcm_again(&world, gcm.address());
    let grpc = gcm.grpcurl();
    assert_eq!(paths(&list(&grpc)), paths(&before), "before its process is here");
    let after = attached(&grpc, &["a"]);
    assert_eq!(
        (&after["revision"], &after["processes"][0]["epoch"]),
        (&before["revision"], &before["processes"][0]["epoch"])
    );
    // A step that took long on a busy machine shows in the health of its component.
    let but_health = |listed: &Value| {
        let mut components = listed["components"].clone();
        for component in components.as_array_mut().into_iter().flatten() {
            component["health"].take();
        }
        components
    };
    assert_eq!(but_health(&after), but_health(&before));
    assert_eq!(grpc.ok("GcmService/Create", make)["revision"], made["revision"], "the first answer");
    let other = json!({ "path": "a/other", "class": "sine", "requestId": "make-one" });
    assert_eq!(grpc.refused("GcmService/Create", other).reason, "ARGUMENT_INVALID");
    let stale = json!({ "path": "a/new", "class": "sine", "expectedRevision": 1 });
    assert_eq!(grpc.refused("GcmService/Create", stale).reason, "REVISION_CONFLICT");
    let (began, term) = (executed(&grpc), &after["term"]);
    assert_ne!(*term, before["term"], "it is another GCM");
    eventually("it runs on", || match executed(&grpc) {
        now if now > began => Ok(()),
        now => Err(now),
    });
}

#[test]
fn an_apply_is_there_as_a_whole_or_not_at_all_however_its_gcm_ends() {
    const EACH: usize = 12;
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let address = gcm.address().to_owned();
    let _hosts = ["a", "b"].map(|name| host_of(&world, name, &gcm));
    attached(&gcm.grpcurl(), &["a", "b"]);
    let (mut whole, mut none) = (0, 0);
    for round in 0..10 {
        let path = |n: usize| format!("{}/r{round}n{n}", ["a", "b"][n % 2]);
        let creates = (0..EACH).map(|n| json!({ "create": { "path": path(n), "class": "sine" } }));
        let apply = json!({ "steps": creates.collect::<Vec<_>>() });
        let made = |grpc: &Grpcurl| {
            paths(&list(grpc)).iter().filter(|path| path.contains(&format!("r{round}n"))).count()
        };
        let grpc = gcm.grpcurl();
        thread::scope(|scope| {
            let applying = scope.spawn(|| grpc.call("GcmService/Apply", apply.clone()));
            eventually("it is under way", || match made(&grpc) {
                now if now >= round => Ok(()),
                now => Err(now),
            });
            gcm.kill();
            let answer = applying.join().unwrap();
            gcm = gcm_again(&world, &address);
            let grpc = gcm.grpcurl();
            attached(&grpc, &["a", "b"]);
            match made(&grpc) {
                EACH => whole += 1,
                0 => {
                    none += 1;
                    assert!(answer.is_err(), "round {round}: it was answered with OK, and nothing is there");
                }
                some => panic!("round {round}: {some} of {EACH} are there; {answer:?}"),
            }
        });
        if made(&gcm.grpcurl()) == 0 {
            // Nothing of it is left in the processes either.
            eventually("the same can be made again", || {
                gcm.grpcurl().call("GcmService/Apply", apply.clone())
            });
        }
    }
    assert_eq!(whole + none, 10);
    let verified = Trocar::new(&world).run(&["journal", "verify", "--state", gcm_state(&world).as_str()]);
    verified.ends_with(0).says("whole");
}

fn gcm_state(world: &World) -> String {
    world.state().join("gcm").to_str().unwrap().to_owned()
}

#[test]
fn a_process_that_was_away_while_it_was_stopped_stands_still_at_the_next_gcm() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let host = host_of(&world, "a", &gcm);
    let grpc = gcm.grpcurl();
    attached(&grpc, &["a"]);
    grpc.ok("GcmService/Create", json!({ "path": "a/arm", "class": "chaos" }));
    grpc.ok("GcmService/Start", json!({ "path": "a/arm" }));
    super::system::freeze(host.pid().into());
    eventually("it is lost", || match list(&grpc)["processes"][0]["state"].as_str() {
        Some("PROCESS_STATE_LOST") => Ok(()),
        other => Err(format!("{other:?}")),
    });
    assert_eq!(grpc.refused("GcmService/Stop", json!({ "path": "a/arm" })).reason, "STOP_NOT_TOLD");
    gcm.kill();
    let gcm = gcm_again(&world, gcm.address());
    super::system::kill("-CONT", host.pid().into());
    let grpc = gcm.grpcurl();
    attached(&grpc, &["a"]);
    eventually("it stands still", || match grpc.component("a/arm") {
        arm if arm["stopReason"] == "STOP_REASON_REQUESTED" => Ok(()),
        arm => Err(arm.to_string()),
    });
}

#[test]
fn a_host_that_was_killed_has_its_components_again_and_one_that_ended_in_order_has_not() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let mut host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    for (path, class) in [("host/s", "sine"), ("host/arm", "chaos")] {
        grpc.ok("GcmService/Create", json!({ "path": path, "class": class }));
        grpc.ok("GcmService/Start", json!({ "path": path }));
    }
    host.kill();
    let mut host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    attached(&grpc, &["host"]);
    assert_eq!(grpc.state("host/s"), "ACTIVE");
    assert_eq!(grpc.component("host/arm")["stopReason"], "STOP_REASON_RESTARTED", "what moves waits");
    assert!(host.interrupt().success());
    let host = HostProcess::start(&world);
    assert_eq!(paths(&list(&host.grpcurl())), Vec::<String>::new());
}

#[test]
fn the_journal_says_who_asked_for_what_also_of_actuators_and_what_cannot_be_read() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.ok("GcmService/Create", json!({ "path": "host/arm", "class": "chaos" }));
    grpc.ok("GcmService/Start", json!({ "path": "host/arm" }));
    grpc.call("InteractService/Invoke", json!({ "path": "host/arm/ctl/nothing-of-that-name" })).unwrap_err();
    grpc.refused("GcmService/Create", json!({ "path": "host/../odd", "class": "chaos" }));
    grpc.refused("GcmService/Create", json!({ "path": "host/arm", "class": "chaos" }));
    grpc.ok("GcmService/Stop", json!({ "path": "host/arm" }));
    let state = world.state().join("host");
    let shown = || {
        let args = ["journal", "show", "--state", state.to_str().unwrap()];
        Trocar::new(&world).run(&args).ends_with(0).stdout
    };
    // Records that nobody waits for come soon.
    let text = eventually("all is on record", || match shown() {
        text if text.contains(r#"{"stop":{"paths":["host/arm"]}}"#) && text.contains("cannot be read") => {
            Ok(text)
        }
        text => Err(text),
    });
    let said = |words: &[&str]| text.lines().any(|line| words.iter().all(|word| line.contains(word)));
    assert!(said(&["user ", r#"{"create":{"class":"chaos","path":"host/arm"}}"#, "ok"]), "{text}");
    assert!(said(&["COMPONENT_EXISTS"]), "{text}");
    assert!(said(&["+ start host/arm"]), "{text}");
    assert!(said(&["- stop host/arm"]), "{text}");
}

#[test]
fn a_journal_that_is_damaged_is_named_and_kept_and_another_one_can_be_begun() {
    let world = World::with_plugins(&["sine"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let _host = host_of(&world, "a", &gcm);
    let grpc = gcm.grpcurl();
    attached(&grpc, &["a"]);
    grpc.ok("GcmService/Create", json!({ "path": "a/one", "class": "sine" }));
    assert!(gcm.terminate().success());
    let file = world.state().join("gcm/journal.redb");
    let mut bytes = fs::read(&file).unwrap();
    bytes.truncate(bytes.len() / 2);
    fs::write(&file, &bytes).unwrap();
    let state = gcm_state(&world);
    let start = ["gcm", "--json", "--listen", gcm.address(), "--state", &state];
    let refused = Trocar::new(&world).run(&start);
    assert_ne!(refused.code, 0);
    let said = refused.json();
    assert_eq!(said["reason"], "JOURNAL_DAMAGED", "{said}");
    assert!(said["help"].as_str().unwrap().contains("--fresh"), "{said}");
    assert_eq!(fs::read(&file).unwrap(), bytes, "it is kept as it is");
    let fresh = ["gcm", "--listen", gcm.address(), "--state", &state, "--fresh"];
    let again = HostProcess::spawn(&world, "gcm", &fresh.map(Into::into));
    let list = attached(&again.grpcurl(), &["a"]);
    assert_eq!(paths(&list), ["a/one"], "it learns from the process");
    assert!(world.state().join("gcm/journal.redb.old-1").exists());
}
