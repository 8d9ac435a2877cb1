//! JSON ↔ plain old data, by the type's description.
//!
//! Invariant: `decode` accepts any bytes without a panic and refuses what is not a value of the type; what
//! `encode` writes, `decode` reads back. Little endian, offsets from the description.

mod get;
mod interpolate;
mod put;
mod range;

pub use get::from_float;
pub use interpolate::interpolate;
pub use range::check_range;

use std::fmt;

use serde_json::Value;

use crate::Type;

/// Largest payload that is converted, bytes. Bulk data travels as frames, not as JSON.
const MAX_BYTES: usize = 64 << 20;
/// Whole numbers from here on lose digits in JSON that is read into doubles, as that of gRPC is.
pub(crate) const EXACT: u64 = 1 << 53;
/// The fault of a whole number that came as such a double.
pub(crate) const ROUNDED: &str =
    "may have been rounded on its way: from 2^53 on write a whole number as a text, \"9007199254740993\"";

/// Why a value cannot be converted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ValueError {
    /// JSON pointer to the part in question; empty = the whole value.
    pub pointer: String,
    pub what: String,
}

impl fmt::Display for ValueError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (pointer, what) = (&self.pointer, &self.what);
        if pointer.is_empty() { f.write_str(what) } else { write!(f, "{pointer}: {what}") }
    }
}

impl std::error::Error for ValueError {}

type Res<T> = Result<T, ValueError>;

/// Place of the conversion in the value; a chain on the stack, so that the good case allocates nothing for
/// it.
#[derive(Clone, Copy)]
enum At<'a> {
    Top,
    Key(&'a At<'a>, &'a str),
    Item(&'a At<'a>, usize),
}

impl At<'_> {
    fn pointer(&self) -> String {
        match self {
            At::Top => String::new(),
            At::Key(up, key) => format!("{}/{}", up.pointer(), key.replace('~', "~0").replace('/', "~1")),
            At::Item(up, i) => format!("{}/{i}", up.pointer()),
        }
    }

    fn err<T>(&self, what: impl Into<String>) -> Res<T> {
        Err(ValueError { pointer: self.pointer(), what: what.into() })
    }
}

/// The bytes of `value` as a `ty`.
///
/// Integers may be strings (for those above 2^53), floats may be "NaN", "Infinity", "-Infinity", enums are
/// names or numbers. Every field of a struct must be there, except stamps (0) and lists and texts (empty).
///
/// # Errors
/// With a pointer to the first part that does not fit.
pub fn encode(ty: &Type, value: &Value) -> Res<Vec<u8>> {
    let mut out = vec![0; checked_size(ty)?];
    put::put(ty, value, &mut out, &At::Top)?;
    Ok(out)
}

/// The value in `bytes`, which must be exactly one `ty`.
///
/// # Errors
/// Wrong length, a bool that is neither 0 nor 1, a list longer than its room, text that is not UTF-8.
pub fn decode(ty: &Type, bytes: &[u8]) -> Res<Value> {
    let size = checked_size(ty)?;
    if bytes.len() != size {
        return At::Top.err(format!("{} bytes are not a {}, which has {size}", bytes.len(), ty.title()));
    }
    get::get(ty, bytes, &At::Top)
}

fn checked_size(ty: &Type) -> Res<usize> {
    let size = ty.size();
    if size > MAX_BYTES {
        return At::Top
            .err(format!("a {} has {size} bytes; at most {MAX_BYTES} can be converted", ty.title()));
    }
    Ok(size)
}

/// Answer to a description that reaches beyond its own type; descriptions come from plugins and may be wrong.
const BEYOND: &str = "the type's description reaches beyond its own size";

fn special(text: &str) -> Option<f64> {
    match text {
        "NaN" => Some(f64::NAN),
        "Infinity" => Some(f64::INFINITY),
        "-Infinity" => Some(f64::NEG_INFINITY),
        _ => None,
    }
}

/// The value as people typed it, cut short.
fn brief(value: &Value) -> String {
    let text = match value {
        Value::Array(items) => return format!("a list of {}", items.len()),
        Value::Object(_) => return "an object".to_owned(),
        other => other.to_string(),
    };
    if text.chars().count() > 40 { text.chars().take(40).chain("…".chars()).collect() } else { text }
}
