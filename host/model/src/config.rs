//! Configurations: defaults, merge patches, validation against the class's JSON Schema.
//!
//! Invariant: a configuration is checked whole before a component sees it; every violation carries the JSON
//! pointer of the offending value and, where the schema knows it, the unit.

use std::collections::BTreeMap;

use jsonschema::ValidationError;
use jsonschema::error::{TypeKind, ValidationErrorKind};
use serde_json::{Map, Value};

use crate::refusal::brief as cut;
use crate::value::{EXACT, ROUNDED};
use crate::{Unit, Violation, nearest};

/// Most bytes of a configuration as JSON: a list of a few components stays below the 4 MiB that gRPC clients
/// accept by default.
const LARGEST: usize = 1 << 20;

/// The object of the schema's defaults; keys without a default are absent.
pub fn defaults(schema: &Value) -> Value {
    complete(schema, Value::Object(Map::new()))
}

/// Returns `value` without what [`complete`] fills in: completed again, it is the same where it was complete.
pub fn without_defaults(schema: &Value, value: &Value) -> Value {
    if let Value::Array(items) = value {
        let item = schema.get("items").unwrap_or(&Value::Null);
        return Value::Array(items.iter().map(|value| without_defaults(item, value)).collect());
    }
    let (Some(properties), Value::Object(map)) = (properties(schema), value) else { return value.clone() };
    let left = map.iter().filter_map(|(key, value)| {
        let Some(sub) = properties.get(key) else { return Some((key.clone(), value.clone())) };
        let filled = match sub.get("default") {
            Some(default) => Some(complete(sub, default.clone())),
            None => Some(defaults(sub)).filter(|v| v.as_object().is_some_and(|o| !o.is_empty())),
        };
        let is_default = filled.is_some_and(|filled| is_same(&filled, value));
        (!is_default).then(|| (key.clone(), without_defaults(sub, value)))
    });
    Value::Object(left.collect())
}

/// Tells whether two settings mean the same: 20 is 20.0, as JSON's numbers are.
pub fn is_same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(x), Value::Number(y)) => {
            x == y || (x.is_f64() != y.is_f64()) && x.as_f64() == y.as_f64()
        }
        (Value::Array(x), Value::Array(y)) => {
            x.len() == y.len() && x.iter().zip(y).all(|(x, y)| is_same(x, y))
        }
        (Value::Object(x), Value::Object(y)) => {
            x.len() == y.len() && x.iter().all(|(key, x)| y.get(key).is_some_and(|y| is_same(x, y)))
        }
        _ => a == b,
    }
}

/// Returns the merge patch that makes `to` of `from`.
pub fn difference(from: &Value, to: &Value) -> Value {
    let (Value::Object(from), Value::Object(to)) = (from, to) else { return to.clone() };
    let gone = from.keys().filter(|key| !to.contains_key(*key)).map(|key| (key.clone(), Value::Null));
    let is_there = |key: &String, value: &Value| from.get(key).is_some_and(|old| is_same(old, value));
    let changed = to.iter().filter(|(key, value)| !is_there(key, value)).map(|(key, value)| {
        // An object that was something else before has no part that could stay.
        let old = from.get(key).filter(|old| old.is_object()).cloned();
        (key.clone(), difference(&old.unwrap_or_else(|| Value::Object(Map::new())), value))
    });
    Value::Object(gone.chain(changed).collect())
}

/// Returns `value` with every absent key that has a default filled in, also in nested objects. Whole numbers
/// that were written as texts, as those beyond 2^53 have to be, become numbers.
pub fn complete(schema: &Value, value: Value) -> Value {
    let value = match value {
        Value::String(text) => return whole(schema, text),
        Value::Array(items) => {
            let item = schema.get("items").unwrap_or(&Value::Null);
            return Value::Array(items.into_iter().map(|value| complete(item, value)).collect());
        }
        value => value,
    };
    let (Some(properties), Value::Object(mut map)) = (properties(schema), value.clone()) else {
        return value;
    };
    for (key, sub) in properties {
        let filled = match (map.remove(key), sub.get("default")) {
            (Some(given), _) => Some(complete(sub, given)),
            (None, Some(default)) => Some(complete(sub, default.clone())),
            // An object without a default of its own still has those of its parts, if that makes it anything.
            (None, None) => Some(defaults(sub)).filter(|v| v.as_object().is_some_and(|o| !o.is_empty())),
        };
        if let Some(filled) = filled {
            map.insert(key.clone(), filled);
        }
    }
    Value::Object(map)
}

/// A text that stands for a whole number, where the schema wants one and takes no text.
fn whole(schema: &Value, text: String) -> Value {
    if !takes(schema, "integer") || takes(schema, "string") {
        return Value::String(text);
    }
    match (text.parse::<u64>(), text.parse::<i64>()) {
        (Ok(number), _) => Value::from(number),
        (_, Ok(number)) => Value::from(number),
        _ => Value::String(text),
    }
}

/// Tells whether the schema names this type.
fn takes(schema: &Value, ty: &str) -> bool {
    match schema.get("type") {
        Some(Value::String(said)) => said == ty,
        Some(Value::Array(said)) => said.iter().any(|said| said == ty),
        _ => false,
    }
}

/// Whole numbers of `config` that came as a double too large to hold them exactly.
fn rounded(schema: &Value, config: &Value, pointer: &str, found: &mut BTreeMap<String, String>) {
    match config {
        Value::Number(n) if n.is_f64() && takes(schema, "integer") && !takes(schema, "number") => {
            let n = n.as_f64().unwrap_or_default();
            if n.abs() >= EXACT as f64 && n.fract() == 0.0 {
                found.insert(pointer.to_owned(), format!("{}: {n} {ROUNDED}", dotted(pointer)));
            }
        }
        Value::Object(map) => {
            for (key, value) in map {
                let inner = properties(schema).and_then(|p| p.get(key)).unwrap_or(&Value::Null);
                rounded(inner, value, &below(pointer, key), found);
            }
        }
        Value::Array(items) => {
            let item = schema.get("items").unwrap_or(&Value::Null);
            for (i, value) in items.iter().enumerate() {
                rounded(item, value, &format!("{pointer}/{i}"), found);
            }
        }
        _ => {}
    }
}

fn properties(schema: &Value) -> Option<&Map<String, Value>> {
    schema.get("properties")?.as_object()
}

/// Bytes of a value as JSON.
fn length(value: &Value) -> usize {
    struct Counting(usize);
    impl std::io::Write for Counting {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 += bytes.len();
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let mut counting = Counting(0);
    // Neither the value nor the counter fails.
    let _ = serde_json::to_writer(&mut counting, value);
    counting.0
}

/// JSON merge patch (RFC 7396): objects merge, null removes, anything else replaces.
pub fn merge(base: &Value, patch: &Value) -> Value {
    let Value::Object(patch) = patch else { return patch.clone() };
    let mut out = match base {
        Value::Object(map) => map.clone(),
        _ => Map::new(),
    };
    for (key, change) in patch {
        if change.is_null() {
            out.remove(key);
        } else {
            let merged = merge(out.get(key).unwrap_or(&Value::Null), change);
            out.insert(key.clone(), merged);
        }
    }
    Value::Object(out)
}

/// Everything wrong with `config`, one entry per JSON pointer, in the pointers' order; empty = valid.
pub fn validate(schema: &Value, config: &Value) -> Vec<Violation> {
    let bytes = length(config);
    if bytes > LARGEST {
        let message = format!(
            "takes {bytes} bytes as JSON, and a configuration takes {LARGEST} at most, since each list shows it: put what is \
             large into a file and let the setting name that"
        );
        return vec![Violation { pointer: String::new(), message }];
    }
    let validator = match jsonschema::validator_for(schema) {
        Ok(validator) => validator,
        Err(error) => {
            let message = format!("the class's own configuration schema is invalid: {error}");
            return vec![Violation { pointer: String::new(), message }];
        }
    };
    let mut found = BTreeMap::new();
    rounded(schema, config, "", &mut found);
    for error in validator.iter_errors(config) {
        for violation in violations(schema, &error) {
            found.entry(violation.pointer).or_insert(violation.message);
        }
    }
    found.into_iter().map(|(pointer, message)| Violation { pointer, message }).collect()
}

/// Returns why `schema` is no JSON Schema; `None` when it is one.
pub fn schema_fault(schema: &Value) -> Option<String> {
    // The validator only knows that a wrong type is none of several schemas, not what was meant.
    let wrong = || jsonschema::validator_for(schema).err().map(|e| e.to_string());
    odd_type(schema, "").or_else(wrong)
}

/// Returns the first type that JSON does not have.
fn odd_type(schema: &Value, path: &str) -> Option<String> {
    const TYPES: [&str; 7] = ["number", "integer", "string", "boolean", "array", "object", "null"];
    let said = match schema.get("type") {
        Some(Value::Array(several)) => several.iter().collect(),
        said => Vec::from_iter(said),
    };
    if let Some(odd) = said.into_iter().filter_map(Value::as_str).find(|said| !TYPES.contains(said)) {
        let hint = nearest(&cut(odd), TYPES).map_or(String::new(), |near| format!("did you mean {near}? "));
        let place = if path.is_empty() { String::new() } else { format!("setting {path}: ") };
        return Some(format!("{place}`{}` is no type; {hint}There are {}", cut(odd), TYPES.join(", ")));
    }
    let inside =
        properties(schema).into_iter().flatten().find_map(|(key, sub)| odd_type(sub, &setting_in(path, key)));
    inside.or_else(|| odd_type(schema.get("items")?, path))
}

fn setting_in(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

/// Returns the first limit or unit that has no effect: one for numbers, at a setting that holds none. JSON
/// Schema passes it over, so it would be shown and never enforced.
pub fn idle_limit(schema: &Value) -> Option<String> {
    idle(schema, "")
}

fn idle(schema: &Value, path: &str) -> Option<String> {
    const LIMITS: [&str; 6] =
        ["minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf", "unit"];
    let types = match schema.get("type") {
        Some(Value::Array(several)) => several.iter().filter_map(Value::as_str).collect(),
        said => Vec::from_iter(said.and_then(Value::as_str)),
    };
    let has = |ty: &str| types.contains(&ty);
    // The unit of a list is that of its items.
    let numbers = types.is_empty() || has("number") || has("integer");
    let said = LIMITS.iter().find(|key| {
        schema.get(**key).is_some() && !(numbers || **key == "unit" && (has("array") || has("object")))
    });
    if let Some(key) = said {
        let todo = if has("array") { "put it into its items" } else { "leave it out" };
        let (place, types) = (
            if path.is_empty() { "the whole".to_owned() } else { format!("setting {path}") },
            types.join(" or "),
        );
        return Some(format!("{place}: `{key}` holds for numbers, and this is of type {types}: {todo}"));
    }
    let inside =
        properties(schema).into_iter().flatten().find_map(|(key, sub)| idle(sub, &setting_in(path, key)));
    inside.or_else(|| idle(schema.get("items")?, path))
}

/// Settings that `patch` takes away (null) and that neither `config` nor the schema has, sorted as in
/// [`validate`].
pub fn unknown_nulls(schema: &Value, config: &Value, patch: &Value) -> Vec<Violation> {
    let mut found = Vec::new();
    look_for_nulls(schema, config, patch, "", &mut found);
    found.sort();
    found
}

fn look_for_nulls(schema: &Value, config: &Value, patch: &Value, at: &str, found: &mut Vec<Violation>) {
    let closed = schema.get("additionalProperties") == Some(&Value::Bool(false));
    for (key, change) in patch.as_object().into_iter().flatten() {
        let known = properties(schema).and_then(|p| p.get(key));
        match (known, change) {
            (None, Value::Null) if closed && config.get(key).is_none() => {
                found.push(unknown(at, Some(schema), key));
            }
            (Some(inner), Value::Object(_)) => {
                let present = config.get(key).unwrap_or(&Value::Null);
                look_for_nulls(inner, present, change, &below(at, key), found);
            }
            _ => {}
        }
    }
}

/// A configuration change that a running component accepts: only settings declared `live` differ.
///
/// # Errors
/// The dotted names of the settings that differ and are not live.
pub fn live_only(schema: &Value, from: &Value, to: &Value) -> Result<(), Vec<String>> {
    let mut fixed = Vec::new();
    not_live(schema, from, to, "", &mut fixed);
    if fixed.is_empty() { Ok(()) } else { Err(fixed) }
}

fn not_live(schema: &Value, from: &Value, to: &Value, path: &str, fixed: &mut Vec<String>) {
    if from == to || is_live(schema) {
        return;
    }
    let (Some(properties), Value::Object(a), Value::Object(b)) = (properties(schema), from, to) else {
        fixed.push(if path.is_empty() { "the configuration".to_owned() } else { path.to_owned() });
        return;
    };
    let mut keys: Vec<&String> = a.keys().chain(b.keys()).collect();
    keys.sort();
    keys.dedup();
    for key in keys {
        let sub = properties.get(key).unwrap_or(&Value::Null);
        let (x, y) = (a.get(key).unwrap_or(&Value::Null), b.get(key).unwrap_or(&Value::Null));
        let name = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        not_live(sub, x, y, &name, fixed);
    }
}

fn is_live(schema: &Value) -> bool {
    schema.get("live").and_then(Value::as_bool).unwrap_or(false)
}

/// Dotted names of the settings that may change while running.
pub fn live_settings(schema: &Value) -> Vec<String> {
    let mut out = Vec::new();
    for (key, sub) in properties(schema).into_iter().flatten() {
        if is_live(sub) {
            out.push(key.clone());
        } else {
            out.extend(live_settings(sub).into_iter().map(|inner| format!("{key}.{inner}")));
        }
    }
    out
}

/// The schema of the value at `pointer`, as far as `properties` and `items` lead there.
fn schema_at<'a>(schema: &'a Value, pointer: &str) -> Option<&'a Value> {
    segments(pointer).iter().try_fold(schema, |at, segment| {
        at.get("properties").and_then(|p| p.get(segment)).or_else(|| at.get("items"))
    })
}

fn segments(pointer: &str) -> Vec<String> {
    pointer.split('/').skip(1).map(|s| s.replace("~1", "/").replace("~0", "~")).collect()
}

/// `/limits/force/0` → `limits.force.0`; the whole configuration is "the configuration".
fn dotted(pointer: &str) -> String {
    if pointer.is_empty() { "the configuration".to_owned() } else { segments(pointer).join(".") }
}

fn violations(schema: &Value, error: &ValidationError<'_>) -> Vec<Violation> {
    let pointer = error.instance_path().as_str();
    let here = schema_at(schema, pointer);
    let pointer = &*cut(pointer);
    let unit = here.map(unit_of).unwrap_or_default();
    let (name, value) = (dotted(pointer), brief(error.instance()));
    let one = |message: String| vec![Violation { pointer: pointer.to_owned(), message }];
    match error.kind() {
        ValidationErrorKind::Maximum { limit } => {
            let limit = brief(limit);
            one(format!("{name}: {value}{unit} is above {limit}{unit}"))
        }
        ValidationErrorKind::Minimum { limit } => {
            let limit = brief(limit);
            one(format!("{name}: {value}{unit} is below {limit}{unit}"))
        }
        ValidationErrorKind::ExclusiveMaximum { limit } => {
            let limit = brief(limit);
            one(format!("{name}: {value}{unit} is not below {limit}{unit}"))
        }
        ValidationErrorKind::ExclusiveMinimum { limit } => {
            let limit = brief(limit);
            one(format!("{name}: {value}{unit} is not above {limit}{unit}"))
        }
        ValidationErrorKind::Type { kind } => {
            let within = if unit.is_empty() { "" } else { " in" };
            one(format!("{name}: {value} is not {}{within}{unit}", kinds(kind)))
        }
        ValidationErrorKind::Enum { options } => {
            let options: Vec<String> = options.as_array().into_iter().flatten().map(brief).collect();
            one(format!("{name}: {value} is none of {}", options.join(", ")))
        }
        ValidationErrorKind::MaxItems { limit } => one(format!("{name}: it has more than {limit} items")),
        ValidationErrorKind::MinItems { limit } => one(format!("{name}: it has fewer than {limit} items")),
        ValidationErrorKind::Required { property } => {
            missing(pointer, here, property.as_str().unwrap_or_default())
        }
        ValidationErrorKind::AdditionalProperties { unexpected } => {
            unexpected.iter().map(|key| unknown(pointer, here, key)).collect()
        }
        _ => one(format!("{name}: {}", cut(&error.to_string()))),
    }
}

fn below(pointer: &str, key: &str) -> String {
    format!("{pointer}/{}", cut(key).replace('~', "~0").replace('/', "~1"))
}

fn missing(pointer: &str, parent: Option<&Value>, key: &str) -> Vec<Violation> {
    let pointer = below(pointer, key);
    let schema = parent.and_then(|p| p.get("properties")).and_then(|p| p.get(key));
    let text =
        |of: &str| schema.and_then(|s| s.get(of)).and_then(Value::as_str).unwrap_or_default().to_owned();
    let unit = schema.map(unit_of).filter(|unit| !unit.is_empty()).map(|unit| format!(" in{unit}"));
    let what = [text("type") + &unit.unwrap_or_default(), text("description")];
    let what: Vec<&str> = what.iter().map(|s| s.trim()).filter(|s| !s.is_empty()).collect();
    let what = if what.is_empty() { String::new() } else { format!(" ({})", what.join("; ")) };
    let message = format!("{} is missing{what}", dotted(&pointer));
    vec![Violation { pointer, message }]
}

fn unknown(pointer: &str, parent: Option<&Value>, key: &str) -> Violation {
    let pointer = below(pointer, key);
    let names = || parent.and_then(properties).into_iter().flat_map(Map::keys).map(String::as_str);
    let hint = match nearest(&cut(key), names()) {
        Some(name) => format!("did you mean {name}?"),
        None if names().next().is_none() => "it takes no settings".to_owned(),
        None => format!("there are {}", names().collect::<Vec<_>>().join(", ")),
    };
    Violation { message: format!("{} is unknown; {hint}", dotted(&pointer)), pointer }
}

/// " Hz", or nothing.
fn unit_of(schema: &Value) -> String {
    match schema.get("unit").and_then(Value::as_str) {
        // `1` is no unit, and "30 1" reads as two numbers.
        Some(unit) if !Unit::same(unit, "") => format!(" {unit}"),
        _ => String::new(),
    }
}

fn kinds(kind: &TypeKind) -> String {
    let names: Vec<String> = match kind {
        TypeKind::Single(t) => vec![t.to_string()],
        TypeKind::Multiple(set) => set.iter().map(|t| t.to_string()).collect(),
    };
    let article = if names.first().is_some_and(|n| n.starts_with(['a', 'e', 'i', 'o'])) { "an" } else { "a" };
    format!("{article} {}", names.join(" or "))
}

fn brief(value: &Value) -> String {
    match value {
        Value::Array(items) => format!("a list of {}", items.len()),
        Value::Object(_) => "an object".to_owned(),
        // A whole number is shown without ".0", whichever way it was written.
        Value::Number(n) => match n.as_f64() {
            Some(whole) if n.is_f64() && whole.fract() == 0.0 && whole.abs() < 1e15 => whole.to_string(),
            _ => n.to_string(),
        },
        other => cut(&other.to_string()).into_owned(),
    }
}
