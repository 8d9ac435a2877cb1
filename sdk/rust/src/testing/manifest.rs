//! A class and its types as the manifest of a plugin describes them.
//!
//! Invariant: the description of a class is exactly that of its plugin's note.

use crate::payload::Payload;
use trocar_plugin_api::contracts;
use trocar_plugin_api::desc::{
    ClassDesc, CommandDesc, EventDesc, FunctionDesc, HandlerDesc, PortType, TypeDesc, TypeKind,
};
use trocar_plugin_api::manifest::{self as m, Description, NamedType, Type};

/// Returns a class as its note describes it, without the parts that no test looks at: execution and
/// configuration.
pub(crate) fn description(class: &ClassDesc) -> Description {
    let mut types = Types(Vec::new());
    let class = types.class(class);
    Description { types: types.0, class }
}

/// The canonical field list of a payload, as `docs/INTERFACES.md` compares it: one line per field,
/// `position: [f64;3] m`.
pub fn field_list<T: Payload>() -> Vec<String> {
    leaves(T::DESC)
}

pub(crate) fn leaves(ty: &TypeDesc) -> Vec<String> {
    let mut types = Types(Vec::new());
    let ty = types.of(ty);
    contracts::leaves_of(&types.0, &ty, "").unwrap_or_else(|why| vec![why])
}

/// The type's own spelling; its structs by name.
pub(crate) fn type_of(ty: &TypeDesc) -> Type {
    Types(Vec::new()).of(ty)
}

/// A type with the types it names.
pub(crate) fn described(ty: &TypeDesc) -> (Vec<NamedType>, Type) {
    let mut types = Types(Vec::new());
    let ty = types.of(ty);
    (types.0, ty)
}

struct Types(Vec<NamedType>);

impl Types {
    fn of(&mut self, ty: &TypeDesc) -> Type {
        match &ty.kind {
            TypeKind::Prim(p) => Type::Prim(p.name().to_string()),
            TypeKind::Array { item, n } => Type::Array { item: Box::new(self.of(item)), n: *n },
            TypeKind::List { item, n } => Type::List { item: Box::new(self.of(item)), n: *n },
            TypeKind::Text { n } => Type::Text { n: *n },
            TypeKind::Enum { name, repr, values } => {
                let values =
                    values.iter().map(|(name, value)| m::EnumValue { name: name.to_string(), value: *value });
                let repr = Some(repr.name().to_string());
                self.named(name, ty, "", Vec::new(), repr, values.collect())
            }
            TypeKind::Struct { name, doc, fields } => {
                let fields = fields.iter().map(|f| m::Field {
                    name: f.name.to_string(),
                    at: f.at,
                    ty: self.of(f.ty),
                    unit: f.unit.to_string(),
                    doc: f.doc.to_string(),
                    frame: f.frame.to_string(),
                });
                let fields = fields.collect();
                self.named(name, ty, doc, fields, None, Vec::new())
            }
        }
    }

    fn named(
        &mut self,
        name: &str,
        ty: &TypeDesc,
        doc: &str,
        fields: Vec<m::Field>,
        repr: Option<String>,
        values: Vec<m::EnumValue>,
    ) -> Type {
        if !self.0.iter().any(|t| t.name == name) {
            let (name, doc) = (name.to_string(), doc.to_string());
            self.0.push(NamedType { name, doc, size: ty.size, align: ty.align, fields, repr, values });
        }
        Type::Ref { name: name.to_string() }
    }

    fn class(&mut self, class: &ClassDesc) -> m::Class {
        m::Class {
            name: class.name.to_string(),
            doc: class.doc.to_string(),
            safety: class.safety.name().to_string(),
            hardware: class.hardware,
            safe_from_any_thread: class.safe_from_any_thread,
            starts_programs: class.starts_programs,
            execution: m::Execution::default(),
            config: crate::serde_json::Value::Null,
            inputs: class
                .inputs
                .iter()
                .map(|i| m::Input {
                    name: i.name.to_string(),
                    doc: i.doc.to_string(),
                    ty: self.port(i.ty),
                    frame: i.frame.to_string(),
                    tag: i.tag.to_string(),
                    optional: i.optional,
                    fifo: i.fifo,
                })
                .collect(),
            outputs: class
                .outputs
                .iter()
                .map(|o| m::Output {
                    name: o.name.to_string(),
                    doc: o.doc.to_string(),
                    ty: self.port(o.ty),
                    frame: o.frame.to_string(),
                    tag: o.tag.to_string(),
                })
                .collect(),
            required: class
                .required
                .iter()
                .map(|r| m::Required {
                    name: r.name.to_string(),
                    doc: r.doc.to_string(),
                    optional: r.optional,
                    functions: r.functions.iter().map(|f| self.function(f)).collect(),
                    handlers: r.handlers.iter().map(|h| self.handler(h)).collect(),
                })
                .collect(),
            provided: class
                .provided
                .iter()
                .map(|p| m::Provided {
                    name: p.name.to_string(),
                    doc: p.doc.to_string(),
                    tag: p.tag.to_string(),
                    commands: p.commands.iter().map(|c| self.command(c)).collect(),
                    events: p.events.iter().map(|e| self.event(e)).collect(),
                })
                .collect(),
            state: None,
        }
    }

    fn port(&mut self, ty: PortType) -> m::PortType {
        match ty {
            PortType::Plain(ty) => m::PortType::Plain { plain: self.of(ty) },
            PortType::Frame { header, format, max_bytes } => {
                m::PortType::Frame { frame: self.of(header), format: format.to_string(), max_bytes }
            }
            PortType::Any => m::PortType::Any("any".to_string()),
        }
    }

    fn function(&mut self, f: &FunctionDesc) -> m::Function {
        m::Function {
            name: f.name.to_string(),
            doc: f.doc.to_string(),
            arg: f.arg.map(|ty| self.of(ty)),
            ret: f.ret.map(|ty| self.of(ty)),
            unit: f.unit.to_string(),
            frame: f.frame.to_string(),
            optional: f.optional,
            any: f.any,
        }
    }

    fn handler(&mut self, h: &HandlerDesc) -> m::Handler {
        m::Handler {
            name: h.name.to_string(),
            doc: h.doc.to_string(),
            payload: h.payload.map(|ty| self.of(ty)),
            frame: h.frame.to_string(),
            optional: h.optional,
            direct: h.direct,
        }
    }

    fn command(&mut self, c: &CommandDesc) -> m::Command {
        m::Command {
            name: c.name.to_string(),
            doc: c.doc.to_string(),
            kind: c.kind.name().to_string(),
            arg: c.arg.as_ref().map(|a| m::Arg {
                name: a.name.to_string(),
                doc: a.doc.to_string(),
                ty: self.of(a.ty),
                unit: a.unit.to_string(),
                frame: a.frame.to_string(),
                min: a.min.parse().ok(),
                max: a.max.parse().ok(),
            }),
            ret: c.ret.map(|ty| self.of(ty)),
            ret_unit: c.ret_unit.to_string(),
            ret_frame: c.ret_frame.to_string(),
            overflow: c.overflow.to_string(),
        }
    }

    fn event(&mut self, e: &EventDesc) -> m::Event {
        m::Event {
            name: e.name.to_string(),
            doc: e.doc.to_string(),
            payload: e.payload.map(|ty| self.of(ty)),
            unit: e.unit.to_string(),
            frame: e.frame.to_string(),
        }
    }
}
