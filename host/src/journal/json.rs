//! A record as JSON for scripts.
//!
//! Invariant: keys only grow; whole numbers stay below 2^53 but for hashes and times, which are texts.

use serde_json::{Map, Value, json as object};
use trocar_model::Entry;

use super::frame::Kept;
use super::lines::{lines, time};
use crate::gcm::{Answer, Asked};

/// Returns a record as JSON.
pub fn json(kept: &Kept) -> Value {
    let record = &kept.record;
    let mut fields = Map::new();
    let mut put = |name: &str, value: Value| _ = fields.insert(name.to_owned(), value);
    put("number", kept.number.into());
    put("hash", kept.hash.to_string().into());
    put("time", time(record.wall_ns).into());
    put("wall_ns", record.wall_ns.to_string().into());
    put("monotonic_ns", record.monotonic_ns.to_string().into());
    put("term", record.term.into());
    put("entry", kind(&record.entry).into());
    if let Some(revision) = record.entry.revision() {
        put("revision", revision.into());
    }
    if let Entry::Changed { decision, .. } | Entry::Stopped { decision, .. } = &record.entry {
        put("decision", (*decision).into());
    }
    put("plan", lines(record).into());
    if let Some(asked) = &record.asked {
        put("asked", request(asked));
    }
    if let Some(answer) = &record.answer {
        put("answer", result(answer));
    }
    Value::Object(fields)
}

fn kind(entry: &Entry) -> &'static str {
    match entry {
        Entry::Changed { .. } => "changed",
        Entry::Stopped { .. } => "stopped",
        Entry::Cut { .. } => "cut",
        Entry::Came { .. } => "came",
        Entry::Brought { .. } => "brought",
        Entry::Gone { .. } => "gone",
        Entry::Failed { .. } => "failed",
        Entry::Noted => "noted",
    }
}

/// A request that was cut is no JSON any more, and stays a text.
fn request(asked: &Asked) -> Value {
    let text = serde_json::from_str(&asked.text).unwrap_or_else(|_| Value::from(asked.text.as_str()));
    object!({ "identity": asked.identity, "request_id": asked.request_id, "request": text })
}

fn result(answer: &Answer) -> Value {
    let done = match answer {
        Ok(done) => done,
        Err(refusal) => {
            let (reason, message) = (refusal.reason(), refusal.to_string());
            return object!({ "refused": { "reason": reason, "message": message } });
        }
    };
    let skipped = done.plan.skipped.iter();
    let skipped: Vec<Value> =
        skipped.map(|it| object!({ "path": it.id.to_string(), "why": it.why })).collect();
    let failed = done.failed.iter().map(|(target, why)| {
        object!({ "target": target.to_string(), "reason": why.reason(), "message": why.to_string() })
    });
    let failed: Vec<Value> = failed.collect();
    let reports = done.reports.iter().map(|report| {
        object!({
            "path": report.id.to_string(),
            "state": report.state.to_string(),
            "health": report.health.to_string(),
            "fault": report.fault,
            "warnings": report.warnings,
        })
    });
    let reports: Vec<Value> = reports.collect();
    object!({ "done": {
        "revision": done.revision, "components": reports, "skipped": skipped, "failed": failed, "left": done.left,
    }})
}
