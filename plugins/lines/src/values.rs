//! Single values: from a cell or from JSON to the bytes of a type.
//!
//! Invariant: a value is taken exactly or not at all: NaN, infinity, what is out of range and what would be
//! cut are refused.

use trocar_sdk::serde_json::Value as Json;

use crate::described::Kind;

/// Characters of a value that are shown.
const SHOWN: usize = 40;

/// The cells of a line: apart by `;`, or else by `,`, a tab, or blanks.
pub(crate) fn split(text: &str) -> Vec<&str> {
    match [';', ',', '\t'].into_iter().find(|sign| text.contains(*sign)) {
        Some(sign) => text.split(sign).map(str::trim).collect(),
        None => text.split_whitespace().collect(),
    }
}

pub(crate) fn shown(value: impl std::fmt::Display) -> String {
    let text: String = value.to_string().chars().take(SHOWN).collect();
    format!("`{}`", text.escape_debug())
}

pub(crate) fn put(kind: Kind, cell: &str, to: &mut [u8]) -> Result<(), String> {
    if cell.is_empty() {
        return Err("empty".into());
    }
    match kind {
        Kind::F64 => match cell.parse::<f64>() {
            Ok(number) => real(kind, number, to),
            Err(_) => Err(format!("{} is not a number", shown(cell))),
        },
        // Read at once: rounded twice, it might be the neighbour of what was written.
        Kind::F32 => match (cell.parse::<f32>(), cell.parse::<f64>()) {
            (Ok(narrow), Ok(number)) if narrow.is_finite() || !number.is_finite() => {
                real(Kind::F64, number, &mut [0; 8])?;
                copy(to, &narrow.to_le_bytes())
            }
            (Ok(_), Ok(number)) => Err(format!("{number} is too large for f32")),
            _ => Err(format!("{} is not a number", shown(cell))),
        },
        Kind::Bool => match cell {
            "0" | "false" => copy(to, &[0]),
            "1" | "true" => copy(to, &[1]),
            _ => Err(format!("{} is not one of 0, 1, false, true", shown(cell))),
        },
        Kind::Text(n) => words(n, cell, to),
        _ => {
            let exact = cell.parse::<i128>().ok();
            whole(kind, exact.or_else(|| cell.parse().ok().and_then(no_fraction)), shown(cell), to)
        }
    }
}

pub(crate) fn put_json(kind: Kind, value: &Json, to: &mut [u8]) -> Result<(), String> {
    match kind {
        Kind::F64 | Kind::F32 => match value.as_f64() {
            Some(number) => real(kind, number, to),
            None => Err(format!("{} is not a number", shown(value))),
        },
        Kind::Bool => match value {
            Json::Bool(on) => copy(to, &[u8::from(*on)]),
            _ => Err(format!("{} is not true or false", shown(value))),
        },
        Kind::Text(n) => match value.as_str() {
            Some(text) => words(n, text, to),
            None => Err(format!("{} is not a text", shown(value))),
        },
        _ => {
            let exact = value.as_i64().map(i128::from).or(value.as_u64().map(i128::from));
            // Beyond 2^53 whole numbers travel as text.
            let text = || value.as_str().and_then(|text| text.parse().ok());
            whole(
                kind,
                exact.or_else(text).or_else(|| value.as_f64().and_then(no_fraction)),
                shown(value),
                to,
            )
        }
    }
}

fn real(kind: Kind, number: f64, to: &mut [u8]) -> Result<(), String> {
    if !number.is_finite() {
        return Err(format!("{number} is not a finite number"));
    }
    if kind == Kind::F64 {
        return copy(to, &number.to_le_bytes());
    }
    let narrow = number as f32;
    if narrow.is_finite() {
        copy(to, &narrow.to_le_bytes())
    } else {
        Err(format!("{number} is too large for f32"))
    }
}

/// A whole number that was written with a point or an exponent.
fn no_fraction(number: f64) -> Option<i128> {
    (number.fract() == 0.0 && number.abs() <= (1u64 << 53) as f64).then_some(number as i128)
}

fn whole(kind: Kind, number: Option<i128>, shown: String, to: &mut [u8]) -> Result<(), String> {
    let Some(number) = number else { return Err(format!("{shown} is not a whole number")) };
    let range = |name: &str| format!("{shown} does not fit into {name}");
    match kind {
        Kind::I64 => copy(to, &i64::try_from(number).map_err(|_| range("i64"))?.to_le_bytes()),
        Kind::I32 => copy(to, &i32::try_from(number).map_err(|_| range("i32"))?.to_le_bytes()),
        Kind::U64 => copy(to, &u64::try_from(number).map_err(|_| range("u64"))?.to_le_bytes()),
        _ => copy(to, &u32::try_from(number).map_err(|_| range("u32"))?.to_le_bytes()),
    }
}

fn words(n: usize, text: &str, to: &mut [u8]) -> Result<(), String> {
    let bytes = text.as_bytes();
    let Some((len, room)) = to.split_at_mut_checked(8).filter(|_| bytes.len() <= n) else {
        return Err(format!("{} is longer than {n} B", shown(text)));
    };
    copy(len, &(bytes.len() as u64).to_le_bytes())?;
    copy(room.get_mut(..bytes.len()).unwrap_or_default(), bytes)
}

fn copy(to: &mut [u8], bytes: &[u8]) -> Result<(), String> {
    if to.len() != bytes.len() {
        return Err("there is no room for it".into());
    }
    to.copy_from_slice(bytes);
    Ok(())
}
