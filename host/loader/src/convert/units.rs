//! Refuses a class with an unreadable unit, by its name, the place and what was probably meant; also one
//! whose execution or defaults no Create could accept.
#![allow(clippy::unwrap_used)]

use serde_json::json;
use trocar_plugin_api::manifest::Manifest;

use super::{classes, description};

fn manifest(unit: &str) -> Manifest {
    let text = json!({
        "trocar": 1, "abi": [1, 2], "name": "toy", "version": "1.0.0",
        "types": [{ "name": "Force", "size": 8, "align": 8, "fields": [
            { "name": "z", "at": 0, "type": "f64", "unit": unit }
        ]}],
        "classes": [class()]
    });
    serde_json::from_value(text).unwrap()
}

fn class() -> serde_json::Value {
    json!({
        "name": "sensor", "execution": { "model": "on_signal" }, "config": {},
        "outputs": [{ "name": "force", "type": { "plain": { "ref": "Force" } } }]
    })
}

#[test]
fn an_unknown_unit_refuses_the_class_and_a_known_one_does_not() {
    let info = classes(&manifest("mN"), "").unwrap().remove(0);
    let why = classes(&manifest("newtons"), "").unwrap_err();
    assert_eq!(
        why,
        "class sensor: output force: field z of Force: unit \"newtons\": `newtons` is no unit; did you mean `N`?"
    );
    let described = |unit: &str| json!({ "types": manifest(unit).types, "class": class() }).to_string();
    description(described("N").as_bytes(), &info).unwrap();
    let why = description(described("newtons").as_bytes(), &info).unwrap_err();
    assert!(
        why.contains("did you mean `N`?"),
        "a description that is written later is held to the same: {why}"
    );
}

#[test]
fn a_class_that_no_create_could_accept_is_refused_when_it_is_listed() {
    let refused = |key: &str, value: serde_json::Value| {
        let mut class = class();
        class[key] = value;
        let mut manifest = manifest("mN");
        manifest.classes = vec![serde_json::from_value(class).unwrap()];
        classes(&manifest, "").unwrap_err()
    };
    let why = refused("execution", json!({ "model": "on_signal", "period_ns": 250_000_000 }));
    assert_eq!(why, "class sensor: execution.rate_hz: a rate means nothing to model on_signal");
    let gain = json!({ "type": "number", "minimum": 3, "maximum": 1, "default": 5 });
    let why = refused("config", json!({ "type": "object", "properties": { "gain": gain } }));
    assert!(why.starts_with("class sensor: its own defaults are not valid: gain: 5 is above 1"), "{why}");
}
