//! `--set host/robot.port=/dev/ttyUSB1`: one machine's values over a shared system file.
//!
//! Invariant: only configuration values can be set, never classes or connections; the component must
//! be in the file.

use std::fmt;

use serde_json::{Map, Value};
use trocar_model::nearest;

use super::ComponentSpec;

/// An assignment that cannot be applied.
#[derive(Clone, Debug, PartialEq)]
pub struct BadSet {
    pub assignment: String,
    pub why: String,
    pub help: String,
}

impl fmt::Display for BadSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "--set {}: {}", self.assignment, self.why)
    }
}

impl std::error::Error for BadSet {}

pub(super) fn set(components: &mut [ComponentSpec], assignment: &str) -> Result<(), BadSet> {
    let bad = |why: String, help: String| BadSet { assignment: assignment.to_owned(), why, help };
    let shape = || "write process/component.key=value, e.g. host/robot.port=/dev/ttyUSB1".to_owned();
    let (target, value) =
        assignment.split_once('=').ok_or_else(|| bad("there is no '='".to_owned(), shape()))?;
    // A name may hold dots itself, so the longest component that fits is meant.
    let owner = components
        .iter()
        .map(|c| c.written.to_string())
        .filter(|id| target.strip_prefix(id.as_str()).is_some_and(|rest| rest.starts_with('.')))
        .max_by_key(String::len);
    let Some(owner) = owner else {
        let known: Vec<String> = components.iter().map(|c| c.written.to_string()).collect();
        let asked = target.split('.').next().unwrap_or(target);
        let help = match nearest(asked, known.iter().map(String::as_str)) {
            _ if !target.contains('.') => shape(),
            Some(near) => format!("did you mean {near:?}? components: {}", known.join(", ")),
            None => format!("components: {}", known.join(", ")),
        };
        return Err(bad(format!("the file has no component for {target:?}"), help));
    };
    let keys: Vec<&str> = target[owner.len() + 1..].split('.').collect();
    if keys.iter().any(|k| k.is_empty()) {
        return Err(bad("an empty key".to_owned(), shape()));
    }
    let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
    let Some(component) = components.iter_mut().find(|c| c.written.to_string() == owner) else {
        return Ok(());
    };
    let mut place = component.config.get_or_insert_with(|| Value::Object(Map::new()));
    for key in keys {
        if !place.is_object() {
            *place = Value::Object(Map::new());
        }
        place = &mut place[key];
    }
    *place = value;
    Ok(())
}
