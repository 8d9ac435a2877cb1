//! A plugin in C that changes the locale of the process or what signals do in it, or closes its standard
//! streams.
//!
//! Promise: each is put back, whichever entry did it, and named at the component that did it; the host and
//! that component go on.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually, repository, skip};

pub(super) const ENTRIES: [&str; 3] = ["start", "step", "command"];
const STREAMS: [&str; 3] = ["standard input", "standard output", "standard error"];

pub(super) struct Scene {
    pub(super) host: HostProcess,
    pub(super) grpc: Grpcurl,
    pub(super) world: World,
}

impl Scene {
    /// A host that offers the plugin; `None` without a C compiler, and the test is then skipped by name.
    pub(super) fn new() -> Option<Self> {
        let world = World::new();
        let mut compiler = Command::new("cc");
        compiler.args(["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]);
        compiler.args(["-fvisibility=hidden", "-I"]).arg(repository().join("sdk/c"));
        compiler.arg("-o").arg(world.path("plugins/libtrocar_untidy.so"));
        let made = compiler.arg(repository().join("tests/it/odd_plugins/untidy.c")).output();
        let Ok(made) = made else {
            skip("a plugin that changes its process is made with a C compiler");
            return None;
        };
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "untidy");
        Some(Self { host, grpc, world })
    }

    /// Makes `host/u`, which does this in that entry.
    pub(super) fn strikes(&self, does: &str, entry: &str) {
        self.grpc.create("host/u", "untidy", json!({ "does": does, "entry": entry }));
        self.grpc.start("host/u");
        self.grpc.invoke("host/u/ctl/poke", Value::Null);
    }

    pub(super) fn warnings(&self, path: &str) -> String {
        self.grpc.component(path)["stats"]["warnings"].to_string()
    }

    pub(super) fn await_named(&self, what: &str, words: &[&str]) -> String {
        eventually(what, || match self.warnings("host/u") {
            said if words.iter().all(|words| said.contains(words)) => Ok(said),
            said => Err(said),
        })
    }

    /// The answer of a command of the component.
    pub(super) fn answers(&self, path: &str) -> Value {
        self.grpc.invoke(path, Value::Null)
    }

    /// It runs; then it is taken away.
    pub(super) fn remove(&self) {
        assert_eq!(self.grpc.state("host/u"), "ACTIVE", "it is named, not punished");
        self.grpc.ok("GcmService/Remove", json!({ "path": "host/u", "force": true }));
    }
}

#[test]
fn a_locale_set_in_any_entry_is_put_back_and_its_setter_named_with_what_to_use_instead() {
    let Some(scene) = Scene::new() else { return };
    scene.strikes("nothing", "start");
    let answers = |command: &str| scene.grpc.invoke(&format!("host/u/ctl/{command}"), Value::Null);
    assert_eq!(answers("is_plain"), true, "the host itself has the locale C");
    if answers("has_other") != true {
        return skip("this machine has no locale but C");
    }
    scene.remove();
    for (does, locale) in [("all", "to C.UTF-8, "), ("numeric", "LC_NUMERIC=C.UTF-8;")] {
        for entry in ENTRIES {
            let what = format!("{does} in {entry} is named");
            scene.strikes(does, entry);
            let words = ["it changed the locale of the process to ", "which was put back", "newlocale"];
            let said = scene.await_named(&what, &words);
            assert!(said.contains(locale), "{what} with what it was set to: {said}");
            assert_eq!(said.contains("start: it changed"), entry == "start", "{what}: {said}");
            assert_eq!(answers("is_plain"), true, "{what}, and put back: {said}");
            scene.remove();
        }
    }
}

#[test]
fn standard_streams_closed_in_any_entry_are_put_back_and_their_closer_is_named() {
    let Some(scene) = Scene::new() else { return };
    let opened = |fd: usize| fs::read_link(format!("/proc/{}/fd/{fd}", scene.host.pid()));
    let before = [0, 1, 2].map(|fd| opened(fd).unwrap());
    assert_ne!(before[1], Path::new("/dev/null"), "this harness reads what the host prints");
    for entry in ENTRIES {
        scene.strikes("streams", entry);
        let words =
            STREAMS.map(|stream| format!("the {stream} of the process by closing it, which was put back"));
        let words = words.each_ref().map(String::as_str);
        scene.await_named(&format!("who closed the streams in {entry} is named"), &words);
        for (fd, stream) in STREAMS.iter().enumerate() {
            let now = opened(fd).ok();
            assert_eq!(now.as_ref(), Some(&before[fd]), "the {stream}, closed in {entry}");
        }
        scene.remove();
    }
    assert_eq!(scene.grpc.ok("grpc.health.v1.Health/Check", json!({}))["status"], "SERVING");
}

/// Signals that a process ignores, and those it catches, as the kernel has it.
fn dispositions(pid: u32) -> Vec<String> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let lines = status.lines().filter(|line| line.starts_with("SigIgn:") || line.starts_with("SigCgt:"));
    lines.map(str::to_owned).collect()
}

#[test]
fn signals_taken_in_any_entry_are_put_back_and_their_taker_is_named() {
    let Some(scene) = Scene::new() else { return };
    scene.grpc.create("host/other", "untidy", json!({}));
    scene.grpc.start("host/other");
    let before = dispositions(scene.host.pid());
    assert_eq!(scene.answers("host/other/ctl/is_told"), true, "a host is not ended by a peer that went");
    scene.grpc.ok("GcmService/Remove", json!({ "path": "host/other", "force": true }));
    for (does, signal) in [("sigfpe", "SIGFPE"), ("sigpipe", "SIGPIPE")] {
        for entry in ENTRIES {
            let what = format!("who takes {signal} in {entry} is named");
            scene.strikes(does, entry);
            let words = format!("it changed what {signal} does in the process, which was put back");
            let said = scene.await_named(&what, &[&words]);
            assert_eq!(said.contains(&format!("start: {words}")), entry == "start", "{what}: {said}");
            assert_eq!(
                dispositions(scene.host.pid()),
                before,
                "{signal}, taken in {entry}, is put back: {said}"
            );
            // Before it was put back this would have ended the host, and every component in it.
            assert_eq!(scene.answers("host/u/ctl/is_told"), true, "{signal}, taken in {entry}");
            scene.remove();
        }
    }
    assert_eq!(scene.grpc.ok("grpc.health.v1.Health/Check", json!({}))["status"], "SERVING");
}

#[test]
fn a_locale_set_beside_other_components_is_put_back_and_said_in_the_log_unless_its_entry_was_alone() {
    let Some(scene) = Scene::new() else { return };
    scene.grpc.create("host/other", "untidy", json!({}));
    scene.grpc.start("host/other");
    if scene.grpc.invoke("host/other/ctl/has_other", Value::Null) != true {
        return skip("this machine has no locale but C");
    }
    let is_plain = || scene.grpc.invoke("host/other/ctl/is_plain", Value::Null);
    scene.strikes("all", "start");
    scene.await_named("who changed it in start", &["start: it changed the locale of the process to C.UTF-8"]);
    assert_eq!(is_plain(), true);
    scene.remove();
    // Steps of others run at any time: then the log says that it was one of them.
    scene.strikes("all", "step");
    let words = "code in this process, of one of 2 components or beside them, changed the locale of the process to C.UTF-8";
    eventually("the log says it", || match scene.host.printed() {
        said if said.contains(words) => Ok(()),
        said => Err(said),
    });
    assert_eq!(is_plain(), true);
    assert!(!scene.warnings("host/other").contains("locale"), "nobody is named by a guess");
    scene.remove();
}
