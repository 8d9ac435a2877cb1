//! Components that get a process of their own while a system runs.
//!
//! Promise: `isolation` works from anywhere a Create comes from, as long as somebody keeps the process it is
//! asked beside; what is refused leaves no process behind, and what is removed takes its process along.

use serde_json::{Value, json};
use trocar_tests::{HostProcess, World, eventually, number};

use super::TWO;
use super::system::{System, gone, kill, pid};

fn isolated(process: &str, name: &str, class: &str) -> Value {
    json!({ "process": process, "name": name, "class": class, "isolation": "process" })
}

/// Names of the processes of a system.
fn names(system: &System) -> Vec<String> {
    let list = system.grpc.ok("GcmService/List", json!({ "brief": true }));
    let all = list["processes"].as_array().cloned().unwrap_or_default();
    all.iter().filter_map(|p| p["name"].as_str().map(str::to_owned)).collect()
}

#[test]
fn one_created_over_grpc_lives_and_dies_alone_and_its_process_goes_with_it() {
    let two = System::up(TWO, &[]);
    let (right, before) = (two.host("right"), two.pids().len());
    let made = two.grpc.ok("GcmService/Create", isolated("right", "x", "sine"));
    assert_eq!(made["path"], "right.x/x", "it says where it is: {made}");
    assert_eq!(two.grpc.state("right.x/x"), "READY");
    two.grpc.start("right.x/x");
    let own = two.host("right.x");
    assert!(pid(&own) != pid(&right) && two.pids().len() == before + 1, "{own}");
    kill("-KILL", pid(&own));
    two.await_back("right.x", &own);
    assert_eq!(two.grpc.state("right.x/x"), "ACTIVE", "made anew as it was");
    assert_eq!(two.host("right"), right, "its neighbours notice nothing");
    let again = pid(&two.host("right.x"));
    two.grpc.ok("GcmService/Remove", json!({ "path": "right.x/x" }));
    assert_eq!(names(&two), ["left", "right"], "its process is gone when that is answered");
    assert!(gone(again));
    let made = two.grpc.ok("GcmService/Create", isolated("right", "x", "sine"));
    assert_eq!(made["path"], "right.x/x", "its name is free again: {made}");
    assert_eq!(number(&two.host("right.x")["restarts"]), 0, "it is another one");
}

#[test]
fn what_is_refused_leaves_no_process_behind() {
    let two = System::up(TWO, &[]);
    let before = two.pids();
    let long = isolated("right", &"x".repeat(60), "sine");
    let mut broken = isolated("right", "x", "chaos");
    broken["config"] = json!({ "error_in": "configure" });
    let mut unknown = isolated("right", "x", "sine");
    unknown["isolation"] = "thread".into();
    let mut wrong = isolated("right", "x", "chaos");
    wrong["config"] = json!({ "flood": "much" });
    let mut shared = isolated("right", "x", "sine");
    shared["execution"] = json!({ "model": "exec_in", "inside": "right/s" });
    let table = [
        (isolated("right", "s", "sine"), "COMPONENT_EXISTS"),
        (isolated("right", "x", "no_such_class"), "CLASS_NOT_FOUND"),
        (isolated("nobody", "x", "sine"), "PROCESS_NOT_FOUND"),
        (long, "BAD_PATH"),
        (unknown, "ARGUMENT_INVALID"),
        (wrong, "CONFIG_INVALID"),
        (shared, "ARGUMENT_INVALID"),
        (broken, "COMPONENT_REFUSED"),
    ];
    for (asked, reason) in table {
        let refused = two.grpc.refused("GcmService/Create", asked.clone());
        assert_eq!(refused.reason, reason, "{asked}: {refused}");
        assert_eq!(names(&two), ["left", "right"], "{asked} left something behind");
    }
    eventually("those that were made for nothing have ended", || match two.pids() {
        now if now == before => Ok(()),
        now => Err(format!("{now:?}, {before:?} before")),
    });
    two.grpc.ok("GcmService/Create", isolated("right", "x", "sine"));
    let twice = two.grpc.refused("GcmService/Create", isolated("right", "x", "sine"));
    assert_eq!(twice.reason, "COMPONENT_EXISTS", "{twice}");
    assert_eq!(two.grpc.state("right.x/x"), "READY", "and the first one is as it was");
    let mut dry = isolated("right", "dry", "sine");
    dry["validateOnly"] = true.into();
    let plan = two.grpc.ok("GcmService/Create", dry);
    assert!(plan["plan"].to_string().contains("right.dry/dry"), "{plan}");
    assert_eq!(names(&two), ["left", "right", "right.x"], "asking made nothing");
}

#[test]
fn where_nobody_keeps_processes_it_is_refused_with_what_to_do() {
    let world = World::with_plugins(&["sine"]);
    let host = HostProcess::start(&world);
    eventually("the class is there", || {
        let plugins = host.grpcurl().plugins();
        if plugins.is_empty() { Err(plugins.len()) } else { Ok(()) }
    });
    let refused = host.grpcurl().refused("GcmService/Create", isolated("host", "x", "sine"));
    assert_eq!(
        (refused.code, refused.reason.as_str()),
        ("FAILED_PRECONDITION", "NOT_SUPERVISED"),
        "{refused}"
    );
    let details = format!("{:?}", refused.details);
    assert!(details.contains("trocar up"), "it says what to do: {details}");
    host.grpcurl().create("host/x", "sine", json!({}));
    // Beside the processes of `up`, one that was started by hand.
    let two = System::up(TWO, &[]);
    let args =
        ["host", "--name", "alone", "--listen", "127.0.0.1:0", "--json", "--gcm", two.process.address()];
    let _alone = HostProcess::spawn(&two.world, "alone", &args.map(Into::into));
    let refused = two.grpc.refused("GcmService/Create", isolated("alone", "x", "sine"));
    let known = refused.metadata("known").unwrap_or_default();
    assert_eq!((refused.reason.as_str(), known), ("NOT_SUPERVISED", "left,right"), "{refused}");
}

#[test]
fn by_the_command_line_and_connected_to_its_neighbours_it_is_linked_again_after_a_crash() {
    let file = r#"{
      "version": 1,
      "processes": { "box": { "plugins": ["plugins"] } },
      "components": { "box/server": { "class": "Server" } }
    }"#;
    let one = System::up(file, &[]);
    let created = one
        .trocar()
        .run(&["create", "box/client", "Client", "--isolation", "process", "--timeout", "30s"])
        .ends_with(0);
    created.says("box.client/client");
    one.grpc.connect("box.client/client/Required", "box/server/Provided");
    one.grpc.start("box.client/client");
    let before = one.host("box.client");
    kill("-KILL", pid(&before));
    one.await_back("box.client", &before);
    one.grpc.await_state("box.client/client", "ACTIVE");
    let list = one.list();
    let halves = list["connections"][0]["proxies"].as_array().map(Vec::len);
    assert_eq!(halves, Some(2), "it is linked again: {list}");
    let unforced = one.grpc.refused("GcmService/Remove", json!({ "path": "box.client/client" }));
    assert_eq!(unforced.reason, "IN_USE", "{unforced}");
    one.grpc.ok("GcmService/Remove", json!({ "path": "box.client/client", "force": true }));
    assert_eq!(names(&one), ["box"]);
}

#[test]
fn a_gcm_that_is_killed_knows_it_again_and_one_killed_with_it_gets_it_back() {
    let two = System::up(TWO, &[]);
    two.grpc.ok("GcmService/Create", isolated("right", "x", "sine"));
    two.grpc.start("right.x/x");
    let before = two.host("right.x");
    let attached = |what: &str, is_it: &dyn Fn(u64) -> bool| {
        eventually(what, || {
            let ls = two.trocar().run(&["ls", "right.x", "--json"]);
            let listed = if ls.code == 0 { ls.json() } else { Value::Null };
            let (process, component) = (&listed["processes"][0], &listed["components"][0]);
            let whole = process["state"] == "ATTACHED" && component["state"] == "ACTIVE";
            if whole && is_it(pid(process)) { Ok(()) } else { Err(format!("{ls:?}")) }
        });
    };
    kill("-KILL", two.gcm_pid());
    attached("it is there under the next GCM", &|now| now == pid(&before));
    kill("-KILL", two.gcm_pid());
    kill("-KILL", pid(&before));
    attached("it is there again although both were lost", &|now| now != pid(&before));
    eventually("the others are attached, too", || match two.list()["processes"].as_array() {
        Some(all) if all.iter().filter(|p| p["state"] == "PROCESS_STATE_ATTACHED").count() == 3 => Ok(()),
        other => Err(format!("{other:?}")),
    });
    eventually("a restarted GCM can end it", || {
        let removed = two.grpc.call("GcmService/Remove", json!({ "path": "right.x/x" }));
        removed.map(|_| ()).map_err(|refused| refused.to_string())
    });
    assert_eq!(names(&two), ["left", "right"]);
}

#[test]
fn one_that_crashes_again_and_again_is_given_up_and_can_be_removed() {
    let policy = "\"right\": { \"restart\": { \"within_s\": 1000 },";
    let two = System::up(&TWO.replacen("\"right\": {", policy, 1), &[]);
    two.grpc.ok("GcmService/Create", isolated("right", "x", "sine"));
    two.kill_until_failed("right.x");
    let refused = two.grpc.refused("GcmService/Start", json!({ "path": "right.x/x" }));
    assert_eq!(refused.reason, "PROCESS_LOST", "{refused}");
    assert!(refused.message.contains("failed") && refused.message.contains("SIGKILL"), "{refused}");
    two.grpc.ok("GcmService/Remove", json!({ "path": "right.x/x", "force": true }));
    assert_eq!(names(&two), ["left", "right"]);
    two.grpc.ok("GcmService/Create", isolated("right", "x", "sine"));
    assert_eq!(two.grpc.state("right.x/x"), "READY", "and made anew");
}
