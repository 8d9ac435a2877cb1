//! What an LCM answers and tells, both ways: replies, samples, items, log lines, figures, plugins.
//!
//! Invariant: what is encoded here decodes to an equal value, but for numbers, which are doubles in JSON values.

use trocar_model::Refusal;
use trocar_proto::v1;

use super::back::unreadable;
use super::json::{from_value, to_value};
use crate::lcm::{
    Detail, Invoke, Item, ItemKind, LinkDetail, LogLine, Payload, PluginInfo, Reply, Sample, Spread,
};

/// Level names; 1 is the first.
const LEVELS: [&str; 5] = ["error", "warn", "info", "debug", "trace"];

/// 1 error … 5 trace; nothing said is info.
pub(crate) fn level(text: &str) -> Option<u32> {
    if text.is_empty() {
        return Some(3);
    }
    (1..).zip(LEVELS).find(|(_, name)| text.eq_ignore_ascii_case(name)).map(|(n, _)| n)
}

pub(crate) fn line(line: LogLine) -> v1::LogLine {
    v1::LogLine {
        wall_ns: line.wall_ns,
        level: LEVELS[(line.level.clamp(1, 5) - 1) as usize].into(),
        path: line.path,
        target: line.target,
        message: line.message,
    }
}

pub(crate) fn line_in(line: v1::LogLine) -> LogLine {
    LogLine {
        wall_ns: line.wall_ns,
        level: level(&line.level).unwrap_or(3),
        path: line.path,
        target: line.target,
        message: line.message,
    }
}

pub(crate) fn item(item: Item) -> v1::SubscribeResponse {
    let kind = match item.kind {
        ItemKind::State => v1::ItemKind::State,
        ItemKind::Event => v1::ItemKind::Event,
        ItemKind::Stream => v1::ItemKind::Stream,
    };
    v1::SubscribeResponse {
        path: item.path,
        kind: kind as i32,
        json: Some(to_value(&item.value)),
        stamp_ns: item.stamp_ns,
        seq: item.seq,
        skipped: item.skipped,
    }
}

pub(crate) fn item_in(item: v1::SubscribeResponse) -> Result<Item, Refusal> {
    let kind = match item.kind() {
        v1::ItemKind::Unspecified => return Err(unreadable("kind")),
        v1::ItemKind::State => ItemKind::State,
        v1::ItemKind::Event => ItemKind::Event,
        v1::ItemKind::Stream => ItemKind::Stream,
    };
    Ok(Item {
        path: item.path,
        kind,
        value: from_value(item.json.unwrap_or_default()),
        stamp_ns: item.stamp_ns,
        seq: item.seq,
        skipped: item.skipped,
    })
}

/// The argument of a call.
pub(crate) fn payload(json: Option<prost_types::Value>, encoded: Vec<u8>) -> Payload {
    match json {
        Some(value) => Payload::Json(from_value(value)),
        None if encoded.is_empty() => Payload::None,
        None => Payload::Encoded(encoded),
    }
}

pub(crate) fn invoke_out(call: Invoke) -> v1::InvokeRequest {
    let (json, encoded) = match call.arg {
        Payload::None => (None, Vec::new()),
        Payload::Json(value) => (Some(to_value(&value)), Vec::new()),
        Payload::Encoded(bytes) => (None, bytes),
    };
    v1::InvokeRequest {
        path: call.member.to_string(),
        json,
        encoded,
        deadline: Some(super::json::duration(call.deadline_ns)),
        send: call.send,
    }
}

pub(crate) fn reply(reply: Reply) -> v1::InvokeResponse {
    v1::InvokeResponse {
        executed: reply.executed,
        json: reply.value.as_ref().map(to_value),
        encoded: reply.encoded,
        unit: reply.unit,
        stamp_ns: reply.stamp_ns,
        age_ns: reply.age_ns,
    }
}

pub(crate) fn reply_in(reply: v1::InvokeResponse) -> Reply {
    Reply {
        executed: reply.executed,
        value: reply.json.map(from_value),
        encoded: reply.encoded,
        stamp_ns: reply.stamp_ns,
        age_ns: reply.age_ns,
        unit: reply.unit,
    }
}

pub(crate) fn sample(sample: Sample) -> v1::ReadResponse {
    v1::ReadResponse {
        json: Some(to_value(&sample.value)),
        encoded: sample.encoded,
        stamp_ns: sample.stamp_ns,
        age_ns: sample.age_ns,
        seq: sample.seq,
        frame_bytes: sample.frame_bytes,
    }
}

pub(crate) fn sample_in(sample: v1::ReadResponse) -> Sample {
    Sample {
        value: from_value(sample.json.unwrap_or_default()),
        encoded: sample.encoded,
        stamp_ns: sample.stamp_ns,
        age_ns: sample.age_ns,
        seq: sample.seq,
        frame_bytes: sample.frame_bytes,
    }
}

pub(crate) fn detail_in(s: v1::ComponentStats) -> Detail {
    let spread = |s: Option<v1::Spread>| {
        let s = s.unwrap_or_default();
        Spread { avg_ns: s.avg_ns, std_ns: s.std_ns, min_ns: s.min_ns, max_ns: s.max_ns }
    };
    Detail {
        period: spread(s.period),
        compute: spread(s.compute),
        lateness_p50_ns: s.lateness_p50_ns,
        lateness_p99_ns: s.lateness_p99_ns,
        lateness_max_ns: s.lateness_max_ns,
        executed: s.executed,
        skipped: s.skipped,
        overruns: s.overruns,
        load: s.load,
        commands: s.commands,
        commands_rejected: s.commands_rejected,
        events_dropped: s.events_dropped,
        thread: s.thread,
        realtime: s.realtime,
        warnings: s.warnings,
    }
}

/// Figures only: ends and options stay empty.
pub(crate) fn link(d: LinkDetail) -> v1::Connection {
    v1::Connection {
        id: d.connection,
        carrier: d.carrier,
        passed: d.passed,
        dropped: d.dropped,
        bytes: d.bytes,
        latency_p50_ns: d.latency_p50_ns,
        latency_p99_ns: d.latency_p99_ns,
        ..Default::default()
    }
}

pub(crate) fn link_in(c: v1::Connection) -> LinkDetail {
    LinkDetail {
        connection: c.id,
        carrier: c.carrier,
        passed: c.passed,
        dropped: c.dropped,
        bytes: c.bytes,
        latency_p50_ns: c.latency_p50_ns,
        latency_p99_ns: c.latency_p99_ns,
    }
}

pub(crate) fn plugin(p: PluginInfo) -> v1::Plugin {
    v1::Plugin {
        process: p.process,
        file: p.file,
        name: p.name,
        version: p.version,
        hash: p.hash,
        abi: p.abi,
        built_with: p.built_with,
        doc: p.doc,
        classes: p.classes,
        loaded: p.loaded,
        warnings: p.warnings,
        refused_reason: p.refused_reason,
        refused: p.refused,
    }
}

pub(crate) fn plugin_in(p: v1::Plugin) -> PluginInfo {
    PluginInfo {
        process: p.process,
        file: p.file,
        name: p.name,
        version: p.version,
        hash: p.hash,
        abi: p.abi,
        built_with: p.built_with,
        doc: p.doc,
        classes: p.classes,
        loaded: p.loaded,
        warnings: p.warnings,
        refused_reason: p.refused_reason,
        refused: p.refused,
    }
}
