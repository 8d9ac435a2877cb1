//! The declared range of a command's argument.
//!
//! Invariant: NaN is within no range.

use serde_json::Value;

use super::special;
use crate::{Arg, Prim, Type};

/// Checks the declared range for every number of an argument, however deep. Stamps, flags, texts and enums
/// are no numbers.
///
/// # Errors
/// "value 300 is above maximum 100 mm".
pub fn check_range(arg: &Arg, value: &Value) -> Result<(), String> {
    if arg.min.is_none() && arg.max.is_none() {
        return Ok(());
    }
    range(arg, &arg.ty, value, if arg.name.is_empty() { "value" } else { &arg.name })
}

fn range(arg: &Arg, ty: &Type, value: &Value, name: &str) -> Result<(), String> {
    match ty {
        Type::Array { item, .. } | Type::List { item, .. } => {
            let mut items = value.as_array().into_iter().flatten().enumerate();
            return items.try_for_each(|(i, value)| range(arg, item, value, &format!("{name}[{i}]")));
        }
        Type::Struct(s) => {
            return s.fields.iter().try_for_each(|field| {
                let inside = value.get(&field.name).unwrap_or(&Value::Null);
                range(arg, &field.ty, inside, &format!("{name}.{}", field.name))
            });
        }
        Type::Prim(Prim::Bool | Prim::Stamp) | Type::Text { .. } | Type::Enum(_) => return Ok(()),
        Type::Prim(_) => {}
    }
    let number = match value {
        Value::Number(n) => n.as_f64(),
        Value::String(s) => special(s).or_else(|| s.parse().ok()),
        _ => None,
    };
    let Some(number) = number else { return Ok(()) };
    let unit = if arg.unit.is_empty() { String::new() } else { format!(" {}", arg.unit) };
    let shown = || match value {
        Value::String(s) => s.clone(),
        _ => number.to_string(),
    };
    if number.is_nan() {
        let limits = match (arg.min, arg.max) {
            (Some(min), Some(max)) => format!("{min} to {max}{unit}"),
            (Some(min), None) => format!("from {min}{unit} up"),
            (_, max) => format!("up to {}{unit}", max.unwrap_or(f64::INFINITY)),
        };
        return Err(format!("{name} NaN is not a number; the limits are {limits}"));
    }
    match (arg.min, arg.max) {
        (Some(min), _) if number < min => Err(format!("{name} {} is below minimum {min}{unit}", shown())),
        (_, Some(max)) if number > max => Err(format!("{name} {} is above maximum {max}{unit}", shown())),
        _ => Ok(()),
    }
}
