//! Configurations: defaults, patches, violations in words, live settings, and Configure in every state.

use serde_json::{Value, json};
use trocar_model::*;

use crate::scene::*;

fn schema() -> Value {
    json!({"type": "object", "additionalProperties": false, "required": ["port"], "properties": {
        "port": {"type": "string", "description": "Device file"},
        "cutoff_hz": {"type": "number", "unit": "Hz", "minimum": 0.1, "maximum": 400, "default": 50, "live": true},
        "mode": {"enum": ["fast", "exact"], "default": "fast"},
        "gains": {"type": "array", "items": {"type": "number", "unit": "N/m", "minimum": 0}, "default": [1, 2]},
        "limits": {"type": "object", "additionalProperties": false, "properties": {
            "force": {"type": "number", "unit": "N", "default": 8, "live": true},
            "speed": {"type": "number", "unit": "m/s", "default": 0.1},
        }},
    }})
}

fn messages(config: Value) -> Vec<(String, String)> {
    validate(&schema(), &config).into_iter().map(|v| (v.pointer, v.message)).collect()
}

fn one(config: Value) -> (String, String) {
    let mut all = messages(config);
    assert_eq!(all.len(), 1, "{all:?}");
    all.remove(0)
}

#[test]
fn a_configuration_too_large_for_a_list_is_refused_with_where_to_put_it() {
    let schema = json!({ "type": "object", "properties": { "lut": { "type": "string" } } });
    assert_eq!(validate(&schema, &json!({ "lut": "x".repeat(1_000_000) })), []);
    let wrong = validate(&schema, &json!({ "lut": "x".repeat(1_100_000) }));
    assert!(wrong.len() == 1 && wrong[0].message.contains("into a file"), "{wrong:?}");
}

#[test]
fn whole_numbers_of_64_bits_are_exact_or_refused() {
    let schema = json!({"type": "object", "properties": {
        "big": {"type": "integer"}, "name": {"type": "string"}, "either": {"type": ["integer", "string"]},
        "all": {"type": "array", "items": {"type": "integer"}}, "real": {"type": "number"},
    }});
    let digits = "9007199254740993";
    let given = complete(
        &schema,
        json!({
            "big": digits, "name": digits, "either": digits, "all": [digits, "-9223372036854775808", 3], "real": 1e300,
        }),
    );
    assert_eq!(given["big"], json!(9_007_199_254_740_993_u64));
    assert_eq!(given["all"], json!([9_007_199_254_740_993_u64, i64::MIN, 3]));
    assert_eq!((&given["name"], &given["either"]), (&json!(digits), &json!(digits)), "texts stay texts");
    assert_eq!(validate(&schema, &given), []);
    // As a double, which is what JSON numbers of gRPC are.
    for (config, pointer) in
        [(json!({"big": 9_007_199_254_740_992.0}), "/big"), (json!({"all": [1, -1e18]}), "/all/1")]
    {
        let wrong = validate(&schema, &config);
        assert_eq!(wrong.iter().map(|v| v.pointer.as_str()).collect::<Vec<_>>(), [pointer]);
        assert!(wrong[0].message.contains("write a whole number as a text"), "{}", wrong[0].message);
    }
    assert_eq!(validate(&schema, &json!({"big": 9_007_199_254_740_991.0})), []);
    let wrong = validate(&schema, &complete(&schema, json!({"big": "12a"})));
    assert!(wrong[0].message.contains("\"12a\" is not an integer"), "{}", wrong[0].message);
}

#[test]
fn defaults_are_filled_in_also_below_and_leave_out_what_has_none() {
    let want =
        json!({"cutoff_hz": 50, "mode": "fast", "gains": [1, 2], "limits": {"force": 8, "speed": 0.1}});
    assert_eq!(defaults(&schema()), want);
    let given = complete(&schema(), json!({"port": "x", "limits": {"force": 3}}));
    assert_eq!(given["limits"], json!({"force": 3, "speed": 0.1}), "what was given stays");
}

#[test]
fn what_the_schema_fills_in_is_left_out_also_below() {
    let whole = complete(&schema(), json!({"port": "x", "limits": {"force": 3}, "cutoff_hz": 50.0}));
    let least = without_defaults(&schema(), &whole);
    assert_eq!(least, json!({"port": "x", "limits": {"force": 3}}), "50.0 is the default of 50");
    assert!(is_same(&complete(&schema(), least), &whole));
    assert_eq!(without_defaults(&schema(), &defaults(&schema())), json!({}));
    let unknown = json!({"of_another_version": {"a": 1}});
    assert_eq!(without_defaults(&schema(), &unknown), unknown);
}

#[test]
fn a_merge_patch_follows_rfc_7396() {
    // The table of RFC 7396, appendix A, where both sides are objects or become one.
    let cases = [
        (json!({"a": "b"}), json!({"a": "c"}), json!({"a": "c"})),
        (json!({"a": "b"}), json!({"b": "c"}), json!({"a": "b", "b": "c"})),
        (json!({"a": "b"}), json!({"a": null}), json!({})),
        (json!({"a": ["b"]}), json!({"a": "c"}), json!({"a": "c"})),
        (json!({"a": {"b": "c"}}), json!({"a": {"b": "d", "c": null}}), json!({"a": {"b": "d"}})),
        (json!({"a": [{"b": "c"}]}), json!({"a": [1]}), json!({"a": [1]})),
        (json!({"e": null}), json!({"a": 1}), json!({"e": null, "a": 1})),
        (json!([1, 2]), json!({"a": "b", "c": null}), json!({"a": "b"})),
        (json!({}), json!({"a": {"bb": {"ccc": null}}}), json!({"a": {"bb": {}}})),
        (json!({"a": "b"}), json!(["c"]), json!(["c"])),
    ];
    for (base, patch, want) in cases {
        assert_eq!(merge(&base, &patch), want, "{base} + {patch}");
    }
}

#[test]
fn a_number_outside_its_limits_is_told_with_its_unit() {
    let (pointer, message) = one(json!({"port": "x", "cutoff_hz": 1000}));
    assert_eq!((pointer.as_str(), message.as_str()), ("/cutoff_hz", "cutoff_hz: 1000 Hz is above 400 Hz"));
    assert_eq!(one(json!({"port": "x", "cutoff_hz": 0})).1, "cutoff_hz: 0 Hz is below 0.1 Hz");
    let (pointer, message) = one(json!({"port": "x", "gains": [1, -2]}));
    assert_eq!((pointer.as_str(), message.as_str()), ("/gains/1", "gains.1: -2 N/m is below 0 N/m"));
}

#[test]
fn a_wrong_kind_and_a_wrong_choice_say_what_is_wanted() {
    assert_eq!(one(json!({"port": "x", "cutoff_hz": "high"})).1, "cutoff_hz: \"high\" is not a number in Hz");
    assert_eq!(
        one(json!({"port": "x", "mode": "quick"})).1,
        "mode: \"quick\" is none of \"fast\", \"exact\""
    );
    assert_eq!(one(json!([])).1, "the configuration: a list of 0 is not an object");
}

#[test]
fn a_missing_key_is_named_with_what_it_is_and_an_unknown_one_with_its_neighbour() {
    assert_eq!(one(json!({})), ("/port".into(), "port is missing (string; Device file)".into()));
    let (pointer, message) = one(json!({"port": "x", "cutof_hz": 5}));
    assert_eq!(
        (pointer.as_str(), message.as_str()),
        ("/cutof_hz", "cutof_hz is unknown; did you mean cutoff_hz?")
    );
    assert_eq!(
        one(json!({"port": "x", "limits": {"weight": 1}})).1,
        "limits.weight is unknown; there are force, speed"
    );
}

#[test]
fn every_violation_is_listed_once_in_the_order_of_the_pointers() {
    let all = messages(json!({"cutoff_hz": -1, "mode": 3, "zzz": 1}));
    let pointers: Vec<&str> = all.iter().map(|(p, _)| p.as_str()).collect();
    assert_eq!(pointers, ["/cutoff_hz", "/mode", "/port", "/zzz"]);
}

#[test]
fn a_broken_schema_blames_the_class_not_the_user() {
    let found = validate(&json!({"type": "no such type"}), &json!({}));
    assert!(found[0].message.starts_with("the class's own configuration schema is invalid"), "{found:?}");
}

#[test]
fn only_settings_declared_live_may_differ_while_running() {
    let base = complete(&schema(), json!({"port": "x"}));
    let patched = |patch: Value| merge(&base, &patch);
    assert_eq!(
        live_only(&schema(), &base, &patched(json!({"cutoff_hz": 10, "limits": {"force": 1}}))),
        Ok(())
    );
    let both = patched(json!({"mode": "exact", "limits": {"speed": 1}}));
    assert_eq!(live_only(&schema(), &base, &both), Err(vec!["limits.speed".into(), "mode".into()]));
    assert_eq!(live_settings(&schema()), ["cutoff_hz", "limits.force"]);
}

fn configure(path: &str, patch: Value) -> Request {
    Request::Configure { id: id(path), patch, execution: None }
}

#[test]
fn configure_merges_checks_and_makes_ready() {
    let mut graph = empty();
    done(&mut graph, &[create("host/dev", "device")]);
    assert_eq!(graph.components[&id("host/dev")].state, State::Created);
    let refusal = refused(&graph, &configure("host/dev", json!({"baud": 1})));
    let Refusal::ConfigInvalid { violations, .. } = &refusal else { panic!("{refusal}") };
    assert_eq!(violations.len(), 2, "both the missing port and the baud rate: {refusal}");
    done(&mut graph, &[configure("host/dev", json!({"port": "/dev/null"}))]);
    let device = &graph.components[&id("host/dev")];
    assert_eq!((device.state, &device.config["baud"]), (State::Ready, &json!(9600)));
}

#[test]
fn null_in_a_patch_brings_the_default_back() {
    let mut graph = theatre();
    done(
        &mut graph,
        &[configure("host/robot", json!({"limit": 5})), configure("host/robot", json!({"limit": null}))],
    );
    assert_eq!(graph.components[&id("host/robot")].config["limit"], json!(2));
}

#[test]
fn configure_on_an_active_component_takes_live_settings_and_names_the_others() {
    let mut graph = theatre();
    done(&mut graph, &[start(&["host/robot"]), configure("host/robot", json!({"limit": 5}))]);
    let robot = &graph.components[&id("host/robot")];
    assert_eq!((robot.state, &robot.config["limit"]), (State::Active, &json!(5)));
    let refusal = refused(&graph, &configure("host/robot", json!({"joints": 6})));
    assert_eq!(refusal.reason(), "WRONG_STATE");
    let text = refusal.to_string();
    assert!(text.contains("joints cannot change while it runs (live settings: limit)"), "{text}");
}

#[test]
fn configure_on_a_stopped_component_makes_it_ready_and_on_a_fault_is_refused() {
    let mut graph = theatre();
    set_state(&mut graph, "host/robot", State::Stopped(StopReason::Requested));
    done(&mut graph, &[configure("host/robot", json!({"limit": 2}))]);
    assert_eq!(graph.components[&id("host/robot")].state, State::Ready);
    set_state(&mut graph, "host/robot", State::Fault);
    let refusal = refused(&graph, &configure("host/robot", json!({})));
    assert!(
        matches!(&refusal, Refusal::WrongState { allowed, .. } if allowed.contains(&Verb::Reset)),
        "{refusal}"
    );
}

#[test]
fn a_patch_that_changes_nothing_is_nothing_to_do() {
    let graph = theatre();
    assert_eq!(plan(&graph, &configure("host/robot", json!({"limit": 2}))).unwrap(), Plan::default());
}

#[test]
fn a_null_for_a_setting_that_does_not_exist_is_a_misspelt_name() {
    let mut graph = empty();
    done(&mut graph, &[create("host/robot", "eyerobot")]);
    let ask = |patch: Value| Request::Configure { id: id("host/robot"), patch, execution: None };
    let refusal = refused(&graph, &ask(json!({"limits": null})));
    assert!(refusal.to_string().contains("limits is unknown; did you mean limit?"), "{refusal}");
    plan(&graph, &ask(json!({"limit": null}))).expect("null asks for the default of what exists");
    let created = Request::Create {
        id: id("host/other"),
        class: "eyerobot".into(),
        config: Some(json!({"x": null})),
        execution: Execution::default(),
    };
    assert_eq!(refused(&graph, &created).reason(), "CONFIG_INVALID");
    let nested = unknown_nulls(&schema(), &json!({}), &json!({"limits": {"forse": null}}));
    assert_eq!(nested[0].message, "limits.forse is unknown; did you mean force?");
}

#[test]
fn a_running_component_that_refuses_a_setting_is_not_said_to_allow_configure() {
    let mut graph = empty();
    done(&mut graph, &[create("host/robot", "eyerobot"), start(&["host/robot"])]);
    let patch = json!({"joints": 3});
    let refusal = refused(&graph, &Request::Configure { id: id("host/robot"), patch, execution: None });
    let text = refusal.to_string();
    assert!(text.ends_with("(live settings: limit); allowed are Stop, Reset, Remove"), "{text}");
}

#[test]
fn the_unit_one_is_not_written_behind_a_number() {
    let schema = json!({ "type": "object", "properties": { "gain": { "type": "number", "maximum": 5, "unit": "1" } } });
    let said = |gain: Value| trocar_model::validate(&schema, &json!({ "gain": gain })).remove(0).message;
    assert_eq!(said(json!(30)), "gain: 30 is above 5");
    assert_eq!(said(json!("a")), "gain: \"a\" is not a number");
}

#[test]
fn a_type_that_json_does_not_have_is_named_with_those_it_has() {
    let inside = json!({ "type": "object", "properties": { "b": { "type": "array", "items": { "type": ["nmber", "null"] } } } });
    let schema = json!({ "type": "object", "properties": { "a": inside } });
    assert_eq!(
        trocar_model::schema_fault(&schema).unwrap(),
        "setting a.b: `nmber` is no type; did you mean number? There are number, integer, string, boolean, array, object, null"
    );
    let odd = json!({ "type": "object", "minProperties": "few" });
    assert!(trocar_model::schema_fault(&odd).is_some(), "the validator is asked as well");
}
