//! Plugin files that were built with the SDKs of earlier minors of the ABI: `tests/data/abi`, which only
//! grows.
//!
//! Promise: a plugin that a laboratory built once is loaded and works with every later host of the same
//! major.

use std::path::{Path, PathBuf};

use serde_json::json;
use trocar_tests::{HostProcess, World, eventually, number, repository};

use super::refused_file;

/// Directories of the archive, one for each earlier minor.
fn archived() -> Vec<PathBuf> {
    let names = |folder: &str| {
        let entries = std::fs::read_dir(repository().join(folder)).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    // The newest is what the plugins of this very checkout are built with.
    let mut minors: Vec<_> =
        names("plugin-api/layouts").iter().map(|name| name.trim_end_matches(".txt").to_owned()).collect();
    minors.pop();
    let kept: Vec<_> = names("tests/data/abi").into_iter().filter(|name| !name.contains(".sh")).collect();
    assert_eq!(
        kept, minors,
        "a new minor of the ABI begins with plugins of the one before in tests/data/abi"
    );
    assert!(!minors.is_empty(), "there were minors before");
    minors.iter().map(|minor| repository().join("tests/data/abi").join(minor)).collect()
}

/// The files are x86-64: on another machine each is refused for that, in a sentence.
fn is_refused_elsewhere(file: &Path) -> bool {
    if cfg!(target_arch = "x86_64") {
        return false;
    }
    let world = World::new();
    let file = world.drop_in(file);
    let host = HostProcess::start(&world);
    let name = file.file_name().unwrap().to_string_lossy().into_owned();
    let (sentence, _) =
        eventually("the file of another machine is refused", || refused_file(&host.grpcurl(), &name));
    assert!(sentence.contains("x86-64"), "{sentence}");
    true
}

#[test]
fn a_rust_plugin_of_each_earlier_abi_is_created_connected_called_and_tells_its_events() {
    for folder in archived() {
        let file = folder.join("libtrocar_example.so");
        if is_refused_elsewhere(&file) {
            continue;
        }
        let world = World::new();
        world.drop_in(&file);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        let class = grpc.await_class("host", "Server");
        grpc.create("host/server", &class, json!({}));
        grpc.create("host/client", "example/Client", json!({}));
        grpc.connect("host/client/Required", "host/server/Provided");
        for path in ["host/server", "host/client"] {
            grpc.ok("GcmService/Start", json!({ "path": path }));
        }
        // By commands there, by a read back, and by an event back.
        eventually(&format!("{}: the ramp is written, read back and told", folder.display()), || {
            let row = grpc.ok("InteractService/Read", json!({ "path": "host/client" }))["json"].clone();
            let [read_back, reached] = ["read_back", "reached"].map(|key| number(&row[key]));
            if read_back > 2 && reached > 2 { Ok(()) } else { Err(row.to_string()) }
        });
        grpc.ok("GcmService/Stop", json!({ "path": "host/client" }));
        let write = json!({ "path": "host/server/Provided/Write", "json": 30 });
        grpc.ok("InteractService/Invoke", write);
        let read = grpc.ok("InteractService/Invoke", json!({ "path": "host/server/Provided/Read" }));
        assert_eq!(read["json"], 30, "{}: {read}", folder.display());
        let refused = json!({ "path": "host/server/Provided/Write", "json": 300 });
        assert_eq!(grpc.refused("InteractService/Invoke", refused).reason, "ARGUMENT_INVALID");
        for path in ["host/server", "host/client"] {
            let component = grpc.component(path);
            assert_eq!(component["health"], "HEALTH_OK", "{}: {component}", folder.display());
            grpc.ok("GcmService/Remove", json!({ "path": path, "force": true }));
        }
    }
}
