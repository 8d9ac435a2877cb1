//! A host that the rows of a table share.
//!
//! Invariant: a row uses components of its own, so that the order of rows means nothing.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Mutex;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, HostProcess, Trocar, World, eventually};

/// A host with the plugins that the rows of a group need.
pub(super) struct Stage {
    pub(super) grpc: Grpcurl,
    pub(super) world: World,
    host: HostProcess,
    /// Other processes under its GCM.
    others: Mutex<Vec<HostProcess>>,
}

impl Stage {
    pub(super) fn new(plugins: &[&str]) -> Self {
        let world = World::with_plugins(plugins);
        let host = HostProcess::start(&world);
        let stage = Self { grpc: host.grpcurl(), world, host, others: Mutex::default() };
        eventually("the plugins are listed", || {
            let listed = stage.grpc.plugins().len();
            if listed >= plugins.len() { Ok(()) } else { Err(format!("{listed} of {}", plugins.len())) }
        });
        stage
    }

    /// Creates components, `name` and class.
    pub(super) fn with(&self, components: &[(&str, &str)]) -> &Self {
        for (name, class) in components {
            self.grpc.create(&format!("host/{name}"), class, json!({}));
        }
        self
    }

    pub(super) fn started(&self, name: &str) -> &Self {
        self.grpc.start(&format!("host/{name}"));
        self
    }

    pub(super) fn connected(&self, client: &str, server: &str) -> &Self {
        self.grpc.connect(&format!("host/{client}"), &format!("host/{server}"));
        self
    }

    pub(super) fn refuses(&self, method: &str, body: Value) -> Failure {
        self.grpc.refused(method, body)
    }

    pub(super) fn refuses_connect(&self, client: &str, server: &str) -> Failure {
        let body = json!({ "client": format!("host/{client}"), "server": format!("host/{server}") });
        self.refuses("GcmService/Connect", body)
    }

    pub(super) fn refuses_invoke(&self, path: &str, arg: Value) -> Failure {
        self.refuses("InteractService/Invoke", json!({ "path": path, "json": arg, "deadline": "30s" }))
    }

    /// The refusal of a Create whose class `name` would have been in this refused file.
    pub(super) fn refuses_create_of_file(&self, name: &str, bytes: &[u8], mode: u32) -> Failure {
        let file = format!("libtrocar_{name}.so");
        let written = self.world.write(&format!("plugins/{file}"), bytes);
        fs::set_permissions(&written, fs::Permissions::from_mode(mode)).unwrap();
        eventually(&format!("{file} is listed as refused"), || {
            let listed = self.grpc.plugins();
            let is_it = |p: &&Value| p["file"].as_str().is_some_and(|path| path.ends_with(&file));
            match listed.iter().find(is_it) {
                Some(p) if p["refusedReason"].as_str().is_some_and(|reason| !reason.is_empty()) => Ok(()),
                _ => Err(format!("{listed:?}")),
            }
        });
        self.refuses("GcmService/Create", json!({ "path": format!("host/{name}"), "class": name }))
    }

    /// The command line, aimed at it.
    pub(super) fn trocar(&self) -> Trocar {
        Trocar::at(&self.world, self.address())
    }

    pub(super) fn address(&self) -> &str {
        self.host.address()
    }

    /// One more process under its GCM, by these words behind `trocar`; waits until it offers `class`.
    pub(super) fn joined(&self, name: &str, words: &[&str], class: &str) {
        let args: Vec<_> = words.iter().map(Into::into).collect();
        let process = HostProcess::spawn(&self.world, name, &args);
        self.others.lock().unwrap().push(process);
        self.grpc.await_class(name, class);
    }

    /// The same, with the world's plugins.
    pub(super) fn with_process(&self, name: &str, class: &str) -> &Self {
        let plugins = self.world.plugins().display().to_string();
        let words = ["host", "--name", name, "--gcm", self.address(), "--listen", "127.0.0.1:0", "--plugins"];
        self.joined(name, &[&words[..], &[&plugins]].concat(), class);
        self
    }

    /// The address of one of them.
    pub(super) fn address_of(&self, name: &str) -> String {
        let others = self.others.lock().unwrap();
        let found = others.iter().find(|other| other.name() == name);
        found.map(|other| other.address().to_owned()).unwrap_or_default()
    }

    /// Ends one of them as `kill -9` does, and waits until that is known.
    pub(super) fn killed(&self, name: &str) {
        self.others.lock().unwrap().retain_mut(|other| {
            let is_it = other.name() == name;
            if is_it {
                other.kill();
            }
            !is_it
        });
        self.await_lost(name);
    }

    pub(super) fn await_lost(&self, name: &str) {
        eventually(&format!("{name} is LOST"), || {
            let list = self.grpc.ok("GcmService/List", json!({ "brief": true }));
            let processes = list["processes"].as_array().cloned().unwrap_or_default();
            let lost = processes.iter().any(|p| p["name"] == name && p["state"] == "PROCESS_STATE_LOST");
            if lost { Ok(()) } else { Err(list) }
        });
    }
}

/// Plays all rows, whatever becomes of one of them.
pub(super) fn play_all<R>(rows: &[R], name: impl Fn(&R) -> &'static str, play: impl Fn(&R)) {
    let mut failed = Vec::new();
    for row in rows {
        if let Err(why) = panic::catch_unwind(AssertUnwindSafe(|| play(row))) {
            let text = why.downcast_ref::<String>().map(String::as_str);
            let text = text.or(why.downcast_ref::<&str>().copied()).unwrap_or("it panicked");
            failed.push(format!("-- {}: {text}", name(row)));
        }
    }
    assert!(failed.is_empty(), "{} of {} rows failed:\n{}", failed.len(), rows.len(), failed.join("\n"));
}
