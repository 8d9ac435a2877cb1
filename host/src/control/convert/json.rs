//! JSON ↔ `google.protobuf.Value`: numbers are doubles there, so whole numbers beyond 2^53 travel as strings.

use prost_types::{Duration, ListValue, Struct, Value as Wire, value::Kind};
use serde_json::Value;
use trocar_model::from_float;

/// Largest whole number a double holds exactly.
const EXACT: f64 = 9_007_199_254_740_992.0;

pub(crate) fn from_value(value: Wire) -> Value {
    match value.kind {
        None | Some(Kind::NullValue(_)) => Value::Null,
        Some(Kind::BoolValue(b)) => Value::Bool(b),
        Some(Kind::NumberValue(n)) if n.fract() == 0.0 && n.abs() < EXACT => Value::from(n as i64),
        Some(Kind::NumberValue(n)) => from_float(n),
        Some(Kind::StringValue(s)) => Value::String(s),
        Some(Kind::StructValue(s)) => from_struct(s),
        Some(Kind::ListValue(l)) => Value::Array(l.values.into_iter().map(from_value).collect()),
    }
}

pub(crate) fn from_struct(fields: Struct) -> Value {
    Value::Object(fields.fields.into_iter().map(|(k, v)| (k, from_value(v))).collect())
}

pub(crate) fn to_value(value: &Value) -> Wire {
    let kind = match value {
        Value::Null => Kind::NullValue(0),
        Value::Bool(b) => Kind::BoolValue(*b),
        Value::Number(n) => match n.as_f64() {
            Some(f) if n.is_f64() || f.abs() < EXACT => Kind::NumberValue(f),
            _ => Kind::StringValue(n.to_string()),
        },
        Value::String(s) => Kind::StringValue(s.clone()),
        Value::Array(items) => Kind::ListValue(ListValue { values: items.iter().map(to_value).collect() }),
        Value::Object(_) => Kind::StructValue(to_struct(value)),
    };
    Wire { kind: Some(kind) }
}

/// The members of an object; anything else has none.
pub(crate) fn to_struct(value: &Value) -> Struct {
    let members = value.as_object().into_iter().flatten();
    Struct { fields: members.map(|(k, v)| (k.clone(), to_value(v))).collect() }
}

/// Nanoseconds of a duration; `None` when it is negative.
pub(crate) fn duration_ns(duration: &Duration) -> Option<u64> {
    let seconds = u64::try_from(duration.seconds).ok()?;
    let nanos = u64::try_from(duration.nanos).ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}

pub(crate) fn duration(ns: u64) -> Duration {
    Duration { seconds: (ns / 1_000_000_000) as i64, nanos: (ns % 1_000_000_000) as i32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_json_has_not_is_said_as_people_write_it() {
        let said = [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1.5]
            .map(|n| from_value(Wire { kind: Some(Kind::NumberValue(n)) }));
        let written = ["Infinity", "-Infinity", "NaN"].map(Value::from);
        assert_eq!(said[..3], written);
        assert_eq!(said[3], Value::from(1.5));
    }
}
