//! `docs/PLUGIN_GUIDE.md`, followed literally from an empty directory, every template it names, and the
//! programs of the pages beside it.
//!
//! Promise: a newcomer who copies the guide's commands ends with a plugin of their own running in a host.

mod embedded;
mod templates;
mod timed;

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::json;
use trocar_tests::{Built, HostProcess, Trocar, World, eventually, repository};

#[test]
fn the_guide_names_the_commands_this_test_follows() {
    let guide = fs::read_to_string(repository().join("docs/PLUGIN_GUIDE.md")).unwrap();
    for command in [
        "trocar plugin new my-filter",
        "cargo build --release",
        "cp target/release/libmy_filter.so",
        "trocar host",
        "trocar create host/",
        "trocar start host/",
    ] {
        assert!(
            guide.contains(command),
            "the guide does not name `{command}`: this test follows it literally"
        );
    }
}

#[test]
fn the_program_shown_for_linking_in_is_whole_and_the_one_that_is_run() {
    let reference = fs::read_to_string(repository().join("docs/PLUGIN_REFERENCE.md")).unwrap();
    let section = reference.split("## Linked into a program").nth(1).unwrap();
    let block = |language: &str| {
        let rest = section.split(&format!("```{language}\n")).nth(1).unwrap();
        rest.split("\n```").next().unwrap()
    };
    let source = include_str!("plugin_guide/embedded.rs");
    let program = block("rust");
    assert!(source.contains(program), "the page shows another program than the one this test runs");
    assert!(
        program.starts_with("use ") && program.contains("async fn main()"),
        "not a whole one:\n{program}"
    );
    // What it imports is what its manifest names, from where it is in this repository.
    for (krate, path) in [("trocar", "host"), ("trocar-sdk", "sdk/rust")] {
        let line = format!("{krate} = {{ path = \"TROCAR_DIRECTORY/{path}\" }}");
        assert!(block("toml").contains(&line), "{line}");
        let manifest = fs::read_to_string(repository().join(path).join("Cargo.toml")).unwrap();
        assert!(manifest.contains(&format!("name = \"{krate}\"")), "{path} is not {krate}");
    }
    for krate in ["tokio", "serde_json"] {
        assert!(program.contains(krate) && block("toml").contains(&format!("{krate} = ")), "{krate}");
    }
}

#[test]
fn a_plugin_made_by_the_guide_runs_in_a_host() {
    let world = World::new();
    world.drop_in(&built_filter(&world));
    cargo(&world.path("my-filter"), &["test"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let class = grpc.await_class("host", "my_filter");
    assert_eq!(class, "my-filter/my_filter");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/f", &class]).ends_with(0);
    connect_what_it_requires(&world, &host);
    trocar.run(&["start", "host/f"]).ends_with(0);
    trocar.run(&["ls"]).ends_with(0).says("host/f").says("ACTIVE");
    assert_eq!(grpc.state("host/f"), "ACTIVE");
}

#[test]
fn a_plugin_that_was_changed_runs_with_the_settings_and_connections_it_had() {
    let guide = fs::read_to_string(repository().join("docs/PLUGIN_GUIDE.md")).unwrap();
    let section = guide.split("### Change it").nth(1).expect("the guide changes its plugin");
    let block =
        section.split("```sh\n").nth(1).and_then(|rest| rest.split("\n```").next()).unwrap_or_default();
    // The target directory is shared, and other tests build `my-filter` there at this moment.
    let world = World::new();
    let kept = world.path("mine.json").display().to_string();
    let block = block.replace("my_filter", "changed_filter").replace("mine.json", &kept);
    Trocar::new(&world).run(&["plugin", "new", "changed-filter"]).ends_with(0);
    let project = world.path("changed-filter");
    let built = cargo(&project, &["build", "--release"]).join("release/libchanged_filter.so");
    world.drop_in(&built);
    let host = HostProcess::start(&world);
    let class = host.grpcurl().await_class("host", "changed_filter");
    let trocar = Trocar::at(&world, host.address());
    trocar.run(&["create", "host/f", &class]).ends_with(0);
    connect_what_it_requires(&world, &host);
    trocar.run(&["start", "host/f"]).ends_with(0);
    trocar.run(&["configure", "host/f", r#"{"cutoff_hz": 5}"#]).ends_with(0);
    let version = |wanted: &str| {
        let ls = trocar.run(&["ls", "--json"]).ends_with(0).json();
        let all = ls["components"].as_array().cloned().unwrap_or_default();
        let filter = all.iter().find(|c| c["path"] == "host/f").cloned().unwrap_or_default();
        assert_eq!(
            (&filter["plugin_version"], &filter["state"]),
            (&json!(wanted), &json!("ACTIVE")),
            "{filter}"
        );
    };
    version("0.1.0");
    let manifest = project.join("Cargo.toml");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replacen("version = \"0.1.0\"", "version = \"0.2.0\"", 1)).unwrap();
    for line in block.lines().map(|line| line.split(" #").next().unwrap_or_default().trim()) {
        let words: Vec<&str> = line.split(' ').collect();
        match words.as_slice() {
            ["cargo", rest @ ..] => _ = cargo(&project, rest),
            ["cp", from, "plugins/"] => {
                assert!(built.ends_with(from.trim_start_matches("target/")), "{line}");
                world.drop_in(&built);
            }
            ["trocar", rest @ ..] => _ = trocar.run(rest).ends_with(0),
            _ => panic!("the guide has another command: {line}"),
        }
    }
    version("0.2.0");
    let described = trocar.run(&["describe", "host/f"]).ends_with(0);
    described.says("cutoff_hz = 5 Hz").says("host/source/value");
}

#[test]
fn a_plugin_that_is_begun_without_a_network_is_built_of_what_trocar_was_built_of() {
    let world = World::new();
    Trocar::new(&world).run(&["plugin", "new", "my-filter"]).ends_with(0);
    let project = world.path("my-filter");
    cargo(&project, &["build", "--release", "--offline"]);
    let lock = |of: &Path| fs::read_to_string(of.join("Cargo.lock")).unwrap();
    let versions = |lock: &str| {
        let packages = lock.split("[[package]]").filter(|package| package.contains("source = "));
        packages.map(|package| package.lines().skip(1).take(2).collect::<String>()).collect::<BTreeSet<_>>()
    };
    let (ours, all) = (versions(&lock(&project)), versions(&lock(&repository())));
    assert!(!ours.is_empty() && ours.is_subset(&all), "others than trocar's: {:?}", ours.difference(&all));
}

/// The library of the guide's plugin, begun and built by the commands of the guide.
fn built_filter(world: &World) -> PathBuf {
    Trocar::new(world).run(&["plugin", "new", "my-filter"]).ends_with(0);
    let project = world.path("my-filter");
    assert!(project.join("src/lib.rs").exists(), "plugin new makes a cargo project");
    cargo(&project, &["build", "--release"]).join("release/libmy_filter.so")
}

/// A required input of the template is fed, as the guide tells.
fn connect_what_it_requires(world: &World, host: &HostProcess) {
    let grpc = host.grpcurl();
    let ports = grpc.ok("GcmService/Describe", json!({ "path": "host/f" }))["ports"].clone();
    let inputs = ports["inputs"].as_array().cloned().unwrap_or_default();
    if inputs.iter().all(|input| input["optional"] == true) {
        return;
    }
    world.drop_in(&Built::plugin("sine"));
    grpc.await_class("host", "sine");
    grpc.create("host/source", "sine", json!({}));
    for input in inputs {
        let name = input["name"].as_str().unwrap_or_default();
        grpc.connect(&format!("host/f/{name}"), "host/source/value");
    }
    grpc.ok("GcmService/Start", json!({ "path": "host/source" }));
}

#[test]
fn the_cpp_plugin_of_the_page_is_found_good_by_the_shown_check() {
    let world = World::new();
    let page = fs::read_to_string(repository().join("docs/C_PLUGINS.md")).unwrap();
    let blocks = page.split("```cpp\n").skip(1).map(|rest| rest.split("\n```").next().unwrap());
    world.write("gauge.cpp", blocks.collect::<Vec<_>>().join("\n"));
    let file = world.path("libtrocar_gauge.so");
    let compiled = Command::new(env::var_os("CXX").unwrap_or_else(|| "c++".into()))
        .args(["-std=c++17", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-I"])
        .arg(repository().join("sdk/c"))
        .arg("-o")
        .args([&file, &world.path("gauge.cpp")])
        .output()
        .unwrap();
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    Trocar::new(&world).run(&["plugin", "check", file.to_str().unwrap()]).ends_with(0).says("gauge");
}

#[test]
fn plugin_new_overwrites_nothing_and_checks_the_name() {
    let world = World::new();
    fs::create_dir(world.path("taken")).unwrap();
    world.write("taken/precious", "mine");
    Trocar::new(&world).run(&["plugin", "new", "taken"]).ends_with(1).says("taken");
    assert_eq!(fs::read_to_string(world.path("taken/precious")).unwrap(), "mine");
    let bad = Trocar::new(&world).run(&["plugin", "new", "9 lives"]);
    assert_ne!(bad.code, 0, "{bad:#?}");
    assert!(!world.path("9 lives").exists(), "nothing is half made");
}

/// Runs cargo in the new project and answers its target directory: our own, to spare building the sdk again.
fn cargo(project: &Path, args: &[&str]) -> PathBuf {
    let target = Built::dir().parent().map(Path::to_path_buf).unwrap_or_default().join("outer/guide-target");
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(args)
        .current_dir(project)
        .env("CARGO_TARGET_DIR", &target)
        // The test asks whether it compiles and runs, not how fast: this halves the time.
        .env("CARGO_PROFILE_RELEASE_OPT_LEVEL", "0")
        .env("CARGO_PROFILE_DEV_DEBUG", "0")
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|e| panic!("cannot start cargo: {e}"));
    assert!(output.status.success(), "cargo {args:?}:\n{}", String::from_utf8_lossy(&output.stderr));
    target
}
