//! A payload type as protobuf: its descriptor, and the plan by which its bytes become a message.
//!
//! Invariant: descriptor and plan are made in one walk, so a number in one is the number in the other. Any
//! bytes of the type's size can be encoded: lengths are clamped and texts made valid.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto, FieldOptions,
    FileDescriptorProto, FileDescriptorSet,
};
use serde_json::Value as Json;
use trocar_sdk::{AnyPart, AnyShape, AnyType};

use crate::wire;

/// Field of a command's outcome, beside those of its argument.
const OUTCOME: u32 = 10_000;

/// Name, descriptor and encoding of a topic's messages.
pub(crate) struct Typed {
    /// `trocar.h0123456789abcdef.Scalar`: the type hash is part of it.
    pub(crate) name: String,
    /// A serialized `FileDescriptorSet`.
    pub(crate) descriptors: Vec<u8>,
    /// Units of the fields, `position` → `m`.
    pub(crate) units: Vec<(String, String)>,
    plan: Vec<Step>,
    /// Field of a frame's bytes.
    data: u32,
}

#[derive(Debug)]
struct Step {
    at: usize,
    field: u32,
    how: How,
}

#[derive(Debug)]
enum How {
    /// Four bytes as they are.
    Word,
    /// Eight bytes as they are.
    Long,
    Small(Small),
    /// `n` numbers of 4 or 8 bytes each, or of one byte as `bytes`: as they are.
    Raw {
        bytes: usize,
    },
    /// A list of those.
    RawList {
        item: usize,
        n: usize,
    },
    Packed {
        small: Small,
        n: usize,
    },
    PackedList {
        small: Small,
        n: usize,
    },
    Text {
        n: usize,
    },
    Nested(Vec<Step>),
    /// One message or text for each item.
    Each {
        item: Box<Step>,
        size: usize,
        n: usize,
        list: bool,
    },
}

/// A number that becomes a varint.
#[derive(Clone, Copy, Debug)]
enum Small {
    /// One byte that is zero or not.
    Flag,
    /// Integer of so many bytes.
    Unsigned(usize),
    /// The same, zigzag.
    Signed(usize),
    /// Proto enum of so many bytes: sign-extended to 64 bits.
    Enum(usize, bool),
}

impl Typed {
    /// Returns the messages of what a port carries; `hash` stands for it.
    pub(crate) fn of(ty: &AnyType, hash: u64) -> Typed {
        let package = format!("trocar.h{hash:016x}");
        let mut walk = Walk { package: &package, messages: Vec::new(), units: Vec::new() };
        let (name, plan, last) = match ty.part().shape() {
            AnyShape::Struct { name, .. } => {
                let name = ident(name);
                let (plan, last) = walk.structure(&name, ty.part(), "");
                (name, plan, last)
            }
            _ => {
                let mut message =
                    DescriptorProto { name: Some("Value".into()), ..DescriptorProto::default() };
                let step = walk.field(&mut message, "value", 1, 0, ty.part(), "");
                walk.messages.push(message);
                ("Value".to_owned(), vec![step], 1)
            }
        };
        let data = last + 1;
        if ty.format().is_some()
            && let Some(message) = walk.messages.iter_mut().find(|m| m.name() == name)
        {
            let taken = message.field.iter().any(|f| f.name() == "data");
            let called = if taken { "frame_data" } else { "data" };
            message.field.push(field(called, data, Label::Optional, Type::Bytes, None));
        }
        let file = FileDescriptorProto {
            name: Some(format!("{}.proto", package.replace('.', "/"))),
            package: Some(package.clone()),
            message_type: walk.messages,
            syntax: Some("proto3".into()),
            ..FileDescriptorProto::default()
        };
        let descriptors = FileDescriptorSet { file: vec![file] }.encode_to_vec();
        Typed { name: format!("{package}.{name}"), descriptors, units: walk.units, plan, data }
    }

    /// Returns the messages of a member of an interface: its payload, if it has one, and its outcome if that
    /// is told.
    pub(crate) fn of_member(ty: Option<&AnyType>, hash: u64, outcome: bool) -> Typed {
        let empty = || Typed {
            name: String::new(),
            descriptors: Vec::new(),
            units: Vec::new(),
            plan: Vec::new(),
            data: OUTCOME + 1,
        };
        let mut typed = ty.map_or_else(empty, |ty| Typed::of(ty, hash));
        let mut files = FileDescriptorSet::decode(typed.descriptors.as_slice()).unwrap_or_default();
        if files.file.is_empty() {
            let package = format!("trocar.h{hash:016x}");
            typed.name = format!("{package}.Nothing");
            files.file.push(FileDescriptorProto {
                name: Some(format!("{}.proto", package.replace('.', "/"))),
                package: Some(package),
                message_type: vec![DescriptorProto {
                    name: Some("Nothing".into()),
                    ..DescriptorProto::default()
                }],
                syntax: Some("proto3".into()),
                ..FileDescriptorProto::default()
            });
        }
        let short = typed.name.rsplit('.').next().unwrap_or_default().to_owned();
        let messages = files.file.iter_mut().flat_map(|file| &mut file.message_type);
        if let Some(message) = messages.into_iter().find(|m| m.name() == short)
            && outcome
        {
            message.field.push(field("trocar_outcome", OUTCOME, Label::Optional, Type::String, None));
        }
        typed.descriptors = files.encode_to_vec();
        typed
    }

    /// Appends how a command ended.
    pub(crate) fn outcome(word: &str, to: &mut Vec<u8>) {
        wire::bytes(to, OUTCOME, word.as_bytes());
    }

    /// Appends a sample; a frame's bytes, so many, are to follow it.
    pub(crate) fn encode(&self, value: &[u8], frame_len: usize, to: &mut Vec<u8>) {
        encode(&self.plan, value, to);
        if frame_len > 0 {
            wire::bytes_follow(to, self.data, frame_len);
        }
    }
}

/// Returns a number for a type as a port describes it, without its documentation: FNV-1a, 64 bit, over the
/// description in one spelling.
pub(crate) fn hash(description: &str) -> u64 {
    fn without_docs(value: &mut Json) {
        match value {
            Json::Object(object) => {
                object.remove("doc");
                object.values_mut().for_each(without_docs);
            }
            Json::Array(items) => items.iter_mut().for_each(without_docs),
            _ => {}
        }
    }
    let mut json: Json = serde_json::from_str(description).unwrap_or_default();
    without_docs(&mut json);
    json.to_string().bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// A name as protobuf takes it.
fn ident(name: &str) -> String {
    let good = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '_' };
    let name: String = name.chars().map(good).collect();
    if name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') { name } else { format!("_{name}") }
}

fn field(
    name: &str,
    number: u32,
    label: Label,
    kind: Type,
    type_name: Option<String>,
) -> FieldDescriptorProto {
    let packable = label == Label::Repeated && !matches!(kind, Type::Message | Type::String | Type::Bytes);
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number as i32),
        label: Some(label as i32),
        r#type: Some(kind as i32),
        type_name,
        options: packable.then(|| FieldOptions { packed: Some(true), ..FieldOptions::default() }),
        ..FieldDescriptorProto::default()
    }
}

struct Walk<'a> {
    package: &'a str,
    messages: Vec<DescriptorProto>,
    units: Vec<(String, String)>,
}

/// Returns the protobuf type of a number, and its conversion.
fn number(name: &str, size: usize) -> (Type, Result<(), Small>) {
    match name {
        "bool" => (Type::Bool, Err(Small::Flag)),
        "u8" | "u16" => (Type::Uint32, Err(Small::Unsigned(size))),
        "i8" | "i16" => (Type::Sint32, Err(Small::Signed(size))),
        "u32" => (Type::Fixed32, Ok(())),
        "i32" => (Type::Sfixed32, Ok(())),
        "f32" => (Type::Float, Ok(())),
        "i64" => (Type::Sfixed64, Ok(())),
        "f64" => (Type::Double, Ok(())),
        _ => (Type::Fixed64, Ok(())),
    }
}

impl Walk<'_> {
    /// Describes a struct once, and says how it is encoded and its last field's number.
    fn structure(&mut self, name: &str, part: AnyPart<'_>, path: &str) -> (Vec<Step>, u32) {
        let AnyShape::Struct { fields, .. } = part.shape() else { return (Vec::new(), 0) };
        let mut message = DescriptorProto { name: Some(name.to_owned()), ..DescriptorProto::default() };
        let mut plan = Vec::new();
        for (n, f) in fields.iter().enumerate() {
            let path = if path.is_empty() { f.name.to_owned() } else { format!("{path}.{}", f.name) };
            if !f.unit.is_empty() {
                self.units.push((path.clone(), f.unit.to_owned()));
            }
            plan.push(self.field(&mut message, &ident(f.name), n as u32 + 1, f.at, f.part, &path));
        }
        if !self.messages.iter().any(|m| m.name() == name) {
            self.messages.push(message);
        }
        (plan, fields.len() as u32)
    }

    fn field(
        &mut self,
        message: &mut DescriptorProto,
        name: &str,
        no: u32,
        at: usize,
        part: AnyPart<'_>,
        path: &str,
    ) -> Step {
        let add = |message: &mut DescriptorProto, label, kind, of| {
            message.field.push(field(name, no, label, kind, of))
        };
        let how = match part.shape() {
            AnyShape::Number(prim) => {
                let (kind, how) = number(prim, part.size());
                add(message, Label::Optional, kind, None);
                match how {
                    Ok(()) if part.size() == 4 => How::Word,
                    Ok(()) => How::Long,
                    Err(small) => How::Small(small),
                }
            }
            AnyShape::Enum { number, values } => {
                let signed = number.starts_with('i');
                match named_values(name, part.size(), values) {
                    Some(of) => {
                        let full = format!(".{}.{}.{}", self.package, message.name(), of.name());
                        message.enum_type.push(of);
                        add(message, Label::Optional, Type::Enum, Some(full));
                    }
                    None => add(message, Label::Optional, Type::Int64, None),
                }
                How::Small(Small::Enum(part.size(), signed))
            }
            AnyShape::Text { n } => {
                add(message, Label::Optional, Type::String, None);
                How::Text { n }
            }
            AnyShape::Struct { name: of, .. } => {
                let of = ident(of);
                let (plan, _) = self.structure(&of, part, path);
                add(message, Label::Optional, Type::Message, Some(format!(".{}.{of}", self.package)));
                How::Nested(plan)
            }
            AnyShape::Array { item, n } => return self.items(message, (name, no, at), item, n, false, path),
            AnyShape::List { item, n } => return self.items(message, (name, no, at), item, n, true, path),
        };
        Step { at, field: no, how }
    }

    fn items(
        &mut self,
        message: &mut DescriptorProto,
        (name, no, at): (&str, u32, usize),
        item: AnyPart<'_>,
        n: usize,
        list: bool,
        path: &str,
    ) -> Step {
        let size = item.size();
        let (label, kind, how) = match item.shape() {
            AnyShape::Number(prim) => numbers(prim, size, n, list),
            AnyShape::Enum { number, .. } => {
                let small = Small::Enum(size, number.starts_with('i'));
                (Label::Repeated, Type::Int64, packed(small, n, list))
            }
            // Numbers in rows of numbers become one row: their bytes lie one after the other.
            AnyShape::Array { item: inner, n: m }
                if !list && matches!(inner.shape(), AnyShape::Number(_)) =>
            {
                return self.items(message, (name, no, at), inner, n * m, false, path);
            }
            _ => {
                let (kind, of, item) = self.item(item, (name, no), path);
                message.field.push(field(name, no, Label::Repeated, kind, of));
                let item = Box::new(item);
                return Step { at, field: no, how: How::Each { item, size, n, list } };
            }
        };
        message.field.push(field(name, no, label, kind, None));
        Step { at, field: no, how }
    }

    /// One of several items that are no numbers: its protobuf type, with the name of a message, and how it is
    /// encoded.
    fn item(
        &mut self,
        item: AnyPart<'_>,
        (name, no): (&str, u32),
        path: &str,
    ) -> (Type, Option<String>, Step) {
        let (of, how) = match item.shape() {
            AnyShape::Struct { name: of, .. } => {
                let of = ident(of);
                let (plan, _) = self.structure(&of, item, path);
                (Some(of), How::Nested(plan))
            }
            AnyShape::Text { n: room } => (None, How::Text { n: room }),
            // Rows of anything else are messages of their own, with the row in them.
            _ => {
                let of = format!("Row_{}", ident(if path.is_empty() { name } else { path }));
                let mut row = DescriptorProto { name: Some(of.clone()), ..DescriptorProto::default() };
                let inner = self.field(&mut row, "items", 1, 0, item, path);
                if !self.messages.iter().any(|m| m.name() == of) {
                    self.messages.push(row);
                }
                (Some(of), How::Nested(vec![inner]))
            }
        };
        let kind = if of.is_some() { Type::Message } else { Type::String };
        let full = of.map(|of| format!(".{}.{of}", self.package));
        (kind, full, Step { at: 0, field: no, how })
    }
}

/// Several numbers side by side: bytes as they are where protobuf packs them so.
fn numbers(prim: &str, size: usize, n: usize, list: bool) -> (Label, Type, How) {
    if size == 1 && prim == "u8" {
        let how = if list { How::RawList { item: 1, n } } else { How::Raw { bytes: n } };
        return (Label::Optional, Type::Bytes, how);
    }
    let (kind, how) = number(prim, size);
    let how = match how {
        Ok(()) if list => How::RawList { item: size, n },
        Ok(()) => How::Raw { bytes: n * size },
        Err(small) => packed(small, n, list),
    };
    (Label::Repeated, kind, how)
}

fn packed(small: Small, n: usize, list: bool) -> How {
    if list { How::PackedList { small, n } } else { How::Packed { small, n } }
}

/// A proto enum has a zero first, 32 bits, and names of its own; none if the values do not fit.
fn named_values(name: &str, size: usize, values: &[(String, i64)]) -> Option<EnumDescriptorProto> {
    if size > 4 || values.iter().any(|(_, value)| i32::try_from(*value).is_err()) {
        return None;
    }
    // Values of protobuf enums are siblings of their type, so each says whose it is.
    let prefix = ident(name).to_uppercase();
    let one = |called: &str, number: i32| EnumValueDescriptorProto {
        name: Some(format!("{prefix}_{}", ident(called))),
        number: Some(number),
        ..EnumValueDescriptorProto::default()
    };
    let mut seen = Vec::new();
    let mut all = Vec::new();
    if !values.iter().any(|(_, value)| *value == 0) {
        all.push(one("NONE_OF_THEM", 0));
    }
    let (zeros, others): (Vec<_>, Vec<_>) = values.iter().partition(|(_, value)| *value == 0);
    for (called, value) in zeros.into_iter().chain(others) {
        if !seen.contains(value) {
            seen.push(*value);
            all.push(one(called, *value as i32));
        }
    }
    let called = format!("Enum_{}", ident(name));
    Some(EnumDescriptorProto { name: Some(called), value: all, ..EnumDescriptorProto::default() })
}

impl Small {
    fn bytes(self) -> usize {
        match self {
            Small::Flag => 1,
            Small::Unsigned(n) | Small::Signed(n) | Small::Enum(n, _) => n,
        }
    }

    fn read(self, from: &[u8]) -> u64 {
        let n = self.bytes().min(8);
        let mut wide = [0u8; 8];
        for (to, byte) in wide.iter_mut().zip(from.iter().take(n)) {
            *to = *byte;
        }
        let value = u64::from_le_bytes(wide);
        let signed = ((value << (64 - 8 * n)) as i64) >> (64 - 8 * n);
        match self {
            Small::Flag => u64::from(value != 0),
            Small::Unsigned(_) | Small::Enum(_, false) => value,
            Small::Signed(_) => (signed << 1 ^ signed >> 63) as u64,
            Small::Enum(_, true) => signed as u64,
        }
    }
}

/// The length in front of a list or text, and what follows it.
fn counted(from: &[u8], n: usize) -> (usize, &[u8]) {
    let Some((len, rest)) = from.split_first_chunk::<8>() else { return (0, &[]) };
    ((u64::from_le_bytes(*len).min(n as u64)) as usize, rest)
}

fn encode(plan: &[Step], value: &[u8], to: &mut Vec<u8>) {
    for step in plan {
        if let Some(from) = value.get(step.at..) {
            one(step, from, to);
        }
    }
}

fn one(step: &Step, from: &[u8], to: &mut Vec<u8>) {
    let field = step.field;
    let raw = |to: &mut Vec<u8>, bytes: &[u8], len: usize| {
        if let Some(bytes) = bytes.get(..len).filter(|b| !b.is_empty()) {
            wire::bytes(to, field, bytes);
        }
    };
    let packed = |to: &mut Vec<u8>, small: Small, n: usize, from: &[u8]| {
        if n > 0 {
            wire::message(to, field, |to| {
                for item in from.chunks_exact(small.bytes().max(1)).take(n) {
                    wire::varint(to, small.read(item));
                }
            });
        }
    };
    match &step.how {
        How::Word => {
            if let Some(word) = from.first_chunk::<4>() {
                wire::fixed32(to, field, u32::from_le_bytes(*word));
            }
        }
        How::Long => {
            if let Some(long) = from.get(..8) {
                wire::key(to, field, wire::FIXED64);
                to.extend_from_slice(long);
            }
        }
        How::Small(small) => wire::number(to, field, small.read(from)),
        How::Raw { bytes } => raw(to, from, *bytes),
        How::RawList { item, n } => {
            let (len, rest) = counted(from, *n);
            raw(to, rest, len * item);
        }
        How::Packed { small, n } => packed(to, *small, *n, from),
        How::PackedList { small, n } => {
            let (len, rest) = counted(from, *n);
            packed(to, *small, len, rest);
        }
        How::Text { n } => {
            let (len, rest) = counted(from, *n);
            let text = String::from_utf8_lossy(rest.get(..len).unwrap_or_default());
            wire::bytes(to, field, text.as_bytes());
        }
        How::Nested(plan) => wire::message(to, field, |to| encode(plan, from, to)),
        How::Each { item, size, n, list } => {
            let (len, rest) = if *list { counted(from, *n) } else { (*n, from) };
            for from in rest.chunks_exact((*size).max(1)).take(len) {
                one(item, from, to);
            }
        }
    }
}

#[cfg(test)]
#[path = "typed_tests.rs"]
mod tests;
