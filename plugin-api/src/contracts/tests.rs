//! Contracts against manifests made here: each way to differ is found and said.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::manifest::Manifest;
use serde_json::{Value, json};

/// A force sensor as its author's manifest would describe it.
fn sensor() -> Value {
    let vector = |unit: &str| json!({"type": {"array": "f64", "n": 3}, "unit": unit});
    let field = |name: &str, at: usize, mut f: Value| {
        (f["name"], f["at"]) = (json!(name), json!(at));
        f
    };
    json!({
        "trocar": 1, "abi": [1, 2], "name": "p", "version": "1",
        "types": [
            {"name": "Load", "size": 56, "align": 8, "fields": [
                field("stamp", 0, json!({"type": "stamp"})),
                field("force", 8, vector("N")),
                field("torque", 32, vector("N.m")),
            ]},
            {"name": "ForceRange", "size": 72, "align": 8, "fields": [
                field("force", 0, vector("N")),
                field("torque", 24, vector("N.m")),
                field("force_noise", 48, json!({"type": "f64", "unit": "N"})),
                field("torque_noise", 56, json!({"type": "f64", "unit": "N.m"})),
                field("rate", 64, json!({"type": "f64", "unit": "Hz"})),
            ]},
        ],
        "classes": [{
            "name": "nano", "safety": "sensor",
            "outputs": [{"name": "wrench", "type": {"plain": {"ref": "Load"}}}],
            "provided": [{"name": "force_sensor",
                "commands": [
                    {"name": "measured_cf", "kind": "read", "ret": {"ref": "Load"}},
                    {"name": "range", "kind": "read", "ret": {"ref": "ForceRange"}},
                    {"name": "bias", "kind": "void"},
                ],
                "events": [{"name": "overload", "payload": "bool"}]}],
        }],
    })
}

fn judge(manifest: &Value) -> Vec<String> {
    let manifest: Manifest = serde_json::from_value(manifest.clone()).unwrap();
    check(&manifest, "nano", &FORCE_SENSOR).iter().map(ToString::to_string).collect()
}

/// The sentences after one value of the manifest was replaced.
fn after(pointer: &str, value: Value) -> Vec<String> {
    let mut manifest = sensor();
    *manifest.pointer_mut(pointer).unwrap() = value;
    judge(&manifest)
}

#[test]
fn a_class_that_has_every_member_fulfils_its_contract_whatever_its_types_are_called() {
    assert_eq!(judge(&sensor()), [""; 0]);
}

#[test]
fn a_missing_member_is_said_with_what_it_would_be() {
    assert_eq!(
        after("/classes/0/provided/0/commands", json!([])),
        [
            "command `force_sensor/measured_cf` is missing: a read command that gives Wrench",
            "command `force_sensor/range` is missing: a read command that gives ForceRange",
            "command `force_sensor/bias` is missing: a void command",
        ]
    );
    let events = after("/classes/0/provided/0/events", json!([]));
    assert_eq!(events, ["event `force_sensor/overload` is missing: it carries bool"]);
    let interface = after("/classes/0/provided/0/name", json!("force"));
    assert_eq!(interface, ["provided interface `force_sensor` is missing; there are force"]);
    let outputs = after("/classes/0/outputs", json!([]));
    assert_eq!(outputs, ["output `wrench` is missing: samples of Wrench; there are none"]);
}

#[test]
fn a_wrong_kind_type_unit_or_safety_is_said_with_both_sides() {
    assert_eq!(
        after("/classes/0/provided/0/commands/2/kind", json!("void_return")),
        ["command `force_sensor/bias` is void_return, the contract says void"]
    );
    assert_eq!(
        after("/types/0/fields/1/unit", json!("mN")),
        [
            "result of `force_sensor/measured_cf` is not Wrench: it has `force: [f64;3] mN`, the contract says `force: [f64;3] N`",
            "type of `wrench` is not Wrench: it has `force: [f64;3] mN`, the contract says `force: [f64;3] N`",
        ]
    );
    assert_eq!(
        after("/classes/0/provided/0/events/0/payload", json!("u8")),
        ["payload of `force_sensor/overload` is not bool: it has `u8`, the contract says `bool`"]
    );
    assert_eq!(
        after("/classes/0/safety", json!("none")),
        ["class `nano` has safety `none`: declare it `sensor`"]
    );
    let framed = json!({"frame": {"ref": "Load"}, "format": "image"});
    assert_eq!(
        after("/classes/0/outputs/0/type", framed),
        [
            "type of `wrench` is not samples of Wrench: it has `frames of format `image``, the contract says `samples of Wrench`"
        ]
    );
}

#[test]
fn a_gap_or_a_coordinate_frame_makes_another_type() {
    assert!(after("/types/0/fields/2/at", json!(40))[0].contains("torque: [f64;3] N.m @40"));
    let mut framed = sensor();
    framed["types"][0]["fields"][1]["frame"] = json!("retina");
    assert!(judge(&framed)[0].contains("force: [f64;3] N in retina"));
}

#[test]
fn types_that_are_missing_or_hold_themselves_are_said_and_end() {
    let missing = after("/types/0/name", json!("Other"));
    assert_eq!(
        missing[0],
        "`force_sensor/measured_cf` cannot be judged: the manifest names the type `Load` and lacks it"
    );
    let endless = after("/types/0/fields/0/type", json!({"ref": "Load"}));
    assert!(endless[0].contains("nested too deeply"), "{endless:?}");
}

#[test]
fn a_manifest_made_to_keep_the_reader_busy_ends_at_once() {
    let mut manifest = sensor();
    for depth in 0..12 {
        let inner = json!({"ref": format!("T{}", depth + 1)});
        let fields: Vec<Value> =
            (0..100).map(|i| json!({"name": format!("f{i}"), "at": 0, "type": inner})).collect();
        let name = if depth == 0 { "Load".to_string() } else { format!("T{depth}") };
        let ty = json!({"name": name, "size": 0, "align": 1, "fields": fields});
        manifest["types"].as_array_mut().unwrap().insert(0, ty);
    }
    manifest["types"].as_array_mut().unwrap().insert(0, json!({"name": "T12", "size": 0, "align": 1}));
    assert!(judge(&manifest)[0].contains("too wide for a payload"));
}

#[test]
fn a_servo_that_queues_is_no_servo() {
    let command = |overflow: &str| {
        let pose = json!({"name": "Pose", "size": 8, "align": 8, "fields": []});
        let servo = json!({"name": "servo_cp", "kind": "write", "overflow": overflow,
            "arg": {"name": "goal", "type": {"ref": "Pose"}}});
        let class = json!({"name": "a", "safety": "actuator",
            "provided": [{"name": "body", "commands": [servo]}]});
        let manifest = json!({"trocar": 1, "abi": [1, 2], "name": "p", "version": "1", "types": [pose], "classes": [class]});
        let manifest: Manifest = serde_json::from_value(manifest).unwrap();
        let found = check(&manifest, "a", &ARM);
        found.iter().map(ToString::to_string).filter(|said| said.contains("overflow")).collect::<Vec<_>>()
    };
    assert_eq!(command("latest_wins"), [""; 0]);
    assert_eq!(
        command("reject"),
        ["command `body/servo_cp` has overflow `reject`, the contract says `latest_wins`"]
    );
}

#[test]
fn one_of_several_devices_of_a_class_is_judged_by_its_own_interface() {
    let mut manifest = sensor();
    manifest["classes"][0]["provided"][0]["name"] = json!("force_left");
    let manifest: Manifest = serde_json::from_value(manifest).unwrap();
    assert_eq!(check_as(&manifest, "nano", &FORCE_SENSOR, "force_left"), []);
    let said = check_as(&manifest, "nano", &FORCE_SENSOR, "force_right");
    assert_eq!(said.len(), 1);
    assert_eq!(said[0].to_string(), "provided interface `force_right` is missing; there are force_left");
}

#[test]
fn a_class_that_is_not_there_is_said_with_those_that_are() {
    let manifest: Manifest = serde_json::from_value(sensor()).unwrap();
    let found = check(&manifest, "mini", &FORCE_SENSOR);
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].to_string(), "no class `mini`; there are nano");
}

#[test]
fn any_of_the_alternatives_of_an_output_is_enough() {
    let formats: Vec<String> = CAMERA.outputs[0].one_of.iter().map(Flows::text).collect();
    assert_eq!(
        formats,
        ["frames with ImageHeader, format \"image\"", "frames with StereoHeader, format \"stereo\""]
    );
}

#[test]
fn contracts_are_found_by_name_or_listed() {
    assert_eq!(contract("arm").unwrap().name, "arm");
    assert_eq!(
        contract("robot").unwrap_err(),
        "no contract `robot`; there are arm, camera, spectrometer, tracker, force_sensor, input"
    );
}

#[test]
fn every_type_of_the_tables_is_a_primitive_or_a_payload_of_the_tables() {
    let known = ["bool", "u8", "u16", "u32", "u64", "i32", "f32", "f64", "stamp"];
    let carried = CONTRACTS.iter().flat_map(|c| {
        let members = c.interfaces.iter().flat_map(|i| {
            let commands = i.commands.iter().flat_map(|c| [c.arg.ty, c.ret.ty]);
            commands.chain(i.events.iter().map(|e| e.payload.ty))
        });
        members.chain(c.outputs.iter().flat_map(|o| o.one_of).map(|f| match f {
            Flows::Samples(ty) | Flows::Frames { header: ty, .. } => *ty,
        }))
    });
    let fields = PAYLOADS.iter().flat_map(|p| p.fields.iter().map(|f| f.ty));
    for ty in carried.chain(fields).filter(|ty| !ty.is_empty()) {
        for leaf in leaves_of_payload(ty, "") {
            let spelt = leaf.split(": ").nth(1).unwrap();
            let base = spelt.trim_start_matches("list").trim_start_matches('[');
            let base = base.split([' ', ';', '(', '[']).next().unwrap();
            assert!(known.contains(&base) || base == "text", "`{ty}`: `{leaf}` ends in an unknown type");
        }
    }
}

#[test]
fn the_document_is_the_one_in_docs() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/INTERFACES.md");
    let wanted = document();
    if std::env::var_os("TROCAR_BLESS").is_some() {
        std::fs::write(path, &wanted).unwrap();
    }
    let there = std::fs::read_to_string(path).unwrap_or_default();
    let line = there.lines().zip(wanted.lines()).take_while(|(a, b)| a == b).count() + 1;
    assert!(
        there == wanted,
        "docs/INTERFACES.md is stale from line {line}: run this test with TROCAR_BLESS=1"
    );
}
