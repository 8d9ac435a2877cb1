//! A plugin in C++ that breaks the contract at run time, or says what a terminal would obey.
//!
//! Promise: what it answers is judged, what it says is shown and never obeyed, and the process stays as it
//! was.

mod arithmetic;
mod forked;
mod household;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, HostProcess, Trocar, World, eventually, number, repository, skip};

/// What a terminal would obey in the plugin's words, as it must be shown.
const SHOWN: &str = "\\u{1b}[2J\\u{1b}[31mgone";

/// The plugin, compiled once; `None` without a C++ compiler.
fn odd() -> Option<&'static Path> {
    static ODD: OnceLock<Option<(World, PathBuf)>> = OnceLock::new();
    let made = ODD.get_or_init(|| {
        let world = World::new();
        let out = world.path("libtrocar_odd.so");
        let source = repository().join("tests/it/odd_plugins/odd.cpp");
        let mut compiler = Command::new(std::env::var_os("CXX").unwrap_or_else(|| "g++".into()));
        compiler.args(["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]);
        compiler.args(["-fvisibility=hidden", "-I"]).arg(repository().join("sdk/c"));
        let made = compiler.arg("-o").arg(&out).arg(source).output().ok()?;
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        Some((world, out))
    });
    if made.is_none() {
        skip("a plugin that breaks the contract is made with a C++ compiler");
    }
    made.as_ref().map(|(_, file)| file.as_path())
}

struct Scene {
    world: World,
    host: HostProcess,
    grpc: Grpcurl,
}

impl Scene {
    /// A host that offers the plugin; `None` where that cannot be made.
    fn new() -> Option<Self> {
        let world = World::new();
        world.drop_in(odd()?);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "odd");
        Some(Self { world, host, grpc })
    }

    fn create(&self, config: &Value) -> Option<Failure> {
        let body = json!({ "path": "host/o", "class": "odd", "config": config });
        self.grpc.call("GcmService/Create", body).err()
    }

    /// Brings it to an entry; what its caller was told.
    fn enter(&self, entry: &str, config: &Value) -> Option<Failure> {
        let call =
            |verb: &str| self.grpc.call(&format!("GcmService/{verb}"), json!({ "path": "host/o" })).err();
        let invoke = |command: &str| {
            let body = json!({ "path": format!("host/o/ctl/{command}") });
            self.grpc.call("InteractService/Invoke", body).err()
        };
        let made = self.create(config);
        if entry == "configure" {
            return made;
        }
        let started = call("Start");
        match entry {
            "command" => invoke("count"),
            "read" => eventually("a row with its status is read", || invoke("status").map(Some).ok_or("0")),
            "stop" | "make_safe" => call("Stop"),
            "resume" => call("Stop").or_else(|| call("Resume")),
            _ => started,
        }
    }

    fn remove(&self) {
        let _ = self.grpc.call("GcmService/Remove", json!({ "path": "host/o", "force": true }));
    }
}

const ENTRIES: [&str; 8] = ["configure", "start", "step", "command", "read", "stop", "resume", "make_safe"];

#[test]
fn a_status_the_abi_does_not_have_is_a_failure_that_names_the_number() {
    let Some(scene) = Scene::new() else { return };
    for (status, words) in [(7, "status 7, which this ABI does not have"), (-99, "status -99")] {
        for entry in ENTRIES {
            let what = format!("status {status} from {entry}");
            let told = scene.enter(entry, &json!({ "in": entry, "status": status }));
            let seen = eventually(&what, || {
                let state = scene.grpc.call("GcmService/GetState", json!({ "path": "host/o" }));
                let seen = format!("{told:?} {state:?}");
                if seen.contains(words) { Ok(state) } else { Err(seen) }
            });
            match (entry, seen) {
                // Nothing half made.
                ("configure", seen) => assert!(seen.is_err(), "{what}: {seen:?}"),
                // Failed for the caller, and nothing else happens.
                ("command" | "read", seen) => {
                    let state = seen.unwrap_or_default()["component"]["state"].clone();
                    assert_eq!(state, "COMPONENT_STATE_ACTIVE", "{what}");
                    assert_eq!(told.map(|t| t.reason).unwrap_or_default(), "COMMAND_FAILED", "{what}");
                }
                _ => scene.grpc.await_state("host/o", "FAULT"),
            }
            scene.remove();
        }
    }
    assert_eq!(scene.create(&json!({})).map(|f| f.to_string()), None, "the host goes on");
}

/// Nothing of `text` is obeyed by a terminal or begins a line that is not its own.
#[track_caller]
fn is_harmless(what: &str, text: &str) {
    let obeyed = text.chars().find(|c| c.is_control() && !matches!(c, '\n' | '\t'));
    assert_eq!(obeyed, None, "{what} is obeyed by a terminal:\n{text:?}");
    let forged = text.lines().find(|line| line.starts_with("ERROR host/other"));
    assert_eq!(forged, None, "{what} looks like a line of another component:\n{text}");
}

#[test]
fn what_a_plugin_says_when_it_refuses_or_logs_is_shown_and_not_obeyed() {
    let Some(scene) = Scene::new() else { return };
    let trocar = Trocar::at(&scene.world, scene.host.address());
    for entry in ["configure", "start", "command", "step"] {
        let config = json!({ "in": entry, "status": -1, "lies": true });
        let created = trocar.run(&["create", "host/o", "odd", "--config", &config.to_string()]);
        let told = match entry {
            "configure" => created,
            "command" => {
                trocar.run(&["start", "host/o"]);
                trocar.run(&["call", "host/o/ctl/poke"])
            }
            _ => trocar.run(&["start", "host/o"]),
        };
        let mut texts = vec![told.stdout, told.stderr];
        if entry == "step" {
            scene.grpc.await_state("host/o", "FAULT");
            let state = trocar.run(&["describe", "host/o"]);
            assert!(state.stdout.contains(SHOWN), "its reason is there: {state:#?}");
            texts.extend([state.stdout, trocar.run(&["ls"]).stdout]);
        } else {
            assert!(texts[1].contains(SHOWN), "its reason is there: {texts:#?}");
        }
        for text in &texts {
            is_harmless(entry, text);
        }
        let refused = scene.grpc.printed("GcmService/GetState", &json!({ "path": "host/o" }));
        is_harmless("the answer to grpcurl", &refused);
        scene.remove();
    }
    let logs = trocar.run(&["logs"]);
    assert!(logs.stdout.contains(SHOWN), "its lines are there: {}", logs.stdout);
    is_harmless("trocar logs", &logs.stdout);
    is_harmless("what the host printed", &scene.host.printed());
}

#[test]
fn what_a_manifest_says_is_shown_and_not_obeyed() {
    let Some(scene) = Scene::new() else { return };
    scene.create(&json!({}));
    let trocar = Trocar::at(&scene.world, scene.host.address());
    let file = odd().unwrap_or(Path::new("")).display().to_string();
    let pages: [&[&str]; 9] = [
        &["plugin", "inspect", &file],
        &["plugin", "check", &file],
        &["plugin", "check", &file, "--as", "arm"],
        &["plugin", "ls"],
        &["describe", "odd/odd"],
        &["describe", "host/o"],
        &["describe", "host/o/ctl/poke"],
        &["ls"],
        &["graph", "--dot"],
    ];
    let mut shown = 0;
    for page in pages {
        for more in [&[][..], &["--json"]] {
            let output = trocar.run(&[page, more].concat());
            is_harmless(&page.join(" "), &output.stdout);
            is_harmless(&page.join(" "), &output.stderr);
            shown += usize::from(output.stdout.contains(SHOWN));
        }
    }
    assert!(shown >= 3, "its documentation is in hardly any page: {shown}");
}

#[test]
fn a_working_directory_changed_while_loading_is_put_back_and_said() {
    let Some(scene) = Scene::new() else { return };
    let place = || fs::read_link(format!("/proc/{}/cwd", scene.host.pid())).unwrap();
    let before = place();
    assert_ne!(before, Path::new("/"));
    assert_eq!(scene.create(&json!({})).map(|f| f.to_string()), None);
    assert_eq!(place(), before, "{}", scene.host.printed());
    let said = scene.host.printed();
    assert!(said.contains("plugin odd: it changed the working directory of the process"), "{said}");
}

#[test]
fn a_pool_of_more_frames_than_there_may_be_is_refused_with_the_limit() {
    let Some(scene) = Scene::new() else { return };
    for slots in [4097, 100_000] {
        let told =
            scene.enter("start", &json!({ "slots": slots })).map(|f| f.to_string()).unwrap_or_default();
        assert!(told.contains("reserve answered -5"), "INVALID_ARGUMENT for {slots}: {told}");
        // Lines of components are printed by a thread of their own.
        eventually("the log names the limit", || {
            let (said, asked) = (scene.host.printed(), format!("{slots} frames"));
            let named = said.lines().any(|line| line.contains(&asked) && line.contains("at most 4096"));
            if named { Ok(()) } else { Err(said) }
        });
        scene.remove();
    }
    assert_eq!(scene.enter("start", &json!({ "slots": 4096 })).map(|f| f.to_string()), None);
    assert_eq!(scene.grpc.state("host/o"), "ACTIVE");
}

#[test]
fn handles_kept_in_statics_are_refused_counted_and_named_when_their_component_is_gone() {
    let Some(scene) = Scene::new() else { return };
    assert_eq!(scene.enter("start", &json!({ "keeps": true, "slots": 4 })).map(|f| f.to_string()), None);
    let late = json!({ "path": "host/late", "class": "odd", "config": { "late": true } });
    scene.grpc.ok("GcmService/Create", late);
    scene.grpc.start("host/late");
    scene.remove();
    let call = || scene.grpc.invoke("host/late/ctl/count", Value::Null);
    for times in ["1 so far", "10 so far", "100 so far"] {
        // Until the host's side of the one that is gone is, too, its handles may still do something.
        eventually(times, || {
            let answer = call();
            let said = scene.host.printed();
            let words = "host/o is removed, and its code still uses its ports or its host handle: refused, ";
            if said.contains(&format!("{words}{times}")) { Ok(()) } else { Err(format!("{answer} {said}")) }
        });
    }
    assert_eq!(number(&call()), 0, "each was refused");
    assert_eq!(scene.grpc.state("host/late"), "ACTIVE");
}
