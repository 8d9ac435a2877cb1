//! A system as the text of a file, laid out as a person would.
//!
//! Invariant: a text reads back as what was written; usual values are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::time::Duration;

use serde_json::{Value, json};
use trocar_model::{ComponentId, Execution, PortId};

use super::words::{spelled, spelled_options};
use super::{ComponentSpec, ConnectionSpec, MachineSpec, ProcessSpec, SystemFile, TrustSpec};
use crate::host::MemoryBounds;
use crate::processes::{Limits, Policy, Unheard};

/// Longest line, unless a single value is longer.
const WIDTH: usize = 110;
/// Whole numbers up to this are the same as doubles.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// The content of a system file, wherever it comes from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    pub machines: Vec<MachineSpec>,
    pub processes: Vec<ProcessSpec>,
    pub components: Vec<ComponentSpec>,
    pub connections: Vec<ConnectionSpec>,
}

impl SystemFile {
    /// Returns its content, settings of the command line included.
    pub fn picture(&self) -> Picture {
        Picture {
            machines: self.machines.clone(),
            processes: self.processes.clone(),
            components: self.components.clone(),
            connections: self.connections.clone(),
        }
    }
}

impl Picture {
    /// The text of a file that says this.
    pub fn text(&self) -> String {
        let isolated: BTreeSet<_> =
            self.components.iter().filter(|c| c.isolated).map(|c| &c.id.process).collect();
        let own = |p: &&ProcessSpec| !isolated.contains(&p.name);
        let processes: Vec<_> =
            self.processes.iter().filter(own).map(|p| (p.name.to_string(), process(p))).collect();
        let components: Vec<_> =
            self.components.iter().map(|c| (c.written.to_string(), component(c))).collect();
        let written: BTreeMap<_, _> = self.components.iter().map(|c| (&c.id, &c.written)).collect();
        let connections = self.connections.iter().map(|c| connection(c, &written)).collect();
        let mut out = "{\n  \"version\": 1,\n".to_owned();
        if !self.machines.is_empty() {
            let agent = |m: &MachineSpec| object([("agent", Some(Value::from(m.agent.as_str())))]);
            let machines = self.machines.iter().map(|m| (m.name.to_string(), agent(m))).collect();
            out.push_str("  \"machines\": ");
            put(&mut out, &Node::Object(machines), 2, WIDTH - 15);
            out.push_str(",\n");
        }
        out.push_str("  \"processes\": ");
        put(&mut out, &Node::Object(processes), 2, WIDTH - 16);
        out.push_str(",\n  \"components\": ");
        broken(&mut out, &Node::Object(components), 2);
        out.push_str(",\n  \"connections\": ");
        broken(&mut out, &Node::List(connections), 2);
        out.push_str("\n}\n");
        out
    }
}

/// `written`: what the file calls the components.
fn connection(c: &ConnectionSpec, written: &BTreeMap<&ComponentId, &ComponentId>) -> Node {
    let end = |port: &PortId| {
        let component = written.get(&port.component).copied().unwrap_or(&port.component);
        Value::from(format!("{component}/{}", port.port))
    };
    let ends = [("client", Some(end(&c.client))), ("server", Some(end(&c.server)))];
    object(ends.into_iter().chain(spelled_options(&c.options)))
}

fn process(p: &ProcessSpec) -> Node {
    let ProcessSpec { name: _, machine, plugins, trust, listen, state, env, restart, memory, allow_exec } = p;
    let path = |path: &std::path::Path| Value::from(path.to_string_lossy().into_owned());
    let plugins: Vec<Value> = plugins.iter().map(|dir| path(dir)).collect();
    let env = env.iter().map(|(name, value)| (name.clone(), Value::from(value.as_str())));
    object([
        ("machine", machine.as_ref().map(|machine| Value::from(machine.as_str()))),
        ("plugins", (!plugins.is_empty()).then_some(Value::Array(plugins))),
        (
            "trust",
            match trust {
                TrustSpec::Dev => None,
                TrustSpec::AllowList(file) => {
                    Some(Value::from(format!("allowlist:{}", file.to_string_lossy())))
                }
            },
        ),
        ("listen", listen.clone().map(Value::from)),
        ("state", state.as_deref().map(path)),
        (
            "env",
            Some(Value::Object(env.collect()))
                .filter(|env| env.as_object().is_some_and(|env| !env.is_empty())),
        ),
        ("restart", policy(restart)),
        ("memory", bounds(memory)),
        ("allow_exec", allow_exec.then_some(Value::from(true))),
    ])
}

fn policy(policy: &Policy) -> Option<Value> {
    if *policy == Policy::default() {
        return None;
    }
    let Policy::OnFailure(limits) = policy else { return Some(Value::from("never")) };
    let Limits { max, within, backoff, most_backoff, start_within, unheard } = limits;
    let usual = Limits::DEFAULT;
    let time =
        |time: &Duration, usual: Duration, unit: f64| (*time != usual).then_some(time.as_secs_f64() * unit);
    let all = json!({
        "max": (*max != usual.max).then_some(max),
        "within_s": time(within, usual.within, 1.0),
        "backoff_ms": time(backoff, usual.backoff, 1e3),
        "most_backoff_ms": time(most_backoff, usual.most_backoff, 1e3),
        "start_within_s": time(start_within, usual.start_within, 1.0),
        "unheard_s": match unheard {
            Unheard::Usual => Value::Null,
            Unheard::Never => Value::from("never"),
            Unheard::After(time) => Value::from(time.as_secs_f64()),
        },
    });
    let set = all.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
    let set: serde_json::Map<_, _> = set.map(|(key, value)| (key.clone(), value.clone())).collect();
    if set.is_empty() { Some(Value::from("on_failure")) } else { Some(Value::Object(set)) }
}

fn bounds(memory: &MemoryBounds) -> Option<Value> {
    let MemoryBounds { warn_mib, limit_mib } = memory;
    match (warn_mib, limit_mib) {
        (None, None) => None,
        (Some(warn), None) => Some(json!({ "warn_mib": warn })),
        (None, Some(limit)) => Some(json!({ "limit_mib": limit })),
        (Some(warn), Some(limit)) => Some(json!({ "limit_mib": limit, "warn_mib": warn })),
    }
}

fn component(c: &ComponentSpec) -> Node {
    let ComponentSpec { id: _, written: _, resumes, isolated, class, config, execution, start } = c;
    object([
        ("class", Some(Value::from(class.as_str()))),
        ("config", config.clone()),
        ("execution", self::execution(execution)),
        ("isolation", isolated.then(|| Value::from("process"))),
        ("resume", resumes.then(|| Value::from("auto"))),
        ("start", (!start).then_some(Value::from(false))),
    ])
}

/// With a rate where that says the period exactly, as people do.
fn execution(e: &Execution) -> Option<Value> {
    let set = spelled(e).into_iter().filter_map(|(key, value)| Some((key, value?)));
    let named = |(key, value): (&str, Value)| match (key, e.period_ns.and_then(rate_hz)) {
        ("period_us", Some(hz)) => ("rate_hz".to_owned(), Value::from(hz)),
        _ => (key.to_owned(), value),
    };
    let all: serde_json::Map<_, _> = set.map(named).collect();
    (!all.is_empty()).then_some(Value::Object(all))
}

/// A rate of six digits at most that has this very period.
fn rate_hz(period_ns: u64) -> Option<f64> {
    let hz: f64 = format!("{:.5e}", 1e9 / period_ns as f64).parse().ok()?;
    ((1e9 / hz).round() == period_ns as f64).then_some(hz)
}

/// A value whose objects keep their order.
#[derive(Debug)]
enum Node {
    Value(Value),
    Object(Vec<(String, Node)>),
    List(Vec<Node>),
}

/// An object of all that is set, in this order.
fn object<'a>(entries: impl IntoIterator<Item = (&'a str, Option<Value>)>) -> Node {
    let set = entries.into_iter().filter_map(|(key, value)| Some((key.to_owned(), node(value?))));
    Node::Object(set.collect())
}

fn node(value: Value) -> Node {
    match value {
        Value::Object(map) => Node::Object(map.into_iter().map(|(key, value)| (key, node(value))).collect()),
        Value::Array(items) => Node::List(items.into_iter().map(node).collect()),
        value => Node::Value(value),
    }
}

/// Writes a value on one line.
fn flat(node: &Node) -> String {
    match node {
        Node::Value(value) => plain(value),
        Node::Object(entries) if entries.is_empty() => "{}".to_owned(),
        Node::Object(entries) => {
            let all: Vec<String> = entries
                .iter()
                .map(|(key, node)| format!("{}: {}", plain(&Value::from(key.as_str())), flat(node)))
                .collect();
            format!("{{ {} }}", all.join(", "))
        }
        Node::List(items) => format!("[{}]", items.iter().map(flat).collect::<Vec<_>>().join(", ")),
    }
}

/// 20 and not 20.0.
fn plain(value: &Value) -> String {
    match value.as_f64() {
        Some(n) if value.is_f64() && n.fract() == 0.0 && n.abs() < EXACT => format!("{n:.0}"),
        _ => value.to_string(),
    }
}

/// Writes a value on one line where there is room for it.
fn put(out: &mut String, node: &Node, indent: usize, room: usize) {
    let line = flat(node);
    if line.chars().count() <= room { out.push_str(&line) } else { broken(out, node, indent) }
}

/// Each part on lines of its own; numbers of a list as many on a line as fit.
fn broken(out: &mut String, node: &Node, indent: usize) {
    let inner = indent + 2;
    let room = WIDTH.saturating_sub(inner + 1);
    match node {
        Node::Object(entries) if !entries.is_empty() => {
            out.push_str("{\n");
            for (at, (key, node)) in entries.iter().enumerate() {
                let key = plain(&Value::from(key.as_str()));
                let _ = write!(out, "{:inner$}{key}: ", "");
                put(out, node, inner, room.saturating_sub(key.chars().count() + 2));
                out.push_str(if at + 1 < entries.len() { ",\n" } else { "\n" });
            }
            let _ = write!(out, "{:indent$}}}", "");
        }
        Node::List(items) if !items.is_empty() => {
            out.push_str("[\n");
            let (mut used, few) = (0, items.iter().all(|item| matches!(item, Node::Value(_))));
            for (at, item) in items.iter().enumerate() {
                let line = flat(item);
                let joins = few && used > 0 && used + line.chars().count() + 2 <= room;
                if joins {
                    out.push(' ');
                } else {
                    let _ = write!(out, "{}{:inner$}", if at > 0 { "\n" } else { "" }, "");
                    used = 0;
                }
                put(out, item, inner, room);
                used += line.chars().count() + 2;
                if at + 1 < items.len() {
                    out.push(',');
                }
            }
            let _ = write!(out, "\n{:indent$}]", "");
        }
        node => out.push_str(&flat(node)),
    }
}
