//! JSON ↔ `google.protobuf.Value`: numbers are doubles there, so whole numbers beyond 2^53 travel as strings.
//!
//! Invariant: what a double holds survives both ways.

use prost_types::{ListValue, Struct, Value as Wire, value::Kind};
use serde_json::{Map, Number, Value};

/// Largest whole number a double holds exactly.
const EXACT: f64 = 9_007_199_254_740_992.0;

pub(crate) fn from_wire(value: &Wire) -> Value {
    match &value.kind {
        None | Some(Kind::NullValue(_)) => Value::Null,
        Some(Kind::BoolValue(b)) => Value::Bool(*b),
        Some(Kind::NumberValue(n)) if n.fract() == 0.0 && n.abs() < EXACT => Value::from(*n as i64),
        Some(Kind::NumberValue(n)) => {
            Number::from_f64(*n).map_or_else(|| Value::String(n.to_string()), Value::Number)
        }
        Some(Kind::StringValue(s)) => Value::String(s.clone()),
        Some(Kind::StructValue(s)) => from_struct(s),
        Some(Kind::ListValue(l)) => Value::Array(l.values.iter().map(from_wire).collect()),
    }
}

pub(crate) fn from_struct(fields: &Struct) -> Value {
    Value::Object(fields.fields.iter().map(|(k, v)| (k.clone(), from_wire(v))).collect::<Map<_, _>>())
}

/// Whole numbers a double cannot hold travel as strings, as the API says.
pub(crate) fn to_wire(value: &Value) -> Wire {
    let kind = match value {
        Value::Null => Kind::NullValue(0),
        Value::Bool(b) => Kind::BoolValue(*b),
        Value::Number(n) => match n.as_f64() {
            Some(f) if f.abs() < EXACT || n.is_f64() => Kind::NumberValue(f),
            _ => Kind::StringValue(n.to_string()),
        },
        Value::String(s) => Kind::StringValue(s.clone()),
        Value::Array(items) => Kind::ListValue(ListValue { values: items.iter().map(to_wire).collect() }),
        Value::Object(_) => Kind::StructValue(to_struct(value)),
    };
    Wire { kind: Some(kind) }
}

/// The fields of an object; anything else has none.
pub(crate) fn to_struct(value: &Value) -> Struct {
    let fields = value.as_object().into_iter().flatten().map(|(k, v)| (k.clone(), to_wire(v)));
    Struct { fields: fields.collect() }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn json_survives_the_wire() {
        let value = json!({"a": [1, 2.5, -3], "b": {"c": null, "d": true}, "e": "text"});
        assert_eq!(from_wire(&to_wire(&value)), value);
    }

    #[test]
    fn whole_numbers_a_double_cannot_hold_go_as_text() {
        assert_eq!(from_wire(&to_wire(&json!(9_007_199_254_740_993_u64))), json!("9007199254740993"));
    }
}
