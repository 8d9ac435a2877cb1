//! A plan as lines for people: "+ create …", "~ configure …", "- stop …".
//!
//! Invariant: one line per change, in order; `+` adds or sets going, `~` alters, `-` takes away or stops.

use trocar_model::{Change, Plan, Verb};

pub(crate) fn lines(plan: &Plan) -> Vec<String> {
    plan.changes.iter().map(line).collect()
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
        Change::Disconnect { connection: c } => {
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
        Change::Disconnect { connection: c } => format!("Disconnect {} from {}", c.client, c.server),
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
