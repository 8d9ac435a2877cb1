//! A process full of puppets: an LCM whose every class is the table of [`super::script`].
//!
//! Invariant: everything goes through an LCM's own verbs; a world removes what it made before it ends.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, ConnectOptions, Connection, ConnectionId, Execution,
    ExecutionModel, Health, PortId, Refusal, State, Verb,
};
use trocar_plugin_api::manifest::Manifest;

use super::script::*;
use crate::watchdog::Watchdog;
use crate::{Classes, Lcm, LcmConfig, LoadedClass, LocalLcm, PluginInfo, Report};

/// Every class of the tests is created by the same table.
struct Puppets;

impl Classes for Puppets {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        Vec::new()
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        Ok(if class.name == MUTE { &MUTE_TABLE } else { &PUPPET }.loaded())
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        Vec::new()
    }
}

/// The types every class of the tests may name.
pub(super) fn types() -> Value {
    let field =
        |name: &str, at: usize, unit: &str| json!({"name": name, "at": at, "type": "f64", "unit": unit});
    json!([
        {"name": "Ab", "size": 16, "align": 8, "fields": [field("a", 0, "N"), field("b", 8, "m")]},
        {"name": "Ba", "size": 24, "align": 8,
            "fields": [field("b", 0, "m"), field("c", 8, "s"), field("a", 16, "N")]},
        {"name": "Named", "size": 16, "align": 8, "fields": [{"name": "label", "at": 0, "type": {"text": 8}}]},
    ])
}

/// A class of that name; `ports` holds inputs, outputs, required, provided.
pub(super) fn class(name: &str, ports: &Value) -> Value {
    let mut class = ports.clone();
    class["name"] = json!(name);
    if class["state"].is_null() {
        class["state"] = json!("u64");
    }
    class["execution"] = json!({"model": "on_signal"});
    class
}

/// A process of its own, shut down when dropped.
pub(super) struct World {
    pub(super) lcm: Arc<LocalLcm>,
    runtime: tokio::runtime::Runtime,
    process: String,
    connections: AtomicU64,
}

pub(super) const PATIENCE: Duration = Duration::from_secs(30);

impl World {
    /// Runs `f` to its end.
    pub(super) fn wait<F: Future>(&self, f: F) -> F::Output {
        self.runtime.block_on(f)
    }

    /// `process` tells tests of one program apart.
    pub(super) fn new(process: &str) -> World {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let config = LcmConfig {
            process: process.parse().unwrap(),
            classes: Some(Arc::new(Puppets)),
            links: None,
            afar: None,
            lock_memory: false,
            allow_exec: false,
        };
        let lcm = LocalLcm::new(config).unwrap();
        World { lcm, runtime, process: process.into(), connections: AtomicU64::new(0) }
    }

    pub(super) fn id(&self, name: &str) -> ComponentId {
        ComponentId::parse(&format!("{}/{name}", self.process)).unwrap()
    }

    pub(super) fn apply(&self, change: Change) -> Result<Report, Refusal> {
        self.runtime.block_on(self.lcm.apply(change, (Instant::now() + PATIENCE).into()))
    }

    /// An ACTIVE component of class `ports`.
    pub(super) fn active(
        &self,
        name: &str,
        ports: &Value,
        execution: Execution,
        script: Script,
    ) -> &'static Stage {
        let stage = self.create(name, ports, execution, script);
        self.configure(name).unwrap();
        self.run(name, Verb::Start).unwrap();
        stage()
    }

    /// A CREATED component, and the way to its present stage.
    pub(super) fn create(
        &self,
        name: &str,
        ports: &Value,
        execution: Execution,
        script: Script,
    ) -> impl Fn() -> &'static Stage + use<> {
        self.try_create(name, ports, execution, script).unwrap();
        let id = self.id(name);
        move || stage_of(&id)
    }

    pub(super) fn try_create(
        &self,
        name: &str,
        ports: &Value,
        execution: Execution,
        script: Script,
    ) -> Result<Report, Refusal> {
        let manifest: Manifest = serde_json::from_value(json!({
            "trocar": 1, "abi": [1, 2], "name": "puppets", "version": "1",
            "types": types(), "classes": [class(name, ports)],
        }))
        .unwrap();
        let info = trocar_loader::convert::classes(&manifest, "").unwrap().remove(0);
        let id = self.id(name);
        enrol(&id, script);
        let component = Box::new(Component {
            ports: Arc::new(info.ports.clone()),
            class: info,
            config: json!({}),
            execution,
            state: State::Created,
            health: Health::Ok,
            fault: String::new(),
        });
        self.apply(Change::Create { id, component })
    }

    /// Sets the text that `describe` writes from now on.
    pub(super) fn describes(&self, name: &str, text: String) {
        *script_of(&self.id(name)).described.lock() = text;
    }

    pub(super) fn configure(&self, name: &str) -> Result<Report, Refusal> {
        let (from, to) = (json!({}), json!({}));
        let state = self.instance(name).state();
        let to_state = if state == State::Active { state } else { State::Ready };
        self.apply(Change::Configure { id: self.id(name), from, to, from_state: state, to_state })
    }

    pub(super) fn run(&self, name: &str, verb: Verb) -> Result<Report, Refusal> {
        self.apply(Change::Run { id: self.id(name), verb, from: State::Ready, to: State::Ready })
    }

    pub(super) fn remove(&self, name: &str) {
        let info = self.instance(name).info.clone();
        let component = Box::new(Component {
            ports: Arc::new(info.ports.clone()),
            class: info,
            config: json!({}),
            execution: Execution::default(),
            state: State::Ready,
            health: Health::Ok,
            fault: String::new(),
        });
        self.apply(Change::Destroy { id: self.id(name), component }).unwrap();
    }

    pub(super) fn instance(&self, name: &str) -> Arc<crate::instance::Instance> {
        self.lcm.instance(&self.id(name)).unwrap()
    }

    pub(super) fn connection(&self, client: &str, server: &str, options: ConnectOptions) -> Connection {
        let port = |path: &str| PortId::parse(&format!("{}/{path}", self.process)).unwrap();
        let id = ConnectionId(self.connections.fetch_add(1, Ordering::Relaxed) + 1);
        Connection { id, client: port(client), server: port(server), options }
    }

    pub(super) fn connect(&self, client: &str, server: &str) -> Connection {
        let connection = self.connection(client, server, ConnectOptions::default());
        self.apply(Change::Connect { connection: connection.clone() }).unwrap();
        connection
    }

    pub(super) fn cut(&self, connection: &Connection) {
        self.apply(Change::Disconnect { connection: connection.clone(), replaced: false }).unwrap();
    }
}

impl Drop for World {
    fn drop(&mut self) {
        self.runtime.block_on(self.lcm.shutdown(PATIENCE));
    }
}

/// Waits until `f` holds; for results of another thread that come soon.
pub(super) fn eventually(what: &str, mut f: impl FnMut() -> bool) {
    let mut watchdog = Watchdog::of(what);
    while !f() {
        watchdog.saw("it is not so");
        std::thread::yield_now();
    }
}

pub(super) fn on_signal() -> Execution {
    Execution { model: Some(ExecutionModel::OnSignal), ..Execution::default() }
}

pub(super) fn passive() -> Execution {
    Execution { model: Some(ExecutionModel::None), ..Execution::default() }
}

/// On the same thread as `head` (`process/component`), stepping when signalled.
pub(super) fn with(head: &ComponentId) -> Execution {
    Execution {
        model: Some(ExecutionModel::Stream),
        stream_of: Some(head.to_string()),
        ..Execution::default()
    }
}
