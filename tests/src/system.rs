//! The verbs of the control plane as a test says them, each one grpcurl call that must succeed.
//!
//! Invariant: nothing here waits or interprets; what the server answered is handed back as it was.

use serde_json::{Value, json};

use crate::{Grpcurl, eventually};

impl Grpcurl {
    /// Creates a component `process/component`.
    pub fn create(&self, path: &str, class: &str, config: Value) -> Value {
        self.ok("GcmService/Create", json!({ "path": path, "class": class, "config": config }))
    }

    /// Creates one with the class's defaults and this execution.
    pub fn create_with(&self, path: &str, class: &str, config: Value, execution: Value) -> Value {
        let body = json!({ "path": path, "class": class, "config": config, "execution": execution });
        self.ok("GcmService/Create", body)
    }

    pub fn start(&self, path: &str) -> Value {
        self.ok("GcmService/Start", json!({ "path": path }))
    }

    pub fn stop(&self, path: &str) -> Value {
        self.ok("GcmService/Stop", json!({ "path": path }))
    }

    /// Connects a client end to a server end.
    pub fn connect(&self, client: &str, server: &str) -> Value {
        self.ok("GcmService/Connect", json!({ "client": client, "server": server }))
    }

    /// Calls a command and answers its result.
    pub fn invoke(&self, path: &str, arg: Value) -> Value {
        let body = if arg.is_null() { json!({ "path": path }) } else { json!({ "path": path, "json": arg }) };
        self.ok("InteractService/Invoke", body)["json"].clone()
    }

    /// How a component stands, figures included.
    #[must_use]
    pub fn component(&self, path: &str) -> Value {
        self.ok("GcmService/GetState", json!({ "path": path }))["component"].clone()
    }

    /// Its state without the prefix, e.g. `ACTIVE`.
    #[must_use]
    pub fn state(&self, path: &str) -> String {
        let component = self.component(path);
        component["state"].as_str().unwrap_or_default().trim_start_matches("COMPONENT_STATE_").to_owned()
    }

    /// Waits until it is in a state.
    pub fn await_state(&self, path: &str, state: &str) {
        eventually(&format!("{path} is {state}"), || match self.state(path) {
            now if now == state => Ok(()),
            now => Err(now),
        });
    }

    /// Waits until a class is offered, and answers its full name.
    pub fn await_class(&self, process: &str, class: &str) -> String {
        eventually(&format!("class {class} in {process}"), || {
            let known = self.classes(process);
            known
                .iter()
                .find(|c| *c == class || c.ends_with(&format!("/{class}")))
                .cloned()
                .ok_or(known.join(", "))
        })
    }

    /// The classes a process offers.
    #[must_use]
    pub fn classes(&self, process: &str) -> Vec<String> {
        let list = self.ok("GcmService/List", json!({ "brief": true }));
        let processes = list["processes"].as_array().cloned().unwrap_or_default();
        let of = processes.iter().find(|p| p["name"] == process);
        let classes = of.and_then(|p| p["classes"].as_array()).cloned().unwrap_or_default();
        classes.iter().filter_map(|c| c.as_str().map(str::to_owned)).collect()
    }

    /// The files of the plugin directories.
    #[must_use]
    pub fn plugins(&self) -> Vec<Value> {
        let answer = self.ok("PluginService/ListPlugins", json!({}));
        answer["plugins"].as_array().cloned().unwrap_or_default()
    }

    /// The revision of the graph.
    #[must_use]
    pub fn revision(&self) -> u64 {
        number(&self.ok("GcmService/List", json!({ "brief": true }))["revision"])
    }
}

/// A number as proto3 JSON writes it: 64-bit ones are strings, zero may be absent.
///
/// # Panics
/// When it is neither.
#[must_use]
pub fn number(value: &Value) -> u64 {
    match value {
        Value::Null => 0,
        Value::String(text) => text.parse().unwrap_or_else(|_| panic!("{text:?} is not a whole number")),
        other => other.as_u64().unwrap_or_else(|| panic!("{other} is not a whole number")),
    }
}
