//! Types, ports, classes and states: wire → model, for another process's report about itself.
//!
//! Invariant: undoes `types.rs`; a description that cannot be read is refused as a whole, never guessed.

use std::sync::Arc;

use trocar_model as model;
use trocar_model::Refusal;
use trocar_proto::v1;

use super::json::from_struct;
use super::requests::execution;

/// Deepest nesting of a type that is read.
const DEPTH: usize = 32;

/// Returns the refusal for a message of the peer that cannot be read.
pub(crate) fn unreadable(what: &str) -> Refusal {
    Refusal::ArgumentInvalid {
        what: "what the other process said".into(),
        why: format!("{what} is missing or of an unknown kind: run the same version of trocar on both sides"),
        field: what.into(),
    }
}

fn need<T>(value: Option<T>, what: &str) -> Result<T, Refusal> {
    value.ok_or_else(|| unreadable(what))
}

fn ty(t: v1::TypeInfo, depth: usize) -> Result<model::Type, Refusal> {
    use v1::type_info::Shape;
    if depth == 0 {
        return Err(unreadable("a type nested less than 32 deep"));
    }
    let item = |a: v1::ArrayType| -> Result<(Box<model::Type>, usize), Refusal> {
        Ok((Box::new(ty(*need(a.item, "item")?, depth - 1)?), a.n as usize))
    };
    Ok(match need(t.shape, "shape")? {
        Shape::Primitive(p) => model::Type::Prim(prim(p)?),
        Shape::Array(a) => item(*a).map(|(item, n)| model::Type::Array { item, n })?,
        Shape::List(a) => item(*a).map(|(item, n)| model::Type::List { item, n })?,
        Shape::Text(n) => model::Type::Text { n: n as usize },
        Shape::Enumeration(e) => model::Type::Enum(Arc::new(model::EnumType {
            name: e.name,
            repr: prim(e.repr)?,
            values: e.values.into_iter().map(|v| (v.name, v.number)).collect(),
        })),
        Shape::Structure(s) => {
            let field = |f: v1::FieldInfo| {
                Ok(model::Field {
                    name: f.name,
                    at: f.offset as usize,
                    ty: ty(need(f.r#type, "type")?, depth - 1)?,
                    unit: f.unit,
                    doc: f.doc,
                    frame: f.frame,
                })
            };
            model::Type::Struct(Arc::new(model::StructType {
                name: s.name,
                doc: s.doc,
                size: s.size as usize,
                align: s.align as usize,
                fields: s.fields.into_iter().map(field).collect::<Result<_, Refusal>>()?,
            }))
        }
    })
}

fn whole(t: v1::TypeInfo) -> Result<model::Type, Refusal> {
    ty(t, DEPTH)
}

fn maybe(t: Option<v1::TypeInfo>) -> Result<Option<model::Type>, Refusal> {
    t.map(whole).transpose()
}

fn prim(p: i32) -> Result<model::Prim, Refusal> {
    use model::Prim as P;
    Ok(match v1::Primitive::try_from(p).unwrap_or_default() {
        v1::Primitive::Unspecified => return Err(unreadable("primitive")),
        v1::Primitive::Bool => P::Bool,
        v1::Primitive::U8 => P::U8,
        v1::Primitive::I8 => P::I8,
        v1::Primitive::U16 => P::U16,
        v1::Primitive::I16 => P::I16,
        v1::Primitive::U32 => P::U32,
        v1::Primitive::I32 => P::I32,
        v1::Primitive::U64 => P::U64,
        v1::Primitive::I64 => P::I64,
        v1::Primitive::F32 => P::F32,
        v1::Primitive::F64 => P::F64,
        v1::Primitive::Stamp => P::Stamp,
    })
}

fn port_type(t: Option<v1::PortType>) -> Result<model::PortType, Refusal> {
    use v1::port_type::Kind;
    Ok(match need(t.and_then(|t| t.kind), "kind")? {
        Kind::Plain(t) => model::PortType::Plain(whole(t)?),
        Kind::Frame(f) => model::PortType::Frame {
            header: whole(need(f.header, "header")?)?,
            format: f.format,
            max_bytes: usize::try_from(f.max_bytes).map_err(|_| unreadable("max_bytes"))?,
        },
        Kind::Any(_) => model::PortType::Any,
    })
}

pub(crate) fn ports(p: v1::Ports) -> Result<model::Ports, Refusal> {
    let input = |i: v1::Input| {
        Ok(model::Input {
            name: i.name,
            doc: i.doc,
            ty: port_type(i.r#type)?,
            tag: tag(&i.tag)?,
            optional: i.optional,
            fifo: i.fifo as usize,
        })
    };
    let output = |o: v1::Output| {
        Ok(model::Output { name: o.name, doc: o.doc, ty: port_type(o.r#type)?, tag: tag(&o.tag)? })
    };
    Ok(model::Ports {
        inputs: all(p.inputs, input)?,
        outputs: all(p.outputs, output)?,
        required: all(p.required, required)?,
        provided: all(p.provided, provided)?,
        state: maybe(p.state)?,
    })
}

fn tag(text: &str) -> Result<model::Tag, Refusal> {
    model::Tag::parse(text).ok_or_else(|| unreadable("tag"))
}

fn all<W, M>(wire: Vec<W>, one: impl Fn(W) -> Result<M, Refusal>) -> Result<Vec<M>, Refusal> {
    wire.into_iter().map(one).collect()
}

fn required(r: v1::RequiredInterface) -> Result<model::Required, Refusal> {
    let function = |f: v1::Function| {
        Ok(model::Function {
            name: f.name,
            doc: f.doc,
            arg: maybe(f.arg)?,
            ret: maybe(f.ret)?,
            unit: f.unit,
            optional: f.optional,
            any: f.any,
        })
    };
    let handler = |h: v1::Handler| {
        Ok(model::Handler {
            name: h.name,
            doc: h.doc,
            payload: maybe(h.payload)?,
            optional: h.optional,
            direct: h.direct,
        })
    };
    Ok(model::Required {
        name: r.name,
        doc: r.doc,
        optional: r.optional,
        functions: all(r.functions, function)?,
        handlers: all(r.handlers, handler)?,
    })
}

fn provided(p: v1::ProvidedInterface) -> Result<model::Provided, Refusal> {
    let event = |e: v1::Event| {
        Ok(model::Event { name: e.name, doc: e.doc, payload: maybe(e.payload)?, unit: e.unit })
    };
    Ok(model::Provided {
        name: p.name,
        doc: p.doc,
        tag: tag(&p.tag)?,
        commands: all(p.commands, command)?,
        events: all(p.events, event)?,
    })
}

fn command(c: v1::Command) -> Result<model::Command, Refusal> {
    use model::CommandKind as K;
    let kind = match c.kind() {
        v1::CommandKind::Unspecified => return Err(unreadable("kind")),
        v1::CommandKind::Void => K::Void,
        v1::CommandKind::Write => K::Write,
        v1::CommandKind::Read => K::Read,
        v1::CommandKind::QualifiedRead => K::QualifiedRead,
        v1::CommandKind::VoidReturn => K::VoidReturn,
        v1::CommandKind::WriteReturn => K::WriteReturn,
    };
    let overflow = match c.overflow() {
        v1::Overflow::Unspecified => return Err(unreadable("overflow")),
        v1::Overflow::Reject => model::Overflow::Reject,
        v1::Overflow::LatestWins => model::Overflow::LatestWins,
        v1::Overflow::DropOldest => model::Overflow::DropOldest,
    };
    let arg = |a: v1::Argument| {
        Ok::<_, Refusal>(model::Arg {
            name: a.name,
            doc: a.doc,
            ty: whole(need(a.r#type, "type")?)?,
            unit: a.unit,
            min: a.min,
            max: a.max,
        })
    };
    Ok(model::Command {
        name: c.name,
        doc: c.doc,
        kind,
        arg: c.arg.map(arg).transpose()?,
        ret: maybe(c.ret)?,
        ret_unit: c.ret_unit,
        overflow,
    })
}

pub(crate) fn class(c: v1::ClassInfo) -> Result<model::ClassInfo, Refusal> {
    let safety = match c.safety() {
        v1::Safety::Unspecified => return Err(unreadable("safety")),
        v1::Safety::None => model::Safety::None,
        v1::Safety::Sensor => model::Safety::Sensor,
        v1::Safety::Actuator => model::Safety::Actuator,
    };
    let programs = match c.programs() {
        v1::Programs::Unspecified => model::Programs::None,
        v1::Programs::Allowed => model::Programs::Allowed,
        v1::Programs::Refused => model::Programs::Refused,
    };
    Ok(model::ClassInfo {
        plugin: c.plugin,
        version: c.version,
        hash: c.hash,
        name: c.name,
        doc: c.doc,
        safety,
        hardware: c.hardware,
        safe_from_any_thread: c.safe_from_any_thread,
        programs,
        execution: execution(need(c.execution, "execution")?)?,
        config_schema: from_struct(c.config_schema.unwrap_or_default()),
        ports: ports(need(c.ports, "ports")?)?,
        limits: limits(c.execution_limits.unwrap_or_default())?,
    })
}

fn limits(l: v1::ExecutionLimits) -> Result<model::ExecutionLimits, Refusal> {
    let model = |text: &String| {
        let found = model::ExecutionModel::ALL.into_iter().find(|m| m.name() == text);
        found.ok_or_else(|| unreadable("execution_limits.models"))
    };
    let period = |d: &Option<prost_types::Duration>, field: &str| {
        d.as_ref().map(|d| super::requests::ns(d, field)).transpose()
    };
    Ok(model::ExecutionLimits {
        models: l.models.iter().map(model).collect::<Result<_, _>>()?,
        min_period_ns: period(&l.min_period, "execution_limits.min_period")?,
        max_period_ns: period(&l.max_period, "execution_limits.max_period")?,
    })
}

pub(crate) fn state(state: i32, reason: i32) -> Result<model::State, Refusal> {
    use model::{State as S, StopReason as R};
    Ok(match v1::ComponentState::try_from(state).unwrap_or_default() {
        v1::ComponentState::Unspecified => return Err(unreadable("state")),
        v1::ComponentState::Created => S::Created,
        v1::ComponentState::Ready => S::Ready,
        v1::ComponentState::Active => S::Active,
        v1::ComponentState::Fault => S::Fault,
        v1::ComponentState::Stopped => {
            S::Stopped(match v1::StopReason::try_from(reason).unwrap_or_default() {
                v1::StopReason::Unspecified => return Err(unreadable("stop_reason")),
                v1::StopReason::Requested => R::Requested,
                v1::StopReason::Restarted => R::Restarted,
                v1::StopReason::Interlock => R::Interlock,
                v1::StopReason::PeerLost => R::PeerLost,
            })
        }
    })
}

pub(crate) fn health(h: i32) -> Result<model::Health, Refusal> {
    Ok(match v1::Health::try_from(h).unwrap_or_default() {
        v1::Health::Unspecified => return Err(unreadable("health")),
        v1::Health::Ok => model::Health::Ok,
        v1::Health::Overrun => model::Health::Overrun,
        v1::Health::StaleInput => model::Health::StaleInput,
        v1::Health::Unresponsive => model::Health::Unresponsive,
        v1::Health::Lost => model::Health::Lost,
    })
}
