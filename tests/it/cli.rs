//! The command line as scripts and people meet it.
//!
//! Promise: every mistake gets one clear sentence with the remedy and the right exit code, and leaves nothing
//! half made.

mod check;
mod doctor;
mod not_started;
mod plugins;
mod saving;
mod taken;
mod words;

use std::net::TcpListener;

use serde_json::json;
use trocar_tests::{HostProcess, Trocar, World, eventually, number};

const OK: i32 = 0;
const REFUSED: i32 = 1;
const USAGE: i32 = 2;
const NO_GCM: i32 = 3;
const TIMED_OUT: i32 = 4;

/// A port nobody listens on: bound by this test, then let go.
fn free_port() -> u16 {
    let socket = TcpListener::bind("127.0.0.1:0").unwrap();
    socket.local_addr().unwrap().port()
}

#[test]
fn a_wrong_flag_is_a_usage_error() {
    let world = World::new();
    Trocar::new(&world).run(&["ls", "--nonsense"]).ends_with(USAGE).says("--nonsense");
    Trocar::new(&world).run(&["lss"]).ends_with(USAGE).says("ls");
    Trocar::new(&world).run::<&str>(&[]).ends_with(USAGE);
}

#[test]
fn without_a_gcm_every_question_says_so() {
    let world = World::new();
    let nobody = format!("127.0.0.1:{}", free_port());
    for question in
        [vec!["ls"], vec!["start", "host/robot"], vec!["describe", "host/robot"], vec!["plugin", "ls"]]
    {
        Trocar::at(&world, &nobody).run(&question).ends_with(NO_GCM).says(&nobody).says("help:");
    }
    let as_json = Trocar::at(&world, &nobody).run(&["ls", "--json"]).ends_with(NO_GCM).json();
    assert!(as_json["message"].is_string() && as_json["help"].is_string(), "{as_json}");
}

#[test]
fn a_class_is_described_by_its_name_wherever_no_path_is_meant() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "Server");
    let trocar = Trocar::at(&world, host.address());
    for name in ["example/Server", "Server"] {
        trocar.run(&["describe", name]).ends_with(OK).says("class example/Server").says("Write");
        let described = [vec!["describe", name, "--json"], vec!["describe", "--class", name, "--json"]]
            .map(|args| trocar.run(&args).ends_with(OK).json());
        assert_eq!(described[0], described[1]);
    }
    trocar.run(&["describe", "example/Nobody"]).ends_with(REFUSED).says("no process");
    trocar.run(&["describe", "--class", "host"]).ends_with(REFUSED);
}

#[test]
fn the_whole_life_of_a_component_goes_by_the_command_line() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "Server");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/server", "Server"]).ends_with(OK);
    trocar.run(&["create", "host/client", "Client"]).ends_with(OK);
    trocar.run(&["connect", "host/client/Required", "host/server/Provided"]).ends_with(OK);
    trocar.run(&["start", "host/server"]).ends_with(OK);
    trocar.run(&["call", "host/server/Provided/Write", "30"]).ends_with(OK);
    trocar.run(&["call", "host/server/Provided/Read"]).ends_with(OK).says("30").says("mm");
    trocar.run(&["ls"]).ends_with(OK).says("host/server").says("ACTIVE");
    trocar.run(&["describe", "host/server"]).ends_with(OK).says("Write").says("mm");
    trocar.run(&["graph", "--mermaid"]).ends_with(OK).says("server");
    trocar.run(&["graph", "--dot"]).ends_with(OK).says("digraph");
    assert!(trocar.run(&["graph", "--json"]).ends_with(OK).json().is_object());
    trocar.run(&["plugin", "ls"]).ends_with(OK).says("example");
    trocar.run(&["disconnect", "host/client/Required", "host/server/Provided"]).ends_with(OK);
    trocar.run(&["stop", "host/server"]).ends_with(OK);
    trocar.run(&["resume", "host/server"]).ends_with(OK);
    trocar.run(&["stop", "--all"]).ends_with(OK);
    trocar.run(&["reset", "host/server"]).ends_with(OK);
    trocar.run(&["rm", "host/client"]).ends_with(OK);
    trocar.run(&["rm", "host/server"]).ends_with(OK);
}

#[test]
fn a_refusal_has_exit_code_1_its_reason_and_a_remedy() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "Server");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/server", "Sever"]).ends_with(REFUSED).says("Server").says("help:");
    let refusal = trocar.run(&["start", "host/nobody", "--json"]).ends_with(REFUSED).json();
    assert_eq!(refusal["reason"], "COMPONENT_NOT_FOUND", "{refusal}");
    trocar.run(&["create", "host/server", "Server", "--config", "{"]).ends_with(USAGE).says("JSON");
    trocar.run(&["create", "server", "Server"]).ends_with(REFUSED).says("process/component");
}

#[test]
fn a_malformed_system_file_is_refused_with_the_place_and_the_fix() {
    let world = World::with_plugins(&["sine"]);
    let cases = [
        ("{ \"version\": 1,", "1:", "a file that ends early"),
        ("{ \"version\": 2, \"components\": {} }", "/version", "a version of the future"),
        ("{ \"version\": 1,\n  \"conections\": [] }", "connections", "a misspelt key"),
        (
            "{ \"version\": 1, \"components\": { \"host/s\": { \"class\": \"sine\" }, \"host/s\": { \"class\": \"sine\" } } }",
            "host/s",
            "a key twice",
        ),
        (
            "{ \"version\": 1, \"components\": { \"robot\": { \"class\": \"sine\" } } }",
            "process/component",
            "a name without process",
        ),
        ("[]", "object", "no object"),
    ];
    for (text, says, what) in cases {
        let file = world.write("system.json", text).display().to_string();
        let output = Trocar::new(&world).run(&["run", &file, "--seconds", "1"]);
        assert!(output.code == REFUSED || output.code == USAGE, "{what}: {output:#?}");
        output.says("system.json").says(says);
    }
    let missing = world.path("missing.json").display().to_string();
    Trocar::new(&world).run(&["run", &missing]).says("missing.json");
    let folder = world.plugins().display().to_string();
    let output = Trocar::new(&world).run(&["run", &folder]);
    assert_ne!(output.code, OK, "a directory is no system file: {output:#?}");
}

#[test]
fn a_system_file_with_a_bad_value_starts_nothing() {
    let world = World::with_plugins(&["filters"]);
    let file = world.write(
        "system.json",
        json!({
            "version": 1,
            "processes": { "host": { "plugins": [world.plugins()] } },
            "components": { "host/f": { "class": "low_pass", "config": { "cutoff_hz": 1000 } } }
        })
        .to_string(),
    );
    Trocar::new(&world)
        .run(&["run", &file.display().to_string(), "--listen", "127.0.0.1:0", "--seconds", "1"])
        .ends_with(REFUSED)
        .says("cutoff_hz")
        .says("400 Hz");
}

#[test]
fn a_system_file_of_several_processes_is_for_up() {
    let world = World::new();
    let file = world.write(
        "system.json",
        "{ \"version\": 1, \"processes\": { \"a\": {}, \"b\": {} }, \"components\": {} }",
    );
    let output = Trocar::new(&world).run(&["run", &file.display().to_string()]);
    assert_ne!(output.code, OK);
    output.says("up");
}

#[test]
fn a_system_file_runs_for_as_long_as_it_is_told() {
    let world = World::with_plugins(&["sine"]);
    let file = world.write(
        "system.json",
        json!({
            "version": 1,
            "//": "one oscillator",
            "processes": { "host": { "plugins": [world.plugins()] } },
            "components": { "host/s": { "class": "sine" } }
        })
        .to_string(),
    );
    Trocar::new(&world)
        .run(&["run", &file.display().to_string(), "--listen", "127.0.0.1:0", "--seconds", "1"])
        .ends_with(OK);
}

#[test]
fn the_schema_of_the_system_file_and_the_completions_are_printed() {
    let world = World::new();
    let schema = Trocar::new(&world).run(&["schema", "system"]).ends_with(OK).json();
    assert!(schema["properties"]["components"].is_object(), "{schema}");
    let script = Trocar::new(&world).run(&["completions", "bash"]).ends_with(OK).says("trocar");
    assert!(!script.stdout.contains("__vet"), "what is hidden is not offered");
}

#[test]
fn a_usage_error_points_to_the_help_of_its_subcommand() {
    let world = World::new();
    let trocar = Trocar::new(&world);
    trocar.run(&["ls", "--nonsense"]).ends_with(USAGE).says("trocar ls --help");
    trocar.run(&["plugin", "inspect"]).ends_with(USAGE).says("trocar plugin inspect --help");
    trocar.run(&["create", "host/a", "b", "--rate-hz", "-5"]).ends_with(USAGE).says("above 0");
    trocar.run(&["configure", "host/a"]).ends_with(USAGE).says("--rate-hz").says("JSON");
    trocar.run(&["configure", "host/a", "--on-failure", "panic"]).ends_with(USAGE).says("bypass");
    let huge = "x".repeat(100_000);
    let output = trocar.run(&["call", "host/a/b/c", &huge]).ends_with(USAGE).says("more characters");
    assert!(output.stderr.len() < 1000, "a huge argument is not repeated whole");
    let output = trocar.run(&["create", "host/a", "b", "--config", &huge]).ends_with(USAGE).says("left out");
    assert!(output.stderr.len() < 1000, "a huge argument is not repeated whole");
}

#[test]
fn a_key_that_stands_twice_is_refused_before_anybody_is_asked() {
    let world = World::new();
    let trocar = Trocar::new(&world);
    let twice = r#"{"seed": 1, "seed": 2}"#;
    trocar.run(&["create", "host/a", "b", "--config", twice]).ends_with(USAGE).says("duplicate key");
    trocar.run(&["configure", "host/a", twice]).ends_with(USAGE).says("duplicate key");
    trocar.run(&["call", "host/a/b/c", twice]).ends_with(USAGE).says("duplicate key");
}

#[test]
fn execution_settings_are_given_changed_and_shown() {
    let world = World::with_plugins(&["fixture_echo"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "echo");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/e", "echo", "--model", "periodic", "--rate-hz", "200"]).ends_with(OK);
    trocar.run(&["configure", "host/e", "--rate-hz", "500", "--catch-up", "3"]).ends_with(OK);
    trocar.run(&["describe", "host/e"]).says("500 Hz").says("catch-up 3");
    trocar.run(&["configure", "host/e", "--on-failure", "stop-branch"]).ends_with(REFUSED).says("on_failure");
    trocar.run(&["create", "host/after", "echo", "--model", "exec_out", "--inside", "host/e"]).ends_with(OK);
    trocar.run(&["ls"]).ends_with(OK).says("after host/e");
    trocar.run(&["start", "host/e"]).ends_with(OK);
    trocar.run(&["configure", "host/e", "--rate-hz", "100"]).ends_with(REFUSED).says("trocar stop host/e");
}

#[test]
fn states_and_events_are_waited_for() {
    let world = World::with_plugins(&["fixture_echo"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "echo");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/e", "echo"]).ends_with(OK);
    trocar.run(&["wait", "host/e", "--deadline", "100ms"]).ends_with(TIMED_OUT).says("READY").says("100 ms");
    trocar.run(&["wait", "host/e", "--state", "ready", "--state", "active"]).ends_with(OK).says("READY");
    let event = "host/e/ctl/echoed";
    trocar.run(&["wait", event, "--deadline", "100ms"]).ends_with(TIMED_OUT).says(event).says("start host/e");
    trocar.run(&["start", "host/e"]).ends_with(OK);
    let call = ["wait", event, "--call", "host/e/ctl/write", "--arg", "2.5"];
    trocar.run(&call).ends_with(OK).says(event).says("2.5");
    let seen = trocar.run(&["wait", "host/e/ctl/void_called", "--call", "host/e/ctl/void", "--json"]);
    let seen = seen.ends_with(OK).json();
    assert!(seen["value"].is_null() && seen["stamp_ns"].as_u64().is_some_and(|ns| ns > 0), "{seen}");
    trocar.run(&["wait", "host/e/ctl/ecoed"]).ends_with(REFUSED).says("did you mean `echoed`");
    trocar.run(&["wait", "host/e", "--call", "host/e/ctl/void"]).ends_with(USAGE).says("event");
    trocar.run(&["wait", "host/e", "--deadline", "2min"]).ends_with(USAGE).says("60s");
}

#[test]
fn rows_of_a_state_table_are_shown_by_age_tick_and_time() {
    let world = World::with_plugins(&["fixture_echo"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "echo");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/e", "echo", "--model", "periodic", "--rate-hz", "100"]).ends_with(OK);
    trocar.run(&["start", "host/e"]).ends_with(OK);
    trocar.run(&["call", "host/e/ctl/write_return", "7"]).ends_with(OK);
    eventually("ten rows are there", || {
        let newest = trocar.run(&["echo", "host/e", "--delayed", "0", "--json"]).ends_with(OK).json();
        if number(&newest["tick"]) > 10 { Ok(()) } else { Err(newest.to_string()) }
    });
    let older = trocar.run(&["echo", "host/e", "--delayed", "3", "--json"]).ends_with(OK).json();
    let tick = older["tick"].to_string();
    let same = trocar.run(&["echo", "host/e", "--tick", &tick, "--json"]).ends_with(OK).json();
    assert_eq!((&same["stamp_ns"], &same["value"]), (&older["stamp_ns"], &older["value"]));
    let then = format!("{}ns", older["stamp_ns"]);
    let nearest = trocar.run(&["echo", "host/e", "--nearest", &then, "--json"]).ends_with(OK).json();
    assert_eq!(nearest["tick"], older["tick"]);
    trocar.run(&["echo", "host/e", "--at", &then]).ends_with(OK).says("value");
    trocar.run(&["echo", "host/e", "--at", "1ns"]).ends_with(REFUSED).says("no such row");
    trocar.run(&["echo", "host/e/sample_out", "--delayed", "1"]).ends_with(REFUSED).says("keeps no rows");
    trocar.run(&["echo", "host/e", "--at", "1s", "--tick", "1"]).ends_with(USAGE).says("--tick");
}

#[test]
fn one_end_of_a_connection_is_enough_to_cut_it_and_unknown_ends_list_what_exists() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "Server");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/server", "Server"]).ends_with(OK);
    trocar.run(&["create", "host/client", "Client"]).ends_with(OK);
    trocar.run(&["connect", "host/client/Required", "host/server/Provided"]).ends_with(OK);
    let again = trocar.run(&["connect", "host/client/Required", "host/server/Provided"]);
    again.ends_with(REFUSED).says("--replace");
    trocar.run(&["disconnect", "host/client/Reqired"]).ends_with(REFUSED).says("`Required`");
    trocar.run(&["disconnect", "host/client/Required"]).ends_with(OK).says("host/client");
    trocar.run(&["disconnect", "host/client/Required"]).ends_with(REFUSED).says("no connections");
    trocar
        .run(&["describe", "host/server/Provided/Write/x"])
        .ends_with(REFUSED)
        .says("too many parts (5, not 4)");
    trocar.run(&["logs", "host/nobody"]).ends_with(REFUSED).says("host/client");
    trocar.run(&["logs", "nobody"]).ends_with(REFUSED).says("no process `nobody`");
}

#[test]
fn a_live_table_into_a_pipe_is_plain_text() {
    let world = World::new();
    let output = Trocar::new(&world)
        .in_dir(&trocar_tests::repository())
        .run(&["demo", "--listen", "127.0.0.1:0", "--seconds", "3"])
        .ends_with(OK)
        .says("COMPONENT")
        .says("host/robot");
    assert!(!output.stdout.contains('\u{1b}'), "{}", output.stdout);
}
