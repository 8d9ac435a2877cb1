//! Payload types, described field by field.
//!
//! Invariant: identity is the canonical field list ([`Type::canonical`]); the 64-bit hash is only a short
//! form of it.

use std::fmt::Write as _;
use std::sync::Arc;

use crate::Unit;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Prim {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
    /// u64 ns of the host's monotonic clock; 0 = invalid.
    Stamp,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Type {
    Prim(Prim),
    Array {
        item: Box<Type>,
        n: usize,
    },
    /// u64 length, then room for `n` items.
    List {
        item: Box<Type>,
        n: usize,
    },
    /// u64 length in bytes, then room for `n` bytes of UTF-8.
    Text {
        n: usize,
    },
    Enum(Arc<EnumType>),
    Struct(Arc<StructType>),
}

#[derive(Clone, Debug, PartialEq)]
pub struct EnumType {
    pub name: String,
    pub repr: Prim,
    pub values: Vec<(String, i64)>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct StructType {
    pub name: String,
    pub doc: String,
    pub size: usize,
    pub align: usize,
    pub fields: Vec<Field>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    pub name: String,
    /// Offset in bytes.
    pub at: usize,
    pub ty: Type,
    pub unit: String,
    pub doc: String,
    /// Coordinate-frame tag; "" = none.
    pub frame: String,
}

impl Prim {
    pub const ALL: [Prim; 12] = [
        Prim::Bool,
        Prim::U8,
        Prim::I8,
        Prim::U16,
        Prim::I16,
        Prim::U32,
        Prim::I32,
        Prim::U64,
        Prim::I64,
        Prim::F32,
        Prim::F64,
        Prim::Stamp,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Prim::Bool => "bool",
            Prim::U8 => "u8",
            Prim::I8 => "i8",
            Prim::U16 => "u16",
            Prim::I16 => "i16",
            Prim::U32 => "u32",
            Prim::I32 => "i32",
            Prim::U64 => "u64",
            Prim::I64 => "i64",
            Prim::F32 => "f32",
            Prim::F64 => "f64",
            Prim::Stamp => "stamp",
        }
    }

    /// The primitive a manifest calls `name`.
    pub fn parse(name: &str) -> Option<Prim> {
        Prim::ALL.into_iter().find(|p| p.name() == name)
    }

    /// Bytes; also the alignment.
    pub fn size(self) -> usize {
        match self {
            Prim::Bool | Prim::U8 | Prim::I8 => 1,
            Prim::U16 | Prim::I16 => 2,
            Prim::U32 | Prim::I32 | Prim::F32 => 4,
            Prim::U64 | Prim::I64 | Prim::F64 | Prim::Stamp => 8,
        }
    }
}

impl Type {
    /// Bytes of one value. Saturates where a description is absurd; such a type cannot be encoded.
    pub fn size(&self) -> usize {
        match self {
            Type::Prim(p) => p.size(),
            Type::Array { item, n } => item.size().saturating_mul(*n),
            Type::List { item, n } => {
                round_up(item.size().saturating_mul(*n).saturating_add(8), self.align())
            }
            Type::Text { n } => round_up(n.saturating_add(8), 8),
            Type::Enum(e) => e.repr.size(),
            Type::Struct(s) => s.size,
        }
    }

    /// Tells whether a value holds numbers, which a range may limit. Stamps, flags, texts and enums are none.
    pub fn has_numbers(&self) -> bool {
        match self {
            Type::Prim(p) => !matches!(p, Prim::Bool | Prim::Stamp),
            Type::Array { item, .. } | Type::List { item, .. } => item.has_numbers(),
            Type::Struct(s) => s.fields.iter().any(|f| f.ty.has_numbers()),
            Type::Text { .. } | Type::Enum(_) => false,
        }
    }

    /// Bytes, a power of two.
    pub fn align(&self) -> usize {
        match self {
            Type::Prim(p) => p.size(),
            Type::Array { item, .. } => item.align(),
            Type::List { item, .. } => item.align().max(8),
            Type::Text { .. } => 8,
            Type::Enum(e) => e.repr.size(),
            Type::Struct(s) => s.align.max(1),
        }
    }

    /// The identity of the type as text: everything that must agree at Connect. Names of structs and enums
    /// and the documentation are not part of it; names, offsets, units and frames of fields are.
    pub fn canonical(&self) -> String {
        let mut out = String::new();
        self.write_canonical(&mut out);
        out
    }

    fn write_canonical(&self, out: &mut String) {
        // Writing to a String cannot fail, so the results carry nothing. `{:?}` quotes: no name can imitate
        // the syntax.
        match self {
            Type::Prim(p) => out.push_str(p.name()),
            Type::Array { item, n } | Type::List { item, n } => {
                out.push_str(if matches!(self, Type::List { .. }) { "list[" } else { "[" });
                item.write_canonical(out);
                let _ = write!(out, ";{n}]");
            }
            Type::Text { n } => {
                let _ = write!(out, "text[{n}]");
            }
            Type::Enum(e) => {
                let _ = write!(out, "enum {}(", e.repr.name());
                for (name, value) in &e.values {
                    let _ = write!(out, "{name:?}={value},");
                }
                out.push(')');
            }
            Type::Struct(s) => {
                out.push('{');
                for f in &s.fields {
                    let _ = write!(out, "{:?}@{}:", f.name, f.at);
                    f.ty.write_canonical(out);
                    let _ = write!(out, " {:?} {:?},", f.unit, f.frame);
                }
                let _ = write!(out, "}}{}", s.size);
            }
        }
    }

    /// FNV-1a of [`Type::canonical`]: for speed; messages use the list itself.
    pub fn hash(&self) -> u64 {
        self.canonical()
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
    }

    /// Tells whether both have the same identity: a value of one may be read as the other without a copy.
    pub fn same(&self, other: &Type) -> bool {
        self == other || self.canonical() == other.canonical()
    }

    /// Tells whether a client of this type can read `server`'s values as they lie: the same fields in the
    /// same places, in units that mean the same, and in the same coordinate frames where both ends name one.
    pub fn accepts(&self, server: &Type) -> bool {
        match (self, server) {
            (Type::Array { item: a, n }, Type::Array { item: b, n: m })
            | (Type::List { item: a, n }, Type::List { item: b, n: m }) => n == m && a.accepts(b),
            (Type::Struct(a), Type::Struct(b)) => {
                let fits = |(f, g): (&Field, &Field)| {
                    f.name == g.name && f.at == g.at && agree(f, g) && f.ty.accepts(&g.ty)
                };
                a.size == b.size
                    && a.fields.len() == b.fields.len()
                    && a.fields.iter().zip(&b.fields).all(fits)
            }
            _ => self.same(server),
        }
    }

    /// Returns the first thing for which this type does not accept `server`'s, in words; `None` when it does.
    /// Kinds and units come before offsets, since a moved field is only a consequence.
    pub fn first_difference(&self, server: &Type) -> Option<String> {
        if self.accepts(server) {
            return None;
        }
        let found = difference(self, server, "", false).or_else(|| difference(self, server, "", true));
        Some(found.unwrap_or_else(|| format!("{} here and {} there", self.canonical(), server.canonical())))
    }

    /// For people: `f64`, `[f64; 3]`, `list of up to 16 f64`, `Force`.
    pub fn title(&self) -> String {
        match self {
            Type::Prim(p) => p.name().to_owned(),
            Type::Array { item, n } => format!("[{}; {n}]", item.title()),
            Type::List { item, n } => format!("list of up to {n} {}", item.title()),
            Type::Text { n } => format!("text of up to {n} bytes"),
            Type::Enum(e) => e.name.clone(),
            Type::Struct(s) => s.name.clone(),
        }
    }
}

/// Tells whether the units mean the same, and the frames do not contradict each other.
pub(crate) fn agree(a: &Field, b: &Field) -> bool {
    Unit::same(&a.unit, &b.unit) && (a.frame == b.frame || a.frame.is_empty() || b.frame.is_empty())
}

fn round_up(size: usize, align: usize) -> usize {
    size.div_ceil(align).saturating_mul(align)
}

/// Returns the first difference; `path` is the dotted name of the compared part, empty at the top.
fn difference(client: &Type, server: &Type, path: &str, layout: bool) -> Option<String> {
    let subject = || if path.is_empty() { "it".to_owned() } else { format!("field `{path}`") };
    match (client, server) {
        (Type::Array { item: a, n }, Type::Array { item: b, n: m })
        | (Type::List { item: a, n }, Type::List { item: b, n: m }) => {
            if n != m {
                return Some(format!("{} has {n} items here and {m} there", subject()));
            }
            let inner = if path.ends_with("[…]") { path.to_owned() } else { format!("{path}[…]") };
            difference(a, b, &inner, layout)
        }
        (Type::Enum(a), Type::Enum(b)) if a.repr == b.repr => {
            let missing = a.values.iter().find(|v| !b.values.contains(v));
            let extra = b.values.iter().find(|v| !a.values.contains(v));
            match (missing, extra) {
                (Some((name, value)), _) => Some(format!("{} has value {name}={value} here only", subject())),
                (None, Some((name, value))) => {
                    Some(format!("{} has value {name}={value} there only", subject()))
                }
                (None, None) => None,
            }
        }
        (Type::Struct(a), Type::Struct(b)) => struct_difference(a, b, path, layout),
        _ if client.accepts(server) => None,
        _ => Some(format!("{} is {} here and {} there", subject(), client.title(), server.title())),
    }
}

fn struct_difference(a: &StructType, b: &StructType, path: &str, layout: bool) -> Option<String> {
    let dotted = |f: &Field| if path.is_empty() { f.name.clone() } else { format!("{path}.{}", f.name) };
    for f in &a.fields {
        let name = dotted(f);
        let Some(g) = b.fields.iter().find(|g| g.name == f.name) else {
            return Some(format!("field `{name}` is missing there"));
        };
        let indexed = if matches!(f.ty, Type::Array { .. } | Type::List { .. }) {
            format!("{name}[…]")
        } else {
            name
        };
        let bare = indexed.strip_suffix("[…]").unwrap_or(&indexed);
        if let Some(found) = difference(&f.ty, &g.ty, bare, layout) {
            return Some(found);
        }
        if !Unit::same(&f.unit, &g.unit) {
            return Some(format!("field `{indexed}` has {} here and {} there", unit(&f.unit), unit(&g.unit)));
        }
        if !agree(f, g) {
            return Some(format!(
                "field `{indexed}` is in {} here and {} there",
                frame(&f.frame),
                frame(&g.frame)
            ));
        }
        if layout && f.at != g.at {
            return Some(format!("field `{indexed}` lies at byte {} here and at byte {} there", f.at, g.at));
        }
    }
    if let Some(g) = b.fields.iter().find(|g| a.fields.iter().all(|f| f.name != g.name)) {
        return Some(format!("field `{}` exists there only", dotted(g)));
    }
    let subject = if path.is_empty() { "it".to_owned() } else { format!("field `{path}`") };
    (layout && a.size != b.size)
        .then(|| format!("{subject} is {} bytes here and {} bytes there", a.size, b.size))
}

fn unit(unit: &str) -> String {
    if unit.is_empty() { "no unit".to_owned() } else { format!("unit {unit}") }
}

fn frame(frame: &str) -> String {
    if frame.is_empty() { "no frame".to_owned() } else { format!("frame {frame}") }
}
