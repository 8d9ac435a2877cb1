//! Model → manifest: the description of its peer that an untyped port gets.
//!
//! Invariant: the text stands for itself: every struct and enum it names is in its `types`, which come before
//! their users.

use serde_json::{Value, json};
use trocar_model as model;
use trocar_plugin_api::manifest as wire;

/// A stream's type as manifest JSON: a port type with the key `types` beside it. Empty for an untyped one.
pub fn port(ty: &model::PortType) -> String {
    let mut types = Vec::new();
    let port = match ty {
        model::PortType::Plain(plain) => wire::PortType::Plain { plain: described(plain, &mut types) },
        model::PortType::Frame { header, format, max_bytes } => wire::PortType::Frame {
            frame: described(header, &mut types),
            format: format.clone(),
            max_bytes: *max_bytes,
        },
        model::PortType::Any => return String::new(),
    };
    text(json!(port), &types)
}

/// A command's description as manifest JSON with the key `types` beside it.
pub fn command(command: &model::Command) -> String {
    let mut types = Vec::new();
    let arg = command.arg.as_ref().map(|arg| wire::Arg {
        name: arg.name.clone(),
        doc: arg.doc.clone(),
        ty: described(&arg.ty, &mut types),
        unit: arg.unit.clone(),
        // The fields of the type have it.
        frame: String::new(),
        min: arg.min,
        max: arg.max,
    });
    let ret = command.ret.as_ref().map(|ty| described(ty, &mut types));
    let overflow = match command.overflow {
        model::Overflow::Reject => "reject",
        model::Overflow::LatestWins => "latest_wins",
        model::Overflow::DropOldest => "drop_oldest",
    };
    let command = wire::Command {
        name: command.name.clone(),
        doc: command.doc.clone(),
        kind: command.kind.name().replace([' ', '-'], "_"),
        arg,
        ret,
        ret_unit: command.ret_unit.clone(),
        ret_frame: String::new(),
        overflow: overflow.into(),
    };
    text(json!(command), &types)
}

fn text(mut value: Value, types: &[wire::NamedType]) -> String {
    value["types"] = json!(types);
    value.to_string()
}

fn described(ty: &model::Type, types: &mut Vec<wire::NamedType>) -> wire::Type {
    match ty {
        model::Type::Prim(p) => wire::Type::Prim(p.name().into()),
        model::Type::Array { item, n } => wire::Type::Array { item: Box::new(described(item, types)), n: *n },
        model::Type::List { item, n } => wire::Type::List { item: Box::new(described(item, types)), n: *n },
        model::Type::Text { n } => wire::Type::Text { n: *n },
        model::Type::Enum(e) => {
            if types.iter().all(|t| t.name != e.name) {
                types.push(wire::NamedType {
                    repr: Some(e.repr.name().into()),
                    values: values(e),
                    ..named(&e.name, "", e.repr.size(), e.repr.size())
                });
            }
            wire::Type::Ref { name: e.name.clone() }
        }
        model::Type::Struct(s) => {
            let fields = s.fields.iter().map(|f| field(f, types)).collect();
            let name = add(wire::NamedType { fields, ..named(&s.name, &s.doc, s.size, s.align) }, types);
            wire::Type::Ref { name }
        }
    }
}

/// Adds the type and returns its new name: an argument and a result of one type may be in two coordinate
/// frames, and each is described as it is.
fn add(mut ty: wire::NamedType, types: &mut Vec<wire::NamedType>) -> String {
    let plain = ty.name.clone();
    let mut number = 1;
    while let Some(other) = types.iter().find(|t| t.name == ty.name) {
        if *other == ty {
            return ty.name;
        }
        number += 1;
        ty.name = format!("{plain} ({number})");
    }
    types.push(ty);
    types[types.len() - 1].name.clone()
}

fn named(name: &str, doc: &str, size: usize, align: usize) -> wire::NamedType {
    wire::NamedType {
        name: name.into(),
        doc: doc.into(),
        size,
        align,
        fields: Vec::new(),
        repr: None,
        values: Vec::new(),
    }
}

fn values(e: &model::EnumType) -> Vec<wire::EnumValue> {
    e.values.iter().map(|(name, value)| wire::EnumValue { name: name.clone(), value: *value }).collect()
}

fn field(f: &model::Field, types: &mut Vec<wire::NamedType>) -> wire::Field {
    wire::Field {
        name: f.name.clone(),
        at: f.at,
        ty: described(&f.ty, types),
        unit: f.unit.clone(),
        doc: f.doc.clone(),
        frame: f.frame.clone(),
    }
}
