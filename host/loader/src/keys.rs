//! Keys of a manifest that no version of the format up to this host's has: mostly typing errors.
//!
//! Invariant: the table names every key `trocar_plugin_api::manifest` reads, and nothing else; a test
//! compares. Keys that begin with `x-` are the author's own and are never looked at.

use serde_json::Value;

/// Content of an object of each kind: each key and the kind of the object, or of each object of the list,
/// behind it; "" for values that are checked elsewhere.
const KINDS: &[(&str, &[(&str, &str)])] = &[
    (
        "manifest",
        &[
            ("trocar", ""),
            ("abi", ""),
            ("name", ""),
            ("version", ""),
            ("vendor", ""),
            ("license", ""),
            ("doc", ""),
            ("built_with", ""),
            ("panic", ""),
            ("unload", ""),
            ("types", "type"),
            ("classes", "class"),
        ],
    ),
    (
        "type",
        &[
            ("name", ""),
            ("doc", ""),
            ("size", ""),
            ("align", ""),
            ("fields", "field"),
            ("enum", ""),
            ("values", "value"),
        ],
    ),
    ("value", &[("name", ""), ("value", "")]),
    ("field", &[("name", ""), ("at", ""), ("type", "form"), ("unit", ""), ("doc", ""), ("frame", "")]),
    ("form", &[("ref", ""), ("array", "form"), ("list", "form"), ("text", ""), ("n", "")]),
    ("port form", &[("plain", "form"), ("frame", "form"), ("format", ""), ("max_bytes", "")]),
    (
        "class",
        &[
            ("name", ""),
            ("doc", ""),
            ("safety", ""),
            ("hardware", ""),
            ("safe_from_any_thread", ""),
            ("starts_programs", ""),
            ("execution", "execution"),
            ("config", ""),
            ("inputs", "input"),
            ("outputs", "output"),
            ("required", "required"),
            ("provided", "provided"),
            ("state", "form"),
        ],
    ),
    (
        "execution",
        &[
            ("model", ""),
            ("period_ns", ""),
            ("max_step_ns", ""),
            ("models", ""),
            ("min_period_ns", ""),
            ("max_period_ns", ""),
        ],
    ),
    (
        "input",
        &[
            ("name", ""),
            ("doc", ""),
            ("type", "port form"),
            ("frame", ""),
            ("tag", ""),
            ("optional", ""),
            ("fifo", ""),
        ],
    ),
    ("output", &[("name", ""), ("doc", ""), ("type", "port form"), ("frame", ""), ("tag", "")]),
    ("provided", &[("name", ""), ("doc", ""), ("tag", ""), ("commands", "command"), ("events", "event")]),
    (
        "command",
        &[
            ("name", ""),
            ("doc", ""),
            ("kind", ""),
            ("arg", "argument"),
            ("ret", "form"),
            ("ret_unit", ""),
            ("ret_frame", ""),
            ("overflow", ""),
        ],
    ),
    (
        "argument",
        &[("name", ""), ("doc", ""), ("type", "form"), ("unit", ""), ("frame", ""), ("min", ""), ("max", "")],
    ),
    ("event", &[("name", ""), ("doc", ""), ("payload", "form"), ("unit", ""), ("frame", "")]),
    (
        "required",
        &[("name", ""), ("doc", ""), ("optional", ""), ("functions", "function"), ("handlers", "handler")],
    ),
    (
        "function",
        &[
            ("name", ""),
            ("doc", ""),
            ("arg", "form"),
            ("ret", "form"),
            ("unit", ""),
            ("frame", ""),
            ("optional", ""),
            ("any", ""),
        ],
    ),
    (
        "handler",
        &[("name", ""), ("doc", ""), ("payload", "form"), ("frame", ""), ("optional", ""), ("direct", "")],
    ),
];

/// Every key there is.
#[cfg(test)]
pub(super) fn all() -> std::collections::BTreeSet<String> {
    KINDS.iter().flat_map(|(_, keys)| *keys).map(|(key, _)| (*key).to_owned()).collect()
}

/// One sentence for each key of the manifest that nothing reads, the nearest known one named.
pub(super) fn unknown(manifest: &Value) -> Vec<String> {
    let mut found = Vec::new();
    look("manifest", manifest, "the manifest", &mut found);
    found
}

fn look(kind: &str, value: &Value, place: &str, found: &mut Vec<String>) {
    let Some((_, keys)) = KINDS.iter().find(|(k, _)| *k == kind) else { return };
    match value {
        Value::Array(all) => all.iter().for_each(|one| look(kind, one, place, found)),
        Value::Object(map) => {
            let place = match map.get("name").and_then(Value::as_str) {
                Some(name) if kind != "manifest" => format!("{kind} `{}`", name.escape_debug()),
                _ => place.to_owned(),
            };
            for (key, value) in map {
                match keys.iter().find(|(k, _)| k == key) {
                    Some((_, inner)) => look(inner, value, &place, found),
                    None if key.starts_with("x-") => {}
                    None => found.push(format!(
                        "{place} has the unknown key `{}`{}",
                        key.escape_debug(),
                        hint(key, keys)
                    )),
                }
            }
        }
        _ => {}
    }
}

fn hint(key: &str, keys: &[(&str, &str)]) -> String {
    let near = |k: &str| strsim::jaro_winkler(key, k);
    match keys.iter().map(|(k, _)| *k).max_by(|a, b| near(a).total_cmp(&near(b))) {
        Some(best) if near(best) > 0.8 => format!("; did you mean `{best}`?"),
        _ => format!("; there are {}", keys.iter().map(|(k, _)| *k).collect::<Vec<_>>().join(", ")),
    }
}
