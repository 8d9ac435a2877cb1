//! The units a class declares: all of them must be readable.
//!
//! Invariant: every place a unit can stand in a description is looked at; the answer names the first bad one
//! with its place.

use std::collections::BTreeSet;

use serde_json::Value;

use super::Unit;
use crate::{ClassInfo, PortType, Ports, Type};

impl ClassInfo {
    /// Checks that every unit of its ports and settings can be read.
    ///
    /// # Errors
    /// The place, the text and what was probably meant.
    pub fn check_units(&self) -> Result<(), String> {
        self.ports.check_units()?;
        settings(&self.config_schema, "")
    }
}

impl Ports {
    /// As [`ClassInfo::check_units`], for ports that were described later.
    ///
    /// # Errors
    /// The place, the text and what was probably meant.
    pub fn check_units(&self) -> Result<(), String> {
        let mut seen = BTreeSet::new();
        let mut ty = |place: &dyn Fn() -> String, t: &Type| {
            fields(t, &mut seen).map_err(|e| format!("{}: {e}", place()))
        };
        for port in &self.inputs {
            payload(&port.ty).map_or(Ok(()), |t| ty(&|| format!("input {}", port.name), t))?;
        }
        for port in &self.outputs {
            payload(&port.ty).map_or(Ok(()), |t| ty(&|| format!("output {}", port.name), t))?;
        }
        for interface in &self.required {
            for f in &interface.functions {
                let place = || format!("function {}/{}", interface.name, f.name);
                one(&f.unit).map_err(|e| format!("{}: {e}", place()))?;
                f.arg.iter().chain(&f.ret).try_for_each(|t| ty(&place, t))?;
            }
            for h in &interface.handlers {
                h.payload
                    .iter()
                    .try_for_each(|t| ty(&|| format!("handler {}/{}", interface.name, h.name), t))?;
            }
        }
        for interface in &self.provided {
            for c in &interface.commands {
                let place = || format!("command {}/{}", interface.name, c.name);
                let units = c.arg.iter().map(|a| a.unit.as_str()).chain([c.ret_unit.as_str()]);
                units.into_iter().try_for_each(one).map_err(|e| format!("{}: {e}", place()))?;
                c.arg.iter().map(|a| &a.ty).chain(&c.ret).try_for_each(|t| ty(&place, t))?;
            }
            for e in &interface.events {
                let place = || format!("event {}/{}", interface.name, e.name);
                one(&e.unit).map_err(|why| format!("{}: {why}", place()))?;
                e.payload.iter().try_for_each(|t| ty(&place, t))?;
            }
        }
        self.state.iter().try_for_each(|t| ty(&|| "state".to_owned(), t))
    }
}

fn payload(ty: &PortType) -> Option<&Type> {
    match ty {
        PortType::Plain(t) | PortType::Frame { header: t, .. } => Some(t),
        PortType::Any => None,
    }
}

fn one(unit: &str) -> Result<(), String> {
    Unit::parse(unit).map(|_| ()).map_err(|e| e.to_string())
}

/// `seen`: structs that were found good, by their identity.
fn fields(ty: &Type, seen: &mut BTreeSet<u64>) -> Result<(), String> {
    match ty {
        Type::Struct(s) => {
            if !seen.insert(ty.hash()) {
                return Ok(());
            }
            for f in &s.fields {
                let place = |e: String| format!("field {} of {}: {e}", f.name, s.name);
                one(&f.unit).map_err(place)?;
                fields(&f.ty, seen)?;
            }
            Ok(())
        }
        Type::Array { item, .. } | Type::List { item, .. } => fields(item, seen),
        Type::Prim(_) | Type::Text { .. } | Type::Enum(_) => Ok(()),
    }
}

fn settings(schema: &Value, path: &str) -> Result<(), String> {
    if let Some(unit) = schema.get("unit").and_then(Value::as_str) {
        one(unit).map_err(|e| format!("setting {path}: {e}"))?;
    }
    if let Some(items) = schema.get("items") {
        settings(items, path)?;
    }
    for (key, sub) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        settings(sub, &path)?;
    }
    Ok(())
}
