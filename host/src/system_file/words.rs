//! Settings in the words of a system file, for plans, differences and the audit log.
//!
//! Invariant: pure; a setting has one name everywhere.

use serde_json::Value;
use trocar_model::{ConnectOptions, Execution, Queue, is_same};

/// "key: old → new" of each setting that differs.
pub(crate) fn settings(from: &Value, to: &Value) -> Vec<String> {
    let (Some(old), Some(new)) = (from.as_object(), to.as_object()) else { return Vec::new() };
    let changed = new.iter().filter_map(|(key, value)| match old.get(key) {
        Some(old) if is_same(old, value) => None,
        Some(old) => Some(format!("{key}: {old} → {value}")),
        None => Some(format!("{key}: {value}")),
    });
    let gone =
        old.keys().filter(|key| !new.contains_key(*key)).map(|key| format!("{key}: {} → unset", old[key]));
    changed.chain(gone).collect()
}

/// "key: old → new" of each setting of an execution that differs.
pub(crate) fn executions(from: &Execution, to: &Execution) -> Vec<String> {
    changed(&spelled(from), &spelled(to))
}

/// "key: old → new" of each option of a connection that differs.
pub(crate) fn options(from: &ConnectOptions, to: &ConnectOptions) -> Vec<String> {
    changed(&spelled_options(from), &spelled_options(to))
}

type Spelled = (&'static str, Option<Value>);

fn changed(from: &[Spelled], to: &[Spelled]) -> Vec<String> {
    let shown = |value: &Option<Value>| match value {
        None => "unset".to_owned(),
        // 2000, not 2000.0.
        Some(Value::Number(n)) => n.as_f64().map_or_else(|| n.to_string(), |n| n.to_string()),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    };
    let differ = from.iter().zip(to).filter(|(old, new)| old != new);
    differ.map(|((key, old), (_, new))| format!("{key}: {} → {}", shown(old), shown(new))).collect()
}

fn scaled(ns: Option<u64>, unit: f64) -> Option<Value> {
    ns.map(|ns| Value::from(ns as f64 / unit))
}

/// Every setting of an execution by the name it has in a system file.
pub(crate) fn spelled(e: &Execution) -> [Spelled; 13] {
    let text = |text: &Option<String>| text.clone().map(Value::from);
    [
        ("model", e.model.map(|m| m.name().into())),
        ("period_us", scaled(e.period_ns, 1e3)),
        ("phase_us", scaled(e.phase_ns, 1e3)),
        ("stream_of", text(&e.stream_of)),
        ("inside", text(&e.inside)),
        ("priority", e.priority.map(Value::from)),
        ("cpus", (!e.cpus.is_empty()).then(|| e.cpus.clone().into())),
        ("catch_up", e.catch_up.map(Value::from)),
        ("threads", e.threads.map(Value::from)),
        ("max_step_ms", scaled(e.max_step_ns, 1e6)),
        ("history", e.history.map(Value::from)),
        ("on_failure", e.on_failure.map(|f| f.name().into())),
        ("wake", e.wake.map(|w| w.name().into())),
    ]
}

/// The same of the options of a connection.
pub(crate) fn spelled_options(o: &ConnectOptions) -> [Spelled; 7] {
    let queue = o.queue.map(|queue| match queue {
        Queue::Latest => Value::from("latest"),
        Queue::Fifo { depth, drop_oldest: false } => serde_json::json!({ "fifo": depth }),
        Queue::Fifo { depth, drop_oldest } => {
            serde_json::json!({ "fifo": depth, "drop_oldest": drop_oldest })
        }
    });
    let flag = |flag: bool| flag.then(|| Value::from(true));
    [
        ("queue", queue),
        ("max_age_ms", scaled(o.max_age_ns, 1e6)),
        ("deadline_ms", scaled(o.deadline_ns, 1e6)),
        ("mailbox", o.mailbox.map(Value::from)),
        ("adapt", flag(o.adapt)),
        ("delay", flag(o.delay)),
        ("carrier", (!o.carrier.is_empty()).then(|| o.carrier.clone().into())),
    ]
}
