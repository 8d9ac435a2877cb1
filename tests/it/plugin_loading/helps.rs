//! The sentence of a refused plugin file, followed: then the file is taken.
//!
//! Invariant: a row does what the sentence says and nothing else; its file is gone before the next row.

use std::fs;
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::path::Path;
use std::process::Command;

use trocar_tests::{Built, Grpcurl, HostProcess, Trocar, World, eventually, replace_in, skip};

use super::{plugin, refused_file};

const FILE: &str = "libtrocar_sine.so";

/// A host, and the file that is refused at first.
struct Bench<'a> {
    world: &'a World,
    grpc: Grpcurl,
    _host: HostProcess,
}

impl<'a> Bench<'a> {
    fn over(world: &'a World, more: &[&str]) -> Self {
        Self::with(world, HostProcess::start_with(world, "host", more))
    }

    fn with(world: &'a World, host: HostProcess) -> Self {
        Self { grpc: host.grpcurl(), _host: host, world }
    }

    /// Makes the file, and after its refusal does what the sentence says: then it is taken, and gone again.
    #[track_caller]
    fn follow(&self, make: impl FnOnce(&Path), says: &str, done: impl FnOnce(&Path, &str)) {
        let path = self.world.plugins().join(FILE);
        make(&path);
        let (sentence, _) = eventually(&format!("a file is refused that is to {says}"), || {
            let (sentence, listed) = refused_file(&self.grpc, FILE)?;
            if sentence.contains(says) { Ok((sentence, listed)) } else { Err(sentence) }
        });
        done(&path, &sentence);
        self.taken(&sentence);
        fs::remove_file(path).unwrap();
        eventually("it is not listed any more", || match plugin(&self.grpc, FILE) {
            None => Ok(()),
            Some(listed) => Err(listed),
        });
    }

    #[track_caller]
    fn taken(&self, sentence: &str) {
        eventually(&format!("it is taken after this was followed: {sentence}"), || {
            match plugin(&self.grpc, FILE) {
                Some(listed) if listed["refused"] == "" => Ok(()),
                other => Err(format!("{other:?}")),
            }
        });
    }

    fn types(&self, line: &str) -> trocar_tests::Output {
        Trocar::new(self.world).types(line)
    }
}

fn good() -> Vec<u8> {
    fs::read(Built::plugin("sine")).unwrap()
}

/// A file of these bytes and mode, all at once.
fn put(path: &Path, bytes: &[u8], mode: u32) {
    let made = path.with_extension("new");
    fs::write(&made, bytes).unwrap();
    fs::set_permissions(&made, fs::Permissions::from_mode(mode)).unwrap();
    fs::rename(made, path).unwrap();
}

/// The `chmod …` that a sentence says to run.
fn chmod(sentence: &str, path: &Path) -> String {
    let (_, rest) = sentence.split_once("run ").unwrap();
    let (command, _) = rest.split_once(" on it").unwrap();
    format!("{command} {}", path.display())
}

#[test]
fn a_file_that_is_corrected_as_its_refusal_says_is_taken() {
    let world = World::new();
    let bench = Bench::over(&world, &[]);
    let again = |path: &Path, _: &str| put(path, &good(), 0o755);
    bench.follow(|path| put(path, b"", 0o755), "copy it again", again);
    bench.follow(|path| put(path, &good()[..9000], 0o755), "copy it again, completely", again);
    bench.follow(|path| put(path, b"#!/bin/sh\n", 0o755), "put a compiled .so here", again);
    let newer = replace_in(&good(), b"\"abi\":[1,", b"\"abi\":[7,");
    bench.follow(|path| put(path, &newer, 0o755), "rebuild the plugin", again);
    bench.follow(|path| symlink(Built::plugin("sine"), path).unwrap(), "copy the file", again);
    let fifo = |path: &Path| assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    bench.follow(fifo, "put the shared library itself here", again);
    bench.follow(
        |path| put(path, &good(), 0o777),
        "run chmod",
        |path, sentence| {
            bench.types(&format!("trocar plugin inspect {}", path.display())).ends_with(0).says("mode 0777");
            bench.types(&chmod(sentence, path)).ends_with(0);
        },
    );
    bench.follow(
        |path| {
            put(&bench.world.plugins().join("libtrocar_another.so"), &good(), 0o755);
            bench.grpc.await_class("host", "sine");
            put(path, &good(), 0o755);
        },
        "remove one of the two",
        |path, _| fs::remove_file(path.with_file_name("libtrocar_another.so")).unwrap(),
    );
    if chown(bench.world.write("owned", ""), Some(4242), None).is_err() {
        return skip("giving a file to another user needs root");
    }
    bench.follow(
        |path| {
            let made = path.with_extension("new");
            fs::write(&made, good()).unwrap();
            chown(&made, Some(4242), None).unwrap();
            fs::rename(made, path).unwrap();
        },
        "copy or chown it",
        |path, _| drop(bench.types(&format!("chown \"$(id -u)\" {}", path.display())).ends_with(0)),
    );
}

#[test]
fn a_file_is_taken_once_the_allow_list_names_it_as_its_refusal_says() {
    let world = World::new();
    let list = world.write("allowed.json", "{ \"sha256\": [] }");
    let trust = format!("allowlist:{}", list.display());
    let begun = || Bench::over(&world, &["--trust", &trust]);
    let bench = begun();
    put(&world.plugins().join(FILE), &good(), 0o775);
    let (writable, _) = eventually("it is refused", || refused_file(&bench.grpc, FILE));
    bench.types(&chmod(&writable, &world.plugins().join(FILE))).ends_with(0);
    let unknown = eventually("its hash is asked for", || {
        let (sentence, _) = refused_file(&bench.grpc, FILE)?;
        if sentence.contains("sha256") { Ok(sentence) } else { Err(sentence) }
    });
    let hash = unknown.split(|c: char| !c.is_ascii_hexdigit()).find(|word| word.len() == 64);
    world.write("allowed.json", format!("{{ \"sha256\": [\"{}\"] }}", hash.unwrap_or_default()));
    drop(bench);
    begun().taken(&unknown);
}

#[test]
fn a_file_is_taken_once_the_library_it_needs_is_installed() {
    let world = World::new();
    fs::create_dir(world.path("libraries")).unwrap();
    let host = HostProcess::start_prepared(&world, "host", &[], |command| {
        command.env("LD_LIBRARY_PATH", world.path("libraries"));
    });
    let bench = Bench::with(&world, host);
    // A library of the same length as one that is there, so that the name can be exchanged in the file.
    let bytes = replace_in(&good(), b"libm.so.6\0", b"libn.so.6\0");
    bench.follow(
        |path| put(path, &bytes, 0o755),
        "install it",
        |path, _| {
            let check = format!("trocar plugin check {}", path.display());
            assert_ne!(bench.types(&check).code, 0, "it says so without a host, too");
            let libm = bench.types("ldconfig -p || /sbin/ldconfig -p");
            let found = libm.stdout.lines().find(|line| line.trim_start().starts_with("libm.so.6 "));
            let found = found.and_then(|line| line.split("=> ").nth(1)).unwrap_or_default();
            fs::copy(found, bench.world.path("libraries/libn.so.6")).unwrap();
        },
    );
}
