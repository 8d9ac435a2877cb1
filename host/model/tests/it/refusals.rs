//! Refusals: every one has a code, a sentence, help and a place in docs/errors.md.

use std::collections::BTreeSet;

use trocar_model::*;

use crate::scene::*;

fn screaming(camel: &str) -> String {
    let mut out = String::new();
    for c in camel.chars() {
        if c.is_ascii_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.push(c.to_ascii_uppercase());
    }
    out
}

#[test]
fn every_refusal_has_an_example_of_its_own_and_its_reason_is_its_name() {
    let mut seen = BTreeSet::new();
    for refusal in Refusal::examples() {
        assert_eq!(refusal.reason(), screaming(refusal.kind()));
        assert!(seen.insert(refusal.reason()), "a row's example is of another row: {refusal:?}");
    }
}

#[test]
fn every_refusal_says_what_is_wrong_and_what_to_do() {
    for refusal in Refusal::examples() {
        let (text, help, reason) = (refusal.to_string(), refusal.help(), refusal.reason());
        assert!(
            text.len() > 15 && !text.ends_with('.'),
            "{reason}: {text:?} must be a sentence without a full stop"
        );
        assert!(help.len() > 15 && help.ends_with('.'), "{reason}: {help:?} must be whole sentences");
        assert!(!text.contains("failed to"), "{reason}: {text:?} says failed to without because");
        assert!(
            !text.contains('\n') && !help.contains('\n') && !help.contains("  "),
            "{reason} must be one line"
        );
        assert!(refusal.metadata().values().all(|v| !v.is_empty()), "{reason}: {:?}", refusal.metadata());
    }
}

#[test]
fn long_lists_are_cut_in_the_sentence_but_whole_in_the_metadata() {
    let known: Vec<ComponentId> = (0..40).map(|i| id(&format!("host/c{i}"))).collect();
    let refusal = Refusal::ComponentNotFound { id: id("host/robot"), known };
    let text = refusal.to_string();
    assert!(text.ends_with("host/c11 and 28 more"), "{text}");
    assert_eq!(refusal.metadata()["known"].split(',').count(), 40);
}

#[test]
fn what_is_far_too_long_is_not_repeated_whole() {
    let long = "x".repeat(1 << 20);
    let graph = theatre();
    let dev = Refusal::BadPath { text: long.clone(), why: "it is no path".into() };
    let limit = serde_json::json!({"limit": long, "joints": [long], long.clone(): 1});
    let carrier = Request::Connect {
        client: port("host/log/force"),
        server: port("host/robot/force"),
        options: ConnectOptions { carrier: long.clone(), replace: true, ..ConnectOptions::default() },
    };
    let many: serde_json::Map<String, serde_json::Value> =
        (0..5000).map(|i| (format!("k{i}"), 1.into())).collect();
    let refusals = [
        dev,
        refused(&graph, &create("host/x", &long)),
        refused(&graph, &Request::Configure { id: id("host/robot"), patch: limit, execution: None }),
        refused(&graph, &Request::Configure { id: id("host/robot"), patch: many.into(), execution: None }),
        refused(&graph, &carrier),
        Refusal::PluginNotFound { name: long.clone(), known: vec![] },
        Refusal::NothingMatches { pattern: long.clone(), known: vec![] },
    ];
    for refusal in refusals {
        let fields: usize = refusal.field_violations().iter().map(|(f, d)| f.len() + d.len()).sum();
        let values: usize = refusal.metadata().values().map(String::len).sum();
        let all = (refusal.to_string().len(), refusal.help().len(), fields, values);
        assert!(
            all.0 < 2500 && all.1 < 1000 && all.2 < 15_000 && all.3 < 2500,
            "{}: {all:?}",
            refusal.reason()
        );
    }
    let force = force("N");
    let error = encode(&force, &serde_json::json!({long.clone(): 1})).unwrap_err().to_string();
    assert!(error.len() < 1500, "{} bytes", error.len());
    assert_eq!(brief("short"), "short");
    assert_eq!(brief(&"é".repeat(300)).chars().filter(|c| *c == 'é').count(), 200, "cut between characters");
}

#[test]
fn a_slip_is_answered_with_the_name_that_was_meant() {
    let refusal = refused(&theatre(), &start(&["host/robt"]));
    assert!(refusal.to_string().contains("did you mean `host/robot`?"), "{refusal}");
    assert_eq!(refusal.metadata()["nearest"], "host/robot");
}

#[test]
fn each_violation_of_a_configuration_becomes_a_field() {
    let request = Request::Configure {
        id: id("host/robot"),
        patch: serde_json::json!({"limit": 99, "joint": 1}),
        execution: None,
    };
    let fields = refused(&theatre(), &request).field_violations();
    let names: Vec<&str> = fields.iter().map(|(f, _)| f.as_str()).collect();
    assert_eq!(names, ["config/joint", "config/limit"]);
    assert_eq!(fields[1].1, "limit: 99 N is above 10 N");
}

#[test]
fn the_page_of_errors_is_what_the_code_says() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/errors.md");
    let want = errors_markdown();
    if std::env::var_os("TROCAR_BLESS").is_some() {
        std::fs::write(path, &want).unwrap();
    }
    let have = std::fs::read_to_string(path).unwrap_or_default();
    assert!(
        have == want,
        "docs/errors.md is stale; run `TROCAR_BLESS=1 cargo test -p trocar-model` and look at the diff"
    );
}

#[test]
fn help_names_only_what_helps_there() {
    let argument = |field: &str| {
        let (what, why) = ("host/s/ctl/write".into(), "it is wrong".into());
        Refusal::ArgumentInvalid { what, why, field: field.into() }.help()
    };
    assert!(argument("json").contains("`trocar describe host/s/ctl/write`"));
    assert!(argument("execution.priority").contains("trocar create --help"));
    assert!(argument("level").len() < 40, "{}", argument("level"));

    let differ = |difference: &str| {
        let (client, server) = (port("host/a/in"), port("host/b/out"));
        let what = "frame header".into();
        Refusal::TypeMismatch { client, server, what, difference: difference.into() }.help()
    };
    assert!(!differ("field `right_offset` exists there only").contains("adapt"));
    assert!(
        differ("field `f` lies at byte 8 here and at byte 0 there; adapt: true would copy it by name")
            .contains("adapt")
    );
}

#[test]
fn an_output_without_a_sample_says_how_its_component_stands_and_what_sets_it_going() {
    let none = |state| Refusal::NoSample { port: port("host/s/value"), state, after_ns: 2_000_400_000 };
    let ready = none(State::Ready);
    let text = ready.to_string();
    assert_eq!(text, "output `host/s/value` gave no sample within 2 s; its component is READY");
    assert!(ready.help().ends_with("`trocar start host/s`."), "{}", ready.help());
    assert!(none(State::Stopped(StopReason::Requested)).help().ends_with("`trocar resume host/s`."));
    assert!(none(State::Fault).help().ends_with("`trocar reset host/s`, `trocar start host/s`."));
}

#[test]
fn a_refused_plugin_file_is_named_once() {
    for text in ["/p/libx.so: has no manifest", "libx.so: has no manifest", "has no manifest"] {
        let refusal = Refusal::PluginBadFile { file: "/p/libx.so".into(), text: text.into() };
        assert_eq!(refusal.to_string(), "`/p/libx.so` is not a usable plugin: has no manifest");
    }
}

#[test]
fn a_process_that_is_away_is_told_as_it_stands_and_what_happens_next() {
    let process = Name::parse("right").unwrap();
    let lost = |state, last_exit: &str| {
        let refusal = Refusal::ProcessLost { process: process.clone(), state, last_exit: last_exit.into() };
        (refusal.to_string(), refusal.help())
    };
    let (silent, help) = lost(ProcessState::Lost, "");
    assert!(
        silent.contains("does not answer") && help.contains("trocar host --name right"),
        "{silent} {help}"
    );
    let (ended, _) = lost(ProcessState::Lost, "exited with code 3");
    assert!(ended.contains("has ended: it exited with code 3"), "{ended}");
    let (restarting, help) = lost(ProcessState::Restarting, "was killed by SIGSEGV");
    assert!(restarting.contains("being restarted: it was killed by SIGSEGV"), "{restarting}");
    assert!(
        help.contains("in a moment") && !help.contains("trocar host"),
        "nobody is to start a second one: {help}"
    );
    let (failed, help) = lost(ProcessState::Failed, "was killed by SIGSEGV");
    assert!(failed.contains("has failed and is not started again: it was killed by SIGSEGV"), "{failed}");
    assert!(help.contains("trocar restart right"), "{help}");
    assert!(
        ![silent, ended, restarting, failed].iter().any(|text| text.ends_with('.')),
        "a sentence goes on"
    );
}
