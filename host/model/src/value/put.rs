//! JSON → bytes.
//!
//! Invariant: `out` is zero when it comes in, so that absent parts (stamps, tails of lists and texts) are
//! zero too.

use serde_json::Value;

use super::{At, BEYOND, EXACT, Res, brief, special};
use crate::refusal::brief as cut;
use crate::{EnumType, Prim, StructType, Type, nearest};

pub(super) fn put(ty: &Type, value: &Value, out: &mut [u8], here: &At<'_>) -> Res<()> {
    match ty {
        Type::Prim(p) => put_prim(*p, value, out, here),
        Type::Enum(e) => put_enum(e, value, out, here),
        Type::Struct(s) => put_struct(s, value, out, here),
        Type::Array { item, n } => {
            let items = array(value, here)?;
            if items.len() != *n {
                return here.err(format!("it has {} items; exactly {n} are wanted", items.len()));
            }
            put_items(item, items, out, here)
        }
        Type::List { item, n } => {
            let items = array(value, here)?;
            if items.len() > *n {
                return here.err(format!("it has {} items; there is room for {n}", items.len()));
            }
            part_mut(out, 0, 8, here)?.copy_from_slice(&(items.len() as u64).to_le_bytes());
            put_items(item, items, out.get_mut(8..).unwrap_or_default(), here)
        }
        Type::Text { n } => {
            let Value::String(text) = value else {
                return here.err(format!("{} is not a text", brief(value)));
            };
            if text.len() > *n {
                return here.err(format!("the text has {} bytes; there is room for {n}", text.len()));
            }
            part_mut(out, 0, 8, here)?.copy_from_slice(&(text.len() as u64).to_le_bytes());
            part_mut(out, 8, text.len(), here)?.copy_from_slice(text.as_bytes());
            Ok(())
        }
    }
}

fn array<'a>(value: &'a Value, here: &At<'_>) -> Res<&'a Vec<Value>> {
    match value {
        Value::Array(items) => Ok(items),
        other => here.err(format!("{} is not a list", brief(other))),
    }
}

fn put_items(item: &Type, items: &[Value], out: &mut [u8], here: &At<'_>) -> Res<()> {
    let size = item.size();
    for (i, value) in items.iter().enumerate() {
        let here = At::Item(here, i);
        put(item, value, part_mut(out, i.saturating_mul(size), size, &here)?, &here)?;
    }
    Ok(())
}

fn put_struct(s: &StructType, value: &Value, out: &mut [u8], here: &At<'_>) -> Res<()> {
    let Value::Object(map) = value else {
        return here.err(format!("{} is not an object with the fields of {}", brief(value), s.name));
    };
    let names = || s.fields.iter().map(|f| f.name.as_str());
    for key in map.keys() {
        if !names().any(|n| n == key) {
            let hint = match nearest(&cut(key), names()) {
                Some(name) => format!("did you mean `{name}`?"),
                None => format!("it has {}", names().collect::<Vec<_>>().join(", ")),
            };
            let key = cut(key);
            return At::Key(here, &key).err(format!("{} has no field `{key}`; {hint}", s.name));
        }
    }
    for f in &s.fields {
        let here = At::Key(here, &f.name);
        let room = part_mut(out, f.at, f.ty.size(), &here)?;
        match map.get(&f.name) {
            Some(value) => put(&f.ty, value, room, &here)?,
            // The bytes are already zero, which is an invalid stamp, an empty list, an empty text, a gap.
            None if matches!(f.ty, Type::Prim(Prim::Stamp) | Type::List { .. } | Type::Text { .. }) => {}
            None if is_gap(&f.name) => {}
            None => {
                let unit = if f.unit.is_empty() { String::new() } else { format!(" in {}", f.unit) };
                return here.err(format!(
                    "field `{}` of {} is missing ({}{unit})",
                    f.name,
                    s.name,
                    f.ty.title()
                ));
            }
        }
    }
    Ok(())
}

/// A field that only fills the room up to the next one, by its name.
fn is_gap(name: &str) -> bool {
    name.starts_with("reserved")
}

fn put_enum(e: &EnumType, value: &Value, out: &mut [u8], here: &At<'_>) -> Res<()> {
    if let Value::String(name) = value {
        if let Some((_, number)) = e.values.iter().find(|(n, _)| n == name) {
            return put_prim(e.repr, &Value::from(*number), out, here);
        }
        if name.parse::<i128>().is_err() {
            let names = || e.values.iter().map(|(n, _)| n.as_str());
            let name = &*cut(name);
            let hint = match nearest(name, names()) {
                Some(name) => format!("did you mean `{name}`?"),
                None => format!("it has {}", names().collect::<Vec<_>>().join(", ")),
            };
            return here.err(format!("{} has no value `{name}`; {hint}", e.name));
        }
    }
    put_prim(e.repr, value, out, here)
}

fn put_prim(p: Prim, value: &Value, out: &mut [u8], here: &At<'_>) -> Res<()> {
    let bytes: [u8; 8] = match p {
        Prim::Bool => match value {
            Value::Bool(b) => u64::from(*b).to_le_bytes(),
            other => return here.err(format!("{} is neither true nor false", brief(other))),
        },
        Prim::F32 => {
            let wide = float(value, here)?;
            let narrow = wide as f32;
            if wide.is_finite() && !narrow.is_finite() {
                return here.err(format!("{wide} does not fit f32"));
            }
            u64::from(narrow.to_bits()).to_le_bytes()
        }
        Prim::F64 => float(value, here)?.to_le_bytes(),
        _ => {
            let (low, high) = limits(p);
            let number = integer(value, p, here)?;
            if number < low || number > high {
                return here.err(format!("{number} does not fit {}, which holds {low} to {high}", p.name()));
            }
            // Two's complement: the low bytes of the wide number are the narrow one.
            let wide = number.to_le_bytes();
            [wide[0], wide[1], wide[2], wide[3], wide[4], wide[5], wide[6], wide[7]]
        }
    };
    part_mut(out, 0, p.size(), here)?.copy_from_slice(&bytes[..p.size()]);
    Ok(())
}

fn limits(p: Prim) -> (i128, i128) {
    match p {
        Prim::Bool => (0, 1),
        Prim::U8 => (0, u8::MAX.into()),
        Prim::U16 => (0, u16::MAX.into()),
        Prim::U32 => (0, u32::MAX.into()),
        Prim::U64 | Prim::Stamp => (0, u64::MAX.into()),
        Prim::I8 => (i8::MIN.into(), i8::MAX.into()),
        Prim::I16 => (i16::MIN.into(), i16::MAX.into()),
        Prim::I32 => (i32::MIN.into(), i32::MAX.into()),
        Prim::I64 => (i64::MIN.into(), i64::MAX.into()),
        Prim::F32 | Prim::F64 => (i128::MIN, i128::MAX),
    }
}

fn integer(value: &Value, p: Prim, here: &At<'_>) -> Res<i128> {
    let wanted = || format!("{} is not a whole number ({})", brief(value), p.name());
    match value {
        Value::Number(n) => match (n.as_i64(), n.as_u64(), n.as_f64()) {
            (Some(i), _, _) => Ok(i.into()),
            (_, Some(u), _) => Ok(u.into()),
            // gRPC's JSON numbers are doubles: 30 arrives as 30.0.
            (_, _, Some(f)) if f.fract() == 0.0 && f.abs() < EXACT as f64 => Ok(f as i128),
            (_, _, Some(f)) if f.fract() == 0.0 => here.err(format!("{f} {}", super::ROUNDED)),
            _ => here.err(wanted()),
        },
        Value::String(s) => s.parse().or_else(|_| here.err(wanted())),
        _ => here.err(wanted()),
    }
}

fn float(value: &Value, here: &At<'_>) -> Res<f64> {
    match value {
        Value::Number(n) => {
            n.as_f64().ok_or(()).or_else(|()| here.err(format!("{n} is not a number a f64 can hold")))
        }
        Value::String(s) => special(s).ok_or(()).or_else(|()| {
            here.err(format!(
                "{} is not a number (texts allowed: \"NaN\", \"Infinity\", \"-Infinity\")",
                brief(value)
            ))
        }),
        other => here.err(format!("{} is not a number", brief(other))),
    }
}

/// The part of `all` that a description claims.
fn part_mut<'a>(all: &'a mut [u8], at: usize, len: usize, here: &At<'_>) -> Res<&'a mut [u8]> {
    match at.checked_add(len).and_then(|end| all.get_mut(at..end)) {
        Some(bytes) => Ok(bytes),
        None => here.err(BEYOND),
    }
}
