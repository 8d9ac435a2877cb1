//! `sdk/c/trocar_plugin.hpp` keeps its promises: a C++ component is driven through its tables by a C++ program.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::process::Command;
use trocar_plugin_api::manifest::Manifest;

fn c_dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../c")
}

/// Compiles one of the tests' C++ sources with `options` and gives the file made of it.
fn compiled(source: &str, name: &str, options: &[&str]) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cpp_header");
    std::fs::create_dir_all(&dir).unwrap();
    let (out, compiler) = (dir.join(name), std::env::var_os("CXX").unwrap_or_else(|| "c++".into()));
    let mut command = Command::new(compiler);
    command.args(["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]).args(options);
    command.arg("-I").arg(c_dir()).arg(c_dir().join("tests").join(source)).arg("-o").arg(&out);
    let done = command
        .output()
        .unwrap_or_else(|e| panic!("{command:?} does not run: {e}; a C++ compiler is needed"));
    assert!(done.status.success(), "{command:?}:\n{}", String::from_utf8_lossy(&done.stderr));
    out
}

#[test]
fn a_cpp_component_has_every_kind_of_member_and_answers_bad_input() {
    let done = Command::new(compiled("gauge.cpp", "gauge", &["-O1"])).output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{said}\n{}", String::from_utf8_lossy(&done.stderr));
}

#[test]
fn repeated_interfaces_of_a_cpp_component_have_commands_reads_and_handlers() {
    let done = Command::new(compiled("arms.cpp", "arms", &["-O1"])).output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{said}\n{}", String::from_utf8_lossy(&done.stderr));
}

#[test]
fn its_manifest_is_a_note_of_the_library() {
    let options = ["-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-Wl,--gc-sections"];
    let file = std::fs::read(compiled("gauge.cpp", "libgauge.so", &options)).unwrap();
    let owner = b"\x01\0\0\0TROCAR\0\0";
    let at = file.windows(owner.len()).position(|w| w == owner).expect("the note is in the file");
    let size = u32::from_le_bytes(file[at - 4..at].try_into().unwrap()) as usize;
    let manifest = Manifest::parse(&file[at + owner.len()..at + owner.len() + size]).unwrap();
    assert_eq!((manifest.name.as_str(), manifest.classes[0].doc.as_str()), ("cpp_gauge", "\"adds\" µ up"));
}
