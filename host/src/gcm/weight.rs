//! About as many bytes as a record takes, without writing it.
//!
//! Invariant: a record with a large configuration weighs at least that much.

use serde_json::Value;
use trocar_model::{Change, Entry, Plan};

use super::journal::Record;

/// Bytes of a record beside configurations and texts.
const LEAST: usize = 256;

pub(super) fn weight(record: &Record) -> usize {
    let entry = match &record.entry {
        Entry::Changed { changes, .. } => of_changes(changes),
        Entry::Brought { components, connections, .. } => {
            components.iter().map(|(_, c)| LEAST + of_value(&c.config)).sum::<usize>()
                + LEAST * connections.len()
        }
        Entry::Stopped { targets, .. } => 64 * targets.len(),
        Entry::Cut { connections, .. } => 8 * connections.len(),
        Entry::Came { .. } | Entry::Gone { .. } | Entry::Failed { .. } | Entry::Noted => 0,
    };
    let answer = match &record.answer {
        Some(Ok(done)) => of_plan(&done.plan) + LEAST * done.reports.len(),
        Some(Err(refusal)) => refusal.to_string().len(),
        None => 0,
    };
    LEAST
        + entry
        + answer
        + record.asked.as_ref().map_or(0, |a| a.text.len() + a.request_id.len() + a.identity.len())
}

fn of_plan(plan: &Plan) -> usize {
    of_changes(&plan.changes) + 64 * plan.skipped.len()
}

fn of_changes(changes: &[Change]) -> usize {
    let of = |change: &Change| match change {
        Change::Create { component, .. } | Change::Destroy { component, .. } => of_value(&component.config),
        Change::Configure { from, to, .. } => of_value(from) + of_value(to),
        Change::Run { .. } | Change::Connect { .. } | Change::Disconnect { .. } => 0,
    };
    changes.iter().map(|change| LEAST + of(change)).sum()
}

fn of_value(value: &Value) -> usize {
    match value {
        Value::Null | Value::Bool(_) | Value::Number(_) => 8,
        Value::String(text) => 8 + text.len(),
        Value::Array(all) => 8 + all.iter().map(of_value).sum::<usize>(),
        Value::Object(all) => 8 + all.iter().map(|(key, value)| key.len() + of_value(value)).sum::<usize>(),
    }
}
