//! The declared limits of a command's argument, checked before the component is entered.
//!
//! Invariant: the check is a host's: each number of an array or list, and NaN lies within no limits.

use crate::dynamic::AnyType;
use serde_json::json;
use trocar_plugin_api::contracts::size_of_type;
use trocar_plugin_api::manifest::{Arg, Type};

/// # Errors
/// "value 300 is above maximum 100 mm".
pub(crate) fn check(arg: &Arg, bytes: &[u8]) -> Result<(), String> {
    if arg.min.is_none() && arg.max.is_none() {
        return Ok(());
    }
    let (item, n, bytes) = match (&arg.ty, bytes.split_first_chunk::<8>()) {
        (Type::Array { item, n }, _) => (&**item, *n, bytes),
        (Type::List { item, n }, Some((len, rest))) => {
            (&**item, (u64::from_le_bytes(*len) as usize).min(*n), rest)
        }
        (ty, _) => (ty, 1, bytes),
    };
    // Only numbers have limits.
    let Type::Prim(_) = item else { return Ok(()) };
    let described = json!({ "plain": item, "types": [] }).to_string();
    let place = AnyType::of_port(&described).ok().and_then(|ty| ty.place(""));
    let size = size_of_type(&[], item)?;
    let several = !matches!(arg.ty, Type::Prim(_));
    for (i, bytes) in bytes.chunks_exact(size.max(1)).take(n).enumerate() {
        let Some(number) = place.and_then(|place| place.number(bytes)) else { continue };
        let name = if several { format!("{}[{i}]", arg.name) } else { arg.name.clone() };
        within(arg, &name, number)?;
    }
    Ok(())
}

fn within(arg: &Arg, name: &str, number: f64) -> Result<(), String> {
    let unit = if arg.unit.is_empty() { String::new() } else { format!(" {}", arg.unit) };
    let limits = match (arg.min, arg.max) {
        (Some(min), Some(max)) => format!("{min} to {max}{unit}"),
        (Some(min), None) => format!("from {min}{unit} up"),
        (_, max) => format!("up to {}{unit}", max.unwrap_or(f64::INFINITY)),
    };
    match (arg.min, arg.max) {
        _ if number.is_nan() => Err(format!("{name} NaN is not a number; the limits are {limits}")),
        (Some(min), _) if number < min => Err(format!("{name} {number} is below minimum {min}{unit}")),
        (_, Some(max)) if number > max => Err(format!("{name} {number} is above maximum {max}{unit}")),
        _ => Ok(()),
    }
}
