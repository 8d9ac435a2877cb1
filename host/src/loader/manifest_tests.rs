//! Which manifests are taken, and what is said about the others.
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
            "inputs": [{"name": "raw", "type": {"plain": {"ref": "Force"}}}, {"name": "spy", "type": "any"}],
            "provided": [{"name": "ctl", "commands": [
                {"name": "set", "kind": "write", "arg": {"type": {"ref": "Mode"}}},
                {"name": "value", "kind": "read", "ret": {"ref": "Force"}}]}]
        }]
    })
}

/// What is said when the value at `pointer` is replaced.
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
fn deeply_nested_types_are_refused_not_followed() {
    let mut ty = json!("f64");
    for _ in 0..60 {
        ty = json!({"array": ty, "n": 1});
    }
    assert!(refusal("/types/0/fields/1/type", ty).contains("nested too deeply"));
}
