//! Configuration from JSON: read whole, checked against the same description the manifest shows, then swapped
//! in.
//!
//! Invariant: a value outside its limits is refused with its unit ("cutoff_hz: 1000 Hz is above 400 Hz"),
//! never clamped.

use crate::error::Result;
use serde_json::{Map, Value};
use trocar_plugin_api::desc::ConfigFieldDesc;

/// A JSON object.
pub type JsonObject = Map<String, Value>;

/// A configuration struct: made by `#[derive(Config)]`.
pub trait Config: Sized + Send + 'static {
    /// The fields in the order of their declaration, as the manifest describes them.
    const FIELDS: &'static [ConfigFieldDesc];
    /// Reads the whole configuration; a field left out has its default.
    ///
    /// # Errors
    /// Names the field, what is wrong with it and what it may be.
    fn parse(object: &JsonObject) -> Result<Self>;
    /// Defaults where there are some, zeros elsewhere: the content of a component before it is configured.
    fn unset() -> Self;
}

/// A type a configuration field may have.
pub trait ConfigField: Sized + Send + 'static {
    /// The value, or what it should have been ("a number").
    #[doc(hidden)]
    fn read(value: &Value) -> Result<Self, &'static str>;
    #[doc(hidden)]
    fn zero() -> Self;
}

macro_rules! numbers {
    ($wanted:literal, $as:ident: $($ty:ty),*) => {$(
        impl ConfigField for $ty {
            fn read(value: &Value) -> Result<Self, &'static str> {
                value.$as().and_then(|n| <$ty>::try_from(n).ok()).ok_or($wanted)
            }
            fn zero() -> Self { 0 as $ty }
        }
    )*};
}
numbers!("a whole number that fits", as_u64: u8, u16, u32, u64, usize);
numbers!("a whole number that fits", as_i64: i8, i16, i32, i64, isize);
numbers!("a number", as_f64: f64);

impl ConfigField for f32 {
    fn read(value: &Value) -> Result<Self, &'static str> {
        value.as_f64().map(|n| n as f32).ok_or("a number")
    }
    fn zero() -> Self {
        0.0
    }
}

impl ConfigField for bool {
    fn read(value: &Value) -> Result<Self, &'static str> {
        value.as_bool().ok_or("true or false")
    }
    fn zero() -> Self {
        false
    }
}

impl ConfigField for String {
    fn read(value: &Value) -> Result<Self, &'static str> {
        value.as_str().map(str::to_string).ok_or("text")
    }
    fn zero() -> Self {
        String::new()
    }
}

impl<T: ConfigField> ConfigField for Vec<T> {
    fn read(value: &Value) -> Result<Self, &'static str> {
        value.as_array().ok_or("a list")?.iter().map(T::read).collect()
    }
    fn zero() -> Self {
        Vec::new()
    }
}

impl<T: ConfigField, const N: usize> ConfigField for [T; N] {
    fn read(value: &Value) -> Result<Self, &'static str> {
        Vec::<T>::read(value)?.try_into().map_err(|_| "a list of the right length")
    }
    fn zero() -> Self {
        core::array::from_fn(|_| T::zero())
    }
}

impl<T: ConfigField> ConfigField for Option<T> {
    fn read(value: &Value) -> Result<Self, &'static str> {
        if value.is_null() { Ok(None) } else { T::read(value).map(Some) }
    }
    fn zero() -> Self {
        None
    }
}

/// Refuses fields that do not exist.
pub fn known(object: &JsonObject, fields: &[ConfigFieldDesc]) -> Result {
    for key in object.keys() {
        if !fields.iter().any(|f| f.name == key) {
            let names: Vec<&str> = fields.iter().map(|f| f.name).collect();
            let there = if names.is_empty() { "nothing to configure".to_string() } else { names.join(", ") };
            return Err(format!("{key}: no such setting; there is {there}").into());
        }
    }
    Ok(())
}

/// One field of the object, or its default.
pub fn field<T: ConfigField>(object: &JsonObject, desc: &ConfigFieldDesc) -> Result<T> {
    let default;
    let value = match object.get(desc.name) {
        Some(given) => given,
        None if desc.default.is_empty() => {
            return Err(format!("{}: is required and has no default", desc.name).into());
        }
        // A host refuses a class whose defaults are not valid: here they are judged like given values.
        None => {
            default = serde_json::from_str(desc.default)
                .map_err(|e| format!("{}: its default {} is not valid JSON: {e}", desc.name, desc.default))?;
            &default
        }
    };
    let read =
        T::read(value).map_err(|wanted| format!("{}: {value} is not {wanted}{}", desc.name, size(desc)))?;
    if let Ok(Value::Object(mut schema)) = serde_json::from_str(&format!("{{{}}}", desc.schema)) {
        for (key, text) in [("minimum", desc.min), ("maximum", desc.max)] {
            if let Ok(limit) = serde_json::from_str::<Value>(text) {
                schema.insert(key.to_string(), limit);
            }
        }
        limits(desc.name, value, &schema, desc.unit)?;
    }
    Ok(read)
}

/// The default, or zero.
pub fn unset<T: ConfigField>(desc: &ConfigFieldDesc) -> T {
    serde_json::from_str(desc.default).ok().and_then(|v: Value| T::read(&v).ok()).unwrap_or_else(T::zero)
}

/// " of 3" for a list of fixed length.
fn size(desc: &ConfigFieldDesc) -> String {
    let n = desc.schema.rsplit_once("\"maxItems\":").map(|(_, n)| n);
    n.map(|n| format!(" ({n} items)")).unwrap_or_default()
}

fn limits(at: &str, value: &Value, schema: &JsonObject, unit: &str) -> Result {
    // `1` is no unit, and "30 1" reads as two numbers.
    let unit = if matches!(unit, "" | "1") { String::new() } else { format!(" {unit}") };
    let number = |key: &str| schema.get(key).and_then(Value::as_f64);
    if let Some(n) = value.as_f64() {
        if let Some(min) = number("minimum").filter(|min| n < *min) {
            return Err(format!("{at}: {n}{unit} is below {min}{unit}").into());
        }
        if let Some(max) = number("maximum").filter(|max| n > *max) {
            return Err(format!("{at}: {n}{unit} is above {max}{unit}").into());
        }
    }
    if let Some(Value::Array(allowed)) = schema.get("enum")
        && !value.is_null()
        && !allowed.contains(value)
    {
        let allowed: Vec<String> = allowed.iter().map(ToString::to_string).collect();
        return Err(format!("{at}: {value} is not one of {}", allowed.join(", ")).into());
    }
    if let (Value::Array(items), Some(Value::Object(inside))) = (value, schema.get("items")) {
        for (i, item) in items.iter().enumerate() {
            limits(&format!("{at}[{i}]"), item, inside, unit.trim())?;
        }
    }
    Ok(())
}
