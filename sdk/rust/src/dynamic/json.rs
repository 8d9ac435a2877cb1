//! Values of types known only while running, to and from JSON, spelled as grpcurl and the other tools spell
//! them.
//!
//! Invariant: values read from bytes give the same bytes when written, unless the bytes were no valid value.

use super::{AnyType, Field, Node, Shape, whole};
use crate::error::Result;
use serde_json::{Map, Number, Value as Json};
use trocar_plugin_api::desc::Prim;

/// Whole numbers beyond ±2^53 travel as text: JSON numbers are doubles elsewhere.
const EXACT: i128 = 1 << 53;

impl AnyType {
    /// The value in `bytes`; none when they have not this type's size.
    pub fn to_json(&self, bytes: &[u8]) -> Option<Json> {
        (bytes.len() == self.size()).then(|| read(&self.node, bytes))
    }

    /// Returns the bytes of a value. Stamps, lists, texts and fields called `reserved` may be left out.
    ///
    /// # Errors
    /// The value does not fit the type: the sentence says where.
    pub fn to_bytes(&self, value: &Json) -> Result<Vec<u8>> {
        let mut bytes = vec![0; self.size()];
        write(&self.node, value, &mut bytes, "")?;
        Ok(bytes)
    }
}

/// `bytes` has at least the node's size: the description was checked when it was read.
fn read(node: &Node, bytes: &[u8]) -> Json {
    match &node.shape {
        Shape::Prim(prim) => read_prim(*prim, &bytes[..prim.size()]),
        Shape::Enum { repr, values, .. } => {
            let n = whole(*repr, &bytes[..repr.size()]);
            let known = values.iter().find(|(_, v)| i128::from(*v) == n);
            known.map_or_else(
                || read_prim(*repr, &bytes[..repr.size()]),
                |(name, _)| Json::from(name.as_str()),
            )
        }
        Shape::Struct { fields, .. } => {
            let field = |f: &Field| (f.name.clone(), read(&f.node, &bytes[f.at..]));
            Json::Object(fields.iter().map(field).collect::<Map<_, _>>())
        }
        Shape::Array { item, n } => items(item, *n, bytes),
        Shape::List { item, n } => items(item, length(bytes, *n), &bytes[8..]),
        Shape::Text { n } => {
            Json::from(String::from_utf8_lossy(&bytes[8..8 + length(bytes, *n)]).into_owned())
        }
    }
}

/// The length before a list or text, clamped to its room.
fn length(bytes: &[u8], room: usize) -> usize {
    whole(Prim::U64, &bytes[..8]).min(room as i128) as usize
}

fn items(item: &Node, n: usize, bytes: &[u8]) -> Json {
    Json::Array((0..n).map(|i| read(item, &bytes[i * item.size..])).collect())
}

fn read_prim(prim: Prim, b: &[u8]) -> Json {
    let float = |n: f64| match Number::from_f64(n) {
        Some(number) => Json::Number(number),
        None if n.is_nan() => Json::from("NaN"),
        None if n > 0.0 => Json::from("Infinity"),
        None => Json::from("-Infinity"),
    };
    match (prim, b) {
        (Prim::Bool, _) => Json::from(b[0] != 0),
        (Prim::F64, &[a, b, c, d, e, f, g, h]) => float(f64::from_le_bytes([a, b, c, d, e, f, g, h])),
        (Prim::F32, &[a, b, c, d]) => {
            let n = f32::from_le_bytes([a, b, c, d]);
            // 0.1f32 should read 0.1, as long as it comes back as the same f32.
            let short = n.to_string().parse::<f64>().unwrap_or(f64::from(n));
            float(if (short as f32).to_bits() == n.to_bits() { short } else { f64::from(n) })
        }
        _ => {
            let n = whole(prim, b);
            if n.abs() > EXACT {
                return Json::from(n.to_string());
            }
            Json::from(n as i64)
        }
    }
}

/// Writes `value` to `out`, which has at least the node's size; `at` is the path to it, for the refusal.
fn write(node: &Node, value: &Json, out: &mut [u8], at: &str) -> Result {
    match &node.shape {
        Shape::Prim(prim) => match prim_bytes(*prim, value) {
            Ok(bytes) => out[..prim.size()].copy_from_slice(&bytes[..prim.size()]),
            Err(wanted) => return refused(at, &format!("{value} is no {wanted}")),
        },
        Shape::Enum { repr, values, .. } => write_enum(*repr, values, value, out, at)?,
        Shape::Array { item, n } => {
            let Some(items) = value.as_array().filter(|items| items.len() == *n) else {
                return refused(at, &format!("{n} items are wanted"));
            };
            write_items(item, items, out, at)?;
        }
        Shape::List { item, n } => {
            let Some(items) = value.as_array().filter(|items| items.len() <= *n) else {
                return refused(at, &format!("a list of at most {n} items is wanted"));
            };
            out[..8].copy_from_slice(&(items.len() as u64).to_le_bytes());
            write_items(item, items, &mut out[8..], at)?;
        }
        Shape::Text { n } => {
            let Some(text) = value.as_str().filter(|text| text.len() <= *n) else {
                return refused(at, &format!("a text of at most {n} bytes is wanted"));
            };
            out[..8].copy_from_slice(&(text.len() as u64).to_le_bytes());
            out[8..8 + text.len()].copy_from_slice(text.as_bytes());
        }
        Shape::Struct { name, fields } => write_struct(name, fields, value, out, at)?,
    }
    Ok(())
}

/// The refusal of the value at this path.
fn refused(at: &str, why: &str) -> Result {
    let at = if at.is_empty() { "value" } else { at.trim_start_matches('/') };
    Err(format!("{at}: {why}").into())
}

/// Named values: by name, or by number.
fn write_enum(repr: Prim, values: &[(String, i64)], value: &Json, out: &mut [u8], at: &str) -> Result {
    let named = value.as_str().and_then(|text| values.iter().find(|(name, _)| name == text));
    let number = named.map(|(_, n)| Json::from(*n));
    let Ok(bytes) = prim_bytes(repr, number.as_ref().unwrap_or(value)) else {
        let names: Vec<&str> = values.iter().map(|(name, _)| name.as_str()).collect();
        return refused(at, &format!("{value} is none of {}", names.join(", ")));
    };
    out[..repr.size()].copy_from_slice(&bytes[..repr.size()]);
    Ok(())
}

fn write_struct(name: &str, fields: &[Field], value: &Json, out: &mut [u8], at: &str) -> Result {
    let Some(object) = value.as_object() else {
        return refused(at, &format!("an object with the fields of {name} is wanted"));
    };
    if let Some(key) = object.keys().find(|key| fields.iter().all(|f| f.name != **key)) {
        let names: Vec<&str> = fields.iter().map(|f| f.name.as_str()).collect();
        return refused(at, &format!("{name} has no field `{key}`; it has {}", names.join(", ")));
    }
    for f in fields {
        match object.get(&f.name) {
            Some(value) => write(&f.node, value, &mut out[f.at..], &format!("{at}/{}", f.name))?,
            None if may_miss(f) => {}
            None => return refused(at, &format!("field `{}` of {name} is missing", f.name)),
        }
    }
    Ok(())
}

/// Tells whether a field may be left out: its zero bytes are a value that means "none".
fn may_miss(field: &Field) -> bool {
    let shape = &field.node.shape;
    matches!(shape, Shape::Prim(Prim::Stamp) | Shape::List { .. } | Shape::Text { .. })
        || field.name.starts_with("reserved")
}

fn write_items(item: &Node, items: &[Json], out: &mut [u8], at: &str) -> Result {
    for (i, value) in items.iter().enumerate() {
        write(item, value, &mut out[i * item.size..], &format!("{at}/{i}"))?;
    }
    Ok(())
}

/// Returns the little-endian bytes, the low ones; or what was wanted.
fn prim_bytes(prim: Prim, value: &Json) -> Result<[u8; 8], String> {
    let float = || match value {
        Json::Number(n) => n.as_f64(),
        Json::String(s) => match s.as_str() {
            "NaN" => Some(f64::NAN),
            "Infinity" => Some(f64::INFINITY),
            "-Infinity" => Some(f64::NEG_INFINITY),
            _ => None,
        },
        _ => None,
    };
    let wanted = || prim.name().to_string();
    match prim {
        Prim::Bool => value.as_bool().map(|b| u64::from(b).to_le_bytes()).ok_or_else(wanted),
        Prim::F64 => float().map(f64::to_le_bytes).ok_or_else(wanted),
        Prim::F32 => {
            let wide = float().ok_or_else(wanted)?;
            if wide.is_finite() && !(wide as f32).is_finite() {
                return Err(wanted());
            }
            Ok(u64::from((wide as f32).to_bits()).to_le_bytes())
        }
        _ => {
            let n = match value {
                Json::String(text) => text.parse::<i128>().ok(),
                Json::Number(n) => n.as_i64().map(i128::from).or(n.as_u64().map(i128::from)).or_else(|| {
                    n.as_f64().filter(|f| f.fract() == 0.0 && f.abs() <= EXACT as f64).map(|f| f as i128)
                }),
                _ => None,
            };
            let bytes = n.ok_or_else(wanted)?.to_le_bytes();
            let low = [bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]];
            // A number that does not come back as itself does not fit.
            if Some(whole(prim, &low[..prim.size()])) == n { Ok(low) } else { Err(wanted()) }
        }
    }
}
