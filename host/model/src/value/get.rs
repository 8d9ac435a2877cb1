//! Bytes → JSON.
//!
//! Invariant: no bytes and no description make this panic.

use serde_json::{Map, Number, Value};

use super::{At, BEYOND, EXACT, Res};
use crate::{Prim, Type};

/// Most items without size that are listed; with a size the bytes themselves are the limit.
const MAX_EMPTY: usize = 1 << 16;

pub(super) fn get(ty: &Type, bytes: &[u8], here: &At<'_>) -> Res<Value> {
    match ty {
        Type::Prim(p) => get_prim(*p, bytes, here),
        Type::Enum(e) => {
            let number = get_prim(e.repr, bytes, here)?;
            let known = number.as_i64().and_then(|n| e.values.iter().find(|(_, v)| *v == n));
            Ok(known.map_or(number, |(name, _)| Value::from(name.as_str())))
        }
        Type::Struct(s) => {
            let mut map = Map::new();
            for f in &s.fields {
                let here = At::Key(here, &f.name);
                map.insert(f.name.clone(), get(&f.ty, part(bytes, f.at, f.ty.size(), &here)?, &here)?);
            }
            Ok(Value::Object(map))
        }
        Type::Array { item, n } => get_items(item, *n, bytes, here),
        Type::List { item, n } => {
            let count = length(bytes, *n, "items", here)?;
            get_items(item, count, bytes.get(8..).unwrap_or_default(), here)
        }
        Type::Text { n } => {
            let count = length(bytes, *n, "bytes of text", here)?;
            match std::str::from_utf8(part(bytes, 8, count, here)?) {
                Ok(text) => Ok(Value::from(text)),
                Err(e) => here.err(format!("the text is not UTF-8 at byte {}", e.valid_up_to())),
            }
        }
    }
}

fn length(bytes: &[u8], room: usize, of: &str, here: &At<'_>) -> Res<usize> {
    let count = u64::from_le_bytes(fixed(bytes, here)?);
    match usize::try_from(count) {
        Ok(count) if count <= room => Ok(count),
        _ => here.err(format!("its length says {count} {of}; there is room for {room}")),
    }
}

fn get_items(item: &Type, n: usize, bytes: &[u8], here: &At<'_>) -> Res<Value> {
    let size = item.size();
    if size == 0 && n > MAX_EMPTY {
        return here.err(format!("{n} items without size cannot be converted"));
    }
    let one = |i: usize| {
        let here = At::Item(here, i);
        get(item, part(bytes, i.saturating_mul(size), size, &here)?, &here)
    };
    (0..n).map(one).collect::<Res<Vec<Value>>>().map(Value::Array)
}

fn fixed<const N: usize>(bytes: &[u8], here: &At<'_>) -> Res<[u8; N]> {
    match part(bytes, 0, N, here)?.try_into() {
        Ok(array) => Ok(array),
        Err(_) => here.err(BEYOND),
    }
}

fn get_prim(p: Prim, b: &[u8], here: &At<'_>) -> Res<Value> {
    Ok(match p {
        Prim::Bool => match fixed::<1>(b, here)?[0] {
            0 => Value::Bool(false),
            1 => Value::Bool(true),
            other => return here.err(format!("byte {other} is neither false (0) nor true (1)")),
        },
        Prim::U8 => Value::from(u8::from_le_bytes(fixed(b, here)?)),
        Prim::I8 => Value::from(i8::from_le_bytes(fixed(b, here)?)),
        Prim::U16 => Value::from(u16::from_le_bytes(fixed(b, here)?)),
        Prim::I16 => Value::from(i16::from_le_bytes(fixed(b, here)?)),
        Prim::U32 => Value::from(u32::from_le_bytes(fixed(b, here)?)),
        Prim::I32 => Value::from(i32::from_le_bytes(fixed(b, here)?)),
        Prim::U64 | Prim::Stamp => {
            let n = u64::from_le_bytes(fixed(b, here)?);
            if n > EXACT { Value::from(n.to_string()) } else { Value::from(n) }
        }
        Prim::I64 => {
            let n = i64::from_le_bytes(fixed(b, here)?);
            if n.unsigned_abs() > EXACT { Value::from(n.to_string()) } else { Value::from(n) }
        }
        Prim::F32 => {
            let n = f32::from_le_bytes(fixed(b, here)?);
            // 0.1f32 should read 0.1, not 0.10000000149011612, as long as it comes back as the same f32.
            let short = n.to_string().parse::<f64>().unwrap_or(f64::from(n));
            from_float(if (short as f32).to_bits() == n.to_bits() { short } else { f64::from(n) })
        }
        Prim::F64 => from_float(f64::from_le_bytes(fixed(b, here)?)),
    })
}

/// A number as JSON has it; NaN and the infinities, which it has not, as texts.
pub fn from_float(n: f64) -> Value {
    match Number::from_f64(n) {
        Some(number) => Value::Number(number),
        None if n.is_nan() => Value::from("NaN"),
        None if n > 0.0 => Value::from("Infinity"),
        None => Value::from("-Infinity"),
    }
}

/// The part of `all` that a description claims.
fn part<'a>(all: &'a [u8], at: usize, len: usize, here: &At<'_>) -> Res<&'a [u8]> {
    match at.checked_add(len).and_then(|end| all.get(at..end)) {
        Some(bytes) => Ok(bytes),
        None => here.err(BEYOND),
    }
}
