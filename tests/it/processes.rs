//! A system of several processes: `trocar up` starts them, keeps them, and takes them down.
//!
//! Promise: what crashes comes back, and what moves something then waits for somebody; what cannot come up is
//! named; nothing outlives `up`, however that ends; losing the GCM stops nothing.

#[path = "processes/away.rs"]
mod away;
#[path = "processes/detached.rs"]
mod detached;
#[path = "processes/ends.rs"]
mod ends;
#[path = "processes/given_up.rs"]
mod given_up;
#[path = "processes/helps.rs"]
mod helps;
#[path = "processes/isolated.rs"]
mod isolated;
#[path = "processes/numbers.rs"]
mod numbers;
#[path = "processes/refusals.rs"]
mod refusals;
#[path = "processes/remembering.rs"]
mod remembering;
#[path = "processes/stopping.rs"]
mod stopping;
#[path = "processes/system.rs"]
pub(crate) mod system;
#[path = "processes/takeover.rs"]
mod takeover;
#[path = "processes/timed.rs"]
mod timed;
#[path = "processes/watching.rs"]
mod watching;

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use system::{System, children, gone, is_gcm, kill, listening, pid, running_in};
use trocar_tests::{Built, HostProcess, Trocar, World, eventually, number};

const TWO: &str = r#"{
  "version": 1,
  "processes": { "left": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] } },
  "components": {
    "left/s":  { "class": "sine" },
    "right/s": { "class": "sine" },
    "right/c": { "class": "chaos" },
    "right/off": { "class": "sine", "start": false }
  }
}"#;

#[test]
fn everything_of_a_file_comes_up_and_goes_down_with_ctrl_c() {
    let mut two = System::up(TWO, &[]);
    let list = two.list();
    let states: Vec<(&str, &str)> = list["components"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| (c["path"].as_str().unwrap(), c["state"].as_str().unwrap()))
        .collect();
    let active = "COMPONENT_STATE_ACTIVE";
    let wanted = [
        ("left/s", active),
        ("right/c", active),
        ("right/off", "COMPONENT_STATE_READY"),
        ("right/s", active),
    ];
    assert_eq!(states, wanted, "{list}");
    let pids = two.pids();
    assert_eq!(pids.len(), 3, "two hosts and their GCM: {pids:?}");
    let status = two.process.interrupt();
    assert!(status.success(), "{status}: {}", two.process.printed());
    assert_eq!(pids.iter().filter(|pid| !gone(**pid)).count(), 0, "it answers when all have ended");
}

#[test]
fn a_killed_process_comes_back_with_all_it_had_and_what_moves_waits_for_somebody() {
    let two = System::up(TWO, &[]);
    let (left, before) = (two.host("left"), two.host("right"));
    kill("-KILL", pid(&before));
    two.await_back("right", &before);
    let after = two.host("right");
    assert!(number(&after["epoch"]) > number(&before["epoch"]), "{after}");
    assert_eq!((after["lastExit"].as_str(), number(&after["restarts"])), (Some("was killed by SIGKILL"), 1));
    assert_eq!(two.grpc.state("right/s"), "ACTIVE", "a sensor runs again");
    assert_eq!(two.grpc.state("right/off"), "READY", "what did not run does not run now");
    let actuator = two.grpc.component("right/c");
    assert_eq!(actuator["stopReason"], "STOP_REASON_RESTARTED", "{actuator}");
    assert_eq!(actuator["health"], "HEALTH_OK", "{actuator}");
    let glob = two.grpc.ok("GcmService/Start", json!({ "path": "right/**" }));
    assert!(glob["skipped"].to_string().contains("right/c"), "a glob does not set it in motion: {glob}");
    two.grpc.ok("GcmService/Resume", json!({ "path": "right/c" }));
    assert_eq!(two.grpc.state("right/c"), "ACTIVE");
    let steps = number(&two.grpc.component("right/c")["stats"]["executed"]);
    eventually("it steps", || match number(&two.grpc.component("right/c")["stats"]["executed"]) {
        now if now > steps => Ok(()),
        now => Err(now),
    });
    assert_eq!(two.host("left"), left, "nobody else was touched");
    two.trocar().run(&["ls"]).ends_with(0).says("was killed by SIGKILL");
}

#[test]
fn what_was_stopped_before_a_crash_is_not_started_after_it() {
    let two = System::up(TWO, &[]);
    two.grpc.stop("right/s");
    let before = two.host("right");
    kill("-KILL", pid(&before));
    two.await_back("right", &before);
    let s = two.grpc.component("right/s");
    assert_eq!(
        (s["state"].as_str(), s["stopReason"].as_str()),
        (Some("COMPONENT_STATE_STOPPED"), Some("STOP_REASON_REQUESTED"))
    );
    two.grpc.ok("GcmService/Resume", json!({ "path": "right/s" }));
    assert_eq!(two.grpc.state("right/s"), "ACTIVE", "it is a new instance, and can be resumed all the same");
}

#[test]
fn connections_within_a_process_are_made_again() {
    let file = r#"{
      "version": 1,
      "processes": { "box": { "plugins": ["plugins"] } },
      "components": { "box/server": { "class": "Server" }, "box/client": { "class": "Client" } },
      "connections": [ { "client": "box/client/Required", "server": "box/server/Provided" } ]
    }"#;
    let one = System::up(file, &[]);
    let before = one.host("box");
    let connections = one.list()["connections"].clone();
    assert_eq!(connections.as_array().map(Vec::len), Some(1), "{connections}");
    kill("-KILL", pid(&before));
    one.await_back("box", &before);
    let list = one.list();
    assert_eq!(list["connections"][0]["id"], connections[0]["id"], "{list}");
    assert_eq!(list["connections"][0]["carrier"], connections[0]["carrier"], "its figures are there: {list}");
    assert_eq!(one.grpc.state("box/client"), "ACTIVE");
}

#[test]
fn a_process_that_dies_again_and_again_is_given_up_and_the_others_go_on() {
    // Four ends within this time, however slow the machine is.
    let policy = "\"right\": { \"restart\": { \"within_s\": 1000 },";
    let mut two = System::up(&TWO.replacen("\"right\": {", policy, 1), &[]);
    let left = two.host("left");
    let right = two.kill_until_failed("right");
    assert_eq!((right["lastExit"].as_str(), number(&right["restarts"])), (Some("was killed by SIGKILL"), 3));
    eventually("it is told", || {
        let printed = two.process.printed();
        if printed.contains("FAILED") { Ok(()) } else { Err(printed) }
    });
    let lost = two.grpc.component("right/s");
    assert_eq!(lost["health"], "HEALTH_LOST", "{lost}");
    assert_eq!(two.host("left"), left);
    assert_eq!(two.grpc.state("left/s"), "ACTIVE");
    two.trocar().run(&["ls"]).ends_with(0).says("FAILED");
    assert!(two.process.interrupt().success(), "and it can be taken down");
}

#[test]
fn a_process_that_is_not_to_be_restarted_is_not() {
    let two = System::up(&TWO.replacen("\"right\": {", "\"right\": { \"restart\": \"never\",", 1), &[]);
    kill("-ABRT", pid(&two.host("right")));
    eventually("right is FAILED", || match two.host("right") {
        right if right["state"] == "PROCESS_STATE_FAILED" => Ok(()),
        right => Err(right.to_string()),
    });
    let right = two.host("right");
    let exit = right["lastExit"].as_str().unwrap_or_default();
    assert!(exit.starts_with("was killed by SIGABRT") && number(&right["restarts"]) == 0, "{right}");
}

#[test]
fn nothing_outlives_an_up_that_is_killed() {
    let mut two = System::up(TWO, &[]);
    let pids = two.pids();
    two.process.kill();
    for pid in pids {
        eventually(&format!("{pid} ends by itself"), || if gone(pid) { Ok(()) } else { Err("it runs") });
    }
    // Everything is free again: the name, the directories, the port.
    let address = two.process.address().to_owned();
    let file = two.world.path("system.json");
    let args = ["up", file.to_str().unwrap(), "--listen", &address, "--json"];
    let again = HostProcess::spawn(&two.world, "again", &args.map(Into::into));
    assert_eq!(again.address(), address);
}

#[test]
fn losing_the_gcm_twenty_times_stops_and_restarts_nothing() {
    let mut two = System::up(TWO, &[]);
    let before = (two.host("left"), two.host("right"));
    let count = |path: &str| number(&two.grpc.component(path)["stats"]["executed"]);
    let paths = ["left/s", "right/s", "right/c"];
    let mut steps = paths.map(count);
    for round in 0..20 {
        let gcm = two.gcm_pid();
        kill("-KILL", gcm);
        eventually(&format!("round {round}: both are attached to the next GCM"), || {
            // The one that dies may take a connection yet.
            if !gone(gcm) || two.gcm_pid() == gcm {
                return Err("it lives".to_owned());
            }
            let ls = two.trocar().run(&["ls", "--json"]);
            let processes = if ls.code == 0 { ls.json()["processes"].clone() } else { Value::Null };
            let attached = |p: &&Value| p["state"] == "ATTACHED";
            let all = processes.as_array().is_some_and(|all| all.iter().filter(attached).count() == 2);
            if all { Ok(()) } else { Err(format!("{ls:?}")) }
        });
        for (path, steps) in paths.iter().zip(&mut steps) {
            let now = count(path);
            assert!(
                now > *steps,
                "round {round}: {path} was made anew or stands still: {steps} then {now} steps"
            );
            *steps = now;
            assert_eq!(two.grpc.state(path), "ACTIVE", "round {round}: {path}");
        }
    }
    let after = (two.host("left"), two.host("right"));
    assert_eq!((pid(&before.0), pid(&before.1)), (pid(&after.0), pid(&after.1)));
    for (before, after) in [(&before.0, &after.0), (&before.1, &after.1)] {
        assert_eq!(after["epoch"], before["epoch"], "one incarnation has one epoch: {after}");
        assert_eq!(number(&after["restarts"]), 0, "{after}");
    }
    assert!(two.process.is_alive());
}

#[test]
fn a_detached_system_is_taken_down_by_file_or_by_name() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let file = world.write("system.json", TWO);
    let file = file.to_str().unwrap();
    for by in [file, "other"] {
        let named = if by == file { vec![] } else { vec!["--name", "other"] };
        let args = [&["up", file, "--detach", "--json", "--listen", "127.0.0.1:0"][..], &named].concat();
        let up = Trocar::new(&world).run(&args).ends_with(0).json();
        let pids: Vec<u64> = up["processes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|p| number(&p["pid"]))
            .chain([number(&up["pid"])])
            .collect();
        let second = Trocar::new(&world).run(&args).ends_with(1);
        assert_eq!(second.json()["reason"], "STATE_IN_USE", "{second:#?}");
        let unknown =
            Trocar::new(&world).run(&["down", "nobody"]).ends_with(1).says("no system nobody is up");
        unknown.says(if by == file { "up are: system" } else { "up are: other" });
        Trocar::new(&world).run(&["down", by]).ends_with(0).says("is down");
        assert_eq!(pids.iter().filter(|pid| !gone(**pid)).count(), 0, "{pids:?}");
    }
    Trocar::new(&world).run(&["down", file]).ends_with(1).says("none is up");
}

#[test]
fn an_isolated_component_dies_alone() {
    let isolated = TWO.replacen("\"right/s\": { ", "\"right/s\": { \"isolation\": \"process\", ", 1);
    let two = System::up(&isolated, &[]);
    let (right, own) = (two.host("right"), two.host("right.s"));
    assert_eq!(two.grpc.state("right.s/s"), "ACTIVE");
    kill("-KILL", pid(&own));
    two.await_back("right.s", &own);
    assert_eq!(two.grpc.state("right.s/s"), "ACTIVE");
    assert_eq!(two.host("right"), right, "its neighbours notice nothing");
    assert_eq!(two.grpc.state("right/c"), "ACTIVE");
}

#[test]
fn the_gcm_of_somebody_else_is_left_as_it_was() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let gcm = HostProcess::start_gcm(&world);
    let file = world.write("system.json", TWO);
    let args = ["up", file.to_str().unwrap(), "--json", "--gcm", gcm.address()];
    let mut up = HostProcess::spawn(&world, "up", &args.map(Into::into));
    assert_eq!(up.address(), gcm.address());
    let before = gcm.grpcurl().ok("GcmService/List", json!({ "path": "right" }))["processes"][0].clone();
    kill("-KILL", pid(&before));
    eventually("right is back", || {
        let right = gcm.grpcurl().ok("GcmService/List", json!({ "path": "right" }))["processes"][0].clone();
        let back = right["state"] == "PROCESS_STATE_ATTACHED" && number(&right["restarts"]) == 1;
        if back { Ok(()) } else { Err(right.to_string()) }
    });
    assert!(up.interrupt().success());
    let list = gcm.grpcurl().ok("GcmService/List", json!({}));
    assert_eq!((&list["processes"], &list["components"]), (&json!([]), &json!([])), "{list}");
}

#[test]
fn a_process_that_stood_still_goes_on_as_it_was() {
    let two = System::up(TWO, &[]);
    let before = two.hold("right");
    assert_eq!(two.grpc.state("left/s"), "ACTIVE");
    kill("-CONT", pid(&before));
    eventually("it is heard again", || {
        let right = two.host("right");
        if right == before { Ok(()) } else { Err(right.to_string()) }
    });
    assert_eq!(two.grpc.state("right/c"), "ACTIVE", "nothing in it was restarted");
}

#[test]
fn what_a_process_and_the_gcm_lost_together_is_made_again() {
    let two = System::up(TWO, &[]);
    let (left, right) = (two.host("left"), two.host("right"));
    kill("-KILL", two.gcm_pid());
    kill("-KILL", pid(&right));
    eventually("right has all it had", || {
        let ls = two.trocar().run(&["ls", "right", "--json"]);
        if ls.code != 0 {
            return Err(format!("{ls:?}"));
        }
        let states: Vec<(String, String)> = ls.json()["components"]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| (c["path"].as_str().unwrap().to_owned(), c["state"].as_str().unwrap().to_owned()))
            .collect();
        let wanted = [("right/c", "STOPPED{restarted}"), ("right/off", "READY"), ("right/s", "ACTIVE")];
        let wanted = wanted.map(|(path, state)| (path.to_owned(), state.to_owned()));
        if states == wanted { Ok(()) } else { Err(format!("{states:?}")) }
    });
    eventually("left has found the new GCM", || {
        let ls = two.trocar().run(&["ls", "left", "--json"]);
        let is_back = ls.code == 0 && ls.json()["processes"][0]["state"] == "ATTACHED";
        if is_back { Ok(()) } else { Err(format!("{ls:?}")) }
    });
    assert_eq!(pid(&two.host("left")), pid(&left));
    assert_eq!(two.grpc.state("left/s"), "ACTIVE", "what has only lost its GCM goes on");
}

#[test]
fn a_process_that_is_given_up_by_mistake_comes_back_as_it_was() {
    let two = System::up(TWO, &[]);
    let before = two.host("right");
    let wrong = json!({ "processes": [{ "process": "right", "fate": "FATE_ENDED", "pid": pid(&before) }] });
    two.grpc.ok("AttachService/Tell", wrong);
    eventually("it says that it lives", || {
        let right = two.host("right");
        if right == before { Ok(()) } else { Err(right.to_string()) }
    });
    assert_eq!(two.grpc.state("right/c"), "ACTIVE");
    let nothing = two.grpc.refused("AttachService/Tell", json!({ "processes": [{ "process": "right" }] }));
    assert_eq!(nothing.reason, "ARGUMENT_INVALID", "{nothing}");
    let nameless = two.grpc.refused("AttachService/Tell", json!({ "processes": [{ "process": "a b" }] }));
    assert_eq!(nameless.reason, "BAD_PATH", "{nameless}");
}

#[test]
fn a_process_killed_at_any_moment_of_its_start_comes_back_whole() {
    let restart = "\"right\": { \"restart\": { \"max\": 1000, \"backoff_ms\": 1, \"most_backoff_ms\": 1 },";
    let two = System::up(&TWO.replacen("\"right\": {", restart, 1), &[]);
    let seed = fastrand::u64(..);
    let mut random = fastrand::Rng::with_seed(seed);
    let first = two.host("right");
    let held = two.holds();
    let mut last = 0;
    for round in 0..40 {
        last =
            eventually(&format!("round {round} of seed {seed}: right runs"), || match two.pid_of("right") {
                Some(pid) if pid != last => Ok(pid),
                other => Err(format!("{other:?}")),
            });
        // Each look takes some microseconds: from the first instruction to long after it has all its
        // components.
        let most = 1 << random.u32(1..18);
        for _ in 0..random.u32(0..most) {
            std::hint::black_box(gone(last));
        }
        kill("-KILL", last);
    }
    two.await_back("right", &first);
    for (path, state) in [("right/s", "ACTIVE"), ("right/off", "READY"), ("right/c", "STOPPED")] {
        assert_eq!(two.grpc.state(path), state, "seed {seed}: {path} in {}", two.list());
    }
    assert_eq!(two.grpc.state("left/s"), "ACTIVE");
    eventually("nothing of the forty stays with `up`", || match two.holds() {
        (files, threads) if files <= held.0 && threads <= held.1 => Ok(()),
        now => Err(format!("{now:?} files and threads, {held:?} before")),
    });
}

#[test]
fn an_up_that_is_killed_while_it_comes_up_leaves_nothing() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let file = world.write("system.json", TWO);
    let home = world.path("xdg-state");
    let seed = fastrand::u64(..);
    let mut random = fastrand::Rng::with_seed(seed);
    for round in 0..15 {
        let mut up = Command::new(Built::trocar())
            .args(["up", file.to_str().unwrap(), "--listen", "127.0.0.1:0", "--json"])
            .env("XDG_STATE_HOME", &home)
            .env_remove("TROCAR_GCM")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let most = 1 << random.u32(1..17);
        for _ in 0..random.u32(0..most) {
            std::hint::black_box(gone(up.id().into()));
        }
        up.kill().unwrap();
        up.wait().unwrap();
        // Those that have not become what they are to be yet, too.
        let world = world.path("");
        eventually(&format!("round {round} of seed {seed}: all have ended"), || match running_in(&world) {
            left if left.is_empty() => Ok(()),
            left => Err(format!("{left:?}")),
        });
    }
    let again = Trocar::new(&world);
    let args = ["up", file.to_str().unwrap(), "--detach", "--listen", "127.0.0.1:0"];
    again.run(&args).ends_with(0);
    again.run(&["down", "system"]).ends_with(0);
}

#[test]
fn what_the_file_lets_go_on_by_itself_does() {
    let file = TWO.replacen("{ \"class\": \"chaos\" }", "{ \"class\": \"chaos\", \"resume\": \"auto\" }", 1);
    let two = System::up(&file, &[]);
    let before = two.host("right");
    kill("-KILL", pid(&before));
    two.await_back("right", &before);
    two.grpc.await_state("right/c", "ACTIVE");
    assert_eq!(two.grpc.state("right/off"), "READY");
}

#[test]
fn what_had_failed_before_a_crash_is_not_let_go_on_by_it() {
    let broken =
        r#"{ "class": "chaos", "resume": "auto", "config": { "error_in": "step", "good_steps": 20 } }"#;
    let goes_on = "{ \"class\": \"chaos\", \"resume\": \"auto\" }, \"right/broken\": ".to_owned() + broken;
    let two = System::up(&TWO.replacen("{ \"class\": \"chaos\" }", &goes_on, 1), &[]);
    two.grpc.await_state("right/broken", "FAULT");
    let before = two.host("right");
    kill("-KILL", pid(&before));
    two.await_back("right", &before);
    two.grpc.await_state("right/c", "ACTIVE");
    // All that goes on by itself is let go on in one step.
    let broken = two.grpc.component("right/broken");
    assert_eq!(broken["stopReason"], "STOP_REASON_RESTARTED", "nobody has looked at why: {broken}");
    assert_eq!(number(&broken["stats"]["executed"]), 0, "{broken}");
    two.grpc.ok("GcmService/Resume", json!({ "path": "right/broken" }));
}

#[test]
fn a_process_that_crashes_while_the_system_comes_up_is_filled_once_more_and_what_moves_waits() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let slow = "{ \"class\": \"chaos\", \"config\": { \"slow_start_ms\": 1500 } }";
    let file = world.write("system.json", TWO.replacen("{ \"class\": \"chaos\" }", slow, 1));
    let mut up = Command::new(Built::trocar())
        .args(["up", file.to_str().unwrap(), "--listen", "127.0.0.1:0"])
        .env("XDG_STATE_HOME", world.path("xdg-state"))
        .env_remove("TROCAR_GCM")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let address = eventually("its GCM listens", || {
        let listens =
            listening(children(up.id().into()).into_iter().find(|pid| is_gcm(*pid)).ok_or("no GCM")?);
        listens.ok_or("no port")
    });
    let trocar = Trocar::at(&world, &address);
    let right = eventually("right begins to be filled", || {
        let ls = trocar.run(&["ls", "right", "--json"]);
        let pid = if ls.code == 0 { ls.json()["processes"][0]["pid"].as_u64() } else { None };
        match pid.filter(|_| ls.json()["components"].to_string().contains("right/c")) {
            Some(pid) => Ok(pid),
            None => Err(format!("{ls:?}")),
        }
    });
    kill("-KILL", right);
    let mut line = String::new();
    BufReader::new(up.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("is up: 2 processes"), "{line:?}");
    let ls = trocar.run(&["ls", "right", "--json"]).ends_with(0).json();
    let states: Vec<&str> =
        ls["components"].as_array().unwrap().iter().filter_map(|c| c["state"].as_str()).collect();
    assert_eq!(states, ["READY", "READY", "ACTIVE"], "nobody asked right/c to go on after a crash: {ls}");
    trocar.run(&["down", "system"]).ends_with(0);
    assert!(up.wait().unwrap().success());
}

#[test]
fn gcm_and_process_killed_at_any_moment_leave_a_whole_system_and_nothing_moves_by_that() {
    let restart = "\"right\": { \"restart\": { \"max\": 1000, \"backoff_ms\": 1, \"most_backoff_ms\": 1 },";
    let mut two = System::up(&TWO.replacen("\"right\": {", restart, 1), &[]);
    let left = two.host("left");
    let seed = fastrand::u64(..);
    let mut random = fastrand::Rng::with_seed(seed);
    let (mut right, mut gcm) = (0, 0);
    for round in 0..25 {
        if round == 0 || random.bool() {
            right = eventually(&format!("round {round} of seed {seed}: right runs"), || {
                match two.pid_of("right") {
                    Some(pid) if pid != right => Ok(pid),
                    other => Err(format!("{other:?}")),
                }
            });
            kill("-KILL", right);
        } else {
            gcm = eventually(&format!("round {round} of seed {seed}: a GCM runs"), || match two.gcm_pid() {
                pid if pid != gcm => Ok(pid),
                pid => Err(pid),
            });
            kill("-KILL", gcm);
        }
        let most = 1 << random.u32(1..17);
        for _ in 0..random.u32(0..most) {
            std::hint::black_box(gone(two.process.pid().into()));
        }
    }
    eventually(&format!("all of seed {seed} is back"), || {
        let ls = two.trocar().run(&["ls", "--json"]);
        if ls.code != 0 {
            return Err(format!("{ls:?}"));
        }
        let state = |path: &str| {
            let components = ls.json()["components"].as_array().cloned().unwrap_or_default();
            let found = components.iter().find(|c| c["path"] == path && c["health"] != "LOST");
            found.and_then(|c| c["state"].as_str().map(str::to_owned)).unwrap_or_default()
        };
        let actuator = state("right/c");
        assert_ne!(actuator, "ACTIVE", "seed {seed}: nobody has let it move");
        let whole =
            state("right/s") == "ACTIVE" && state("right/off") == "READY" && state("left/s") == "ACTIVE";
        if whole && !actuator.is_empty() { Ok(()) } else { Err(format!("{ls:?}")) }
    });
    assert_eq!(pid(&two.host("left")), pid(&left), "seed {seed}");
    assert!(two.process.is_alive());
}
