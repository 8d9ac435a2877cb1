//! JSON to `google.protobuf.Value` and back.
//!
//! Invariant: a whole number beyond 2^53 travels as text, since numbers are doubles there; [`number`] reads
//! both.

use prost_types::value::Kind;
use prost_types::{ListValue, Struct, Value as Wire};
use serde_json::{Number, Value};

/// Beyond this a double skips whole numbers.
const EXACT: u64 = 1 << 53;

pub(crate) fn to_wire(value: &Value) -> Wire {
    let kind = match value {
        Value::Null => Kind::NullValue(0),
        Value::Bool(b) => Kind::BoolValue(*b),
        Value::Number(n) if n.as_u64().is_some_and(|n| n >= EXACT) => Kind::StringValue(n.to_string()),
        Value::Number(n) => Kind::NumberValue(n.as_f64().unwrap_or(f64::NAN)),
        Value::String(s) => Kind::StringValue(s.clone()),
        Value::Array(items) => Kind::ListValue(ListValue { values: items.iter().map(to_wire).collect() }),
        Value::Object(_) => Kind::StructValue(to_struct(value)),
    };
    Wire { kind: Some(kind) }
}

pub(crate) fn to_struct(value: &Value) -> Struct {
    let members = value.as_object().into_iter().flatten();
    Struct { fields: members.map(|(k, v)| (k.clone(), to_wire(v))).collect() }
}

pub(crate) fn from_wire(value: Wire) -> Value {
    match value.kind {
        None | Some(Kind::NullValue(_)) => Value::Null,
        Some(Kind::BoolValue(b)) => Value::Bool(b),
        Some(Kind::NumberValue(n)) if n.fract() == 0.0 && n.abs() < EXACT as f64 => Value::from(n as i64),
        Some(Kind::NumberValue(n)) => Number::from_f64(n).map_or(Value::Null, Value::Number),
        Some(Kind::StringValue(s)) => Value::String(s),
        Some(Kind::StructValue(s)) => {
            Value::Object(s.fields.into_iter().map(|(k, v)| (k, from_wire(v))).collect())
        }
        Some(Kind::ListValue(l)) => Value::Array(l.values.into_iter().map(from_wire).collect()),
    }
}

/// A whole number, whichever way it came; 0 when it is none.
pub(crate) fn number(value: &Value) -> u64 {
    value.as_u64().or_else(|| value.as_str()?.parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn large_numbers_come_back_as_they_went() {
        let value = json!({ "a": [1, 2.5, true, null, "x"], "b": u64::MAX });
        let back = from_wire(to_wire(&value));
        assert_eq!((&back["a"], number(&back["b"])), (&value["a"], u64::MAX));
    }
}
