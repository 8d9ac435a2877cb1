//! `describe`: the class with its present lists of names.
//!
//! Invariant: the fixed part comes first, as in the manifest; the repeated part follows in the order of the
//! fields and, within, of the names; provided interfaces that share a list go name by name. `Binder` and the
//! generated dispatch count the same way.

use crate::class::Class;
use crate::dynamic::AnyType;
use crate::error::Result;
use crate::names::Names;
use serde_json::{Value as Json, json};

/// The description as JSON.
///
/// # Errors
/// Two ports or interfaces would have the same name.
pub(crate) fn build<C: Class>(component: &C) -> Result<Json> {
    let mut json: Json = serde_json::from_str(C::DESCRIPTION)?;
    let many = json.as_object_mut().and_then(|o| o.remove("many")).unwrap_or_default();
    let lists = component.lists();
    let kinds = [
        ("inputs", &lists.inputs),
        ("outputs", &lists.outputs),
        ("required", &lists.required),
        ("provided", &lists.provided),
    ];
    let mut seen: Vec<String> = Vec::new();
    let mut made = Vec::new();
    for (kind, lists) in kinds {
        let Some(ports) = json["class"][kind].as_array_mut() else { continue };
        let repeated: Vec<(&Json, &Names)> =
            many[kind].as_array().into_iter().flatten().zip(lists.iter().copied()).collect();
        let together =
            |a: &(&Json, &Names), b: &(&Json, &Names)| kind == "provided" && std::ptr::eq(a.1, b.1);
        for group in repeated.chunk_by(together) {
            for (at, name) in group[0].1.wanted().iter().enumerate() {
                for (pattern, names) in group {
                    let mut port = named(pattern, name);
                    if let Some(ty) = names.made_type(at) {
                        let mut described = ty.to_port();
                        made.append(
                            &mut described["types"].as_array_mut().map(std::mem::take).unwrap_or_default(),
                        );
                        port["type"] = json!({ "plain": described["plain"] });
                    }
                    ports.push(port);
                }
            }
        }
        for port in ports {
            let name = port["name"].as_str().unwrap_or_default();
            if seen.iter().any(|s| s == name) {
                return Err(format!(
                    "`{name}` would be there twice: inputs, outputs and interfaces share one set of names"
                )
                .into());
            }
            seen.push(name.to_string());
        }
    }
    if !json["types"].is_array() {
        json["types"] = json!([]);
    }
    if let Some(types) = json["types"].as_array_mut() {
        made.into_iter().try_for_each(|ty| add(types, ty))?;
    }
    Ok(json)
}

/// Adds a type that was made while running, unless it is there.
fn add(types: &mut Vec<Json>, ty: Json) -> Result {
    let read = |types: &[Json]| {
        AnyType::of_port(&json!({ "plain": { "ref": ty["name"] }, "types": types }).to_string())
    };
    if !types.iter().any(|there| there["name"] == ty["name"]) {
        types.push(ty);
    } else if let Ok(there) = read(types)
        && read(&[std::slice::from_ref(&ty), &types[..]].concat()).is_ok_and(|new| new != there)
    {
        return Err(format!(
            "{} would be the name of two types with different fields: choose another",
            ty["name"]
        )
        .into());
    }
    Ok(())
}

/// One port or interface of a pattern.
fn named(pattern: &Json, name: &str) -> Json {
    let mut port = pattern.clone();
    let text = pattern["name"].as_str().unwrap_or_default().replace("{}", name);
    port["name"] = Json::String(text);
    port
}

/// Checks the lists a component's `configure` has set.
///
/// # Errors
/// As the description itself.
pub fn check<C: Class>(component: &C) -> Result {
    build(component).map(drop)
}
