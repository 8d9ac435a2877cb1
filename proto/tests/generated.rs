//! The committed code is what the `.proto` files say.
//!
//! Invariant: compiled without protoc, so that a machine with only a Rust toolchain can regenerate it.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use prost::Message;

const FILES: [&str; 6] = ["types", "gcm", "attach", "interact", "plugin", "guest"];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn generate(out: &Path) -> Vec<u8> {
    let mut compiler = protox::Compiler::new([root()]).unwrap();
    compiler.include_imports(true).include_source_info(true);
    compiler.open_files(FILES.map(|file| format!("trocar/v1/{file}.proto"))).unwrap();
    let set = compiler.file_descriptor_set();
    // `rpc Connect` would collide with the constructor that `build_transport(true)` makes.
    tonic_prost_build::configure()
        .build_transport(false)
        .out_dir(out)
        .emit_rerun_if_changed(false)
        .compile_fds(set.clone())
        .unwrap();
    set.encode_to_vec()
}

#[test]
fn the_committed_code_is_generated_from_the_proto_files() {
    let dir = root().join("src/gen");
    let bless = std::env::var_os("TROCAR_BLESS").is_some();
    let fresh = tempfile::tempdir().unwrap();
    let descriptors = generate(fresh.path());
    let code = std::fs::read_to_string(fresh.path().join("trocar.v1.rs")).unwrap();
    if bless {
        std::fs::create_dir_all(&dir).unwrap();
        std::fs::write(dir.join("trocar.v1.rs"), &code).unwrap();
        std::fs::write(dir.join("trocar.v1.bin"), &descriptors).unwrap();
    }
    let help =
        "the .proto files changed: run `TROCAR_BLESS=1 cargo test -p trocar-proto` and commit proto/src/gen";
    assert!(std::fs::read_to_string(dir.join("trocar.v1.rs")).unwrap() == code, "{help}");
    assert!(std::fs::read(dir.join("trocar.v1.bin")).unwrap() == descriptors, "{help}");
}

#[test]
fn every_message_field_rpc_and_value_has_a_comment() {
    let mut missing = Vec::new();
    for file in FILES {
        let text = std::fs::read_to_string(root().join(format!("trocar/v1/{file}.proto"))).unwrap();
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        for (at, line) in lines.iter().enumerate().skip(1) {
            let declares =
                ["message ", "enum ", "service ", "rpc ", "oneof "].iter().any(|word| line.starts_with(word))
                    || (line.ends_with(';') && line.contains(" = ") && !line.starts_with("syntax"));
            if declares && !line.starts_with("//") && !lines[at - 1].starts_with("//") {
                missing.push(format!("{file}.proto:{}: {line}", at + 1));
            }
        }
    }
    assert!(
        missing.is_empty(),
        "comments are the help text of every tool; missing on:\n{}",
        missing.join("\n")
    );
}
