//! `trocar save`, `diff` and `apply`: a running system and a system file, from one to the other.
//!
//! Promise: a saved file makes the same system again; a system becomes what a file says, all of it or
//! nothing, and what does not differ goes on as it was.

use std::ffi::OsString;
use std::fs;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually, number};

use super::{OK, REFUSED};
use crate::processes::system::System;

const PLUGINS: [&str; 3] = ["sine", "filters", "eyerobot"];

/// Two processes, and a third for a component alone.
const FILE: &str = r#"{
  "version": 1,
  "processes": { "device": { "plugins": ["plugins"] }, "control": { "plugins": ["plugins"] } },
  "components": {
    "control/filter": { "class": "filters/biquad", "config": { "frequency_hz": 5 }, "start": false },
    "control/wave": { "class": "sine/sine", "isolation": "process" },
    "device/robot": { "class": "eyerobot/eyerobot", "execution": { "rate_hz": 2000 } },
    "device/wave": { "class": "sine/sine", "config": { "frequency_hz": 50 } }
  },
  "connections": [
    { "client": "control/filter/value", "server": "device/wave/value", "queue": { "fifo": 16 } }
  ]
}
"#;

fn up() -> System {
    System::up_with(&PLUGINS, FILE, &[])
}

/// A file of the world, by its path.
fn path(system: &System, name: &str) -> String {
    system.world.path(name).display().to_string()
}

/// The file with one part replaced, beside it.
fn changed(system: &System, name: &str, part: &str, by: &str) -> String {
    assert!(FILE.contains(part), "the file has no {part:?}");
    system.world.write(name, FILE.replacen(part, by, 1)).display().to_string()
}

fn differences(trocar: &Trocar, file: &str) -> Vec<String> {
    let told = trocar.run(&["diff", file, "--json"]).json();
    told["differences"].as_array().unwrap().iter().map(|line| line.as_str().unwrap().to_owned()).collect()
}

/// Steps and incarnation of a component.
fn steps(system: &System, component: &str) -> (u64, String) {
    let stands = system.grpc.component(component);
    (number(&stands["stats"]["executed"]), stands["state"].as_str().unwrap().to_owned())
}

#[test]
fn a_plugin_directory_that_was_given_relative_to_the_host_is_found_from_a_file_elsewhere() {
    let world = World::with_plugins(&["sine"]);
    let args = ["host", "--listen", "127.0.0.1:0", "--plugins", "plugins", "--state", "state/host"];
    let host = HostProcess::spawn(&world, "host", &args.map(OsString::from));
    let trocar = Trocar::at(&world, host.address());
    host.grpcurl().await_class("host", "sine");
    trocar.run(&["create", "host/s", "sine"]).ends_with(OK);
    fs::create_dir(world.path("elsewhere")).unwrap();
    trocar.run(&["save", "-o", "elsewhere/system.json"]).ends_with(OK);
    trocar.run(&["check", "elsewhere/system.json"]).ends_with(OK);
}

#[test]
fn what_is_saved_reads_as_written_by_hand_and_comes_up_again() {
    let system = up();
    let (trocar, saved) = (system.trocar(), path(&system, "saved.json"));
    trocar
        .run(&["save", "-o", &saved])
        .ends_with(OK)
        .says("saved.json: 3 processes, 4 components, 1 connection")
        .says("the GCM does not know these settings");
    assert_eq!(fs::read_to_string(&saved).unwrap(), sorted(FILE));
    trocar.run(&["diff", &saved]).ends_with(OK).says("the system is what");
    trocar.run(&["check", &saved]).ends_with(OK).says("is right");
    // Nothing is replaced unasked; without a file the text is what is printed.
    fs::write(&saved, "mine").unwrap();
    trocar.run(&["save", "-o", &saved]).ends_with(REFUSED).says("is there already").says("--force");
    assert_eq!(fs::read_to_string(&saved).unwrap(), "mine");
    trocar.run(&["save", "-o", &saved, "--force"]).ends_with(OK);
    let text = fs::read_to_string(&saved).unwrap();
    let printed = system.trocar().in_dir(system.world.path("plugins").parent().unwrap()).run(&["save"]);
    assert_eq!(printed.ends_with(OK).stdout, text);
    let nowhere = path(&system, "nowhere/saved.json");
    trocar.run(&["save", "-o", &nowhere]).ends_with(REFUSED).says("make it first");
    drop(system);
    let again = System::up_with(&PLUGINS, &text, &[]);
    again.trocar().run(&["diff", &path(&again, "system.json")]).ends_with(OK);
    assert_eq!(again.grpc.component("device/robot")["execution"]["period"], "0.000500s");
}

#[test]
fn what_a_configuration_made_what_failed_and_what_is_lost_is_saved_and_comes_up_again() {
    let file = r#"{
  "version": 1,
  "processes": { "control": { "plugins": ["plugins"] }, "device": { "plugins": ["plugins"] } },
  "components": {
    "control/faulty": { "class": "fixture-chaos/chaos", "config": { "error_in": "step", "good_steps": 20 } },
    "control/log": { "class": "recorder/recorder", "config": { "directory": "runs", "topics": ["a", "b"] } },
    "device/wave": { "class": "sine/sine" }
  },
  "connections": [
    { "client": "control/log/b", "server": "device/wave/value" }
  ]
}
"#;
    let plugins = ["sine", "recorder", "fixture_chaos"];
    let without_restart =
        file.replace(r#""device": {"#, r#""device": { "restart": { "max": 0, "within_s": 1 },"#);
    let system = System::up_with(&plugins, &without_restart, &[]);
    let (trocar, saved) = (system.trocar(), path(&system, "saved.json"));
    eventually("one has failed", || match system.grpc.state("control/faulty").as_str() {
        "FAULT" => Ok(()),
        other => Err(other.to_owned()),
    });
    system.kill_until_failed("device");
    let told = trocar.run(&["save", "-o", &saved]).ends_with(OK);
    let told = told.says("2 processes, 3 components, 1 connection");
    told.says("process device is not there to tell its plugin directories")
        .says("control/log.directory = \"runs\"");
    let text = fs::read_to_string(&saved).unwrap();
    // Nothing is missing but what is told to be.
    let completed = text.replace(r#""device": {}"#, r#""device": { "plugins": ["plugins"] }"#);
    assert_eq!(completed, file, "{text}");
    drop(system);
    let again = System::up_with(&plugins, &completed, &[]);
    again.trocar().run(&["check", &path(&again, "system.json")]).ends_with(OK);
    assert_eq!(again.grpc.state("control/log"), "ACTIVE");
}

/// The processes of a saved system are in alphabetical order.
fn sorted(file: &str) -> String {
    let processes = r#"{ "device": { "plugins": ["plugins"] }, "control": { "plugins": ["plugins"] } }"#;
    assert!(file.contains(processes));
    file.replace(
        processes,
        r#"{ "control": { "plugins": ["plugins"] }, "device": { "plugins": ["plugins"] } }"#,
    )
}

#[test]
fn a_system_becomes_what_a_file_says_and_what_does_not_differ_goes_on() {
    let system = up();
    let trocar = system.trocar();
    let robot = steps(&system, "device/robot");
    let wanted = FILE
        .replacen(r#""frequency_hz": 50"#, r#""frequency_hz": 60"#, 1)
        .replacen(r#""frequency_hz": 5 }, "start": false"#, r#""kind": "notch" }"#, 1)
        .replacen(r#""control/wave": { "class": "sine/sine", "isolation": "process" },"#, "", 1)
        .replacen(
            r#""device/wave": {"#,
            r#""device/second": { "class": "sine", "isolation": "process" }, "device/wave": {"#,
            1,
        )
        .replacen(r#""queue": { "fifo": 16 }"#, r#""max_age_ms": 20"#, 1);
    let file = system.world.write("wanted.json", wanted).display().to_string();
    let expected = [
        "~ control/filter: frequency_hz: 5 → 20, kind: \"low_pass\" → \"notch\", READY, and the file starts it",
        "+ device.second/second (sine/sine)",
        "~ device/wave: frequency_hz: 50 → 60",
        "- control.wave/wave (sine/sine)",
        "~ device/wave/value → control/filter/value: queue: {\"fifo\":16} → unset, max_age_ms: unset → 20",
    ];
    let seen = differences(&trocar, &file);
    assert_eq!(seen.len(), expected.len(), "{seen:#?}");
    for line in expected {
        assert!(seen.contains(&line.to_owned()), "{line}: {seen:#?}");
    }
    trocar.run(&["diff", &file]).ends_with(REFUSED).says("5 differences");
    // The plan, and nothing is done.
    trocar.run(&["apply", &file, "--prune", "--dry-run"]).ends_with(OK).says("nothing was changed");
    assert_eq!(differences(&trocar, &file).len(), expected.len());
    // Nothing goes that the file does not name, unless it is said.
    trocar.run(&["apply", &file]).ends_with(OK).says("control/filter  ACTIVE");
    assert_eq!(differences(&trocar, &file), ["- control.wave/wave (sine/sine)"]);
    trocar.run(&["apply", &file, "--prune"]).ends_with(OK);
    trocar.run(&["diff", &file]).ends_with(OK).says("the system is what");
    trocar.run(&["apply", &file]).ends_with(OK).says("nothing to do");
    let later = steps(&system, "device/robot");
    assert!(later.0 > robot.0 && later.1 == robot.1, "it was left alone: {robot:?}, {later:?}");
    // And back, by the file it came from.
    trocar.run(&["apply", &path(&system, "system.json"), "--prune"]).ends_with(OK);
    trocar.run(&["diff", &path(&system, "system.json")]).ends_with(OK);
}

#[test]
fn what_is_refused_is_led_back_to_the_file_and_nothing_is_changed() {
    let system = up();
    let trocar = system.trocar();
    let before = system.grpc.revision();
    let wrong =
        changed(&system, "wrong.json", r#""frequency_hz": 5 }"#, r#""frequency_hz": 5, "kinds": 1 }"#);
    trocar.run(&["apply", &wrong]).ends_with(REFUSED).says("wrong.json:5:").says("did you mean kind?");
    trocar.run(&["diff", &wrong]).ends_with(REFUSED).says("wrong.json:5:");
    let set = ["--set", "device/wave.frequency_hz=900"];
    trocar
        .run(&["apply", &path(&system, "system.json"), set[0], set[1]])
        .ends_with(REFUSED)
        .says("above 500 Hz");
    // The first part of it could be done alone, and is not.
    let half =
        changed(&system, "half.json", r#""server": "device/wave/value""#, r#""server": "device/robot/arm""#);
    trocar
        .run(&["apply", &half, "--set", "device/wave.frequency_hz=7"])
        .ends_with(REFUSED)
        .says("half.json:11:");
    // A process is not started by it.
    let more = changed(&system, "more.json", r#""processes": {"#, r#""processes": { "gui": {},"#);
    let told = trocar.run(&["diff", &more]).ends_with(REFUSED).says("+ process gui");
    told.says("trocar host --name gui");
    trocar.run(&["apply", &more]).ends_with(OK).says("does not run").says("nothing to do");
    assert_eq!(system.grpc.revision(), before, "nothing was changed");
}

#[test]
fn what_a_component_refuses_in_the_middle_leaves_everything_as_it_ran() {
    let system = up();
    let (trocar, grpc) = (system.trocar(), &system.grpc);
    // Not in the file: what is put back is what was there.
    grpc.ok("GcmService/Configure", json!({ "path": "device/wave", "config": { "amplitude": 7 } }));
    let median = r#""control/median": { "class": "filters/moving_median", "config": { "window": 4 } },"#;
    let wanted = FILE
        .replacen(
            r#""frequency_hz": 50 } }"#,
            r#""frequency_hz": 50 }, "execution": { "rate_hz": 500 } }"#,
            1,
        )
        .replacen(r#""device/robot""#, &format!("{median}\n    \"device/robot\""), 1);
    let file = system.world.write("refused.json", wanted).display().to_string();
    let before = grpc.component("device/wave");
    trocar.run(&["apply", &file]).ends_with(REFUSED).says("refused.json:").says("window: 4 is even");
    let after = grpc.component("device/wave");
    for what in ["class", "config", "execution", "state"] {
        assert_eq!(after[what], before[what], "{what}");
    }
    eventually("it gives what it gave", || {
        let sample = grpc.ok("InteractService/Read", json!({ "path": "device/wave/value" }));
        let value = sample["json"]["value"].as_f64().unwrap_or_default();
        if value.abs() > 1.5 { Ok(()) } else { Err(sample.to_string()) }
    });
    let list = grpc.ok("GcmService/List", json!({}));
    assert_eq!(list["connections"].as_array().map(Vec::len), Some(1), "{list}");
    assert!(list["components"].as_array().unwrap().iter().all(|c| c["path"] != "control/median"), "{list}");
}

#[test]
fn anybody_may_ask_for_it_over_grpc() {
    let system = up();
    let grpc = &system.grpc;
    let text = fs::read_to_string(path(&system, "system.json")).unwrap();
    let refused = |body: Value, words: &str| {
        let refused = grpc.refused("GcmService/Apply", body);
        assert!(refused.reason == "ARGUMENT_INVALID" && refused.message.contains(words), "{refused}");
    };
    refused(json!({ "system": "{" }), "system:1:1: not JSON");
    refused(json!({ "system": "{}" }), "\"version\"");
    refused(json!({ "prune": true }), "prune is for the text of a system file");
    refused(json!({ "system": text, "steps": [{ "stop": { "path": "**" } }] }), "give one of them");
    let refused = grpc.refused("GcmService/Compare", json!({ "system": "[]" }));
    assert_eq!(refused.reason, "ARGUMENT_INVALID", "{refused}");
    // The same id is the same request: nothing is done twice, and another text is another request.
    let wanted = text.replace(r#""frequency_hz": 50"#, r#""frequency_hz": 70"#);
    let body = json!({ "system": wanted, "requestId": "one" });
    let first = grpc.ok("GcmService/Apply", body.clone());
    assert_eq!(first["plan"], json!(["~ configure device/wave {frequency_hz: 50 → 70} → ACTIVE"]));
    assert_eq!(grpc.ok("GcmService/Apply", body), first);
    let other = grpc.refused("GcmService/Apply", json!({ "system": text, "requestId": "one" }));
    assert!(other.message.contains("used for another request"), "{other}");
    let stale = grpc.refused("GcmService/Apply", json!({ "system": text, "expectedRevision": 1 }));
    assert_eq!(stale.reason, "REVISION_CONFLICT", "{stale}");
    let saved = grpc.ok("GcmService/Save", json!({}));
    let plugins = system.world.plugins().canonicalize().unwrap();
    let saved = saved["text"].as_str().unwrap();
    assert!(
        saved.contains(&format!("[\"{}\"]", plugins.display())),
        "absolute where no folder is said: {saved}"
    );
    let same = grpc.ok("GcmService/Compare", json!({ "system": saved }));
    assert_eq!(same["differences"], json!([]), "{same}");
}
