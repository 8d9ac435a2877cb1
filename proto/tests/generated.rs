//! The committed code is what the `.proto` files say.
//!
//! Invariant: a `.proto` file or generated file that changed alone fails here, without the generator's
//! dependencies.
#![allow(clippy::unwrap_used)]

use std::path::PathBuf;

use sha2::{Digest, Sha256};

const FILES: [&str; 9] = [
    "trocar/v1/types.proto",
    "trocar/v1/gcm.proto",
    "trocar/v1/attach.proto",
    "trocar/v1/interact.proto",
    "trocar/v1/plugin.proto",
    "trocar/v1/guest.proto",
    "trocar/v1/agent.proto",
    "trocar/journal/v1/journal.proto",
    "etcdserverpb/rpc.proto",
];
const GENERATED: [&str; 4] = ["trocar.v1.rs", "trocar.v1.bin", "trocar.journal.v1.rs", "etcdserverpb.rs"];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The sums that `proto/generate` wrote beside the code name what the code was made from. The generator
/// itself runs in `./tests/run --all` (suite `generated`).
#[test]
fn the_committed_code_belongs_to_the_committed_proto_files() {
    let help = "run `cargo run --manifest-path proto/generate/Cargo.toml` and commit proto/src/gen";
    let sums = std::fs::read_to_string(root().join("src/gen/sha256")).unwrap();
    let mut named = Vec::new();
    for line in sums.lines() {
        let (sum, name) = line.split_once("  ").unwrap();
        let folder = if name.ends_with(".proto") { root() } else { root().join("src/gen") };
        let bytes = std::fs::read(folder.join(name)).unwrap();
        let now: String = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        assert!(now == sum, "{name} changed since proto/src/gen was generated: {help}");
        named.push(name);
    }
    let expected: Vec<&str> = FILES.into_iter().chain(GENERATED).collect();
    assert_eq!(named, expected, "proto/src/gen/sha256 names other files: {help}");
}

#[test]
fn every_message_field_rpc_and_value_has_a_comment() {
    let mut missing = Vec::new();
    for file in FILES {
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        for (at, line) in lines.iter().enumerate().skip(1) {
            let declares =
                ["message ", "enum ", "service ", "rpc ", "oneof "].iter().any(|word| line.starts_with(word))
                    || (line.ends_with(';') && line.contains(" = ") && !line.starts_with("syntax"));
            if declares && !line.starts_with("//") && !lines[at - 1].starts_with("//") {
                missing.push(format!("{file}:{}: {line}", at + 1));
            }
        }
    }
    assert!(
        missing.is_empty(),
        "comments are the help text of every tool; missing on:\n{}",
        missing.join("\n")
    );
}
