//! Manifests that are taken, and the refusals of the others.
#![allow(clippy::unwrap_used)]

use serde_json::{Value, json};

use super::*;

fn good() -> Value {
    json!({
        "trocar": 1, "abi": [1, 0], "name": "filters", "version": "0.1.0",
        "types": [
            {"name": "Force", "size": 32, "align": 8, "fields": [
                {"name": "stamp", "at": 0, "type": "stamp"},
                {"name": "f", "at": 8, "type": {"array": "f64", "n": 3}, "unit": "N"}]},
            {"name": "Mode", "size": 1, "align": 1, "enum": "u8", "values": [{"name": "on", "value": 1}]}],
        "classes": [{
            "name": "low_pass",
            "config": setting(json!({"type": "number"})),
            "inputs": [{"name": "raw", "type": {"plain": {"ref": "Force"}}, "tag": "sim"}, {"name": "spy", "type": "any"}],
            "provided": [{"name": "ctl", "tag": "truth", "commands": [
                {"name": "set", "kind": "write", "arg": {"type": {"ref": "Mode"}}},
                {"name": "value", "kind": "read", "ret": {"ref": "Force"}}]}]
        }]
    })
}

/// A schema with the one setting `gain`.
fn setting(gain: Value) -> Value {
    json!({"type": "object", "properties": {"gain": gain}})
}

/// Returns the refusal when the value at `pointer` is replaced.
fn refusal(pointer: &str, value: Value) -> String {
    let mut manifest = good();
    *manifest.pointer_mut(pointer).unwrap_or_else(|| panic!("no {pointer}")) = value;
    read(manifest.to_string().as_bytes()).expect_err("it was taken").to_string()
}

#[test]
fn a_good_manifest_is_taken_with_its_padding() {
    let mut text = good().to_string();
    assert!(read(text.as_bytes()).is_ok());
    text.push_str("   ");
    assert!(read(text.as_bytes()).is_ok());
}

#[test]
fn what_is_wrong_is_named() {
    for (pointer, value, said) in [
        ("/name", json!("a/b"), "plugin name `a/b`"),
        ("/name", json!(""), "plugin name ``"),
        ("/classes/0/name", json!("../x"), "class name `../x`"),
        ("/classes", json!([]), "offers no class"),
        ("/types/0/fields/1/type", json!({"array": "f64", "n": 4}), "field `f` leaves its type `Force`"),
        ("/types/0/fields/1/type", json!({"ref": "Nobody"}), "type `Nobody` is not described"),
        ("/types/0/fields/1/type", json!({"ref": "Force"}), "contains itself"),
        ("/types/0/fields/1/type", json!("f128"), "`f128` is no primitive"),
        ("/types/0/fields/1/type", json!({"array": "f64", "n": u64::MAX / 2}), "larger than"),
        ("/types/1/enum", json!("u16"), "does not have the size"),
        ("/classes/0/inputs/1/type", json!("some"), "`some` is no port type"),
        ("/classes/0/inputs/1/name", json!("raw"), "`raw` is there twice"),
        ("/classes/0/provided/0/commands/0/kind", json!("read"), "do not fit the kind"),
        ("/classes/0/provided/0/commands/0/kind", json!("shout"), "no command kind"),
        (
            "/classes/0/provided/0/commands/0/kind",
            json!("vod"),
            "there are void, write, read, qualified_read",
        ),
        // Faults only the listing of the classes finds.
        ("/classes/0/inputs/1/name", json!("system"), "may not be named system"),
        ("/classes/0/inputs/1/name", json!("tap_events"), "may not be named tap_events: every component has"),
        ("/types/0/fields/1/unit", json!("newton"), "did you mean `N`?"),
        ("/classes/0/inputs/0/tag", json!("truth"), "input raw: tag \"truth\" is not one of sim"),
        ("/classes/0/provided/0/tag", json!("thruth"), "tag \"thruth\" is not one of truth, sim"),
        (
            "/classes/0/config",
            setting(json!({"type": "number", "default": "x"})),
            "its own defaults are not valid",
        ),
        (
            "/classes/0/config",
            setting(json!({"type": "number", "maximum": 400, "default": 5000})),
            "gain: 5000 is above 400",
        ),
        (
            "/classes/0/config",
            setting(json!({"type": "nmber"})),
            "setting gain: `nmber` is no type; did you mean number?",
        ),
        (
            "/classes/0/config",
            setting(json!({"type": "string", "minimum": 3})),
            "its config schema: setting gain: `minimum` holds for numbers, and this is of type string: leave it out",
        ),
        (
            "/classes/0/config",
            setting(json!({"type": ["array", "null"], "items": {"type": "number"}, "maximum": 3})),
            "`maximum` holds for numbers, and this is of type array or null: put it into its items",
        ),
        (
            "/classes/0/config",
            setting(json!({"type": "array", "items": {"type": "boolean", "unit": "mm"}})),
            "setting gain: `unit` holds for numbers, and this is of type boolean",
        ),
        (
            "/classes/0/provided/0/commands/0/arg",
            json!({"type": {"ref": "Mode"}, "min": 0}),
            "min and max of its argument are limits of numbers, and Mode has none: leave them out",
        ),
        (
            "/classes/0/provided/0/commands/0/arg",
            json!({"type": {"array": {"text": 8}, "n": 2}, "max": 8}),
            "min and max of its argument are limits of numbers",
        ),
        (
            "/classes/0/provided/0/commands/0/arg",
            json!({"type": {"list": "bool", "n": 2}, "unit": "mm"}),
            "the unit \"mm\" of its argument is one of numbers",
        ),
        ("/trocar", json!(2), "format 2"),
    ] {
        let text = refusal(pointer, value);
        assert!(text.contains(said), "{pointer}: `{said}` is not in: {text}");
    }
}

#[test]
fn unknown_keys_of_newer_minors_are_ignored() {
    let mut manifest = good();
    manifest["abi"] = json!([1, 99]);
    manifest["classes"][0]["hologram"] = json!({"deep": true});
    assert!(read(manifest.to_string().as_bytes()).is_ok());
}

#[test]
fn a_newer_minor_is_told_which_keys_this_host_does_without() {
    let mut manifest = good();
    manifest["abi"] = json!([1, 99]);
    manifest["classes"][0]["hologram"] = json!({"deep": true});
    let (_, warnings) = read_warned(manifest.to_string().as_bytes()).unwrap();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].starts_with("class `low_pass` has the unknown key `hologram`"), "{warnings:?}");
}

#[test]
fn a_slip_of_the_pen_in_a_key_is_refused_and_the_nearest_key_named() {
    for (place, key, said) in [
        ("", "venodr", "the manifest has the unknown key `venodr`; did you mean `vendor`?"),
        ("/classes/0", "safty", "class `low_pass` has the unknown key `safty`; did you mean `safety`?"),
        (
            "/classes/0/inputs/0",
            "optinal",
            "input `raw` has the unknown key `optinal`; did you mean `optional`?",
        ),
        ("/classes/0/provided/0/commands/0", "overflo", "did you mean `overflow`?"),
        ("/classes/0/provided/0/commands/0/arg", "maximum", "unknown key `maximum`"),
        ("/types/0/fields/1", "qqq", "field `f` has the unknown key `qqq`; there are name, at,"),
        ("/types/0/fields/1/type", "m", "field `f` has the unknown key `m`"),
    ] {
        let mut manifest = good();
        manifest.pointer_mut(place).unwrap()[key] = json!("actuator");
        let text = read(manifest.to_string().as_bytes()).expect_err(key).to_string();
        assert!(text.contains(said), "{key}: `{said}` is not in: {text}");
        let mut own = good();
        own.pointer_mut(place).unwrap()[format!("x-{key}")] = json!("the author's own");
        assert!(read(own.to_string().as_bytes()).is_ok(), "x-{key}");
    }
}

#[test]
fn every_key_that_is_read_is_known_and_no_other() {
    let read = include_str!("../../../plugin-api/src/manifest.rs");
    let mut fields: BTreeSet<String> = BTreeSet::new();
    let mut renamed = None;
    for line in read.lines().map(str::trim) {
        if let Some((_, name)) = line.split_once("rename = \"") {
            renamed = name.split('"').next().map(str::to_owned);
        }
        let field = line.strip_prefix("pub ").unwrap_or(line).split_once(": ");
        if let Some((name, rest)) = field
            && rest.ends_with(',')
            && name.bytes().all(|b| b.is_ascii_lowercase() || b == b'_')
        {
            fields.insert(renamed.take().unwrap_or_else(|| name.to_owned()));
        }
    }
    // Field of `Description`, which is not part of a manifest.
    fields.remove("class");
    assert_eq!(fields, keys::all());
}

#[test]
fn another_major_is_named_also_behind_the_padding_of_a_c_string() {
    let mut manifest = good();
    manifest["abi"] = json!([2, 0]);
    for end in ["\n\0", "\0\0", " \n \0", "\n"] {
        let fault = read(format!("{manifest}{end}").as_bytes()).expect_err(end);
        assert_eq!(fault, Fault::Abi { plugin: [2, 0] }, "{end:?}");
    }
}

#[test]
fn a_configuration_is_an_object_with_a_schema_that_is_one() {
    for (schema, said) in [
        (json!({"type": "objekt"}), "config schema has the type \"objekt\""),
        (json!({}), "config schema has the type none"),
        (json!({"type": "object", "properties": {"a": {"type": "numbre"}}}), "is not a JSON Schema"),
    ] {
        let mut manifest = good();
        manifest["classes"][0]["config"] = schema;
        let text = read(manifest.to_string().as_bytes()).expect_err(said).to_string();
        assert!(text.contains(said), "`{said}` is not in: {text}");
    }
    let mut manifest = good();
    manifest["classes"][0]["safety"] = json!("aktuator");
    assert!(
        read(manifest.to_string().as_bytes()).unwrap_err().to_string().contains("`aktuator` is no safety")
    );
}

#[test]
fn deeply_nested_types_are_refused_not_followed() {
    let mut ty = json!("f64");
    for _ in 0..60 {
        ty = json!({"array": ty, "n": 1});
    }
    assert!(refusal("/types/0/fields/1/type", ty).contains("nested too deeply"));
}
