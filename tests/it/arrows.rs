//! The arrows between our crates, read from cargo itself.
//!
//! Promise: no crate depends on another of ours unless `docs/ARCHITECTURE.md` draws that arrow.

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand};
use trocar_tests::repository;

/// What each crate may depend on, apart from plugins and fixtures, which may use the sdk (and plain libraries of ours) only.
const ALLOWED: &[(&str, &[&str])] = &[
    ("trocar-model", &[]),
    ("trocar-proto", &[]),
    ("trocar-plugin-api", &[]),
    ("trocar-sdk-derive", &["trocar-plugin-api"]),
    ("trocar-sdk", &["trocar-sdk-derive", "trocar-plugin-api"]),
    ("trocar-rt", &["trocar-plugin-api"]),
    ("trocar-links", &["trocar-rt"]),
    ("trocar", &["trocar-model", "trocar-links", "trocar-rt", "trocar-proto", "trocar-plugin-api"]),
    ("trocar-conform-classes", &["trocar-sdk"]),
    ("trocar-oct-core", &[]),
    (
        "trocar-tests",
        &["trocar", "trocar-links", "trocar-rt", "trocar-sdk", "trocar-proto", "trocar-conform-classes"],
    ),
    ("trocar-torture", &["trocar-proto"]),
];

const PLUGINS_MAY: &[&str] =
    &["trocar-sdk", "trocar-imaging", "trocar-oct-core", "trocar-phantom", "trocar-conform-classes"];

/// What must never reach a plugin author's build.
const BANNED_IN_SDK: &[&str] = &["tokio", "tonic", "trocar"];

#[test]
fn every_arrow_between_our_crates_is_drawn_in_the_architecture() {
    let metadata = workspace();
    let ours: BTreeSet<&str> = metadata.workspace_packages().iter().map(|p| p.name.as_str()).collect();
    let mut wrong = Vec::new();
    for package in metadata.workspace_packages() {
        let folder = package.manifest_path.as_str();
        let plugin = folder.contains("/plugins/");
        let allowed = ALLOWED.iter().find(|(name, _)| *name == package.name.as_str()).map(|(_, list)| *list);
        let allowed = match allowed {
            Some(list) => list,
            None if plugin => PLUGINS_MAY,
            None => {
                wrong.push(format!("{}: a new crate without a row in tests/it/arrows.rs", package.name));
                continue;
            }
        };
        for dependency in &package.dependencies {
            // Tests of a crate may parse what it made, e.g. the sdk its own manifests.
            let name = dependency.name.as_str();
            if dependency.kind == DependencyKind::Development || !ours.contains(name) {
                continue;
            }
            if !allowed.contains(&name) {
                wrong.push(format!("{} → {name}: allowed are {allowed:?}", package.name));
            }
        }
    }
    assert!(wrong.is_empty(), "arrows that no one drew:\n{}", wrong.join("\n"));
}

#[test]
fn the_sdk_never_reaches_the_host_or_its_network_stack() {
    let metadata = workspace();
    let reached = reached_from(&metadata, "trocar-sdk");
    let banned: Vec<_> = BANNED_IN_SDK.iter().filter(|name| reached.contains(**name)).collect();
    assert!(banned.is_empty(), "trocar-sdk reaches {banned:?}; it reaches in all: {reached:?}");
}

#[test]
fn no_plugin_is_linked_into_the_host() {
    let metadata = workspace();
    let reached = reached_from(&metadata, "trocar");
    let plugins =
        metadata.workspace_packages().into_iter().filter(|p| p.manifest_path.as_str().contains("/plugins/"));
    let linked: Vec<_> =
        plugins.map(|p| p.name.to_string()).filter(|name| reached.contains(name.as_str())).collect();
    assert!(
        linked.is_empty(),
        "the host links {linked:?}: an executable with only an LCM loads them from files"
    );
}

#[test]
fn the_model_reaches_no_runtime_and_no_system_interface() {
    let metadata = workspace();
    let reached = reached_from(&metadata, "trocar-model");
    let banned: Vec<_> = ["tokio", "tonic", "libloading", "mio", "socket2"]
        .into_iter()
        .filter(|n| reached.contains(*n))
        .collect();
    assert!(banned.is_empty(), "trocar-model is pure but reaches {banned:?}");
}

fn workspace() -> Metadata {
    let mut command = MetadataCommand::new();
    command.manifest_path(repository().join("Cargo.toml"));
    command.exec().unwrap_or_else(|e| panic!("cargo metadata: {e}"))
}

/// Everything a crate is built with, development dependencies apart.
fn reached_from(metadata: &Metadata, root: &str) -> BTreeSet<String> {
    let resolve = metadata.resolve.as_ref().unwrap_or_else(|| panic!("cargo metadata resolved nothing"));
    let nodes: BTreeMap<_, _> = resolve.nodes.iter().map(|node| (&node.id, node)).collect();
    let start = metadata.workspace_packages().into_iter().find(|p| p.name.as_str() == root);
    let start = start.unwrap_or_else(|| panic!("there is no crate {root} in the workspace"));
    let (mut open, mut seen) = (vec![&start.id], BTreeSet::new());
    while let Some(id) = open.pop() {
        for dependency in &nodes[id].deps {
            let built = dependency.dep_kinds.iter().any(|kind| kind.kind == DependencyKind::Normal);
            if built && seen.insert(&dependency.pkg) {
                open.push(&dependency.pkg);
            }
        }
    }
    seen.into_iter().map(|id| metadata[id].name.to_string()).collect()
}
