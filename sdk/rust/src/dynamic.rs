//! Types known only while running: the type that an untyped port is connected to, read from its description.
//!
//! Invariant: every place lies inside the type's size (checked when the description is read), and any bytes
//! of that size can be read: lengths are clamped, flags are "not zero".

mod json;
mod made;
mod parts;
pub(crate) mod scan;

pub use parts::{AnyField, AnyPart, AnyShape};

use crate::error::Result;
use serde_json::Value as Json;
use trocar_plugin_api::desc::Prim;

/// Deepest nesting of a type.
const MAX_DEPTH: usize = 32;
/// Largest type, bytes; with the smallest, 1, also the limit of the size of one unfolded description.
const MAX_SIZE: usize = 1 << 20;

/// The type behind an untyped port.
///
/// ```
/// use trocar_sdk::AnyType;
/// let ty = AnyType::of_port(r#"{"plain": {"array": "f64", "n": 3}, "types": []}"#).unwrap();
/// let y = ty.place("1").unwrap();
/// let bytes = ty.to_bytes(&vec![1.0, 2.5, 3.0].into()).unwrap();
/// assert_eq!((ty.size(), y.number(&bytes)), (24, Some(2.5)));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct AnyType {
    node: Node,
    /// Format of a frame's bytes ("image"); none for plain samples.
    format: Option<String>,
}

/// Command that an untyped function is bound to.
#[derive(Clone, Debug, PartialEq)]
pub struct AnyCommand {
    /// The command's name within its interface.
    pub name: String,
    /// "void", "write", "read", "qualified_read", "void_return", "write_return".
    pub kind: String,
    /// The argument's type; none without one.
    pub arg: Option<AnyType>,
    /// The result's type; none without one.
    pub ret: Option<AnyType>,
    /// Units of the argument and of the result, empty without.
    pub arg_unit: String,
    /// Unit of the result, empty without.
    pub ret_unit: String,
}

/// Place of a number, found once and read without searching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    at: usize,
    prim: Prim,
}

#[derive(Clone, Debug, PartialEq)]
struct Node {
    shape: Shape,
    /// Bytes.
    size: usize,
}

#[derive(Clone, Debug, PartialEq)]
enum Shape {
    Prim(Prim),
    Enum {
        name: String,
        repr: Prim,
        values: Vec<(String, i64)>,
    },
    Array {
        item: Box<Node>,
        n: usize,
    },
    /// u64 length, then room for `n` items.
    List {
        item: Box<Node>,
        n: usize,
    },
    /// u64 length in bytes, then room for `n` bytes.
    Text {
        n: usize,
    },
    Struct {
        name: String,
        fields: Vec<Field>,
    },
}

#[derive(Clone, Debug, PartialEq)]
struct Field {
    name: String,
    at: usize,
    unit: String,
    node: Node,
}

impl AnyType {
    /// Reads the `type_json` of an input or output.
    ///
    /// # Errors
    /// A sentence where the text is no description of a port's type.
    pub fn of_port(text: &str) -> Result<AnyType> {
        let json: Json = serde_json::from_str(text)?;
        let format = json["format"].as_str().unwrap_or_default().to_string();
        let types = &json["types"];
        if let Some(header) = json.get("frame") {
            return Ok(AnyType { node: node(header, types, 0)?, format: Some(format) });
        }
        let plain = json.get("plain").ok_or("the description of a port says neither plain nor frame")?;
        Ok(AnyType { node: node(plain, types, 0)?, format: None })
    }

    /// Bytes of a plain sample, or of the header of a frame.
    pub fn size(&self) -> usize {
        self.node.size
    }

    /// Returns the format of the bytes behind the header ("image", "spectra"); none for plain samples.
    pub fn format(&self) -> Option<&str> {
        self.format.as_deref()
    }

    /// Returns the place of the number at `path`: field names and positions, such as `pose/position/2`; an
    /// empty path is the value itself. Lists and texts have no fixed places.
    pub fn place(&self, path: &str) -> Option<Place> {
        let (at, node) = self.find(path)?;
        match node.shape {
            Shape::Prim(prim) | Shape::Enum { repr: prim, .. } => Some(Place { at, prim }),
            _ => None,
        }
    }

    /// The unit of the field at `path`, or of the nearest field around it; empty without one.
    pub fn unit(&self, path: &str) -> &str {
        let (mut node, mut unit) = (&self.node, "");
        for step in path.split('/').filter(|s| !s.is_empty()) {
            let Some((_, inside, of)) = node.step(step) else { return "" };
            node = inside;
            unit = if of.is_empty() { unit } else { of };
        }
        unit
    }

    fn find(&self, path: &str) -> Option<(usize, &Node)> {
        let (mut at, mut node) = (0, &self.node);
        for step in path.split('/').filter(|s| !s.is_empty()) {
            let (further, inside, _) = node.step(step)?;
            at += further;
            node = inside;
        }
        Some((at, node))
    }
}

impl AnyCommand {
    /// Reads the `type_json` of a function.
    ///
    /// # Errors
    /// A sentence where the text is no description of a command.
    pub fn of_function(text: &str) -> Result<AnyCommand> {
        let json: Json = serde_json::from_str(text)?;
        let one = |ty: Option<&Json>| match ty {
            None | Some(Json::Null) => Ok(None),
            Some(ty) => node(ty, &json["types"], 0).map(|node| Some(AnyType { node, format: None })),
        };
        let text = |value: &Json| value.as_str().unwrap_or_default().to_string();
        Ok(AnyCommand {
            name: text(&json["name"]),
            kind: text(&json["kind"]),
            arg: one(json.get("arg").and_then(|arg| arg.get("type")))?,
            ret: one(json.get("ret"))?,
            arg_unit: text(&json["arg"]["unit"]),
            ret_unit: text(&json["ret_unit"]),
        })
    }

    /// Bytes of the argument; 0 without one.
    pub fn arg_size(&self) -> usize {
        self.arg.as_ref().map_or(0, AnyType::size)
    }

    /// Bytes of the result; 0 without one.
    pub fn ret_size(&self) -> usize {
        self.ret.as_ref().map_or(0, AnyType::size)
    }
}

impl Place {
    /// Returns the number there; none when `bytes` are too few. Whole numbers above 2^53 lose digits.
    #[inline]
    pub fn number(&self, bytes: &[u8]) -> Option<f64> {
        let b = bytes.get(self.at..self.at + self.prim.size())?;
        Some(match self.prim {
            Prim::Bool => f64::from(b[0] != 0),
            Prim::F32 => f32::from_le_bytes(b.try_into().ok()?).into(),
            Prim::F64 => f64::from_le_bytes(b.try_into().ok()?),
            prim => whole(prim, b) as f64,
        })
    }
}

/// A little-endian whole number; `b` has the primitive's size.
fn whole(prim: Prim, b: &[u8]) -> i128 {
    let mut wide = [0u8; 8];
    wide[..b.len()].copy_from_slice(b);
    let bits = u64::from_le_bytes(wide);
    match prim {
        Prim::I8 => i128::from(bits as u8 as i8),
        Prim::I16 => i128::from(bits as u16 as i16),
        Prim::I32 => i128::from(bits as u32 as i32),
        Prim::I64 => i128::from(bits as i64),
        _ => i128::from(bits),
    }
}

impl Node {
    /// The alignment of its bytes in memory.
    fn align(&self) -> usize {
        match &self.shape {
            Shape::Prim(prim) | Shape::Enum { repr: prim, .. } => prim.size(),
            Shape::Array { item, .. } => item.align(),
            Shape::List { .. } | Shape::Text { .. } => 8,
            Shape::Struct { fields, .. } => fields.iter().map(|f| f.node.align()).max().unwrap_or(1),
        }
    }

    /// One step of a path: the distance, the node there, its unit.
    fn step(&self, step: &str) -> Option<(usize, &Node, &str)> {
        match &self.shape {
            Shape::Struct { fields, .. } => {
                let field = fields.iter().find(|f| f.name == step)?;
                Some((field.at, &field.node, &field.unit))
            }
            Shape::Array { item, n } => {
                let i = step.parse::<usize>().ok().filter(|i| i < n)?;
                Some((i * item.size, item, ""))
            }
            _ => None,
        }
    }
}

fn prim(name: &str) -> Option<Prim> {
    use Prim::{Bool, F32, F64, I8, I16, I32, I64, Stamp, U8, U16, U32, U64};
    let all = [Bool, U8, I8, U16, I16, U32, I32, U64, I64, F32, F64, Stamp];
    all.into_iter().find(|p| p.name() == name)
}

/// A type of the manifest, with the types it names.
fn node(ty: &Json, types: &Json, depth: usize) -> Result<Node> {
    if depth > MAX_DEPTH {
        return Err(format!("a type is nested deeper than {MAX_DEPTH}").into());
    }
    let count = |key: &str| {
        ty[key]
            .as_u64()
            .and_then(|n| usize::try_from(n).ok())
            .ok_or_else(|| format!("`{key}` of {ty} is no count"))
    };
    let made = if let Some(name) = ty.as_str() {
        let prim = prim(name).ok_or_else(|| format!("there is no primitive `{name}`"))?;
        Node { shape: Shape::Prim(prim), size: prim.size() }
    } else if let Some(item) = ty.get("array") {
        let (item, n) = (node(item, types, depth + 1)?, count("n")?);
        Node { size: item.size.saturating_mul(n), shape: Shape::Array { item: item.into(), n } }
    } else if let Some(item) = ty.get("list") {
        let (item, n) = (node(item, types, depth + 1)?, count("n")?);
        let size = item.size.saturating_mul(n).saturating_add(8);
        let size = size.checked_next_multiple_of(8).unwrap_or(usize::MAX);
        Node { size, shape: Shape::List { item: item.into(), n } }
    } else if ty.get("text").is_some() {
        let n = count("text")?;
        let size = n.saturating_add(8).checked_next_multiple_of(8).unwrap_or(usize::MAX);
        Node { size, shape: Shape::Text { n } }
    } else if let Some(name) = ty["ref"].as_str() {
        named(name, types, depth)?
    } else {
        return Err(format!("{ty} is no type").into());
    };
    if made.size == 0 || made.size > MAX_SIZE {
        return Err(format!("a type of {} bytes: it has 1 to {MAX_SIZE} bytes", made.size).into());
    }
    Ok(made)
}

fn named(name: &str, types: &Json, depth: usize) -> Result<Node> {
    let mut all = types.as_array().into_iter().flatten();
    let ty = all.find(|t| t["name"] == name).ok_or_else(|| format!("the type `{name}` is not described"))?;
    let size = ty["size"].as_u64().and_then(|n| usize::try_from(n).ok()).unwrap_or_default();
    if let Some(repr) = ty["enum"].as_str() {
        let repr = prim(repr).ok_or_else(|| format!("there is no primitive `{repr}`"))?;
        let value = |v: &Json| Some((v["name"].as_str()?.to_string(), v["value"].as_i64()?));
        let values = ty["values"].as_array().into_iter().flatten().filter_map(value).collect();
        let name = name.to_string();
        return Ok(Node { shape: Shape::Enum { name, repr, values }, size: repr.size() });
    }
    let mut fields = Vec::new();
    for f in ty["fields"].as_array().into_iter().flatten() {
        let node = node(&f["type"], types, depth + 1)?;
        let at = f["at"].as_u64().and_then(|n| usize::try_from(n).ok()).unwrap_or(usize::MAX);
        let text = |key: &str| f[key].as_str().unwrap_or_default().to_string();
        if at.checked_add(node.size).is_none_or(|end| end > size) {
            return Err(format!("field `{}` lies beyond the {size} bytes of `{name}`", text("name")).into());
        }
        fields.push(Field { name: text("name"), at, unit: text("unit"), node });
    }
    Ok(Node { shape: Shape::Struct { name: name.to_string(), fields }, size })
}
