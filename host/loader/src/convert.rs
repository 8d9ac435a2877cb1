//! Manifest → model: the class descriptions of a plugin in the graph's own types.
//!
//! Invariant: order is kept (ids are positions), offsets and sizes are checked here so that no later code has
//! to distrust a description; the system interface and the taps are appended to every class, last, so they
//! move no id.

pub mod back;
mod frames;
#[cfg(test)]
mod units;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use trocar_model as model;
use trocar_plugin_api::manifest as wire;

use crate::{system, taps};

/// Largest payload that may pass through a mailbox or a state table, bytes.
pub const MAX_PAYLOAD: usize = 64 * 1024;

/// Longest text a `describe` may write, bytes.
pub const MAX_DESCRIPTION: usize = 1024 * 1024;
/// Most inputs, outputs, functions, commands, handlers and events of one class together.
const MAX_MEMBERS: usize = 10_000;
/// Longest queue an input may ask for, samples.
const MAX_FIFO: usize = 65_536;
/// Deepest nesting of structs.
const MAX_DEPTH: usize = 64;
/// Largest frame of an output, bytes.
const MAX_FRAME: usize = 1 << 30;

/// All classes of a manifest.
///
/// # Errors
/// A sentence naming the first description that contradicts itself.
pub fn classes(manifest: &wire::Manifest, hash: &str) -> Result<Vec<Arc<model::ClassInfo>>, String> {
    let mut types = Types::new(&manifest.types);
    manifest
        .classes
        .iter()
        .map(|class| {
            class_info(manifest, hash, class, &mut types)
                .and_then(|info| info.check_units().map(|()| Arc::new(info)))
                .map_err(|e| format!("class {}: {e}", class.name))
        })
        .collect()
}

/// The ports `describe` wrote for an instance of `class`.
///
/// # Errors
/// A sentence that says where the text contradicts itself, or what a description may not change.
pub fn description(text: &[u8], class: &model::ClassInfo) -> Result<model::Ports, String> {
    if text.len() > MAX_DESCRIPTION {
        return Err(format!("{} bytes are more than a description may have, {MAX_DESCRIPTION}", text.len()));
    }
    let wire::Description { types, class: described } =
        serde_json::from_slice(text).map_err(|e| format!("it is not a class description: {e}"))?;
    if described.name != class.name {
        return Err(format!("it describes class {}, this is {}", described.name, class.name));
    }
    let ports = ports(&described, &mut Types::new(&types))?;
    ports.check_units()?;
    let same_state = match (&ports.state, &class.ports.state) {
        (Some(a), Some(b)) => a.same(b),
        (None, None) => true,
        _ => false,
    };
    if !same_state {
        return Err("the state type is another than the class's: state may not change".into());
    }
    Ok(ports)
}

fn class_info(
    manifest: &wire::Manifest,
    hash: &str,
    class: &wire::Class,
    types: &mut Types,
) -> Result<model::ClassInfo, String> {
    name(&class.name)?;
    let execution = model::Execution {
        model: Some(execution_model(&class.execution.model)?),
        period_ns: (class.execution.period_ns > 0).then_some(class.execution.period_ns),
        max_step_ns: (class.execution.max_step_ns > 0).then_some(class.execution.max_step_ns),
        ..Default::default()
    };
    let info = model::ClassInfo {
        plugin: manifest.name.clone(),
        version: manifest.version.clone(),
        hash: hash.to_owned(),
        name: class.name.clone(),
        doc: class.doc.clone(),
        safety: match class.safety.as_str() {
            "actuator" => model::Safety::Actuator,
            "sensor" => model::Safety::Sensor,
            "none" | "" => model::Safety::None,
            other => return Err(format!("safety \"{other}\" is not one of none, sensor, actuator")),
        },
        hardware: class.hardware,
        safe_from_any_thread: class.safe_from_any_thread,
        programs: if class.starts_programs { model::Programs::Allowed } else { model::Programs::None },
        execution,
        limits: model::ExecutionLimits {
            models: class.execution.models.iter().map(|m| execution_model(m)).collect::<Result<_, _>>()?,
            min_period_ns: Some(class.execution.min_period_ns).filter(|ns| *ns > 0),
            max_period_ns: Some(class.execution.max_period_ns).filter(|ns| *ns > 0),
        },
        config_schema: class.config.clone(),
        ports: ports(class, types)?,
    };
    // Found now, and not by each Create.
    match model::class_fault(&info) {
        Some(why) => Err(why),
        None => Ok(info),
    }
}

fn execution_model(text: &str) -> Result<model::ExecutionModel, String> {
    use model::ExecutionModel as M;
    Ok(match text {
        "periodic" => M::Periodic,
        "continuous" => M::Continuous,
        "on_signal" | "" => M::OnSignal,
        "on_callback" => M::OnCallback,
        "exec_in" => M::ExecIn,
        "exec_out" => M::ExecOut,
        "stream" => M::Stream,
        "none" => M::None,
        other => {
            return Err(format!(
                "execution model \"{other}\" is not one of periodic, continuous, on_signal, on_callback, exec_in, exec_out, stream, none"
            ));
        }
    })
}

/// Refuses a second member of the same name.
fn once<'a>(names: impl IntoIterator<Item = &'a String>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    match names.into_iter().find(|n| !seen.insert(n.as_str())) {
        Some(twice) => Err(format!("{twice} stands there twice")),
        None => Ok(()),
    }
}

fn depth(fifo: usize) -> Result<usize, String> {
    if fifo <= MAX_FIFO {
        Ok(fifo)
    } else {
        Err(format!("a queue of {fifo} samples is longer than {MAX_FIFO}"))
    }
}

fn members(class: &wire::Class) -> usize {
    let required = class.required.iter().map(|r| r.functions.len() + r.handlers.len());
    let provided = class.provided.iter().map(|p| p.commands.len() + p.events.len());
    class.inputs.len() + class.outputs.len() + required.chain(provided).sum::<usize>()
}

fn name(text: &str) -> Result<(), String> {
    text.parse::<model::Name>().map(|_| ()).map_err(|_| format!("\"{text}\" is not a valid name"))
}

fn ports(class: &wire::Class, types: &mut Types) -> Result<model::Ports, String> {
    if members(class) > MAX_MEMBERS {
        return Err(format!("{} ports and members are more than {MAX_MEMBERS}", members(class)));
    }
    let mut names = PortNames::default();
    let mut ports = model::Ports::default();
    for input in &class.inputs {
        names.take("input", &input.name)?;
        let here = |e| format!("input {}: {e}", input.name);
        ports.inputs.push(self::input(input, types).map_err(here)?);
    }
    for output in &class.outputs {
        names.take("output", &output.name)?;
        let here = |e| format!("output {}: {e}", output.name);
        ports.outputs.push(self::output(output, types).map_err(here)?);
    }
    for required in &class.required {
        names.take("required interface", &required.name)?;
        ports.required.push(self::required(required, types)?);
    }
    for provided in &class.provided {
        names.take("provided interface", &provided.name)?;
        ports.provided.push(self::provided(provided, types)?);
    }
    if let Some(state) = &class.state {
        ports.state = Some(types.state(state).map_err(|e| format!("state: {e}"))?);
    }
    ports.provided.push(system::interface());
    taps::append(&mut ports);
    Ok(ports)
}

/// Names of the ports of one class so far.
#[derive(Default)]
struct PortNames(BTreeSet<String>);

impl PortNames {
    /// Takes the name for one more port.
    fn take(&mut self, kind: &str, n: &str) -> Result<(), String> {
        name(n)?;
        if n == system::INTERFACE {
            return Err(format!("{kind} may not be named {n}: every component has that interface already"));
        }
        if model::TAPS.contains(&n) {
            return Err(format!("{kind} may not be named {n}: every component has that output already"));
        }
        if self.0.insert(n.to_owned()) {
            Ok(())
        } else {
            Err(format!("{kind} {n} has the name of another port of this class"))
        }
    }
}

fn input(input: &wire::Input, types: &mut Types) -> Result<model::Input, String> {
    Ok(model::Input {
        name: input.name.clone(),
        doc: input.doc.clone(),
        ty: frames::port(types.port(&input.ty)?, &input.frame)?,
        tag: tag(&input.tag, &[model::Tag::None, model::Tag::Sim])?,
        optional: input.optional,
        fifo: depth(input.fifo)?,
    })
}

fn output(output: &wire::Output, types: &mut Types) -> Result<model::Output, String> {
    Ok(model::Output {
        name: output.name.clone(),
        doc: output.doc.clone(),
        ty: frames::port(types.port(&output.ty)?, &output.frame)?,
        tag: tag(&output.tag, &model::Tag::ALL)?,
    })
}

/// Returns the tag of that name, one of `allowed`; a typing error must not leave a port without one.
fn tag(text: &str, allowed: &[model::Tag]) -> Result<model::Tag, String> {
    model::Tag::parse(text).filter(|tag| allowed.contains(tag)).ok_or_else(|| {
        let names: Vec<&str> = allowed.iter().map(|tag| tag.name()).filter(|name| !name.is_empty()).collect();
        format!("tag \"{text}\" is not one of {}", names.join(", "))
    })
}

fn required(required: &wire::Required, types: &mut Types) -> Result<model::Required, String> {
    once(required.functions.iter().map(|f| &f.name))
        .and_then(|()| once(required.handlers.iter().map(|h| &h.name)))
        .map_err(|e| format!("required interface {}: {e}", required.name))?;
    let functions = required
        .functions
        .iter()
        .map(|f| {
            name(&f.name)?;
            let (arg, ret) = (types.optional(&f.arg)?, types.optional(&f.ret)?);
            let (arg, ret) = frames::either(arg, ret, &f.frame)
                .map_err(|e| format!("function {}/{}: {e}", required.name, f.name))?;
            Ok(model::Function {
                name: f.name.clone(),
                doc: f.doc.clone(),
                arg,
                ret,
                unit: f.unit.clone(),
                optional: f.optional,
                any: f.any,
            })
        })
        .collect::<Result<_, String>>()?;
    let handlers = required
        .handlers
        .iter()
        .map(|h| {
            name(&h.name)?;
            Ok(model::Handler {
                name: h.name.clone(),
                doc: h.doc.clone(),
                payload: frames::optional(types.optional(&h.payload)?, &h.frame)
                    .map_err(|e| format!("handler {}/{}: {e}", required.name, h.name))?,
                optional: h.optional,
                direct: h.direct,
            })
        })
        .collect::<Result<_, String>>()?;
    Ok(model::Required {
        name: required.name.clone(),
        doc: required.doc.clone(),
        optional: required.optional,
        functions,
        handlers,
    })
}

fn provided(provided: &wire::Provided, types: &mut Types) -> Result<model::Provided, String> {
    once(provided.commands.iter().map(|c| &c.name))
        .and_then(|()| once(provided.events.iter().map(|e| &e.name)))
        .map_err(|e| format!("provided interface {}: {e}", provided.name))?;
    let commands = provided
        .commands
        .iter()
        .map(|c| command(c, types).map_err(|e| format!("command {}/{}: {e}", provided.name, c.name)))
        .collect::<Result<_, String>>()?;
    let events = provided
        .events
        .iter()
        .map(|e| {
            name(&e.name)?;
            Ok(model::Event {
                name: e.name.clone(),
                doc: e.doc.clone(),
                payload: frames::optional(types.optional(&e.payload)?, &e.frame)
                    .map_err(|why| format!("event {}/{}: {why}", provided.name, e.name))?,
                unit: e.unit.clone(),
            })
        })
        .collect::<Result<_, String>>()?;
    Ok(model::Provided {
        name: provided.name.clone(),
        doc: provided.doc.clone(),
        tag: tag(&provided.tag, &model::Tag::ALL)
            .map_err(|e| format!("provided interface {}: {e}", provided.name))?,
        commands,
        events,
    })
}

/// A limit that is shown must hold: the argument has to have a number for it, and a unit one or a time.
fn limited(ty: model::Type, arg: &wire::Arg, command: &str) -> Result<model::Type, String> {
    if (arg.min.is_some() || arg.max.is_some()) && !ty.has_numbers() {
        let title = ty.title();
        return Err(format!(
            "command {command}: min and max of its argument are limits of numbers, and {title} has none: leave them out"
        ));
    }
    if !(arg.unit.is_empty() || ty.has_numbers() || matches!(ty, model::Type::Prim(model::Prim::Stamp))) {
        let (unit, title) = (&arg.unit, ty.title());
        return Err(format!(
            "command {command}: the unit \"{unit}\" of its argument is one of numbers, and {title} has none: leave it out"
        ));
    }
    Ok(ty)
}

fn command(command: &wire::Command, types: &mut Types) -> Result<model::Command, String> {
    use model::CommandKind as K;
    name(&command.name)?;
    let (kind, wants_arg, wants_ret) = match command.kind.as_str() {
        "void" => (K::Void, false, false),
        "write" => (K::Write, true, false),
        "read" => (K::Read, false, true),
        "qualified_read" => (K::QualifiedRead, true, true),
        "void_return" => (K::VoidReturn, false, true),
        "write_return" => (K::WriteReturn, true, true),
        other => {
            return Err(format!(
                "kind \"{other}\" is not one of void, write, read, qualified_read, void_return, write_return"
            ));
        }
    };
    if wants_arg != command.arg.is_some() || wants_ret != command.ret.is_some() {
        return Err(format!("a {} command has the wrong argument or result", command.kind));
    }
    let arg = match &command.arg {
        None => None,
        Some(a) => Some(model::Arg {
            name: a.name.clone(),
            doc: a.doc.clone(),
            ty: limited(frames::value(types.resolve(&a.ty)?, &a.frame)?, a, &command.name)?,
            unit: a.unit.clone(),
            min: a.min,
            max: a.max,
        }),
    };
    Ok(model::Command {
        name: command.name.clone(),
        doc: command.doc.clone(),
        kind,
        arg,
        ret: frames::optional(types.optional(&command.ret)?, &command.ret_frame)?,
        ret_unit: command.ret_unit.clone(),
        overflow: match command.overflow.as_str() {
            "latest_wins" => model::Overflow::LatestWins,
            "drop_oldest" => model::Overflow::DropOldest,
            "reject" | "" => model::Overflow::Reject,
            other => {
                return Err(format!("overflow \"{other}\" is not one of reject, latest_wins, drop_oldest"));
            }
        },
    })
}

/// Resolves references; a type that contains itself or names a missing one is an error.
struct Types<'a> {
    described: &'a [wire::NamedType],
    done: BTreeMap<String, model::Type>,
    open: Vec<String>,
    /// The next struct may have holes: a state row, which never leaves as it lies in memory.
    holes: bool,
}

impl<'a> Types<'a> {
    fn new(described: &'a [wire::NamedType]) -> Self {
        Types { described, done: BTreeMap::new(), open: Vec::new(), holes: false }
    }

    fn port(&mut self, ty: &wire::PortType) -> Result<model::PortType, String> {
        Ok(match ty {
            wire::PortType::Plain { plain } => model::PortType::Plain(self.resolve(plain)?),
            wire::PortType::Frame { max_bytes, .. } if *max_bytes > MAX_FRAME => {
                return Err(format!("frames of {max_bytes} bytes are larger than {MAX_FRAME}"));
            }
            wire::PortType::Frame { frame, format, max_bytes } => model::PortType::Frame {
                header: self.resolve(frame)?,
                format: format.clone(),
                max_bytes: *max_bytes,
            },
            wire::PortType::Any(text) if text == "any" => model::PortType::Any,
            wire::PortType::Any(text) => return Err(format!("port type \"{text}\" is not known")),
        })
    }

    fn optional(&mut self, ty: &Option<wire::Type>) -> Result<Option<model::Type>, String> {
        ty.as_ref().map(|t| self.resolve(t)).transpose()
    }

    /// A state row: its holes are zero (the SDK writes field by field), and it is sent field by field.
    fn state(&mut self, ty: &wire::Type) -> Result<model::Type, String> {
        self.holes = true;
        let resolved = self.resolve(ty);
        self.holes = false;
        resolved
    }

    fn resolve(&mut self, ty: &wire::Type) -> Result<model::Type, String> {
        let resolved = match ty {
            wire::Type::Prim(text) => model::Type::Prim(prim(text)?),
            wire::Type::Array { item, n } => {
                model::Type::Array { item: Box::new(self.resolve(item)?), n: count(*n)? }
            }
            wire::Type::List { item, n } => {
                model::Type::List { item: Box::new(self.resolve(item)?), n: count(*n)? }
            }
            wire::Type::Text { n } => model::Type::Text { n: count(*n)? },
            wire::Type::Ref { name } => self.named(name)?,
        };
        if resolved.size() > MAX_PAYLOAD {
            return Err(format!(
                "a payload of {} bytes is larger than {MAX_PAYLOAD}: use a frame",
                resolved.size()
            ));
        }
        Ok(resolved)
    }

    fn named(&mut self, name: &str) -> Result<model::Type, String> {
        if let Some(done) = self.done.get(name) {
            return Ok(done.clone());
        }
        if self.open.iter().any(|n| n == name) {
            return Err(format!("type {name} contains itself"));
        }
        if self.open.len() >= MAX_DEPTH {
            return Err(format!("type {name} is nested deeper than {MAX_DEPTH}"));
        }
        let described = self.described;
        let named = described
            .iter()
            .find(|t| t.name == name)
            .ok_or_else(|| format!("type {name} is not described"))?;
        self.open.push(name.to_owned());
        let ty = if let Some(repr) = &named.repr {
            model::Type::Enum(Arc::new(model::EnumType {
                name: name.to_owned(),
                repr: prim(repr)?,
                values: named.values.iter().map(|v| (v.name.clone(), v.value)).collect(),
            }))
        } else {
            self.structure(named)?
        };
        self.open.pop();
        if ty.size() != named.size || ty.align() != named.align {
            return Err(format!(
                "type {name} says size {} and alignment {}, its fields say {} and {}",
                named.size,
                named.align,
                ty.size(),
                ty.align()
            ));
        }
        self.done.insert(name.to_owned(), ty.clone());
        Ok(ty)
    }

    /// Fields must follow each other without holes: padding would carry undefined bytes across processes.
    fn structure(&mut self, named: &wire::NamedType) -> Result<model::Type, String> {
        let allowed = std::mem::take(&mut self.holes);
        let mut at = 0usize;
        let mut fields = Vec::with_capacity(named.fields.len());
        for field in &named.fields {
            let ty = self.resolve(&field.ty).map_err(|e| format!("{}.{}: {e}", named.name, field.name))?;
            let fits = if allowed { field.at >= at } else { field.at == at };
            if !fits || !field.at.is_multiple_of(ty.align().max(1)) {
                return Err(format!(
                    "field {}.{} lies at {} where {at} was expected: payloads have no padding",
                    named.name, field.name, field.at
                ));
            }
            at = field.at.checked_add(ty.size()).filter(|n| *n <= MAX_PAYLOAD).ok_or("type too large")?;
            fields.push(model::Field {
                name: field.name.clone(),
                at: field.at,
                ty,
                unit: field.unit.clone(),
                doc: field.doc.clone(),
                frame: field.frame.clone(),
            });
        }
        let full = if allowed { at <= named.size && named.size <= MAX_PAYLOAD } else { at == named.size };
        if !full || !named.align.is_power_of_two() || named.align > 16 {
            return Err(format!("type {} says size {}, its fields fill {at}", named.name, named.size));
        }
        Ok(model::Type::Struct(Arc::new(model::StructType {
            name: named.name.clone(),
            doc: named.doc.clone(),
            size: named.size,
            align: named.align,
            fields,
        })))
    }
}

fn count(n: usize) -> Result<usize, String> {
    if n <= MAX_PAYLOAD { Ok(n) } else { Err(format!("{n} items are more than {MAX_PAYLOAD}")) }
}

fn prim(text: &str) -> Result<model::Prim, String> {
    use model::Prim as P;
    Ok(match text {
        "bool" => P::Bool,
        "u8" => P::U8,
        "i8" => P::I8,
        "u16" => P::U16,
        "i16" => P::I16,
        "u32" => P::U32,
        "i32" => P::I32,
        "u64" => P::U64,
        "i64" => P::I64,
        "f32" => P::F32,
        "f64" => P::F64,
        "stamp" => P::Stamp,
        other => return Err(format!("type \"{other}\" is not known")),
    })
}
