//! Answers and reports of an LCM, both ways: replies, samples, items, log lines, figures, plugins.
//!
//! Invariant: decoding gives a value equal to the encoded one, except for numbers, which are doubles in JSON
//! values.

use trocar_model::{ComponentId, End, Name, Proxy, Refusal, Wake};
use trocar_proto::v1;

use super::back::unreadable;
use super::json::{from_value, to_value};
use crate::lcm::{
    Detail, Eye, HalfReport, Invoke, Item, ItemKind, LinkDetail, LogLine, Payload, PluginInfo, Reply, Sample,
    Selection, Spread, When,
};

/// Level names; 1 is the first.
const LEVELS: [&str; 5] = ["error", "warn", "info", "debug", "trace"];

/// 1 error … 5 trace; an empty text is info.
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

pub(crate) fn selection(s: v1::Selection) -> Result<Selection, Refusal> {
    let eye = match v1::Eye::try_from(s.eye) {
        Ok(v1::Eye::Unspecified | v1::Eye::Left) => Eye::Left,
        Ok(v1::Eye::Right) => Eye::Right,
        Ok(v1::Eye::Both) => Eye::Both,
        Err(_) => {
            return Err(Refusal::ArgumentInvalid {
                what: format!("following {}", s.path),
                why: format!("eye is {}; it is EYE_LEFT, EYE_RIGHT or EYE_BOTH", s.eye),
                field: "selections.eye".into(),
            });
        }
    };
    Ok(Selection { path: s.path, max_rate_hz: s.max_rate_hz, thumbnail_width: s.thumbnail_width, eye })
}

pub(crate) fn selection_out(s: Selection) -> v1::Selection {
    let eye = match s.eye {
        Eye::Left => v1::Eye::Left,
        Eye::Right => v1::Eye::Right,
        Eye::Both => v1::Eye::Both,
    };
    v1::Selection {
        path: s.path,
        max_rate_hz: s.max_rate_hz,
        thumbnail_width: s.thumbnail_width,
        eye: eye.into(),
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
        jpeg: item.jpeg,
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
        jpeg: item.jpeg,
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

/// Which row a Read means.
pub(crate) fn when(row: Option<v1::read_request::Row>) -> When {
    use v1::read_request::Row;
    match row {
        None => When::Newest,
        Some(Row::AtNs(ns)) => When::Time(ns),
        Some(Row::NearestNs(ns)) => When::Nearest(ns),
        Some(Row::Tick(tick)) => When::Tick(tick),
        Some(Row::Delayed(rows)) => When::Delayed(rows),
    }
}

pub(crate) fn row(when: When) -> Option<v1::read_request::Row> {
    use v1::read_request::Row;
    match when {
        When::Newest => None,
        When::Time(ns) => Some(Row::AtNs(ns)),
        When::Nearest(ns) => Some(Row::NearestNs(ns)),
        When::Tick(tick) => Some(Row::Tick(tick)),
        When::Delayed(rows) => Some(Row::Delayed(rows)),
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
        frame: sample.frame,
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
        frame: sample.frame,
    }
}

/// Two functions for two types that have the same fields, out and back; `name: out, back` converts a field.
macro_rules! mirror {
    ($out:ident, $back:ident: $model:ident = $wire:ident {
        $($same:ident),* $(; $($field:ident: $to:expr, $from:expr);+)?
    }) => {
        pub(crate) fn $out(m: $model) -> v1::$wire {
            v1::$wire { $($same: m.$same,)* $($($field: $to(m.$field)),+)? }
        }

        pub(crate) fn $back(w: v1::$wire) -> $model {
            $model { $($same: w.$same,)* $($($field: $from(w.$field)),+)? }
        }
    };
}

mirror!(spread, spread_in: Spread = Spread { avg_ns, std_ns, min_ns, max_ns });

fn some_spread(s: Spread) -> Option<v1::Spread> {
    Some(spread(s))
}

fn any_spread(s: Option<v1::Spread>) -> Spread {
    spread_in(s.unwrap_or_default())
}

mirror!(stats_out, stats_in: Detail = ComponentStats {
    lateness_p50_ns, lateness_p99_ns, lateness_max_ns, executed, skipped, overruns, load, commands, commands_rejected,
    events_dropped, thread, realtime, warnings, phase_ns, phase_auto;
    period: some_spread, any_spread;
    compute: some_spread, any_spread
});

pub(crate) fn stats(d: &Detail) -> v1::ComponentStats {
    stats_out(d.clone())
}

pub(crate) fn details(of: Vec<(ComponentId, Detail)>) -> v1::Details {
    let one = |(id, detail): (ComponentId, Detail)| v1::ComponentDetail {
        path: id.to_string(),
        stats: Some(stats_out(detail)),
    };
    v1::Details { components: of.into_iter().map(one).collect() }
}

/// # Errors
/// It is of no component.
pub(crate) fn detail_in(d: v1::ComponentDetail) -> Result<(ComponentId, Detail), Refusal> {
    Ok((ComponentId::parse(&d.path)?, stats_in(d.stats.unwrap_or_default())))
}

/// Figures only: ends and options stay empty.
pub(crate) fn link(d: LinkDetail) -> v1::Connection {
    v1::Connection {
        id: d.connection,
        carrier: d.carrier,
        passed: d.passed,
        dropped: d.dropped,
        skipped: d.skipped,
        bytes: d.bytes,
        latency_p50_ns: d.latency_p50_ns,
        latency_p99_ns: d.latency_p99_ns,
        rejected: d.rejected,
        depth: d.depth,
        high_water: d.high_water,
        failed: d.failed,
        unexecuted: d.unexecuted,
        client_wake: d.client_wake.into(),
        server_wake: d.server_wake.into(),
        sent: d.sent,
        came: d.came,
        round_trip_ns: d.round_trip_ns,
        clock_offset_ns: d.clock_offset_ns,
        clock_bound_ns: d.clock_bound_ns,
        proxies: d.halves.iter().map(|(end, half)| proxy(*end, half)).collect(),
        ..Default::default()
    }
}

pub(crate) fn link_in(c: v1::Connection) -> Result<LinkDetail, Refusal> {
    Ok(LinkDetail {
        connection: c.id,
        carrier: c.carrier,
        passed: c.passed,
        dropped: c.dropped,
        skipped: c.skipped,
        bytes: c.bytes,
        latency_p50_ns: c.latency_p50_ns,
        latency_p99_ns: c.latency_p99_ns,
        rejected: c.rejected,
        depth: c.depth,
        high_water: c.high_water,
        failed: c.failed,
        unexecuted: c.unexecuted,
        client_wake: wake_in(&c.client_wake)?,
        server_wake: wake_in(&c.server_wake)?,
        sent: c.sent,
        came: c.came,
        round_trip_ns: c.round_trip_ns,
        clock_offset_ns: c.clock_offset_ns,
        clock_bound_ns: c.clock_bound_ns,
        halves: c.proxies.into_iter().map(proxy_in).collect::<Result<_, _>>()?,
    })
}

fn wake_in(said: &str) -> Result<&'static str, Refusal> {
    let known = std::iter::once("").chain(Wake::ALL.map(Wake::name));
    known.into_iter().find(|name| *name == said).ok_or_else(|| unreadable("wake"))
}

const ENDS: [(End, v1::ConnectionEnd); 2] =
    [(End::Client, v1::ConnectionEnd::Client), (End::Server, v1::ConnectionEnd::Server)];

fn end_out(end: End) -> i32 {
    ENDS.iter().find(|(e, _)| *e == end).map_or(0, |(_, wire)| *wire as i32)
}

fn end_in(end: i32) -> Result<End, Refusal> {
    ENDS.iter().find(|(_, wire)| *wire as i32 == end).map(|(e, _)| *e).ok_or_else(|| unreadable("end"))
}

/// A half of a connection between two processes.
pub(crate) fn proxy(end: End, p: &Proxy) -> v1::Proxy {
    v1::Proxy {
        process: p.process.to_string(),
        end: end_out(end),
        linked: p.is_linked(),
        why_not: p.why.clone(),
        epoch: p.epoch,
        carrier: p.carrier.clone(),
    }
}

fn proxy_in(p: v1::Proxy) -> Result<(End, Proxy), Refusal> {
    let process = Name::parse(&p.process)?;
    let (why, peer) = (p.why_not, String::new());
    Ok((end_in(p.end)?, Proxy { process, epoch: p.epoch, why, carrier: p.carrier, peer }))
}

pub(crate) fn half(half: &HalfReport) -> v1::ProxyNews {
    let HalfReport { connection, end, proxy: now } = half;
    let peer = now.as_ref().map(|now| now.peer.clone()).unwrap_or_default();
    let now = now.as_ref().map(|now| proxy(*end, now));
    v1::ProxyNews { connection: *connection, end: end_out(*end), proxy: now, peer }
}

pub(crate) fn half_in(half: v1::ProxyNews) -> Result<HalfReport, Refusal> {
    let peer = half.peer;
    let proxy = half.proxy.map(proxy_in).transpose()?.map(|(_, proxy)| Proxy { peer, ..proxy });
    Ok(HalfReport { connection: half.connection, end: end_in(half.end)?, proxy })
}

mirror!(plugin, plugin_in: PluginInfo = Plugin {
    process, file, name, version, hash, abi, built_with, doc, classes, loaded, warnings, refused_reason, refused
});
