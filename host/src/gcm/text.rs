//! A plan as lines for people: "+ create …", "~ configure …", "- stop …".
//!
//! Invariant: one line per change, in order; `+` adds or sets going, `~` alters, `-` takes away or stops.

use serde_json::Value;
use trocar_model::{Change, Execution, Plan, Verb};

pub(crate) fn lines(plan: &Plan) -> Vec<String> {
    let one = |(at, change): (usize, &Change)| match anew(change, &plan.changes[..at]) {
        Some(from) => line(change) + &from,
        None => line(change),
    };
    plan.changes.iter().enumerate().map(one).collect()
}

/// What of its execution differs, when a component is made anew.
fn anew(change: &Change, before: &[Change]) -> Option<String> {
    let Change::Create { id, component } = change else { return None };
    before.iter().rev().find_map(|earlier| match earlier {
        Change::Destroy { id: gone, component: was } if gone == id => {
            Some(executions(&was.execution, &component.execution))
        }
        _ => None,
    })
}

/// What a change is called in a plan or a log line.
pub(super) fn line(change: &Change) -> String {
    match change {
        Change::Create { id, component } => format!("+ create {id} ({})", component.class.full_name()),
        Change::Destroy { id, .. } => format!("- remove {id}"),
        Change::Configure { id, from, to, to_state, .. } => {
            format!("~ configure {id}{} → {to_state}", settings(from, to))
        }
        Change::Run { id, verb, from, to } => {
            let (sign, word) = match verb {
                Verb::Start => ('+', "start"),
                Verb::Resume => ('+', "resume"),
                Verb::Stop => ('-', "stop"),
                Verb::Reset => ('~', "reset"),
                Verb::Configure => ('~', "configure"),
                Verb::Remove => ('-', "remove"),
            };
            format!("{sign} {word} {id} ({from} → {to})")
        }
        Change::Connect { connection: c } => {
            format!("+ connect {} → {} (connection {})", c.server, c.client, c.id.0)
        }
        Change::Disconnect { connection: c, .. } => {
            format!("- disconnect {} → {} (connection {})", c.server, c.client, c.id.0)
        }
    }
}

/// What is waited for when a change takes too long: "Start host/robot".
pub(crate) fn asked(change: &Change) -> String {
    match change {
        Change::Create { id, .. } => format!("Create {id}"),
        Change::Destroy { id, .. } => format!("Remove {id}"),
        Change::Configure { id, .. } => format!("Configure {id}"),
        Change::Run { id, verb, .. } => format!("{verb} {id}"),
        Change::Connect { connection: c } => format!("Connect {} to {}", c.client, c.server),
        Change::Disconnect { connection: c, .. } => format!("Disconnect {} from {}", c.client, c.server),
    }
}

/// " key: old → new, …" of the settings that change.
fn settings(from: &serde_json::Value, to: &serde_json::Value) -> String {
    let Some(new) = to.as_object() else { return String::new() };
    let changed = new.iter().filter(|(key, value)| from.get(key.as_str()) != Some(value));
    let list: Vec<String> = changed
        .map(|(key, value)| match from.get(key.as_str()) {
            Some(old) => format!("{key}: {old} → {value}"),
            None => format!("{key}: {value}"),
        })
        .collect();
    if list.is_empty() { String::new() } else { format!(" {{{}}}", list.join(", ")) }
}

/// " {key: old → new, …}" of the execution settings that change.
fn executions(from: &Execution, to: &Execution) -> String {
    let old = spelled(from);
    let changed = spelled(to).into_iter().zip(old).filter(|((_, new), (_, old))| new != old);
    let shown = |value: Option<Value>| match value {
        None => "unset".to_owned(),
        // 2000, not 2000.0.
        Some(Value::Number(n)) => n.as_f64().map_or_else(|| n.to_string(), |n| n.to_string()),
        Some(Value::String(text)) => text,
        Some(other) => other.to_string(),
    };
    let list: Vec<String> =
        changed.map(|((key, new), (_, old))| format!("{key}: {} → {}", shown(old), shown(new))).collect();
    if list.is_empty() { String::new() } else { format!(" {{{}}}", list.join(", ")) }
}

/// Every setting by the name it has in a system file.
pub(super) fn spelled(e: &Execution) -> [(&'static str, Option<Value>); 13] {
    let scaled = |ns: Option<u64>, unit: f64| ns.map(|ns| Value::from(ns as f64 / unit));
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
