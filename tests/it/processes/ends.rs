//! How processes of a system end, and what follows.
//!
//! Promise: devices are made safe at every end that can be; one that is of no use is put down where its
//! policy says so; what did not end in order is named; and nobody has to read what `up` says.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use trocar_tests::{Built, HostProcess, Trocar, World, eventually, number};

use super::TWO;
use super::system::{System, children, freeze, gone, is_gcm, kill, listening, pid, running, running_in};

/// One process, whose policy and components are these.
fn one(policy: &str, components: &str) -> String {
    format!(
        r#"{{ "version": 1, "processes": {{ "right": {{ "plugins": ["plugins"], "restart": {policy} }} }},
             "components": {{ {components} }} }}"#
    )
}

fn last_exit(process: &Value) -> &str {
    process["lastExit"].as_str().unwrap_or_default()
}

#[test]
fn devices_are_made_safe_when_up_is_asked_to_end_and_when_it_is_killed() {
    let file = one("\"never\"", r#""right/d": { "class": "device" }"#);
    for how in ["-INT", "-KILL", "down"] {
        let mut system = System::up(&file, &[]);
        let right = pid(&system.host("right"));
        match how {
            "-INT" => assert!(system.process.interrupt().success()),
            "-KILL" => system.process.kill(),
            _ => _ = system.trocar().run(&["down", "system"]).ends_with(0),
        }
        let mark = format!("make_safe {right}");
        eventually(&format!("{how}: its device is safe"), || {
            let marks = std::fs::read_to_string(system.world.path("device-marks")).unwrap_or_default();
            if gone(right) && marks.lines().any(|line| line == mark) { Ok(()) } else { Err(marks) }
        });
    }
}

#[test]
fn one_that_stands_still_is_killed_where_its_policy_says_so_also_when_it_moves_something() {
    let file = one(r#"{ "unheard_s": 0.5 }"#, r#""right/c": { "class": "chaos" }"#);
    let system = System::up(&file, &[]);
    let before = system.host("right");
    freeze(pid(&before));
    system.await_back("right", &before);
    let after = system.host("right");
    assert_eq!(last_exit(&after), "was not heard for 0.5 s and was killed", "{after}");
    let actuator = system.grpc.component("right/c");
    assert_eq!(actuator["stopReason"], "STOP_REASON_RESTARTED", "{actuator}");
    assert!(gone(pid(&before)));
}

#[test]
fn one_that_holds_a_component_that_does_not_come_back_is_killed() {
    let hangs = r#""right/c": { "class": "chaos", "config": { "hang_in": "command" } }"#;
    let system = System::up(&one(r#"{ "unheard_s": 0.5 }"#, hangs), &[]);
    let before = system.host("right");
    system.grpc.ok("InteractService/Invoke", json!({ "path": "right/c/ctl/poke", "send": true }));
    system.await_back("right", &before);
    let after = system.host("right");
    assert!(last_exit(&after).starts_with("held right/c, which did not come back for 0.5 s"), "{after}");
    let actuator = system.grpc.component("right/c");
    assert_eq!(actuator["stopReason"], "STOP_REASON_RESTARTED", "{actuator}");
}

#[test]
fn one_that_may_open_no_more_files_is_told_and_replaced_and_its_classes_stay() {
    let file = one(r#"{ "unheard_s": 0.5 }"#, r#""right/s": { "class": "sine" }"#).replacen(
        r#""processes": {"#,
        r#""processes": { "left": { "plugins": ["plugins"], "restart": "never" },"#,
        1,
    );
    let system = System::up(&file, &[]);
    let before = [system.host("left"), system.host("right")];
    for process in &before {
        let pid = pid(process).to_string();
        let done = Command::new("prlimit").args(["--pid", &pid, "--nofile=8:"]).status();
        assert!(done.is_ok_and(|status| status.success()), "prlimit {pid}");
    }
    system.await_back("right", &before[1]);
    let right = system.host("right");
    assert!(last_exit(&right).starts_with("was unfit for 0.5 s (nearly all of the 8 files"), "{right}");
    assert_eq!(right["unfit"], false, "{right}");
    let left = eventually("the one that is never put down is told", || match system.host("left") {
        left if left["unfit"] == true => Ok(left),
        left => Err(left.to_string()),
    });
    assert!(left["warnings"][0].as_str().is_some_and(|said| said.contains("ulimit -n")), "{left}");
    // Both look at their plugin directory again.
    system.world.drop_in(&Built::plugin("filters"));
    let classes = |process: &str| {
        system.grpc.ok("GcmService/Describe", json!({ "path": process }))["classes"].to_string()
    };
    eventually("the one that may reads it", || match classes("right") {
        all if all.contains("filters") => Ok(()),
        all => Err(all),
    });
    assert!(classes("left").contains("sine"), "what it cannot read is gone: {}", classes("left"));
}

/// A component that closes what is not its own, when it is told to.
fn closer(what: &str) -> String {
    format!(r#""right/c": {{ "class": "chaos", "config": {{ "rude": "{what}", "rude_in": "command" }} }}"#)
}

#[test]
fn one_whose_sockets_were_closed_is_told_and_put_down_where_its_policy_says_so() {
    let system = System::up(&one(r#"{ "unheard_s": 0.5 }"#, &closer("close_port")), &[]);
    let before = system.host("right");
    system.grpc.ok("InteractService/Invoke", json!({ "path": "right/c/ctl/poke", "send": true }));
    system.await_back("right", &before);
    let after = system.host("right");
    // A plugin that was loaded between two looks at the descriptors is named beside it.
    let why = last_exit(&after);
    assert!(why.starts_with("was unfit for 0.5 s ("), "{after}");
    for part in ["right/c", " closed descriptors of the host (listening socket "] {
        assert!(why.contains(part), "{part}: {after}");
    }
    assert_eq!(after["unfit"], false, "{after}");
}

#[test]
fn one_that_can_hear_of_nothing_any_more_makes_its_devices_safe_and_says_why_it_ends() {
    let device = r#""right/d": { "class": "device" }"#;
    let idle =
        closer("close_all").replace("\"config\"", "\"start\": false, \"config\"").replace("command", "start");
    for (entry, components) in [("command", closer("close_all")), ("start", idle)] {
        let system = System::up(&one("\"on_failure\"", &format!("{components}, {device}")), &[]);
        let before = system.host("right");
        // It may be gone before it answers.
        let _ = match entry {
            "start" => system.grpc.call("GcmService/Start", json!({ "path": "right/c" })),
            _ => system
                .grpc
                .call("InteractService/Invoke", json!({ "path": "right/c/ctl/poke", "send": true })),
        };
        system.await_back("right", &before);
        let mark = format!("make_safe {}", pid(&before));
        let marks = std::fs::read_to_string(system.world.path("device-marks")).unwrap_or_default();
        assert!(marks.lines().any(|line| line == mark), "{entry}: {marks}");
        let after = system.host("right");
        let why = last_exit(&after);
        assert!(why.starts_with("ended with code 1: the process cannot go on: "), "{entry}: {after}");
        for part in ["right/c", " closed descriptors of the host (", "epoll"] {
            assert!(why.contains(part), "{entry}: {part}: {after}");
        }
    }
}

#[test]
fn what_a_process_has_started_ends_with_it() {
    let system = System::up(&one("\"on_failure\"", r#""right/doom": { "class": "doom" }"#), &[]);
    let before = system.host("right");
    system
        .grpc
        .ok("InteractService/Invoke", json!({ "path": "right/doom/ctl/strike", "json": 8, "send": true }));
    system.await_back("right", &before);
    assert!(
        last_exit(&system.host("right")).starts_with("was killed by SIGABRT"),
        "{}",
        system.host("right")
    );
    let litter = ["sleep".to_owned(), format!("8{}", pid(&before))];
    let left = running(|arguments| arguments.starts_with(&litter));
    assert!(left.is_empty(), "{left:?} of {litter:?}");
}

#[test]
fn a_process_comes_back_although_its_state_directory_was_removed() {
    let two = System::up(TWO, &[]);
    let before = two.host("right");
    std::fs::remove_dir_all(two.world.path("xdg-state")).unwrap();
    kill("-KILL", pid(&before));
    two.await_back("right", &before);
    assert_eq!(two.grpc.state("right/s"), "ACTIVE");
}

#[test]
fn one_that_hangs_before_it_serves_is_killed_and_counts_as_failed() {
    let policy = r#"{ "max": 1000, "backoff_ms": 1, "start_within_s": 10 }"#;
    let system = System::up(&one(policy, r#""right/s": { "class": "sine" }"#), &[]);
    let before = system.host("right");
    kill("-KILL", pid(&before));
    let hung = eventually("the next one begins", || match system.pid_of("right") {
        Some(now) if now != pid(&before) => Ok(now),
        other => Err(format!("{other:?}")),
    });
    freeze(hung);
    eventually("the one after it is whole", || {
        let right = system.host("right");
        let whole = right["state"] == "PROCESS_STATE_ATTACHED" && pid(&right) != hung && gone(hung);
        if whole && number(&right["restarts"]) >= 2 { Ok(()) } else { Err(right.to_string()) }
    });
    assert_eq!(last_exit(&system.host("right")), "did not serve within 10 s and was killed");
    system.grpc.await_state("right/s", "ACTIVE");
}

#[test]
fn a_plugin_that_ends_its_process_has_asked_nobody_and_a_person_has() {
    // So slow that `send` is answered before the step in which it ends.
    let doom = r#""right/doom": { "class": "doom", "execution": { "rate_hz": 0.5 } }"#;
    let system = System::up(&one("\"on_failure\"", doom), &[]);
    let before = system.host("right");
    system
        .grpc
        .ok("InteractService/Invoke", json!({ "path": "right/doom/ctl/strike", "json": 7, "send": true }));
    system.await_back("right", &before);
    let back = system.host("right");
    assert_eq!(last_exit(&back), "ended with code 0", "{back}");
    kill("-TERM", pid(&back));
    eventually("it is told that it stays away", || {
        let printed = system.process.printed();
        if printed.contains("\"phase\":\"ENDED\"") { Ok(()) } else { Err(printed) }
    });
    assert!(gone(pid(&back)) && system.pid_of("right").is_none());
}

#[test]
fn down_names_what_it_had_to_kill() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let file = world.write("system.json", TWO);
    let up = ["up", file.to_str().unwrap(), "--detach", "--json", "--listen", "127.0.0.1:0"];
    let up = Trocar::new(&world).run(&up).ends_with(0).json();
    let right = up["processes"].as_array().unwrap().iter().find(|p| p["name"] == "right").unwrap();
    freeze(pid(right));
    let down = Trocar::new(&world).run(&["down", "system", "--json"]).ends_with(5).json();
    let named = down["not_in_order"].to_string();
    assert!(named.contains("process right did not end within 12 s and was killed"), "{down}");
    assert!(!named.contains("left"), "{down}");
    assert!(running_in(&world.path("")).is_empty());
}

#[test]
fn whoever_stops_reading_ends_nothing() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let file = world.write("system.json", TWO);
    for json in [false, true] {
        let mut args = vec!["up", file.to_str().unwrap(), "--listen", "127.0.0.1:0"];
        args.extend(json.then_some("--json"));
        let mut up = Command::new(Built::trocar())
            .args(&args)
            .current_dir(world.path(""))
            .env("XDG_STATE_HOME", world.path("xdg-state"))
            .env_remove("TROCAR_GCM")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(up.stdout.take().unwrap());
        let mut line = String::new();
        while !line.contains("listening") && !line.contains("right") {
            line.clear();
            assert_ne!(lines.read_line(&mut line).unwrap(), 0, "it ended");
        }
        drop((lines, up.stderr.take()));
        let gcm = children(up.id().into()).into_iter().find(|pid| is_gcm(*pid)).unwrap();
        let trocar = Trocar::at(&world, &listening(gcm).unwrap());
        let right = || trocar.run(&["ls", "right", "--json"]).ends_with(0).json()["processes"][0].clone();
        for round in 1..=2 {
            let before = right();
            kill("-KILL", pid(&before));
            eventually(&format!("json {json}, round {round}: right is back, although nobody reads"), || {
                let now = right();
                let back = now["state"] == "ATTACHED" && number(&now["restarts"]) == round;
                if back { Ok(()) } else { Err(now.to_string()) }
            });
        }
        assert!(up.try_wait().unwrap().is_none(), "it goes on");
        Trocar::new(&world).run(&["down", "system"]).ends_with(0);
        assert!(up.wait().unwrap().success());
    }
}

#[test]
fn a_component_that_fails_later_is_told_and_what_it_printed_is_kept() {
    let file = TWO.replacen(
        "\"class\": \"chaos\"",
        "\"class\": \"chaos\", \"config\": { \"panic_in\": \"step\", \"good_steps\": 20 }",
        1,
    );
    let two = System::up(&file, &[]);
    eventually("it is told", || {
        let printed = two.process.printed();
        let told =
            printed.lines().any(|line| line.contains("\"component\":\"right/c\"") && line.contains("FAULT"));
        if told { Ok(()) } else { Err(printed) }
    });
    let output = two.world.path("xdg-state/trocar/up/system/right.output.log");
    eventually("its words are there", || {
        let text = std::fs::read_to_string(&output).unwrap_or_default();
        if text.contains("chaos in step") { Ok(()) } else { Err(text) }
    });
}

#[test]
fn what_a_process_and_somebody_elses_gcm_lost_together_is_made_again() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let mut gcm = HostProcess::start_gcm(&world);
    let address = gcm.address().to_owned();
    let file = world.write("system.json", TWO);
    let args = ["up", file.to_str().unwrap(), "--json", "--gcm", &address];
    let mut up = HostProcess::spawn(&world, "up", &args.map(Into::into));
    gcm.grpcurl().stop("left/s");
    let right = eventually("right runs", || {
        let trocar = Trocar::at(&world, &address).run(&["ls", "right", "--json"]);
        trocar.json()["processes"][0]["pid"].as_u64().ok_or("none")
    });
    gcm.kill();
    kill("-KILL", right);
    eventually("it has ended", || if gone(right) { Ok(()) } else { Err("it runs") });
    let state = world.state().join("gcm");
    let again = ["gcm", "--listen", &address, "--state", state.to_str().unwrap()];
    let gcm = HostProcess::spawn(&world, "gcm", &again.map(Into::into));
    let states = || {
        let ls = Trocar::at(&world, gcm.address()).run(&["ls", "--json"]);
        let all = if ls.code == 0 { ls.json()["components"].clone() } else { Value::Null };
        let all = all.as_array().cloned().unwrap_or_default();
        all.iter().map(|c| format!("{} {}", c["path"], c["state"]).replace('"', "")).collect::<Vec<_>>()
    };
    let wanted =
        ["left/s STOPPED{requested}", "right/c STOPPED{restarted}", "right/off READY", "right/s ACTIVE"];
    eventually("all is there again", || match states() {
        all if all == wanted => Ok(()),
        all => Err(format!("{all:?}")),
    });
    assert!(up.interrupt().success());
}

#[test]
fn a_system_under_somebody_elses_gcm_comes_up_again_after_its_up_was_killed() {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let gcm = HostProcess::start_gcm(&world);
    let file = world.write("system.json", TWO);
    let args = ["up", file.to_str().unwrap(), "--json", "--gcm", gcm.address()];
    let mut up = HostProcess::spawn(&world, "up", &args.map(Into::into));
    let hosts = children(up.pid().into());
    up.kill();
    for host in hosts {
        eventually("its hosts end by themselves", || if gone(host) { Ok(()) } else { Err("one runs") });
    }
    let left = gcm.grpcurl().ok("GcmService/List", json!({ "brief": true }));
    assert_eq!(left["components"].as_array().map(Vec::len), Some(4), "it is still known: {left}");
    let mut up = HostProcess::spawn(&world, "up", &args.map(Into::into));
    for (path, state) in
        [("left/s", "ACTIVE"), ("right/s", "ACTIVE"), ("right/c", "ACTIVE"), ("right/off", "READY")]
    {
        assert_eq!(gcm.grpcurl().state(path), state, "{path}");
    }
    assert!(up.interrupt().success());
}
