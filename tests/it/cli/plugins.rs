//! What the command line does with plugin files without a host: inspect, check, begin one.
//!
//! Promise: a file is judged as a host would judge it, and what is begun says where its SDK comes from.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use trocar_tests::{Built, HostProcess, Trocar, World, eventually, replace_in, repository};

use super::{OK, REFUSED, USAGE};

#[test]
fn inspect_shows_a_plugin_without_running_it() {
    let world = World::new();
    let file = Built::plugin("example").display().to_string();
    Trocar::new(&world).run(&["plugin", "inspect", &file]).ends_with(OK).says("Server").says("Provided");
    let text = world.write("plain.so", "this is no library").display().to_string();
    Trocar::new(&world).run(&["plugin", "inspect", &text]).ends_with(REFUSED).says("plain.so");
}

#[test]
fn a_file_name_cannot_command_the_terminal() {
    let world = World::with_plugins(&["sine"]);
    fs::write(world.plugins().join("lib\u{1b}[31mred.so"), "").unwrap();
    let host = HostProcess::start_with(&world, "host", &["--lock-memory"]);
    host.grpcurl().await_class("host", "sine");
    let trocar = Trocar::at(&world, host.address());
    let output = eventually("the bad file is listed", || {
        let output = trocar.run(&["plugin", "ls"]);
        if output.stdout.contains("refused") { Ok(output) } else { Err(output.stdout) }
    });
    assert!(!output.stdout.contains('\u{1b}') && output.stdout.contains("red.so"), "{output:#?}");
}

#[test]
fn a_process_that_uses_more_memory_than_it_was_to_is_listed_with_a_warning() {
    let world = World::new();
    let host = HostProcess::start_with(&world, "host", &["--memory-warn", "1", "--memory-limit", "4000"]);
    let trocar = Trocar::at(&world, host.address());
    let listed = || {
        let list = host.grpcurl().ok("GcmService/List", json!({}));
        let warnings = list["processes"][0]["warnings"].to_string();
        if warnings.contains("to be warned of 1 MiB") { Ok(warnings) } else { Err(warnings) }
    };
    let warnings = eventually("it is warned of", listed);
    assert!(warnings.contains("asks for more than 4000 MiB"), "{warnings}");
    trocar.run(&["ls"]).ends_with(OK).says("WARNINGS").says("to be warned of 1 MiB");
    let never = ["host", "--name", "other", "--memory-warn", "300", "--memory-limit", "200"];
    trocar.run(&never).ends_with(USAGE).says("ends at 200 MiB, before it is warned of 300 MiB");
    trocar.run(&["host", "--memory-warn", "0"]).ends_with(USAGE).says("--memory-warn");
}

#[test]
fn a_file_is_tried_as_a_host_would_try_it() {
    let world = World::new();
    let trocar = Trocar::new(&world);
    let good = Built::plugin("example").display().to_string();
    trocar.run(&["plugin", "check", &good]).ends_with(OK).says("example loads").says("example/Server");
    let seen = trocar.run(&["plugin", "check", &good, "--json"]).ends_with(OK).json();
    assert_eq!((&seen["loads"], &seen["file"]), (&json!(true), &json!(good)), "{seen}");
    assert!(seen["classes"].as_array().is_some_and(|all| all.contains(&json!("example/Server"))), "{seen}");
    fs::copy(&good, world.path("named_plainly.so")).unwrap();
    trocar.run(&["plugin", "check", "named_plainly.so"]).ends_with(OK).says("example loads");

    let bytes = fs::read(Built::plugin("example")).unwrap();
    let other_name = replace_in(&bytes, b"\"name\":\"Server\"", b"\"name\":\"Sexver\"");
    let cases = [
        ("empty.so", Vec::new(), "PLUGIN_BAD_FILE", "empty"),
        ("text.so", b"#!/bin/sh\n".to_vec(), "PLUGIN_BAD_FILE", "text"),
        ("half.so", bytes[..bytes.len() / 2].to_vec(), "PLUGIN_BAD_FILE", "truncated"),
        ("newer.so", replace_in(&bytes, b"\"abi\":[1,", b"\"abi\":[7,"), "PLUGIN_ABI", "7"),
        // Its manifest reads well: only its tables, which take code to be seen, say something else.
        ("liar.so", other_name, "PLUGIN_BAD_FILE", "Sexver"),
    ];
    for (name, bytes, reason, word) in cases.into_iter().chain(with_limits_of_nothing()) {
        let file = world.write(name, bytes).display().to_string();
        let refused = trocar.run(&["plugin", "check", &file, "--json"]).ends_with(REFUSED).json();
        assert_eq!(refused["reason"], reason, "{name}: {refused}");
        assert!(refused["message"].as_str().is_some_and(|text| text.contains(word)), "{name}: {refused}");
    }
    trocar
        .run(&["plugin", "check", "nowhere.so"])
        .ends_with(REFUSED)
        .says("nowhere.so")
        .says("target/release");
    trocar.run(&["plugin", "check", &good, "--class", "Server"]).ends_with(USAGE).says("--as");
}

/// Plugins whose manifests, as an author in C writes them by hand, limit what is no number.
fn with_limits_of_nothing() -> [(&'static str, Vec<u8>, &'static str, &'static str); 3] {
    let changed = |plugin: &str, from: &str, to: &str| {
        replace_in(&fs::read(Built::plugin(plugin)).unwrap(), from.as_bytes(), to.as_bytes())
    };
    let measured = r#""type":"i32","unit":"mm","min":0,"max":100"#;
    let flag = r#""type":"bool","unit":"","min":0,"max":100 "#;
    let measured_flag = r#""type":"bool","unit":"mm"                 "#;
    let (number, text) =
        (r#""type":"number","description":"Frequency"#, r#""type":"string","description":"Frequency"#);
    [
        (
            "flag.so",
            changed("example", measured, flag),
            "PLUGIN_BAD_FILE",
            "min and max of its argument are limits",
        ),
        (
            "mm.so",
            changed("example", measured, measured_flag),
            "PLUGIN_BAD_FILE",
            "the unit \"mm\" of its argument",
        ),
        (
            "text.so",
            changed("sine", number, text),
            "PLUGIN_BAD_FILE",
            "`minimum` holds for numbers, and this is of type string",
        ),
    ]
}

#[test]
fn a_class_is_checked_against_the_contract_of_a_standard_device() {
    let world = World::new();
    let trocar = Trocar::new(&world);
    let robot = Built::plugin("eyerobot").display().to_string();
    let check = |contract: &str| trocar.run(&["plugin", "check", &robot, "--as", contract]);
    check("arm").ends_with(OK).says("eyerobot/eyerobot");
    check("camera").ends_with(REFUSED).says("does not fulfil").says("`image` is missing");
    let as_json = trocar.run(&["plugin", "check", &robot, "--as", "camera", "--class", "eyerobot", "--json"]);
    let as_json = as_json.ends_with(REFUSED).json();
    assert_eq!(as_json["reason"], "CONTRACT_NOT_FULFILLED", "{as_json}");
    assert!(as_json["classes"][0]["violations"].as_array().is_some_and(|v| !v.is_empty()), "{as_json}");
    check("leg").ends_with(USAGE).says("force_sensor");
    trocar
        .run(&["plugin", "check", &robot, "--as", "arm", "--class", "leg"])
        .ends_with(REFUSED)
        .says("eyerobot");
    trocar.run(&["plugin", "check", "nowhere.so", "--as", "arm"]).ends_with(REFUSED).says("nowhere.so");
}

/// `trocar plugin new` of a program that lies in the world, with no sources around it.
fn begin(world: &World, args: &[&str]) -> (i32, Value, String) {
    let program = world.path("bin/trocar");
    if !program.exists() {
        fs::create_dir(world.path("bin")).unwrap();
        // By another process: a child that a thread of this one starts meanwhile would hold the file open for
        // writing, and what is open so cannot be run.
        let copied = Command::new("cp").args([&*Built::trocar(), &*program]).status().unwrap();
        assert!(copied.success(), "{copied}");
    }
    let mut command = Command::new(program);
    let output = command.args(["plugin", "new"]).args(args).current_dir(world.path("")).output().unwrap();
    let said = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output.status.code().unwrap_or(-1), said, String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_plugin_begun_far_from_the_sources_says_that_it_needs_a_registry_or_their_directory() {
    let world = World::new();
    let asks_for = |name: &str| {
        let manifest = fs::read_to_string(world.path(&format!("{name}/Cargo.toml"))).unwrap();
        manifest.lines().find(|line| line.starts_with("trocar-sdk")).unwrap_or_default().to_owned()
    };
    let (code, said, _) = begin(&world, &["far", "--json"]);
    assert_eq!((code, &said["sdk_found"], &said["directory"]), (OK, &json!(false), &json!("far")), "{said}");
    assert!(!asks_for("far").contains("path"), "{}", asks_for("far"));
    let (code, _, warned) = begin(&world, &["farther"]);
    assert!(code == OK && warned.contains("--sdk") && warned.contains("registry"), "{warned}");

    let sdk = repository().join("sdk/rust").display().to_string();
    let (code, said, _) = begin(&world, &["near", "--sdk", &sdk, "--json"]);
    assert_eq!((code, &said["sdk_found"]), (OK, &json!(true)), "{said}");
    assert!(asks_for("near").contains(&sdk), "{}", asks_for("near"));

    let (code, _, refused) = begin(&world, &["nothing", "--sdk", "/"]);
    assert!(code == USAGE && refused.contains("is not the SDK"), "{refused}");
    assert!(!Path::new(&world.path("nothing")).exists(), "nothing is half made");
}
