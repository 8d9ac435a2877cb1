//! Types, ports, classes and states: model → wire.

use trocar_model as model;
use trocar_proto::v1;

use super::json::{duration, to_struct};

pub(crate) fn ty(t: &model::Type) -> v1::TypeInfo {
    use v1::type_info::Shape;
    let shape = match t {
        model::Type::Prim(p) => Shape::Primitive(prim(*p) as i32),
        model::Type::Array { item, n } => Shape::Array(Box::new(array(item, *n))),
        model::Type::List { item, n } => Shape::List(Box::new(array(item, *n))),
        model::Type::Text { n } => Shape::Text(*n as u32),
        model::Type::Enum(e) => Shape::Enumeration(v1::EnumType {
            name: e.name.clone(),
            repr: prim(e.repr) as i32,
            values: e
                .values
                .iter()
                .map(|(name, number)| v1::EnumValue { name: name.clone(), number: *number })
                .collect(),
        }),
        model::Type::Struct(s) => Shape::Structure(v1::StructType {
            name: s.name.clone(),
            doc: s.doc.clone(),
            size: s.size as u32,
            align: s.align as u32,
            fields: s
                .fields
                .iter()
                .map(|f| v1::FieldInfo {
                    name: f.name.clone(),
                    offset: f.at as u32,
                    r#type: Some(ty(&f.ty)),
                    unit: f.unit.clone(),
                    doc: f.doc.clone(),
                    frame: f.frame.clone(),
                })
                .collect(),
        }),
    };
    v1::TypeInfo {
        name: t.title(),
        hash: format!("{:016x}", t.hash()),
        size: t.size() as u32,
        shape: Some(shape),
    }
}

fn array(item: &model::Type, n: usize) -> v1::ArrayType {
    v1::ArrayType { item: Some(Box::new(ty(item))), n: n as u32 }
}

fn prim(p: model::Prim) -> v1::Primitive {
    use model::Prim as P;
    match p {
        P::Bool => v1::Primitive::Bool,
        P::U8 => v1::Primitive::U8,
        P::I8 => v1::Primitive::I8,
        P::U16 => v1::Primitive::U16,
        P::I16 => v1::Primitive::I16,
        P::U32 => v1::Primitive::U32,
        P::I32 => v1::Primitive::I32,
        P::U64 => v1::Primitive::U64,
        P::I64 => v1::Primitive::I64,
        P::F32 => v1::Primitive::F32,
        P::F64 => v1::Primitive::F64,
        P::Stamp => v1::Primitive::Stamp,
    }
}

fn port_type(t: &model::PortType) -> v1::PortType {
    use v1::port_type::Kind;
    let kind = match t {
        model::PortType::Plain(t) => Kind::Plain(ty(t)),
        model::PortType::Frame { header, format, max_bytes } => Kind::Frame(v1::FrameType {
            header: Some(ty(header)),
            format: format.clone(),
            max_bytes: *max_bytes as u64,
        }),
        model::PortType::Any => Kind::Any(true),
    };
    v1::PortType { kind: Some(kind) }
}

pub(crate) fn ports(p: &model::Ports) -> v1::Ports {
    v1::Ports {
        inputs: p
            .inputs
            .iter()
            .map(|i| v1::Input {
                name: i.name.clone(),
                doc: i.doc.clone(),
                r#type: Some(port_type(&i.ty)),
                optional: i.optional,
                fifo: i.fifo as u32,
                tag: i.tag.name().to_owned(),
            })
            .collect(),
        outputs: p
            .outputs
            .iter()
            .map(|o| v1::Output {
                name: o.name.clone(),
                doc: o.doc.clone(),
                r#type: Some(port_type(&o.ty)),
                tag: o.tag.name().to_owned(),
                tap: o.is_tap(),
            })
            .collect(),
        required: p.required.iter().map(required).collect(),
        provided: p.provided.iter().map(provided).collect(),
        state: p.state.as_ref().map(ty),
    }
}

fn required(r: &model::Required) -> v1::RequiredInterface {
    v1::RequiredInterface {
        name: r.name.clone(),
        doc: r.doc.clone(),
        optional: r.optional,
        functions: r
            .functions
            .iter()
            .map(|f| v1::Function {
                name: f.name.clone(),
                doc: f.doc.clone(),
                arg: f.arg.as_ref().map(ty),
                ret: f.ret.as_ref().map(ty),
                unit: f.unit.clone(),
                optional: f.optional,
                any: f.any,
            })
            .collect(),
        handlers: r
            .handlers
            .iter()
            .map(|h| v1::Handler {
                name: h.name.clone(),
                doc: h.doc.clone(),
                payload: h.payload.as_ref().map(ty),
                optional: h.optional,
                direct: h.direct,
            })
            .collect(),
    }
}

pub(crate) fn provided(p: &model::Provided) -> v1::ProvidedInterface {
    v1::ProvidedInterface {
        name: p.name.clone(),
        doc: p.doc.clone(),
        tag: p.tag.name().to_owned(),
        commands: p.commands.iter().map(command).collect(),
        events: p
            .events
            .iter()
            .map(|e| v1::Event {
                name: e.name.clone(),
                doc: e.doc.clone(),
                payload: e.payload.as_ref().map(ty),
                unit: e.unit.clone(),
            })
            .collect(),
    }
}

fn command(c: &model::Command) -> v1::Command {
    use model::CommandKind as K;
    let kind = match c.kind {
        K::Void => v1::CommandKind::Void,
        K::Write => v1::CommandKind::Write,
        K::Read => v1::CommandKind::Read,
        K::QualifiedRead => v1::CommandKind::QualifiedRead,
        K::VoidReturn => v1::CommandKind::VoidReturn,
        K::WriteReturn => v1::CommandKind::WriteReturn,
    };
    let overflow = match c.overflow {
        model::Overflow::Reject => v1::Overflow::Reject,
        model::Overflow::LatestWins => v1::Overflow::LatestWins,
        model::Overflow::DropOldest => v1::Overflow::DropOldest,
    };
    v1::Command {
        name: c.name.clone(),
        doc: c.doc.clone(),
        kind: kind as i32,
        arg: c.arg.as_ref().map(|a| v1::Argument {
            name: a.name.clone(),
            doc: a.doc.clone(),
            r#type: Some(ty(&a.ty)),
            unit: a.unit.clone(),
            min: a.min,
            max: a.max,
        }),
        ret: c.ret.as_ref().map(ty),
        ret_unit: c.ret_unit.clone(),
        overflow: overflow as i32,
    }
}

pub(crate) fn class(c: &model::ClassInfo) -> v1::ClassInfo {
    v1::ClassInfo {
        plugin: c.plugin.clone(),
        version: c.version.clone(),
        hash: c.hash.clone(),
        name: c.name.clone(),
        doc: c.doc.clone(),
        safety: safety(c.safety) as i32,
        hardware: c.hardware,
        safe_from_any_thread: c.safe_from_any_thread,
        programs: match c.programs {
            model::Programs::None => v1::Programs::Unspecified,
            model::Programs::Allowed => v1::Programs::Allowed,
            model::Programs::Refused => v1::Programs::Refused,
        } as i32,
        execution: Some(execution_out(&c.execution)),
        config_schema: Some(to_struct(&c.config_schema)),
        ports: Some(ports(&c.ports)),
        execution_limits: Some(v1::ExecutionLimits {
            models: c.limits.models.iter().map(|m| m.name().to_owned()).collect(),
            min_period: c.limits.min_period_ns.map(duration),
            max_period: c.limits.max_period_ns.map(duration),
        }),
    }
}

pub(crate) fn safety(s: model::Safety) -> v1::Safety {
    match s {
        model::Safety::None => v1::Safety::None,
        model::Safety::Sensor => v1::Safety::Sensor,
        model::Safety::Actuator => v1::Safety::Actuator,
    }
}

pub(crate) fn execution_out(e: &model::Execution) -> v1::Execution {
    v1::Execution {
        model: e.model.map_or("", model::ExecutionModel::name).into(),
        rate_hz: e.period_ns.map(|ns| 1e9 / ns as f64),
        period: e.period_ns.map(duration),
        phase: e.phase_ns.map(duration),
        stream_of: e.stream_of.clone().unwrap_or_default(),
        inside: e.inside.clone().unwrap_or_default(),
        priority: e.priority.map(u32::from),
        cpus: e.cpus.iter().map(|c| *c as u32).collect(),
        catch_up: e.catch_up,
        threads: e.threads,
        max_step: e.max_step_ns.map(duration),
        history: e.history,
        on_failure: e.on_failure.map_or("", model::OnFailure::name).into(),
        wake: e.wake.map_or("", model::Wake::name).into(),
    }
}

pub(crate) fn state(s: model::State) -> (v1::ComponentState, v1::StopReason) {
    use model::{State as S, StopReason as R};
    match s {
        S::Created => (v1::ComponentState::Created, v1::StopReason::Unspecified),
        S::Ready => (v1::ComponentState::Ready, v1::StopReason::Unspecified),
        S::Active => (v1::ComponentState::Active, v1::StopReason::Unspecified),
        S::Fault => (v1::ComponentState::Fault, v1::StopReason::Unspecified),
        S::Stopped(R::Requested) => (v1::ComponentState::Stopped, v1::StopReason::Requested),
        S::Stopped(R::Restarted) => (v1::ComponentState::Stopped, v1::StopReason::Restarted),
        S::Stopped(R::Interlock) => (v1::ComponentState::Stopped, v1::StopReason::Interlock),
        S::Stopped(R::PeerLost) => (v1::ComponentState::Stopped, v1::StopReason::PeerLost),
    }
}

pub(crate) fn health(h: model::Health) -> v1::Health {
    match h {
        model::Health::Ok => v1::Health::Ok,
        model::Health::Overrun => v1::Health::Overrun,
        model::Health::StaleInput => v1::Health::StaleInput,
        model::Health::Unresponsive => v1::Health::Unresponsive,
        model::Health::Lost => v1::Health::Lost,
    }
}

pub(crate) fn options_out(o: &model::ConnectOptions) -> v1::ConnectOptions {
    v1::ConnectOptions {
        queue: o.queue.map(|q| match q {
            model::Queue::Latest => v1::Queue { fifo: 0, drop_oldest: false },
            model::Queue::Fifo { depth, drop_oldest } => v1::Queue { fifo: depth as u32, drop_oldest },
        }),
        max_age: o.max_age_ns.map(duration),
        deadline: o.deadline_ns.map(duration),
        mailbox: o.mailbox.map(|n| n as u32),
        adapt: o.adapt,
        delay: o.delay,
        replace: o.replace,
        carrier: o.carrier.clone(),
    }
}
