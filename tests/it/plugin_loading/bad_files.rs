//! Every kind of bad file, one row each.
//!
//! Invariant: a row says how the file is made, where it is refused (listing or Create), and the words that
//! must be there.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;
use trocar_tests::{Built, HostProcess, Trocar, World, eventually, replace_in, repository, skip};

use super::refused_file;

/// Makes the file `bad.so`, waits for its refusal and compares; the host must live on.
#[track_caller]
fn refused_when_listed(make: impl FnOnce(&World, &Path), reason: &str, words: &[&str]) {
    let world = World::new();
    let host = HostProcess::start(&world);
    make(&world, &world.plugins().join("bad.so"));
    let grpc = host.grpcurl();
    let (sentence, listed) = eventually("bad.so is refused", || refused_file(&grpc, "bad.so"));
    assert_eq!(listed["refusedReason"], reason, "{listed}");
    for word in words {
        assert!(sentence.contains(word), "the sentence does not say {word:?}: {sentence}");
    }
    assert!(sentence.lines().count() == 1, "one sentence, one line: {sentence}");
    assert_eq!(grpc.classes("host"), Vec::<String>::new(), "nothing of it is offered");
}

fn good() -> Vec<u8> {
    fs::read(Built::plugin("sine")).unwrap()
}

#[test]
fn an_empty_file() {
    refused_when_listed(|_, bad| fs::write(bad, "").unwrap(), "PLUGIN_BAD_FILE", &["empty"]);
}

#[test]
fn a_text_file() {
    refused_when_listed(|_, bad| fs::write(bad, "#!/bin/sh\n").unwrap(), "PLUGIN_BAD_FILE", &["text"]);
}

#[test]
fn a_truncated_file_names_both_lengths() {
    let bytes = good();
    let half = &bytes[..bytes.len() / 2];
    refused_when_listed(
        |_, bad| fs::write(bad, half).unwrap(),
        "PLUGIN_BAD_FILE",
        &["truncated", &half.len().to_string()],
    );
}

#[test]
fn a_library_of_another_machine_names_both_machines() {
    let mut bytes = good();
    let (other, names) =
        if cfg!(target_arch = "x86_64") { (183, ["aarch64", "x86-64"]) } else { (62, ["x86-64", "aarch64"]) };
    bytes[18] = other;
    refused_when_listed(|_, bad| fs::write(bad, bytes).unwrap(), "PLUGIN_BAD_FILE", &names);
}

#[test]
fn an_executable() {
    refused_when_listed(
        |world, bad| {
            compile(world, "int main(void) { return 0; }", &["-o", &bad.display().to_string()]);
        },
        "PLUGIN_BAD_FILE",
        &["executable"],
    );
}

#[test]
fn a_library_without_a_note() {
    refused_when_listed(
        |world, bad| {
            compile(world, "int nothing;", &["-shared", "-fPIC", "-o", &bad.display().to_string()]);
        },
        "PLUGIN_BAD_FILE",
        &["no trocar plugin"],
    );
}

#[test]
fn an_abi_of_the_future_names_both_versions() {
    let bytes = replace_in(&good(), b"\"abi\":[1,", b"\"abi\":[7,");
    refused_when_listed(|_, bad| fs::write(bad, bytes).unwrap(), "PLUGIN_ABI", &["7", "1"]);
}

#[test]
fn a_file_everybody_can_write() {
    let make = |_: &World, bad: &Path| {
        fs::write(bad, good()).unwrap();
        fs::set_permissions(bad, fs::Permissions::from_mode(0o666)).unwrap();
    };
    refused_when_listed(make, "PLUGIN_UNTRUSTED", &["chmod"]);
}

#[test]
fn a_file_of_another_user() {
    let probe = World::new();
    let file = probe.write("owned", "");
    if std::os::unix::fs::chown(&file, Some(4242), None).is_err() {
        skip("giving a file to another user needs root");
        return;
    }
    let make = |_: &World, bad: &Path| {
        fs::write(bad, good()).unwrap();
        std::os::unix::fs::chown(bad, Some(4242), None).unwrap();
    };
    refused_when_listed(make, "PLUGIN_UNTRUSTED", &["4242"]);
}

#[test]
fn a_fifo_is_refused_and_blocks_nobody() {
    let make = |_: &World, bad: &Path| {
        assert!(Command::new("mkfifo").arg(bad).status().unwrap().success());
    };
    refused_when_listed(make, "PLUGIN_BAD_FILE", &["FIFO"]);
}

#[test]
fn a_sparse_file_of_4_gib_is_refused_by_its_size() {
    let make = |_: &World, bad: &Path| fs::File::create(bad).unwrap().set_len(4 << 30).unwrap();
    refused_when_listed(make, "PLUGIN_BAD_FILE", &["4096 MiB"]);
}

#[test]
fn a_link_out_of_the_directory() {
    refused_when_listed(
        |_, bad| symlink(Built::plugin("sine"), bad).unwrap(),
        "PLUGIN_UNTRUSTED",
        &["symbolic link"],
    );
}

#[test]
fn two_files_of_one_plugin_are_both_named() {
    let world = World::with_plugins(&["sine"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "sine");
    fs::copy(Built::plugin("sine"), world.plugins().join("libtrocar_sine_copy.so")).unwrap();
    let sentence = eventually("one of the two is refused", || {
        let of_either = ["libtrocar_sine.so", "libtrocar_sine_copy.so"].map(|f| refused_file(&grpc, f));
        let [first, second] = of_either;
        first.or(second).map(|(sentence, _)| sentence)
    });
    for name in ["libtrocar_sine", "sine"] {
        assert!(sentence.contains(name), "{sentence}");
    }
}

/// In strict trust, what `dev` takes with a warning or a note is refused.
#[test]
fn the_allow_list_refuses_group_writable_and_linked_files() {
    let world = World::new();
    let list = world.write("allowed.json", "{ \"sha256\": [] }");
    fs::write(world.plugins().join("group.so"), good()).unwrap();
    fs::set_permissions(world.plugins().join("group.so"), fs::Permissions::from_mode(0o775)).unwrap();
    fs::write(world.plugins().join("plain.so"), good()).unwrap();
    fs::set_permissions(world.plugins().join("plain.so"), fs::Permissions::from_mode(0o755)).unwrap();
    symlink("plain.so", world.plugins().join("linked.so")).unwrap();
    let host =
        HostProcess::start_with(&world, "host", &["--trust", &format!("allowlist:{}", list.display())]);
    let grpc = host.grpcurl();
    for (file, word) in [("group.so", "group"), ("linked.so", "symbolic link"), ("plain.so", "sha256")] {
        let (sentence, listed) = eventually(&format!("{file} is refused"), || refused_file(&grpc, file));
        assert_eq!(listed["refusedReason"], "PLUGIN_UNTRUSTED", "{listed}");
        assert!(sentence.contains(word), "{sentence}");
    }
}

#[test]
fn the_dev_mode_takes_a_group_writable_file_with_a_warning() {
    let world = World::new();
    let file = world.drop_in(&Built::plugin("sine"));
    fs::set_permissions(&file, fs::Permissions::from_mode(0o775)).unwrap();
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "sine");
    let listed = super::plugin(&grpc, "libtrocar_sine.so").unwrap_or_default();
    assert!(listed["warnings"].to_string().contains("group"), "{listed}");
}

/// A good C++ plugin with more code in it, compiled in the world's directory; none without a compiler.
pub(super) fn filter_with(world: &World, name: &str, extra: &str, more: &[&str]) -> Option<PathBuf> {
    let source = repository().join("tests/fixtures/plugins/cpp_filter/cpp_filter.cpp");
    let header = repository().join("sdk/c");
    let (extra, out) = (world.write("extra.cpp", extra), world.path(name));
    let mut command = Command::new(std::env::var_os("CXX").unwrap_or_else(|| "g++".into()));
    command.args(["-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-I"]).arg(header).arg("-o").arg(&out);
    let made = command.arg(source).arg(extra).args(more).current_dir(world.path("")).output().ok()?;
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    Some(out)
}

/// What only running the file shows is found in the vetting child, at the first Create.
#[track_caller]
fn refused_when_created(extra: &str, more: &[&str], prepare: impl FnOnce(&World), words: &[&str]) {
    let world = World::new();
    prepare(&world);
    let Some(out) = filter_with(&world, "bad.so", extra, more) else {
        return skip("a plugin that misbehaves when loaded is made with a C++ compiler");
    };
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    world.drop_in(&out);
    let (reason, message) =
        eventually("bad.so is refused, when listed or when created", || -> Result<_, String> {
            if let Ok((sentence, listed)) = refused_file(&grpc, "bad.so") {
                return Ok((listed["refusedReason"].as_str().unwrap_or_default().to_owned(), sentence));
            }
            let class = grpc.classes("host").into_iter().next().ok_or("it is not listed yet")?;
            match grpc.call("GcmService/Create", json!({ "path": "host/f", "class": class })) {
                Err(refused) => Ok((refused.reason, refused.message)),
                Ok(made) => panic!("a component was made of it: {made}"),
            }
        });
    assert_eq!(reason, "PLUGIN_BAD_FILE", "{message}");
    for word in words {
        assert!(message.contains(word), "the sentence does not say {word:?}: {message}");
    }
    assert_eq!(grpc.ok("grpc.health.v1.Health/Check", json!({}))["status"], "SERVING", "the host is alive");
}

#[test]
fn a_constructor_that_crashes_is_found_in_the_vetting_child() {
    let crash = "#include <cstdlib>\n__attribute__((constructor)) static void boom() { abort(); }";
    refused_when_created(crash, &[], |_| (), &["crashes"]);
}

#[test]
fn a_constructor_that_hangs_is_found_in_the_vetting_child() {
    let hang = "#include <unistd.h>\n__attribute__((constructor)) static void stay() { for (;;) pause(); }";
    refused_when_created(hang, &[], |_| (), &["does not come back"]);
}

#[test]
fn an_undefined_symbol_is_named() {
    let undefined = "extern \"C\" void nobody_defines_me(); \
                     extern \"C\" __attribute__((visibility(\"default\"))) void calls() { nobody_defines_me(); }";
    refused_when_created(undefined, &[], |_| (), &["nobody_defines_me"]);
}

#[test]
fn a_missing_library_is_named() {
    let uses = "extern \"C\" void from_elsewhere(); \
                extern \"C\" __attribute__((visibility(\"default\"))) void calls() { from_elsewhere(); }";
    let prepare = |world: &World| {
        compile(
            world,
            "void from_elsewhere(void) {}",
            &["-shared", "-fPIC", "-Wl,-soname,libfrom_elsewhere.so.3", "-o", "libfrom_elsewhere.so"],
        );
    };
    refused_when_created(uses, &["-L.", "-lfrom_elsewhere"], prepare, &["libfrom_elsewhere.so.3"]);
}

/// Compiles a few lines of C in the world's directory.
pub(super) fn compile(world: &World, source: &str, args: &[&str]) {
    let file = world.write("made.c", source);
    let made = Command::new("cc").arg(file).args(args).current_dir(world.path("")).output();
    let made = made.unwrap_or_else(|e| panic!("cc: {e}"));
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
}

#[test]
fn what_a_host_refuses_of_a_class_is_refused_by_check_and_inspect_with_the_same_words() {
    let bytes = replace_in(&good(), b"\"unit\":\"Hz\"", b"\"unit\":\"hz\"");
    let words = ["`hz` is no unit", "did you mean `Hz`?"];
    refused_when_listed(|_, bad| fs::write(bad, &bytes).unwrap(), "PLUGIN_BAD_FILE", &words);
    let world = World::new();
    let file = world.path("libodd.so");
    fs::write(&file, &bytes).unwrap();
    for verb in ["check", "inspect"] {
        let told = Trocar::new(&world).run(&["plugin", verb, &file.display().to_string()]);
        assert_ne!(told.code, 0, "{verb}: {told:?}");
        for word in words {
            assert!(told.stderr.contains(word), "{verb} does not say {word:?}: {told:?}");
        }
    }
}
