//! Answers of Describe: ports, members, types and classes, wire → shown.
//!
//! Invariant: as the rest of `convert`, it decides nothing and leaves out nothing that a person asks for.

use serde_json::Value;
use trocar_proto::v1;

use super::json::from_struct;
use super::{component, connection, execution, ns, process, word};
use crate::view::{
    ArgView, ClassView, DescribeView, ExecutionLimitsView, FieldView, MemberView, PortsView, ProvidedView,
    RequiredView, StreamView, TypeView,
};

pub(crate) fn description(path: &str, d: &v1::DescribeResponse) -> DescribeView {
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

fn class(c: &v1::ClassInfo) -> ClassView {
    ClassView {
        name: format!("{}/{}", c.plugin, c.name),
        version: c.version.clone(),
        hash: c.hash.clone(),
        doc: c.doc.clone(),
        safety: word(c.safety().as_str_name(), "SAFETY_").to_lowercase(),
        hardware: c.hardware,
        programs: match c.programs() {
            v1::Programs::Unspecified => "none",
            v1::Programs::Allowed => "allowed",
            v1::Programs::Refused => "refused",
        }
        .to_owned(),
        execution: c.execution.as_ref().map(execution).unwrap_or_default(),
        execution_limits: c.execution_limits.as_ref().map(execution_limits).unwrap_or_default(),
        config_schema: c.config_schema.as_ref().map_or(Value::Null, from_struct),
        ports: c.ports.as_ref().map(ports).unwrap_or_default(),
    }
}

fn execution_limits(l: &v1::ExecutionLimits) -> ExecutionLimitsView {
    let hz = |period: &Option<prost_types::Duration>| period.as_ref().map(|d| 1e9 / ns(Some(d)) as f64);
    ExecutionLimitsView {
        models: l.models.clone(),
        min_rate_hz: hz(&l.max_period),
        max_rate_hz: hz(&l.min_period),
    }
}

fn ports(p: &v1::Ports) -> PortsView {
    let input = |i: &v1::Input| StreamView {
        tag: i.tag.clone(),
        optional: i.optional,
        fifo: i.fifo,
        ..stream(&i.name, &i.doc, i.r#type.as_ref())
    };
    let output = |o: &v1::Output| StreamView {
        tag: o.tag.clone(),
        tap: o.tap,
        ..stream(&o.name, &o.doc, o.r#type.as_ref())
    };
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
    StreamView { name: name.to_owned(), doc: doc.to_owned(), ty, format, ..StreamView::default() }
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
    MemberView { name: c.name.clone(), kind, doc: c.doc.clone(), arg, returns, ..MemberView::default() }
}

fn required(r: &v1::RequiredInterface) -> RequiredView {
    let function = |f: &v1::Function| MemberView {
        name: f.name.clone(),
        kind: "function".to_owned(),
        doc: f.doc.clone(),
        arg: f.arg.as_ref().map(|t| bare(t, &f.unit)),
        returns: f.ret.as_ref().map(|t| bare(t, "")),
        optional: f.optional,
        direct: false,
    };
    let handler = |h: &v1::Handler| MemberView {
        name: h.name.clone(),
        kind: "handler".to_owned(),
        doc: h.doc.clone(),
        arg: h.payload.as_ref().map(|t| bare(t, "")),
        returns: None,
        optional: h.optional,
        direct: h.direct,
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
    let doc = match &t.shape {
        Some(Shape::Structure(s)) => s.doc.clone(),
        _ => String::new(),
    };
    let (fields, values) = inside(t);
    TypeView { name: t.name.clone(), hash: t.hash.clone(), bytes: t.size, doc, fields, values }
}

/// Fields of a struct or names of an enumeration; of a list or an array those of its items.
fn inside(t: &v1::TypeInfo) -> (Vec<FieldView>, Vec<String>) {
    use v1::type_info::Shape;
    match &t.shape {
        Some(Shape::Structure(s)) => (s.fields.iter().map(field).collect(), Vec::new()),
        Some(Shape::Enumeration(e)) => (Vec::new(), e.values.iter().map(|v| v.name.clone()).collect()),
        Some(Shape::Array(a) | Shape::List(a)) => a.item.as_deref().map(inside).unwrap_or_default(),
        _ => Default::default(),
    }
}

fn field(f: &v1::FieldInfo) -> FieldView {
    let (fields, values) = f.r#type.as_ref().map(inside).unwrap_or_default();
    FieldView {
        name: f.name.clone(),
        ty: f.r#type.as_ref().map(|t| t.name.clone()).unwrap_or_default(),
        unit: f.unit.clone(),
        doc: f.doc.clone(),
        frame: f.frame.clone(),
        fields,
        values,
    }
}
