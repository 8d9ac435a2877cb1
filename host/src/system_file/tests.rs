//! Each kind of mistake in a system file, with the place and the help it must answer.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use serde_json::json;
use trocar_model::{ExecutionModel, OnFailure, Queue, Refusal, Request, Wake};

use super::{Draft, Problem, SystemFile, system_schema};
use crate::host::MemoryBounds;
use crate::processes::{Limits, Policy, Unheard};

const GOOD: &str = r#"{
  "version": 1,
  "//": "a comment",
  "//": "and another",
  "processes": { "host": { "plugins": ["plugins"], "trust": "dev" } },
  "components": {
    "host/gray":   { "class": "gray", "execution": { "stream_of": "host/source" } },
    "host/robot":  { "class": "eyerobot", "config": { "seed": 7, "//": "why 7" },
                     "execution": { "model": "periodic", "rate_hz": 1000, "priority": 80, "cpus": [1], "catch_up": 3, "max_step_ms": 2.5, "wake": "signal" } },
    "host/source": { "class": "stereo/image_source", "execution": { "model": "stream", "threads": 2, "on_failure": "bypass" } },
    "host/log":    { "class": "recorder", "start": false }
  },
  "connections": [
    { "client": "host/gray/image", "server": "host/source/image" },
    { "client": "host/log/any", "server": "host/robot/arm", "queue": { "fifo": 4096 }, "max_age_ms": 2.5 }
  ],
  "scenarios": {}
}"#;

fn parse(text: &str) -> Result<SystemFile, Problem> {
    SystemFile::parse("system.json", text.to_owned())
}

/// Returns the problems of the file by itself.
fn checked(text: &str) -> Result<SystemFile, Vec<Problem>> {
    draft(text).and_then(Draft::finished)
}

fn draft(text: &str) -> Result<Draft, Vec<Problem>> {
    Draft::of("system.json", text.to_owned())
}

/// The file with one part replaced, which must then be refused.
fn refused(part: &str, by: &str) -> Problem {
    assert!(GOOD.contains(part), "the good file has no {part:?}");
    parse(&GOOD.replacen(part, by, 1)).unwrap_err()
}

#[test]
fn a_good_file_becomes_creates_then_connects_then_one_start() {
    let file = parse(GOOD).unwrap();
    let requests = file.requests();
    let kinds: Vec<String> = requests
        .iter()
        .map(|r| match r {
            Request::Create { id, .. } => format!("create {id}"),
            Request::Connect { client, .. } => format!("connect {client}"),
            Request::Start { targets } => format!("start {}", targets.len()),
            other => panic!("unexpected {other:?}"),
        })
        .collect();
    assert_eq!(
        kinds,
        [
            "create host/robot",
            "create host/source",
            "create host/log",
            "create host/gray",
            "connect host/gray/image",
            "connect host/log/any",
            "start 3"
        ],
        "a stream's owner is created before its members, and what says start: false is not started"
    );
}

#[test]
fn values_arrive_in_the_models_units() {
    let file = parse(GOOD).unwrap();
    let robot = file.components.iter().find(|c| c.class == "eyerobot").unwrap();
    assert_eq!(robot.execution.period_ns, Some(1_000_000));
    assert_eq!(robot.execution.model, Some(ExecutionModel::Periodic));
    assert_eq!(robot.execution.priority, Some(80));
    assert_eq!(robot.execution.cpus, [1]);
    assert_eq!((robot.execution.catch_up, robot.execution.max_step_ns), (Some(3), Some(2_500_000)));
    assert_eq!(robot.execution.wake, Some(Wake::Signal));
    let source = file.components.iter().find(|c| c.class == "stereo/image_source").unwrap();
    assert_eq!((source.execution.threads, source.execution.on_failure), (Some(2), Some(OnFailure::Bypass)));
    assert_eq!(robot.config, Some(json!({"seed": 7})), "comments do not reach the component");
    let log = &file.connections[1].options;
    assert_eq!(log.queue, Some(Queue::Fifo { depth: 4096, drop_oldest: false }));
    assert_eq!(log.max_age_ns, Some(2_500_000));
}

#[test]
fn every_mistake_is_listed_in_the_order_of_the_file_and_none_for_another_ones_sake() {
    let text = r#"{
  "version": 1,
  "processes": { "host": { "plugins": "plugins", "restart": { "max": -1 } }, "a b": {} },
  "components": {
    "host/robot": { "clas": "eyerobot", "execution": { "rate_hz": "fast", "period_us": 1, "cpus": ["a", 1] } },
    "hst/sine":   { "class": "sine", "config": 7, "start": 0 },
    "host/log":   [],
    "host/log":   { "class": "recorder" }
  },
  "connections": [
    { "client": "host/robot/arm", "server": "host/other/arm", "queue": {} },
    { "client": "hst/sine/x" },
    7
  ],
  "more": 1
}"#;
    let problems = checked(text).unwrap_err();
    let said: Vec<String> = problems.iter().map(|p| format!("{}: {}", p.pointer, p.what)).collect();
    assert_eq!(
        said,
        [
            "/processes/host/plugins: expected a list, found the text \"plugins\"",
            "/processes/host/restart/max: expected a number of restarts, a whole number from 0 to 1000, found the number -1",
            "/processes/a b: `a b` is not a path: character 2 is ' '; a name holds letters, digits, _ . -",
            "/components/host~1robot/clas: unknown key \"clas\" in a component",
            "/components/host~1robot/execution/rate_hz: expected a number above 0 Hz, found the text \"fast\"",
            "/components/host~1robot/execution/period_us: \"rate_hz\" and \"period_us\" exclude each other",
            "/components/host~1robot/execution/cpus/0: expected a CPU number, a whole number from 0 to 4095, found the text \"a\"",
            "/components/hst~1sine: process \"hst\" is not in \"processes\"",
            "/components/hst~1sine/config: expected config (an object), found the number 7",
            "/components/hst~1sine/start: expected true or false, found the number 0",
            "/components/host~1log: expected a component (an object), found a list",
            "/components/host~1log: duplicate key \"host/log\": it is already at line 7, column 5",
            "/connections/0/server: component host/other is not in this file",
            "/connections/0/queue: a queue (or the text \"latest\") has no \"fifo\"",
            "/connections/1: a connection has no \"server\"",
            "/connections/2: expected a connection (an object), found the number 7",
            "/more: unknown key \"more\" in a system file",
        ]
    );
    assert!(problems.iter().all(|p| !p.help.is_empty()));
}

#[test]
fn a_file_of_mistakes_is_read_in_no_time_and_a_hundred_are_listed() {
    let many: Vec<String> = (0..200_000).map(|n| format!("\"k{n}\": 1")).collect();
    let problems = checked(&format!("{{{}}}", many.join(","))).unwrap_err();
    assert_eq!(problems.len(), 100);
}

#[test]
fn an_unknown_key_is_refused_with_its_place_and_the_nearest_name() {
    let p = refused("\"class\": \"eyerobot\"", "\"clas\": \"eyerobot\"");
    assert_eq!((p.line, p.column, p.pointer.as_str()), (8, 22, "/components/host~1robot/clas"));
    assert!(p.help.contains("did you mean \"class\"?"), "{}", p.help);
    assert_eq!(
        p.to_string(),
        "system.json:8:22: /components/host/robot/clas: unknown key \"clas\" in a component"
    );
}

#[test]
fn a_duplicate_key_is_refused_with_both_places() {
    let p = refused("\"scenarios\": {}", "\"version\": 1");
    assert_eq!((p.line, p.pointer.as_str()), (17, "/version"));
    assert!(p.what.contains("already at line 2, column 3"), "{}", p.what);
    let p = refused("\"seed\": 7", "\"seed\": 7, \"seed\": 8");
    assert!(p.pointer.ends_with("/config/seed"), "duplicates inside config too: {p}");
}

#[test]
fn a_duplicate_key_of_any_json_text_is_found_at_any_depth() {
    use super::duplicate_key;
    assert_eq!(duplicate_key("config", r#"{"a": {"x": 1}, "b": [{"x": 1}]}"#), None);
    let p = duplicate_key("config", r#"{"a": [{"x": 1, "x": 2}]}"#).unwrap();
    assert_eq!((p.file.as_str(), p.pointer.as_str(), p.column), ("config", "/a/0/x", 17));
    assert!(p.what.contains("already at line 1"), "{p}");
    assert_eq!(duplicate_key("config", "30"), None);
    assert_eq!(duplicate_key("config", "{"), None, "what is no JSON is for the reader to say");
}

#[test]
fn text_that_is_not_json_is_refused_with_line_and_column() {
    let p = refused("\"version\": 1,", "\"version\": 1");
    assert_eq!((p.line, p.column), (3, 3), "{p}");
    let p = parse("{\n  // system\n  \"version\": 1\n}").unwrap_err();
    assert!(p.help.contains("JSON has no comments"), "{}", p.help);
    let p = parse("").unwrap_err();
    assert!(p.help.contains("empty"), "{}", p.help);
}

#[test]
fn another_version_is_refused_and_a_missing_one_too() {
    assert!(refused("\"version\": 1,", "\"version\": 2,").what.contains("reads version 1"));
    assert!(refused("\"version\": 1,", "").what.contains("has no \"version\""));
}

#[test]
fn a_wrong_type_names_what_was_found() {
    let p = refused("\"rate_hz\": 1000", "\"rate_hz\": \"1 kHz\"");
    assert_eq!(p.what, "expected a number above 0 Hz, found the text \"1 kHz\"");
    assert!(refused("\"start\": false", "\"start\": 0").what.contains("expected true or false"));
    assert!(refused("\"priority\": 80", "\"priority\": 100").what.contains("from 1 to 99"));
    assert!(refused("\"catch_up\": 3", "\"catch_up\": 1001").what.contains("from 0 to 1000"));
    assert!(refused("\"threads\": 2", "\"threads\": 0").what.contains("from 1 to 64"));
    assert!(refused("\"max_step_ms\": 2.5", "\"max_step_ms\": -1").what.contains("above 0 ms"));
    for never in ["0", "-2.5", "null"] {
        let p = refused("\"max_age_ms\": 2.5", &format!("\"max_age_ms\": {never}"));
        assert!(p.what.contains("above 0 ms") && p.pointer == "/connections/1/max_age_ms", "{never}: {p}");
    }
    assert!(refused("\"bypass\"", "\"bypas\"").help.contains("did you mean \"bypass\"?"));
    assert!(refused("{ \"seed\": 7, \"//\": \"why 7\" }", "[]").what.contains("found a list"));
}

#[test]
fn a_model_that_does_not_exist_lists_those_that_do() {
    let p = refused("\"model\": \"periodic\"", "\"model\": \"periodical\"");
    assert!(p.help.contains("did you mean \"periodic\"?") && p.help.contains("on_signal"), "{}", p.help);
}

#[test]
fn two_keys_for_one_thing_are_refused() {
    let p = refused("\"rate_hz\": 1000", "\"rate_hz\": 1000, \"period_us\": 1000");
    assert!(p.what.contains("exclude each other"), "{}", p.what);
}

#[test]
fn a_malformed_path_is_refused_where_it_is_written() {
    let p = refused("\"host/log\":    {", "\"log\":    {");
    assert_eq!((p.line, p.column), (11, 5), "{p}");
    let p = refused("\"server\": \"host/source/image\"", "\"server\": \"host/source\"");
    assert_eq!(p.pointer, "/connections/0/server");
    assert!(p.help.contains("process/component/port"), "{}", p.help);
}

#[test]
fn a_process_or_component_that_is_not_in_the_file_is_refused() {
    let p = refused("\"host/log\":    {", "\"hots/log\":    {");
    assert!(p.what.contains("\"hots\"") && p.help.contains("did you mean \"host\"?"), "{p} / {}", p.help);
    let p = refused("\"server\": \"host/source/image\"", "\"server\": \"host/sorce/image\"");
    assert!(p.help.contains("did you mean \"host/source\"?"), "{}", p.help);
}

#[test]
fn the_same_connection_twice_is_refused() {
    let part = "{ \"client\": \"host/gray/image\", \"server\": \"host/source/image\" },";
    let p = refused(part, &format!("{part}{part}"));
    assert!(p.what.contains("listed twice"), "{}", p.what);
}

#[test]
fn scenarios_and_signed_trust_say_that_they_are_not_in_this_version() {
    assert!(
        refused("\"scenarios\": {}", "\"scenarios\": {\"a\": {}}").what.contains("not part of this version")
    );
    assert!(refused("\"dev\"", "\"signed\"").what.contains("not part of this version"));
    assert!(refused("\"dev\"", "\"allowlist\"").what.contains("needs the file of hashes"));
}

#[test]
fn several_processes_are_not_for_run() {
    let text = GOOD.replacen("\"trust\": \"dev\" } }", "\"trust\": \"dev\" }, \"other\": {} }", 1);
    let p = parse(&text).unwrap().single_process().unwrap_err().clone();
    assert!(p.what.contains("2 processes (host, other)") && p.help.contains("trocar up"), "{p} / {}", p.help);
}

#[test]
fn without_processes_they_are_those_of_the_components() {
    let file = parse(r#"{"version": 1, "components": {"a/x": {"class": "c"}}}"#).unwrap();
    assert_eq!(file.single_process().unwrap().name.as_str(), "a");
}

#[test]
fn set_changes_one_configuration_value() {
    let mut file = parse(GOOD).unwrap();
    file.set("host/robot.port=/dev/ttyUSB1").unwrap();
    file.set("host/robot.limits.tilt_rad=0.5").unwrap();
    file.set("host/source.loop=false").unwrap();
    let config =
        |class: &str| file.components.iter().find(|c| c.class == class).unwrap().config.clone().unwrap();
    assert_eq!(config("eyerobot"), json!({"seed": 7, "port": "/dev/ttyUSB1", "limits": {"tilt_rad": 0.5}}));
    assert_eq!(config("stereo/image_source"), json!({"loop": false}));
}

#[test]
fn set_refuses_what_it_cannot_place() {
    let mut file = parse(GOOD).unwrap();
    assert!(file.set("host/robot.port").unwrap_err().why.contains("no '='"));
    assert!(file.set("host/robt.port=1").unwrap_err().help.contains("did you mean \"host/robot\"?"));
    assert!(file.set("port=1").unwrap_err().help.contains("process/component.key=value"));
    assert!(file.set("host/robot..x=1").unwrap_err().why.contains("empty key"));
}

#[test]
fn a_refusal_of_the_model_is_led_back_to_its_place() {
    let file = parse(GOOD).unwrap();
    let client = file.connections[0].client.clone();
    let p = file.locate(&Refusal::InterfaceNotFound { port: client, known: vec!["images".into()] }).unwrap();
    assert_eq!((p.line, p.pointer.as_str()), (14, "/connections/0/client"), "{p}");
}

#[test]
fn the_schema_lists_exactly_the_keys_that_are_read() {
    let schema = system_schema();
    let keys = |pointer: &str| -> Vec<String> {
        let map =
            schema.pointer(pointer).and_then(|v| v.as_object()).unwrap_or_else(|| panic!("no {pointer}"));
        map.keys().filter(|k| *k != "//").cloned().collect()
    };
    let sorted = |known: &[&str]| {
        let mut known: Vec<String> = known.iter().map(|k| (*k).to_owned()).collect();
        known.sort();
        known
    };
    let parts = [
        ("/properties", super::read::SYSTEM),
        ("/$defs/machine/properties", super::read::MACHINE),
        ("/$defs/process/properties", super::read::PROCESS),
        ("/$defs/restart/properties", super::read::RESTART),
        ("/$defs/memory/properties", super::read::MEMORY),
        ("/$defs/component/properties", super::read::COMPONENT),
        ("/$defs/execution/properties", super::read::EXECUTION),
        ("/$defs/connection/properties", super::read::CONNECTION),
        ("/$defs/queue/properties", super::read::QUEUE),
    ];
    for (pointer, known) in parts {
        assert_eq!(keys(pointer), sorted(known), "{pointer} of the schema and read.rs differ");
    }
}

const APART: &str = r#"{
  "version": 1,
  "machines": { "cart": { "agent": "https://10.0.0.2:50550" }, "here": { "agent": "127.0.0.1:50550" } },
  "processes": { "oct": { "machine": "cart", "plugins": ["p"] }, "host": {} },
  "components": { "oct/source": { "class": "oct_source", "isolation": "process" }, "host/s": { "class": "sine" } },
  "connections": []
}
"#;

#[test]
fn a_process_is_on_the_machine_that_the_file_says_and_so_is_what_is_isolated_from_it() {
    let file = parse(APART).unwrap();
    let on = |name: &str| {
        let process = file.processes.iter().find(|p| p.name.as_str() == name).unwrap();
        process.machine.as_ref().map(ToString::to_string)
    };
    assert_eq!(
        (on("oct").as_deref(), on("oct.source").as_deref(), on("host")),
        (Some("cart"), Some("cart"), None)
    );
    let written = parse(&file.picture().text()).unwrap();
    assert_eq!((written.picture(), written.machines.len()), (file.picture(), 2));
    let alone =
        APART.replacen(", \"host\": {}", "", 1).replacen(", \"host/s\": { \"class\": \"sine\" }", "", 1);
    let alone = alone.replacen(", \"isolation\": \"process\"", "", 1);
    let refused = parse(&alone).unwrap().single_process().unwrap_err();
    assert_eq!(refused.pointer, "/processes/oct/machine", "{refused}");
}

#[test]
fn a_machine_that_cannot_be_is_said_with_its_place() {
    for (from, to, pointer) in [
        ("\"machine\": \"cart\"", "\"machine\": \"crat\"", "/processes/oct/machine"),
        ("127.0.0.1:50550", "127.0.0.1", "/machines/here/agent"),
        ("127.0.0.1:50550", "127.0.0.1:0", "/machines/here/agent"),
        ("https://10.0.0.2:50550", "ftp://10.0.0.2:50550", "/machines/cart/agent"),
        ("{ \"agent\": \"127.0.0.1:50550\" }", "{}", "/machines/here"),
        ("\"here\"", "\"he/re\"", "/machines/he~1re"),
    ] {
        let problems = Draft::of("f", APART.replacen(from, to, 1)).unwrap().problems;
        let pointers: Vec<&str> = problems.iter().map(|p| p.pointer.as_str()).collect();
        assert_eq!(pointers, [pointer], "{to}: {problems:#?}");
    }
}

const THREE: &str = r#"{
  "version": 1,
  "processes": {
    "left":  { "listen": "127.0.0.1:4000", "state": "l", "env": { "A": "1" }, "restart": "never" },
    "right": { "restart": { "max": 5, "within_s": 2.5, "backoff_ms": 10, "start_within_s": 4, "unheard_s": 0.5 } },
    "gui":   { "memory": { "warn_mib": 100, "limit_mib": 200 } }
  },
  "components": {
    "left/robot": { "class": "eyerobot", "isolation": "process", "config": { "seed": 1 } },
    "left/log":   { "class": "logger" },
    "right/eye":  { "class": "image_source" },
    "right/gray": { "class": "gray", "execution": { "stream_of": "right/eye" } }
  },
  "connections": [
    { "client": "left/log/force", "server": "left/robot/force" },
    { "client": "right/gray/raw", "server": "right/eye/image" }
  ]
}"#;

fn three(part: &str, by: &str) -> Result<SystemFile, Problem> {
    assert!(THREE.contains(part), "the file has no {part:?}");
    parse(&THREE.replacen(part, by, 1))
}

#[test]
fn what_a_process_is_started_with_is_read() {
    let file = parse(THREE).unwrap();
    let [left, right, gui, robot] = file.processes.as_slice() else { panic!("{:?}", file.processes) };
    assert_eq!(
        (left.listen.as_deref(), left.env.as_slice()),
        (Some("127.0.0.1:4000"), &[("A".into(), "1".into())][..])
    );
    assert_eq!(left.restart, Policy::Never);
    let limits = Limits {
        max: 5,
        within: Duration::from_millis(2500),
        backoff: Duration::from_millis(10),
        start_within: Duration::from_secs(4),
        unheard: Unheard::After(Duration::from_millis(500)),
        ..Limits::DEFAULT
    };
    assert_eq!(right.restart, Policy::OnFailure(limits));
    assert_eq!((gui.restart, &gui.state), (Policy::default(), &None));
    assert_eq!(gui.memory, MemoryBounds { warn_mib: Some(100), limit_mib: Some(200) });
    assert_eq!((robot.name.as_str(), robot.restart), ("left.robot", Policy::Never), "made like its process");
    assert_eq!(
        (robot.listen.as_deref(), robot.state.as_deref()),
        (None, Some(std::path::Path::new("l/robot")))
    );
}

#[test]
fn an_isolated_component_keeps_its_written_name_within_the_file() {
    let mut file = parse(THREE).unwrap();
    let robot = file.components.iter().find(|c| c.class == "eyerobot").unwrap();
    assert_eq!(
        (robot.id.to_string(), robot.written.to_string()),
        ("left.robot/robot".into(), "left/robot".into())
    );
    assert_eq!(file.connections[0].server.to_string(), "left.robot/robot/force");
    file.set("left/robot.seed=8").unwrap();
    let robot = file.components.iter().find(|c| c.class == "eyerobot").unwrap();
    assert_eq!(robot.config, Some(json!({"seed": 8})));
    let p = file.locate(&Refusal::ComponentExists { id: robot.id.clone() }).unwrap();
    assert_eq!(p.pointer, "/components/left~1robot");
}

#[test]
fn what_a_process_cannot_be_started_with_is_refused_in_its_place() {
    let refused = |part: &str, by: &str| three(part, by).unwrap_err();
    let p = refused("\"127.0.0.1:4000\"", "\"here\"");
    assert!(p.pointer.ends_with("/left/listen") && p.help.contains("127.0.0.1:PORT"), "{p} / {}", p.help);
    assert!(refused("\"A\": \"1\"", "\"A=B\": \"1\"").what.contains("name of a variable"));
    assert!(refused("\"A\": \"1\"", "\"A\": 1").what.contains("expected a text"));
    assert!(refused("\"never\"", "\"nevr\"").help.contains("did you mean \"never\"?"));
    assert!(refused("\"max\": 5", "\"max\": -1").what.contains("number of restarts"));
    assert!(refused("\"warn_mib\": 100", "\"warn_mib\": 0").what.contains("amount of memory"));
    assert!(
        refused("\"warn_mib\": 100", "\"warn_mib\": 300")
            .what
            .contains("ends at 200 MiB, before it is warned")
    );
    assert!(refused("\"unheard_s\": 0.5", "\"unheard_s\": 0").what.contains("above 0 s, or \"never\""));
    assert!(refused("\"unheard_s\": 0.5", "\"unheard_s\": \"nevr\"").help.contains("never"));
    assert!(refused("\"max\": 5", "\"maxx\": 5").help.contains("did you mean \"max\"?"));
    assert!(refused("\"process\"", "\"proces\"").help.contains("did you mean \"process\"?"));
    let p = refused("\"gui\":", "\"left.robot\":");
    assert!(p.what.contains("there is one of that name"), "{p}");
    let p = refused("\"class\": \"image_source\"", "\"class\": \"image_source\", \"isolation\": \"process\"");
    assert_eq!(p.pointer, "/components/right~1gray/execution/stream_of", "{p}");
    let p = refused("\"gui\":", "\"right\":");
    assert!(p.what.contains("duplicate key"), "{p}");
}

#[test]
fn a_refusal_from_the_wire_is_led_back_to_its_place() {
    let file = parse(THREE).unwrap();
    let told = |reason: &str, values: &[(&str, &str)]| {
        let values = values.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        file.locate_told(reason, "no", "do so", &values).map(|p| p.pointer)
    };
    let carrier = [("what", "Connect right/gray/raw"), ("field", "options.carrier")];
    assert_eq!(told("ARGUMENT_INVALID", &carrier).unwrap(), "/connections/1/carrier");
    let age = [("what", "Connect right/gray/raw"), ("field", "options.max_age")];
    assert_eq!(told("ARGUMENT_INVALID", &age).unwrap(), "/connections/1/max_age_ms");
    let class = [("process", "right"), ("class", "gray")];
    assert_eq!(told("CLASS_NOT_FOUND", &class).unwrap(), "/components/right~1gray/class");
    let robot = [("component", "left.robot/robot")];
    assert_eq!(told("CONFIG_INVALID", &robot).unwrap(), "/components/left~1robot/config");
    assert_eq!(told("COMPONENT_FAULT", &robot).unwrap(), "/components/left~1robot");
    let ends = [("client", "right/gray/raw"), ("server", "right/eye/image")];
    assert_eq!(told("TYPE_MISMATCH", &ends).unwrap(), "/connections/1");
    assert_eq!(told("INTERFACE_NOT_FOUND", &[("port", "right/gray/raw")]).unwrap(), "/connections/1");
    assert_eq!(told("LCM_TIMEOUT", &[("process", "right")]), None);
}

#[test]
fn a_refusal_that_is_led_back_to_a_file_tells_what_to_change_in_the_file() {
    let file = parse(THREE).unwrap();
    let first = &file.connections[0];
    let (client, server) = (first.client.clone(), first.server.clone());
    let values =
        [("client", client.to_string()), ("server", server.to_string())].map(|(k, v)| (k.to_owned(), v));
    let refusal = Refusal::AlreadyConnected { client, server };
    let told = file.locate_told(refusal.reason(), "no", &refusal.help(), &values.into()).unwrap();
    for place in [file.locate(&refusal).unwrap(), told] {
        assert!(!place.help.contains("--replace"), "a file has no such option: {}", place.help);
        assert!(place.help.contains("Leave one of the client's connections out"), "{}", place.help);
    }
    let (what, field) = (format!("Connect {}", first.client), "options.carrier".to_owned());
    let place = file.locate(&Refusal::ArgumentInvalid { what, why: "no carrier".into(), field }).unwrap();
    assert!(place.help.contains("trocar schema system"), "{}", place.help);
}
