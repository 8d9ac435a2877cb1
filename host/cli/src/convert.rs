//! Wire messages → what the program shows, and typed arguments → wire.
//!
//! Invariant: only these files and `session` of the command line know wire types; they decide nothing.

mod describe;
mod json;
mod steps;

use serde_json::Value;
use trocar_proto::v1;

pub(super) use self::describe::description;
pub(super) use self::json::{from_struct, from_wire, to_struct, to_wire};
pub(super) use self::steps::{fate, step, supervisor, wanted};

use super::execution::ExecutionArgs;
use super::question::Awaited;
use super::view::{
    ChangeView, ComponentView, ConnectionView, ExecutionView, ItemView, LineView, LogView, OptionsView,
    PluginView, ProcessView, ProxyView, RowView, StatsView, SystemView, WaitView,
};

pub(super) fn duration(ns: u64) -> prost_types::Duration {
    prost_types::Duration { seconds: (ns / 1_000_000_000) as i64, nanos: (ns % 1_000_000_000) as i32 }
}

fn ns(duration: Option<&prost_types::Duration>) -> u64 {
    duration.map_or(0, |d| d.seconds.max(0) as u64 * 1_000_000_000 + d.nanos.max(0) as u64)
}

/// "STATE_NAME_X" without the prefix every value of the enumeration has.
fn word(name: &str, prefix: &str) -> String {
    match name.strip_prefix(prefix).unwrap_or(name) {
        "UNSPECIFIED" => String::new(),
        word => word.to_owned(),
    }
}

/// "ACTIVE", "STOPPED{requested}".
pub(super) fn state(state: v1::ComponentState, reason: v1::StopReason) -> String {
    let name = word(state.as_str_name(), "COMPONENT_STATE_");
    match word(reason.as_str_name(), "STOP_REASON_") {
        reason if state == v1::ComponentState::Stopped && !reason.is_empty() => {
            format!("{name}{{{}}}", reason.to_lowercase())
        }
        _ => name,
    }
}

pub(super) fn health(health: v1::Health) -> String {
    word(health.as_str_name(), "HEALTH_")
}

pub(super) fn system(answer: &v1::ListResponse) -> SystemView {
    SystemView {
        revision: answer.revision,
        processes: answer.processes.iter().map(process).collect(),
        components: answer.components.iter().map(component).collect(),
        connections: answer.connections.iter().map(connection).collect(),
        warnings: answer.warnings.clone(),
    }
}

pub(super) fn process(p: &v1::Process) -> ProcessView {
    ProcessView {
        name: p.name.clone(),
        state: word(p.state().as_str_name(), "PROCESS_STATE_"),
        epoch: p.epoch,
        endpoint: p.endpoint.clone(),
        guest: p.guest.clone(),
        pid: p.pid,
        classes: p.classes.clone(),
        last_exit: p.last_exit.clone(),
        restarts: p.restarts,
        warnings: p.warnings.clone(),
        unfit: p.unfit,
    }
}

pub(super) fn component(c: &v1::Component) -> ComponentView {
    let stats = c.stats.as_ref();
    let mut execution = c.execution.as_ref().map(execution).unwrap_or_default();
    execution.thread = stats.map(|s| s.thread.clone()).unwrap_or_default();
    ComponentView {
        path: c.path.clone(),
        class: c.class.clone(),
        plugin_version: c.plugin_version.clone(),
        state: state(c.state(), c.stop_reason()),
        health: health(c.health()),
        fault: c.fault.clone(),
        config: c.config.as_ref().map_or(Value::Null, from_struct),
        execution,
        safety: word(c.safety().as_str_name(), "SAFETY_").to_lowercase(),
        stats: stats.map(self::stats).unwrap_or_default(),
        is_measured: stats.is_some(),
        warnings: stats.map(|s| s.warnings.clone()).unwrap_or_default(),
    }
}

fn stats(s: &v1::ComponentStats) -> StatsView {
    let (period, compute) = (s.period.unwrap_or_default(), s.compute.unwrap_or_default());
    StatsView {
        executed: s.executed,
        skipped: s.skipped,
        overruns: s.overruns,
        lateness_p50_ns: s.lateness_p50_ns,
        lateness_p99_ns: s.lateness_p99_ns,
        lateness_max_ns: s.lateness_max_ns,
        period_avg_ns: period.avg_ns.max(0.0) as u64,
        compute_avg_ns: compute.avg_ns.max(0.0) as u64,
        compute_max_ns: compute.max_ns,
        load: s.load,
        realtime: s.realtime,
        commands: s.commands,
        commands_rejected: s.commands_rejected,
        events_dropped: s.events_dropped,
        phase_ns: s.phase_ns,
        phase_auto: s.phase_auto,
    }
}

fn execution(e: &v1::Execution) -> ExecutionView {
    let period_ns = match (ns(e.period.as_ref()), e.rate_hz.unwrap_or(0.0)) {
        (0, hz) if hz > 0.0 => (1e9 / hz).round() as u64,
        (period, _) => period,
    };
    ExecutionView {
        model: e.model.clone(),
        period_ns,
        phase_ns: e.phase.as_ref().map(|d| ns(Some(d))),
        stream_of: e.stream_of.clone(),
        inside: e.inside.clone(),
        priority: e.priority.unwrap_or(0),
        cpus: e.cpus.clone(),
        catch_up: e.catch_up.unwrap_or(0),
        threads: e.threads.unwrap_or(0),
        max_step_ns: ns(e.max_step.as_ref()),
        history: e.history.unwrap_or(0),
        on_failure: e.on_failure.clone(),
        wake: e.wake.clone(),
        thread: String::new(),
    }
}

/// Converts only the settings that were typed.
pub(super) fn typed_execution(e: &ExecutionArgs) -> v1::Execution {
    v1::Execution {
        model: e.model.map(|m| m.wire_name().to_owned()).unwrap_or_default(),
        rate_hz: e.rate_hz,
        period: None,
        phase: e.phase.map(duration),
        stream_of: e.stream_of.clone().unwrap_or_default(),
        inside: e.inside.clone().unwrap_or_default(),
        priority: e.priority.map(u32::from),
        cpus: e.cpus.clone(),
        catch_up: e.catch_up,
        threads: e.threads,
        max_step: e.max_step.map(duration),
        history: e.history,
        on_failure: e.on_failure.map(|f| f.wire_name().to_owned()).unwrap_or_default(),
        wake: e.wake.map(|w| w.wire_name().to_owned()).unwrap_or_default(),
    }
}

fn options(o: &v1::ConnectOptions) -> OptionsView {
    OptionsView {
        fifo: o.queue.as_ref().map(|q| q.fifo),
        drop_oldest: o.queue.as_ref().is_some_and(|q| q.drop_oldest),
        max_age_ns: o.max_age.as_ref().map(|d| ns(Some(d))),
        deadline_ns: o.deadline.as_ref().map(|d| ns(Some(d))),
        mailbox: o.mailbox,
        adapt: o.adapt,
        delay: o.delay,
        carrier: o.carrier.clone(),
    }
}

fn proxy(p: &v1::Proxy) -> ProxyView {
    ProxyView {
        process: p.process.clone(),
        end: word(p.end().as_str_name(), "CONNECTION_END_"),
        linked: p.linked,
        why_not: p.why_not.clone(),
        epoch: p.epoch,
        carrier: p.carrier.clone(),
    }
}

pub(super) fn connection(c: &v1::Connection) -> ConnectionView {
    ConnectionView {
        id: c.id,
        client: c.client.clone(),
        server: c.server.clone(),
        carrier: c.carrier.clone(),
        options: c.options.as_ref().map(options).unwrap_or_default(),
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
        client_wake: c.client_wake.clone(),
        server_wake: c.server_wake.clone(),
        // A line that stands has a time there and back.
        line: (c.round_trip_ns > 0).then_some(LineView {
            sent: c.sent,
            came: c.came,
            round_trip_ns: c.round_trip_ns,
            clock_offset_ns: c.clock_offset_ns,
            clock_bound_ns: c.clock_bound_ns,
        }),
        proxies: c.proxies.iter().map(proxy).collect(),
    }
}

pub(super) fn plugin(p: &v1::Plugin) -> PluginView {
    PluginView {
        process: p.process.clone(),
        file: p.file.clone(),
        name: p.name.clone(),
        version: p.version.clone(),
        hash: p.hash.clone(),
        abi: p.abi.clone(),
        built_with: p.built_with.clone(),
        doc: p.doc.clone(),
        classes: p.classes.clone(),
        loaded: p.loaded,
        warnings: p.warnings.clone(),
        refused_reason: p.refused_reason.clone(),
        refused: p.refused.clone(),
    }
}

pub(super) fn item(i: &v1::SubscribeResponse) -> ItemView {
    ItemView {
        path: i.path.clone(),
        kind: word(i.kind().as_str_name(), "ITEM_KIND_").to_lowercase(),
        value: i.json.as_ref().map_or(Value::Null, from_wire),
        stamp_ns: i.stamp_ns,
        seq: i.seq,
        skipped: i.skipped,
    }
}

pub(super) fn row(path: &str, r: &v1::ReadResponse) -> RowView {
    RowView {
        path: path.to_owned(),
        value: r.json.as_ref().map_or(Value::Null, from_wire),
        stamp_ns: r.stamp_ns,
        age_ns: r.age_ns,
        tick: r.seq,
        frame_bytes: r.frame_bytes,
    }
}

pub(super) fn states(states: &[Awaited]) -> Vec<i32> {
    let wire = |state: &Awaited| match state {
        Awaited::Created => v1::ComponentState::Created,
        Awaited::Ready => v1::ComponentState::Ready,
        Awaited::Active => v1::ComponentState::Active,
        Awaited::Stopped => v1::ComponentState::Stopped,
        Awaited::Fault => v1::ComponentState::Fault,
    };
    states.iter().map(|s| wire(s).into()).collect()
}

pub(super) fn waited(path: &str, w: &v1::WaitForResponse) -> WaitView {
    let component = w.component.as_ref().map(component).unwrap_or_default();
    WaitView {
        path: path.to_owned(),
        state: component.state,
        health: component.health,
        value: w.json.as_ref().map(from_wire),
        stamp_ns: w.stamp_ns,
    }
}

pub(super) fn change(w: &v1::WatchResponse) -> ChangeView {
    use v1::watch_response::News;
    let mut view =
        ChangeView { revision: w.revision, term: w.term, cursor: w.cursor.clone(), ..ChangeView::default() };
    let (processes, components, connections) = match &w.news {
        Some(News::Snapshot(s)) => {
            view.snapshot = true;
            (&s.processes, &s.components, &s.connections)
        }
        Some(News::Delta(d)) => {
            view.removed_processes.clone_from(&d.removed_processes);
            view.removed_components.clone_from(&d.removed_components);
            view.removed_connections.clone_from(&d.removed_connections);
            (&d.processes, &d.components, &d.connections)
        }
        None => return view,
    };
    view.processes = processes.iter().map(process).collect();
    view.components = components.iter().map(component).collect();
    view.connections = connections.iter().map(connection).collect();
    view
}

pub(super) fn log_line(l: &v1::LogsResponse) -> LogView {
    let line = l.line.clone().unwrap_or_default();
    LogView {
        wall_ns: line.wall_ns,
        level: line.level,
        path: line.path,
        target: line.target,
        message: line.message,
        skipped: l.skipped,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stopped_component_says_why() {
        assert_eq!(state(v1::ComponentState::Stopped, v1::StopReason::PeerLost), "STOPPED{peer_lost}");
        assert_eq!(state(v1::ComponentState::Active, v1::StopReason::Unspecified), "ACTIVE");
    }
}
