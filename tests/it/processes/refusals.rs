//! What cannot come up is named with its place and reason, and leaves nothing running.

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Output, Trocar, World};

use super::TWO;
use super::system::running_in;

/// `up` of a file that must be refused; nothing of it is left.
fn refused(world: &World, file: &str, more: &[&str]) -> Output {
    let path = world.write("system.json", file);
    let args = [&["up", path.to_str().unwrap(), "--json", "--listen", "127.0.0.1:0"][..], more].concat();
    let output = Trocar::new(world).run(&args);
    let left = running_in(&world.path("xdg-state"));
    assert!(left.is_empty(), "{left:?} still run: {output:#?}");
    output
}

fn world() -> World {
    World::with_plugins(&["sine", "example", "fixture_chaos"])
}

#[test]
fn a_missing_plugin_directory_is_said_with_the_process_that_wants_it() {
    let world = world();
    let file =
        TWO.replacen("\"right\": { \"plugins\": [\"plugins\"]", "\"right\": { \"plugins\": [\"plugin\"]", 1);
    let refused = refused(&world, &file, &[]).ends_with(1).json();
    assert_eq!(refused["reason"], "PLUGIN_DIR", "{refused}");
    let message = refused["message"].as_str().unwrap_or_default();
    assert!(message.contains("process right did not come up") && message.contains("plugin"), "{message}");
}

#[test]
fn a_taken_port_is_said() {
    let world = world();
    let taken = HostProcess::start_gcm(&world);
    let path = world.write("system.json", TWO);
    let args = ["up", path.to_str().unwrap(), "--json", "--listen", taken.address()];
    let output = Trocar::new(&world).run(&args).ends_with(1).json();
    assert_eq!(
        (&output["reason"], &output["metadata"]["process"]),
        (&"LISTEN".into(), &":gcm".into()),
        "{output}"
    );
    let listen = format!("\"right\": {{ \"listen\": \"{}\",", taken.address());
    let output = Trocar::new(&world)
        .run(&[
            "up",
            world.write("own.json", TWO.replacen("\"right\": {", &listen, 1)).to_str().unwrap(),
            "--json",
            "--listen",
            "127.0.0.1:0",
        ])
        .ends_with(1)
        .json();
    assert_eq!(
        (&output["reason"], &output["metadata"]["process"]),
        (&"LISTEN".into(), &"right".into()),
        "{output}"
    );
}

#[test]
fn processes_that_are_twice_or_unknown_are_refused_in_their_place() {
    let world = world();
    let twice = TWO.replacen("\"left\":", "\"right\":", 1);
    let output = refused(&world, &twice, &[]).ends_with(1).json();
    assert_eq!(
        (&output["reason"], &output["metadata"]["line"]),
        (&"SYSTEM_FILE".into(), &"3".into()),
        "{output}"
    );
    let unknown = TWO.replacen("\"left/s\":", "\"lefd/s\":", 1);
    let output = refused(&world, &unknown, &[]).ends_with(1);
    assert!(output.json()["help"].to_string().contains("left"), "{output:#?}");
}

#[test]
fn a_carrier_that_cannot_be_had_is_refused_in_its_place() {
    let file = r#"{
  "version": 1,
  "processes": { "left": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] } },
  "components": { "left/server": { "class": "Server" }, "right/client": { "class": "Client" } },
  "connections": [
    { "client": "right/client/Required", "server": "left/server/Provided",
      "carrier": "heap" }
  ]
}"#;
    let output = refused(&world(), file, &[]).ends_with(1).json();
    assert_eq!(
        (&output["reason"], &output["metadata"]["line"]),
        (&"ARGUMENT_INVALID".into(), &"7".into()),
        "{output}"
    );
    let message = output["message"].as_str().unwrap_or_default();
    for part in ["left and right", "\"heap\"", "possible is \"memfd\""] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

#[test]
fn a_component_that_does_not_start_is_said_and_nothing_stays_up() {
    let file = TWO.replacen(
        "\"class\": \"chaos\"",
        "\"class\": \"chaos\", \"config\": { \"error_in\": \"start\" }",
        1,
    );
    let output = refused(&world(), &file, &[]).ends_with(1).json();
    assert_eq!(
        (&output["reason"], &output["metadata"]["line"]),
        (&"COMPONENT_FAULT".into(), &"7".into()),
        "{output}"
    );
    assert!(output["message"].to_string().contains("chaos in start"), "{output}");
}

#[test]
fn what_fails_as_soon_as_it_runs_is_named_and_the_rest_stays_up() {
    let world = world();
    let file = TWO.replacen(
        "\"class\": \"chaos\"",
        "\"class\": \"chaos\", \"config\": { \"panic_in\": \"step\" }",
        1,
    );
    let path = world.write("system.json", &file);
    let args = ["up", path.to_str().unwrap(), "--detach", "--json", "--listen", "127.0.0.1:0"];
    let up = Trocar::new(&world).run(&args).ends_with(5);
    let named = up.json()["not_active"].to_string();
    assert!(named.contains("right/c") && named.contains("FAULT") && !named.contains("right/s"), "{up:#?}");
    Trocar::new(&world).run(&["down", "system"]).ends_with(0);
}

#[test]
fn a_gcm_that_is_not_there_is_said_at_once() {
    let world = world();
    let path = world.write("system.json", TWO);
    let args = ["up", path.to_str().unwrap(), "--json", "--gcm", "127.0.0.1:1"];
    let output = Trocar::new(&world).run(&args).ends_with(3).json();
    assert_eq!(output["reason"], "NO_GCM", "{output}");
}

#[test]
fn run_says_that_several_processes_are_for_up() {
    let world = world();
    let path = world.write("system.json", TWO);
    Trocar::new(&world).run(&["run", path.to_str().unwrap()]).ends_with(1).says("trocar up");
}

#[test]
fn a_name_that_somebody_else_has_is_refused_and_that_one_is_left_alone() {
    let world = world();
    let gcm = HostProcess::start_gcm(&world);
    let _other = HostProcess::start_with(&world, "right", &["--gcm", gcm.address()]);
    let right = || {
        let mut right =
            gcm.grpcurl().ok("GcmService/List", json!({ "path": "right", "brief": true }))["processes"][0]
                .clone();
        right["classes"] = Value::Null;
        right
    };
    let before = right();
    let path = world.write("system.json", TWO);
    let args = ["up", path.to_str().unwrap(), "--json", "--gcm", gcm.address()];
    let output = Trocar::new(&world).run(&args).ends_with(1).json();
    assert_eq!(
        (&output["reason"], &output["metadata"]["process"]),
        (&"PROCESS_EXISTS".into(), &"right".into()),
        "{output}"
    );
    assert_eq!(right(), before);
    let all = gcm.grpcurl().ok("GcmService/List", json!({ "brief": true }));
    assert_eq!(all["processes"].as_array().map(Vec::len), Some(1), "nothing of the file is left: {all}");
}
