//! The arrows between our crates, read from cargo itself.
//!
//! Promise: no crate depends on another of ours unless `docs/ARCHITECTURE.md` draws that arrow.

use std::collections::{BTreeMap, BTreeSet};

use std::process::Command;

use serde_json::Value;
use trocar_tests::repository;

/// Crates that each crate may depend on. Plugins and fixtures may use the sdk (and plain libraries of ours)
/// only.
const ALLOWED: &[(&str, &[&str])] = &[
    ("trocar-model", &[]),
    ("trocar-proto", &[]),
    ("trocar-plugin-api", &[]),
    ("trocar-sdk-derive", &["trocar-plugin-api"]),
    ("trocar-sdk", &["trocar-sdk-derive", "trocar-plugin-api"]),
    ("trocar-rt", &["trocar-plugin-api"]),
    ("trocar-links", &["trocar-rt"]),
    ("trocar-net", &["trocar-rt"]),
    ("trocar-loader", &["trocar-model", "trocar-rt", "trocar-plugin-api"]),
    ("trocar-lcm-api", &["trocar-model", "trocar-links"]),
    (
        "trocar-lcm",
        &[
            "trocar-lcm-api",
            "trocar-loader",
            "trocar-model",
            "trocar-links",
            "trocar-net",
            "trocar-rt",
            "trocar-plugin-api",
        ],
    ),
    (
        "trocar",
        &[
            "trocar-lcm",
            "trocar-lcm-api",
            "trocar-loader",
            "trocar-model",
            "trocar-links",
            "trocar-net",
            "trocar-rt",
            "trocar-proto",
            "trocar-plugin-api",
        ],
    ),
    (
        "trocar-cli",
        &[
            "trocar",
            "trocar-loader",
            "trocar-model",
            "trocar-net",
            "trocar-rt",
            "trocar-proto",
            "trocar-plugin-api",
        ],
    ),
    ("trocar-conform-classes", &["trocar-sdk"]),
    ("trocar-fft", &[]),
    ("trocar-oct-core", &["trocar-fft"]),
    (
        "trocar-tests",
        &[
            "trocar",
            "trocar-links",
            "trocar-net",
            "trocar-rt",
            "trocar-sdk",
            "trocar-proto",
            "trocar-conform-classes",
        ],
    ),
    ("trocar-simulation", &["trocar", "trocar-lcm-api", "trocar-links", "trocar-model", "trocar-proto"]),
    ("trocar-torture", &["trocar-proto"]),
];

const PLUGINS_MAY: &[&str] =
    &["trocar-sdk", "trocar-imaging", "trocar-oct-core", "trocar-phantom", "trocar-conform-classes"];

/// What must never reach a plugin author's build.
const BANNED_IN_SDK: &[&str] = &["tokio", "tonic", "trocar"];

#[test]
fn every_arrow_between_our_crates_is_drawn_in_the_architecture() {
    let metadata = Metadata::read();
    let ours: BTreeSet<&str> = metadata.members().map(name).collect();
    let mut wrong = Vec::new();
    for package in metadata.members() {
        let plugin = text(&package["manifest_path"]).contains("/plugins/");
        let own = name(package);
        let allowed = ALLOWED.iter().find(|(name, _)| *name == own).map(|(_, list)| *list);
        let allowed = match allowed {
            Some(list) => list,
            None if plugin => PLUGINS_MAY,
            None => {
                wrong.push(format!("{own}: a new crate without a row in tests/it/arrows.rs"));
                continue;
            }
        };
        for dependency in list(&package["dependencies"]) {
            // Tests of a crate may parse what it made, e.g. the sdk its own manifests.
            let name = name(dependency);
            if dependency["kind"] == "dev" || !ours.contains(name) {
                continue;
            }
            if !allowed.contains(&name) {
                wrong.push(format!("{own} → {name}: allowed are {allowed:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "arrows that no one drew:\n{}", wrong.join("\n"));
}

#[test]
fn the_sdk_never_reaches_the_host_or_its_network_stack() {
    let reached = Metadata::read().reached_from("trocar-sdk");
    let banned: Vec<_> = BANNED_IN_SDK.iter().filter(|name| reached.contains(**name)).collect();
    assert!(banned.is_empty(), "trocar-sdk reaches {banned:?}; it reaches in all: {reached:?}");
}

#[test]
fn no_plugin_is_linked_into_the_host() {
    let metadata = Metadata::read();
    let reached = metadata.reached_from("trocar-cli");
    let plugins = metadata.members().filter(|p| text(&p["manifest_path"]).contains("/plugins/"));
    let linked: Vec<_> = plugins.map(name).filter(|name| reached.contains(*name)).collect();
    assert!(
        linked.is_empty(),
        "the host links {linked:?}: an executable with only an LCM loads them from files"
    );
}

#[test]
fn the_model_reaches_no_runtime_and_no_system_interface() {
    let reached = Metadata::read().reached_from("trocar-model");
    let banned: Vec<_> = ["tokio", "tonic", "libloading", "mio", "socket2"]
        .into_iter()
        .filter(|n| reached.contains(*n))
        .collect();
    assert!(banned.is_empty(), "trocar-model is pure but reaches {banned:?}");
}

#[test]
fn loader_and_lcm_reach_no_grpc() {
    let metadata = Metadata::read();
    for (own, banned) in [("trocar-loader", "tokio"), ("trocar-lcm", "tonic"), ("trocar-lcm-api", "tonic")] {
        assert!(!metadata.reached_from(own).contains(banned), "{own} reaches {banned}");
    }
}

/// An LCM may be in another process: what the GCM knows of one is what can be asked over Attach.
#[test]
fn the_gcm_names_the_contract_of_the_lcm_and_no_lcm() {
    let mut folders = vec![repository().join("host/src/gcm")];
    let (mut looked_at, mut wrong) = (0, Vec::new());
    while let Some(folder) = folders.pop() {
        for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let code = std::fs::read_to_string(&path).unwrap();
            looked_at += 1;
            if ["crate::lcm", "trocar_lcm::", "LocalLcm"].iter().any(|name| code.contains(name)) {
                wrong.push(path);
            }
        }
    }
    assert!(looked_at > 20, "{looked_at} files");
    assert!(wrong.is_empty(), "these name an LCM: {wrong:?}");
}

/// A library that is built on is a decision with its reasons; one that is not built on any more has none.
#[test]
fn the_libraries_we_build_on_are_those_of_adr_0003() {
    let metadata = Metadata::read();
    let ours: BTreeSet<&str> = metadata.members().map(name).collect();
    let used: BTreeSet<&str> = metadata
        .members()
        .flat_map(|package| list(&package["dependencies"]).map(name))
        .filter(|name| !ours.contains(name))
        .collect();
    let adr = std::fs::read_to_string(repository().join("docs/adr/0003-libraries.md")).unwrap();
    // Rows `| crate, crate | version | …`; those of a workspace of its own are not in this one's metadata.
    let rows = adr.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| crate"));
    let decided: BTreeSet<&str> = rows
        .filter(|row| !row.contains("a workspace of its own"))
        .flat_map(|row| row.split('|').nth(1).unwrap_or_default().split(',').map(str::trim))
        .collect();
    let missing: Vec<_> = used.difference(&decided).collect();
    let left: Vec<_> = decided.difference(&used).collect();
    assert!(missing.is_empty(), "ADR 0003 gives no reason for {missing:?}");
    assert!(left.is_empty(), "ADR 0003 names {left:?}, on which nothing is built");
}

/// Floors of `host/lcm/src`, the upper one first: a module names modules of its own floor and of those below.
const FLOORS: [(&str, &[&str]); 5] = [
    (
        "manager",
        &["local", "lifecycle", "services", "calling", "outside", "static_classes", "store", "classes"],
    ),
    ("joining", &["connect", "carriers", "remote", "ends", "passage"]),
    ("component", &["executor", "cycle", "supervise", "dynamic", "instance"]),
    ("cell", &["described", "boundary", "core", "inbox"]),
    (
        "parts",
        &[
            "books",
            "concern",
            "context",
            "request_queue",
            "gate",
            "goal",
            "hub",
            "kept",
            "latches",
            "logs",
            "loss",
            "order",
            "pending",
            "readers",
            "reading",
            "realtime",
            "rows",
            "thread",
            "thumbnail",
            "watch",
        ],
    ),
];

#[test]
fn the_floors_of_the_lcm_see_only_what_is_below() {
    let floor = |module: &str| FLOORS.iter().position(|(_, modules)| modules.contains(&module));
    let source = repository().join("host/lcm/src");
    let mut open = vec![source.clone()];
    let (mut arrows, mut wrong) = (0, Vec::new());
    while let Some(folder) = open.pop() {
        for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            let place = path.strip_prefix(&source).unwrap().with_extension("");
            let parts: Vec<&str> = place.iter().filter_map(|part| part.to_str()).collect();
            let is_test = parts.iter().any(|part| part.starts_with("test") || *part == "fake");
            if path.is_dir() {
                open.push(path);
            } else if !is_test && !["lib", "counting"].contains(&parts[parts.len() - 1]) {
                let code = std::fs::read_to_string(&path).unwrap();
                let Some(own) = floor(parts[0]) else {
                    wrong.push(format!("{}: no floor in tests/it/arrows.rs", path.display()));
                    continue;
                };
                // A `mod.rs` lies where its folder does.
                let depth = parts.len() - usize::from(parts.last() == Some(&"mod"));
                for other in named_modules(&code, depth) {
                    let Some(at) = floor(&other) else { continue };
                    arrows += 1;
                    if at < own {
                        let (from, to) = (FLOORS[own].0, FLOORS[at].0);
                        wrong.push(format!("{} ({from}) names {other} ({to})", place.display()));
                    }
                }
            }
        }
    }
    assert!(arrows > 150, "{arrows} arrows");
    assert!(wrong.is_empty(), "arrows upwards:\n{}", wrong.join("\n"));
}

/// The modules below the crate's root that `use` lines of a file name, which lies so many modules deep.
fn named_modules(code: &str, depth: usize) -> Vec<String> {
    // Tests that lie in a file of their own are declared wherever it suits; those in this file are its end.
    let code = code.replace("#[cfg(test)]\nmod tests;", "");
    let code = code.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let mut found = Vec::new();
    for line in code.split(';').filter_map(|statement| statement.rsplit_once("use ").map(|(_, path)| path)) {
        let supers = line.matches("super::").count();
        let Some(rest) = line
            .strip_prefix("crate::")
            .or_else(|| (supers == depth).then(|| line.trim_start_matches("super::")))
        else {
            continue;
        };
        let names: Vec<&str> = match rest.strip_prefix('{') {
            Some(list) => list.split(',').collect(),
            None => vec![rest],
        };
        let module =
            |name: &str| name.trim().split([':', ' ', '}', '{']).next().unwrap_or_default().to_owned();
        found.extend(names.into_iter().map(module));
    }
    found
}

/// A dependency with two sets of features is compiled twice, and so is all that depends on it: by
/// `cargo build --release`, and again by `./tests/run`.
#[test]
fn program_and_tests_use_one_set_of_features_of_every_dependency() {
    let program = features(&["--edges", "normal,build"]);
    let everything = features(&["--edges", "normal,build,dev", "--workspace"]);
    // The simulation sets the clock of tokio, which a program is not to be able to.
    let but_the_clock =
        |sets: &BTreeSet<String>| sets.iter().map(|set| set.replace(",test-util", "")).collect();
    let differ = |(package, sets): (&String, &BTreeSet<String>)| {
        let with_tests: BTreeSet<String> = but_the_clock(&everything[package]);
        (with_tests != *sets).then(|| format!("{package}: program {sets:?}, with all tests {with_tests:?}"))
    };
    let differing: Vec<String> = program.iter().filter_map(differ).collect();
    assert!(
        differing.is_empty(),
        "give these one set of features in [workspace.dependencies]:\n{}",
        differing.join("\n")
    );
}

/// The sets of features with which each package from a registry is built.
fn features(args: &[&str]) -> BTreeMap<String, BTreeSet<String>> {
    let tree = cargo(&[&["tree", "--prefix", "none", "--format", "{p}|{f}"], args].concat());
    let mut found: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for line in tree.lines().filter(|line| !line.contains(" (/") && line.contains('|')) {
        let (package, features) = line.trim_end_matches(" (*)").split_once('|').unwrap_or_default();
        found.entry(package.to_owned()).or_default().insert(features.to_owned());
    }
    assert!(found.len() > 100, "cargo tree was not understood:\n{tree}");
    found
}

/// The answer of `cargo metadata`.
struct Metadata(Value);

impl Metadata {
    fn read() -> Self {
        let said = cargo(&["metadata", "--format-version", "1"]);
        Self(serde_json::from_str(&said).unwrap_or_else(|e| panic!("cargo metadata: {e}")))
    }

    fn packages(&self) -> BTreeMap<&str, &Value> {
        list(&self.0["packages"]).map(|package| (text(&package["id"]), package)).collect()
    }

    fn members(&self) -> impl Iterator<Item = &Value> {
        let packages = self.packages();
        list(&self.0["workspace_members"]).map(move |id| packages[text(id)])
    }

    /// Everything a crate is built with, development dependencies apart.
    fn reached_from(&self, root: &str) -> BTreeSet<String> {
        let packages = self.packages();
        let nodes: BTreeMap<_, _> =
            list(&self.0["resolve"]["nodes"]).map(|node| (text(&node["id"]), node)).collect();
        let start = self.members().find(|p| name(p) == root);
        let start = start.unwrap_or_else(|| panic!("there is no crate {root} in the workspace"));
        let (mut open, mut seen) = (vec![text(&start["id"])], BTreeSet::new());
        while let Some(id) = open.pop() {
            for dependency in list(&nodes[id]["deps"]) {
                let built = list(&dependency["dep_kinds"]).any(|kind| kind["kind"].is_null());
                if built && seen.insert(text(&dependency["pkg"])) {
                    open.push(text(&dependency["pkg"]));
                }
            }
        }
        seen.into_iter().map(|id| name(packages[id]).to_owned()).collect()
    }
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().unwrap_or_else(|| panic!("no list: {value}")).iter()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_else(|| panic!("no text: {value}"))
}

fn name(package: &Value) -> &str {
    text(&package["name"])
}

fn cargo(args: &[&str]) -> String {
    let mut command = Command::new("cargo");
    let output = command.args(args).current_dir(repository()).output();
    let output = output.unwrap_or_else(|e| panic!("cargo cannot be started: {e}"));
    assert!(output.status.success(), "cargo {args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}
