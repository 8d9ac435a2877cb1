//! Wire messages → what the program shows, and JSON ↔ `google.protobuf.Value`.
//!
//! Invariant: only this file and `session.rs` of the command line know wire types; it decides nothing.

use prost_types::{ListValue, Struct, Value as Wire, value::Kind};
use serde_json::{Map, Number, Value};
use trocar_proto::v1;

use super::view::{
    ArgView, ChangeView, ClassView, ComponentView, ConnectionView, DescribeView, ExecutionView, FieldView,
    ItemView, LogView, MemberView, PluginView, PortsView, ProcessView, ProvidedView, RequiredView, StatsView,
    StreamView, SystemView, TypeView,
};

/// Largest whole number a double holds exactly.
const EXACT: f64 = 9_007_199_254_740_992.0;

pub(super) fn from_wire(value: &Wire) -> Value {
    match &value.kind {
        None | Some(Kind::NullValue(_)) => Value::Null,
        Some(Kind::BoolValue(b)) => Value::Bool(*b),
        Some(Kind::NumberValue(n)) if n.fract() == 0.0 && n.abs() < EXACT => Value::from(*n as i64),
        Some(Kind::NumberValue(n)) => {
            Number::from_f64(*n).map_or_else(|| Value::String(n.to_string()), Value::Number)
        }
        Some(Kind::StringValue(s)) => Value::String(s.clone()),
        Some(Kind::StructValue(s)) => from_struct(s),
        Some(Kind::ListValue(l)) => Value::Array(l.values.iter().map(from_wire).collect()),
    }
}

pub(super) fn from_struct(fields: &Struct) -> Value {
    Value::Object(fields.fields.iter().map(|(k, v)| (k.clone(), from_wire(v))).collect::<Map<_, _>>())
}

/// Whole numbers a double cannot hold travel as strings, as the API says.
pub(super) fn to_wire(value: &Value) -> Wire {
    let kind = match value {
        Value::Null => Kind::NullValue(0),
        Value::Bool(b) => Kind::BoolValue(*b),
        Value::Number(n) => match n.as_f64() {
            Some(f) if f.abs() < EXACT || n.is_f64() => Kind::NumberValue(f),
            _ => Kind::StringValue(n.to_string()),
        },
        Value::String(s) => Kind::StringValue(s.clone()),
        Value::Array(items) => Kind::ListValue(ListValue { values: items.iter().map(to_wire).collect() }),
        Value::Object(_) => Kind::StructValue(to_struct(value)),
    };
    Wire { kind: Some(kind) }
}

/// The fields of an object; anything else has none.
pub(super) fn to_struct(value: &Value) -> Struct {
    let fields = value.as_object().into_iter().flatten().map(|(k, v)| (k.clone(), to_wire(v)));
    Struct { fields: fields.collect() }
}

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
    }
}

pub(super) fn process(p: &v1::Process) -> ProcessView {
    ProcessView {
        name: p.name.clone(),
        state: word(p.state().as_str_name(), "PROCESS_STATE_"),
        epoch: p.epoch,
        endpoint: p.endpoint.clone(),
        pid: p.pid,
        classes: p.classes.clone(),
    }
}

pub(super) fn component(c: &v1::Component) -> ComponentView {
    let stats = c.stats.as_ref();
    let mut execution = c.execution.as_ref().map(execution).unwrap_or_default();
    execution.thread = stats.map(|s| s.thread.clone()).unwrap_or_default();
    ComponentView {
        path: c.path.clone(),
        class: c.class.clone(),
        state: state(c.state(), c.stop_reason()),
        health: health(c.health()),
        fault: c.fault.clone(),
        config: c.config.as_ref().map_or(Value::Null, from_struct),
        execution,
        stats: stats.map(self::stats).unwrap_or_default(),
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
        commands: s.commands,
        commands_rejected: s.commands_rejected,
        events_dropped: s.events_dropped,
    }
}

fn execution(e: &v1::Execution) -> ExecutionView {
    let period_ns = match (ns(e.period.as_ref()), e.rate_hz) {
        (0, hz) if hz > 0.0 => (1e9 / hz).round() as u64,
        (period, _) => period,
    };
    ExecutionView {
        model: e.model.clone(),
        period_ns,
        phase_ns: ns(e.phase.as_ref()),
        stream_of: e.stream_of.clone(),
        inside: e.inside.clone(),
        priority: e.priority.unwrap_or(0),
        cpus: e.cpus.clone(),
        thread: String::new(),
    }
}

pub(super) fn connection(c: &v1::Connection) -> ConnectionView {
    ConnectionView {
        id: c.id,
        client: c.client.clone(),
        server: c.server.clone(),
        carrier: c.carrier.clone(),
        passed: c.passed,
        dropped: c.dropped,
        bytes: c.bytes,
        latency_p50_ns: c.latency_p50_ns,
        latency_p99_ns: c.latency_p99_ns,
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

pub(super) fn change(w: &v1::WatchResponse) -> ChangeView {
    use v1::watch_response::News;
    let mut view = ChangeView { revision: w.revision, ..ChangeView::default() };
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

pub(super) fn description(path: &str, d: &v1::DescribeResponse) -> DescribeView {
    DescribeView {
        path: path.to_owned(),
        process: d.process.as_ref().map(process),
        component: d.component.as_ref().map(component),
        class: d.class.as_ref().map(class),
        ports: d.ports.as_ref().map(ports),
        connections: d.connections.iter().map(connection).collect(),
        classes: d.classes.iter().map(class).collect(),
    }
}

pub(super) fn class(c: &v1::ClassInfo) -> ClassView {
    ClassView {
        name: format!("{}/{}", c.plugin, c.name),
        version: c.version.clone(),
        hash: c.hash.clone(),
        doc: c.doc.clone(),
        safety: word(c.safety().as_str_name(), "SAFETY_").to_lowercase(),
        hardware: c.hardware,
        execution: c.execution.as_ref().map(execution).unwrap_or_default(),
        config_schema: c.config_schema.as_ref().map_or(Value::Null, from_struct),
        ports: c.ports.as_ref().map(ports).unwrap_or_default(),
    }
}

fn ports(p: &v1::Ports) -> PortsView {
    let input = |i: &v1::Input| StreamView {
        optional: i.optional,
        fifo: i.fifo,
        ..stream(&i.name, &i.doc, i.r#type.as_ref())
    };
    let output = |o: &v1::Output| stream(&o.name, &o.doc, o.r#type.as_ref());
    PortsView {
        inputs: p.inputs.iter().map(input).collect(),
        outputs: p.outputs.iter().map(output).collect(),
        required: p.required.iter().map(required).collect(),
        provided: p.provided.iter().map(provided).collect(),
        state: p.state.as_ref().map(type_view),
    }
}

fn stream(name: &str, doc: &str, ty: Option<&v1::PortType>) -> StreamView {
    use v1::port_type::Kind;
    let (ty, format) = match ty.and_then(|t| t.kind.as_ref()) {
        Some(Kind::Plain(t)) => (type_view(t), String::new()),
        Some(Kind::Frame(f)) => (f.header.as_ref().map(type_view).unwrap_or_default(), f.format.clone()),
        _ => (TypeView { name: "any".to_owned(), ..TypeView::default() }, String::new()),
    };
    StreamView { name: name.to_owned(), doc: doc.to_owned(), ty, format, optional: false, fifo: 0 }
}

fn provided(p: &v1::ProvidedInterface) -> ProvidedView {
    let event = |e: &v1::Event| MemberView {
        name: e.name.clone(),
        kind: "event".to_owned(),
        doc: e.doc.clone(),
        arg: e.payload.as_ref().map(|t| bare(t, &e.unit)),
        ..MemberView::default()
    };
    ProvidedView {
        name: p.name.clone(),
        doc: p.doc.clone(),
        tag: p.tag.clone(),
        commands: p.commands.iter().map(command).collect(),
        events: p.events.iter().map(event).collect(),
    }
}

fn command(c: &v1::Command) -> MemberView {
    let kind = match c.kind() {
        v1::CommandKind::VoidReturn => "void-return".to_owned(),
        v1::CommandKind::WriteReturn => "write-return".to_owned(),
        other => word(other.as_str_name(), "COMMAND_KIND_").to_lowercase().replace('_', " "),
    };
    let arg = c.arg.as_ref().map(|a| ArgView {
        name: a.name.clone(),
        doc: a.doc.clone(),
        ty: a.r#type.as_ref().map(type_view).unwrap_or_default(),
        unit: a.unit.clone(),
        min: a.min,
        max: a.max,
    });
    let returns = c.ret.as_ref().map(|t| bare(t, &c.ret_unit));
    MemberView { name: c.name.clone(), kind, doc: c.doc.clone(), arg, returns, optional: false }
}

fn required(r: &v1::RequiredInterface) -> RequiredView {
    let function = |f: &v1::Function| MemberView {
        name: f.name.clone(),
        kind: "function".to_owned(),
        doc: f.doc.clone(),
        arg: f.arg.as_ref().map(|t| bare(t, &f.unit)),
        returns: f.ret.as_ref().map(|t| bare(t, "")),
        optional: f.optional,
    };
    let handler = |h: &v1::Handler| MemberView {
        name: h.name.clone(),
        kind: "handler".to_owned(),
        doc: h.doc.clone(),
        arg: h.payload.as_ref().map(|t| bare(t, "")),
        returns: None,
        optional: h.optional,
    };
    RequiredView {
        name: r.name.clone(),
        doc: r.doc.clone(),
        optional: r.optional,
        functions: r.functions.iter().map(function).collect(),
        handlers: r.handlers.iter().map(handler).collect(),
    }
}

fn bare(ty: &v1::TypeInfo, unit: &str) -> ArgView {
    ArgView { ty: type_view(ty), unit: unit.to_owned(), ..ArgView::default() }
}

fn type_view(t: &v1::TypeInfo) -> TypeView {
    use v1::type_info::Shape;
    let mut view =
        TypeView { name: t.name.clone(), hash: t.hash.clone(), bytes: t.size, ..TypeView::default() };
    match &t.shape {
        Some(Shape::Structure(s)) => {
            view.doc.clone_from(&s.doc);
            view.fields = s.fields.iter().map(field).collect();
        }
        Some(Shape::Enumeration(e)) => view.values = e.values.iter().map(|v| v.name.clone()).collect(),
        _ => {}
    }
    view
}

fn field(f: &v1::FieldInfo) -> FieldView {
    FieldView {
        name: f.name.clone(),
        ty: f.r#type.as_ref().map(|t| t.name.clone()).unwrap_or_default(),
        unit: f.unit.clone(),
        doc: f.doc.clone(),
        frame: f.frame.clone(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn json_survives_the_wire() {
        let value = json!({"a": [1, 2.5, -3], "b": {"c": null, "d": true}, "e": "text"});
        assert_eq!(from_wire(&to_wire(&value)), value);
    }

    #[test]
    fn whole_numbers_a_double_cannot_hold_go_as_text() {
        assert_eq!(from_wire(&to_wire(&json!(9_007_199_254_740_993_u64))), json!("9007199254740993"));
    }

    #[test]
    fn a_stopped_component_says_why() {
        assert_eq!(state(v1::ComponentState::Stopped, v1::StopReason::PeerLost), "STOPPED{peer_lost}");
        assert_eq!(state(v1::ComponentState::Active, v1::StopReason::Unspecified), "ACTIVE");
    }
}
