//! Drafts judged by classes: each refusal at its place, none for what follows from another.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use trocar_model::{ClassInfo, Process, ProcessState, SystemGraph, Warnings, plan_all};

use super::{Draft, SystemFile};

fn draft(text: &str) -> Draft {
    Draft::of("system.json", text.to_owned()).unwrap()
}

/// Processes whose plugins offer the class `arm`: an input, an output, a required and a provided interface.
fn processes(names: &[&str]) -> SystemGraph {
    processes_of(names, &[crate::gcm::fake::class()])
}

/// Processes without components whose plugins offer these classes.
pub(super) fn processes_of(names: &[&str], classes: &[Arc<ClassInfo>]) -> SystemGraph {
    let process = |name: &&str| {
        let process = Process {
            epoch: 1,
            state: ProcessState::Attached,
            endpoint: String::new(),
            pid: 0,
            classes: classes.to_vec(),
            last_exit: String::new(),
            restarts: 0,
            warnings: Warnings::default(),
            guest: String::new(),
        };
        (name.parse().unwrap(), process)
    };
    let processes = names.iter().map(process).collect();
    SystemGraph { processes, next_connection: 1, ..SystemGraph::default() }
}

const WIRED: &str = r#"{
  "version": 1,
  "components": {
    "host/a": { "class": "arm" },
    "host/b": { "class": "arm", "config": { "gain": 2 }, "execution": { "rate_hz": 500 } },
    "host/c": { "class": "arm", "start": false }
  },
  "connections": [
    { "client": "host/b/input", "server": "host/a/value" },
    { "client": "host/c/robot", "server": "host/b/arm" }
  ]
}"#;

#[test]
fn what_is_right_is_told_as_the_plan_that_would_be_carried_out() {
    let file = SystemFile::parse("system.json", WIRED.to_owned()).unwrap();
    let judged = draft(WIRED).judge(&processes(&["host"]));
    assert_eq!((judged.problems, judged.unknown.len()), (vec![], 0));
    let whole = plan_all(&processes(&["host"]), &file.requests()).unwrap();
    assert_eq!(judged.plan, whole);
}

#[test]
fn a_file_of_many_components_is_judged_at_once_and_a_hundred_of_their_mistakes_are_listed() {
    // Each plan by itself would copy the graph, ten thousand times ten thousand components.
    let of = |class: &str| {
        let all: Vec<String> =
            (0..10_000).map(|n| format!(r#""host/c{n}": {{ "class": "{class}" }}"#)).collect();
        draft(&format!(r#"{{ "version": 1, "components": {{ {} }} }}"#, all.join(",")))
    };
    let right = of("arm").judge(&processes(&["host"]));
    assert_eq!((right.problems.len(), right.plan.changes.len()), (0, 30_000));
    assert_eq!(of("leg").judge(&processes(&["host"])).problems.len(), 100);
}

#[test]
fn a_misspelt_class_hides_no_other_mistake_of_its_component() {
    let text = WIRED
        .replacen(r#"{ "class": "arm" }"#, r#"{ "class": "amr", "execution": { "rate_hz": 100000 } }"#, 1)
        .replacen("host/a/value", "host/a/vlaue", 1);
    let judged = draft(&text).judge(&processes(&["host"]));
    let pointers: Vec<&str> = judged.problems.iter().map(|p| p.pointer.as_str()).collect();
    assert_eq!(
        pointers,
        ["/components/host~1a/class", "/components/host~1a/execution/rate_hz", "/connections/0/server"],
        "{:#?}",
        judged.problems
    );
}

#[test]
fn every_refusal_is_listed_with_its_place_and_none_for_what_hangs_on_another() {
    let wrong = [
        (r#""host/a": { "class": "arm" }"#, r#""host/a": { "class": "leg" }"#),
        (r#""gain": 2"#, r#""gain": -2"#),
        (r#""start": false"#, r#""execution": { "rate_hz": 100000 }"#),
        (
            r#""connections": ["#,
            r#""connections": [
    { "client": "host/d/inputs", "server": "host/e/value" },
    { "client": "host/d/robot", "server": "host/f/values" },"#,
        ),
        (
            r#""components": {"#,
            r#""components": {
    "host/d": { "class": "arm" }, "host/e": { "class": "arm" },
    "host/f": { "class": "arm", "config": { "gain": 1 } },"#,
        ),
    ];
    let text = wrong.iter().fold(WIRED.to_owned(), |text, (part, by)| text.replacen(part, by, 1));
    let judged = draft(&text).judge(&processes(&["host"]));
    let places: Vec<&str> = judged.problems.iter().map(|p| p.pointer.as_str()).collect();
    assert_eq!(
        places,
        [
            "/components/host~1a/class",
            "/components/host~1b/config/gain",
            "/components/host~1c/execution/rate_hz",
            "/connections/0/client",
        ],
        "{:#?}",
        judged.problems
    );
    assert!(judged.problems.iter().all(|p| p.line > 3 && !p.help.is_empty()), "{:#?}", judged.problems);
    let unknown: Vec<String> = judged.unknown.iter().map(|(port, _)| port.to_string()).collect();
    assert_eq!(unknown, ["host/f/values"], "its configuration may make it");
    let done = crate::gcm::plan_lines(&judged.plan).join("; ");
    assert!(done.contains("+ create host/f (toy/arm)") && !done.contains("host/a"), "{done}");
}

#[test]
fn a_server_that_is_not_there_is_found_beside_a_client_that_nobody_knows_yet() {
    let text = WIRED.replacen("host/b/input", "host/b/made", 1).replacen("host/a/value", "host/a/valeu", 1);
    let judged = draft(&text).judge(&processes(&["host"]));
    let said: Vec<&str> = judged.problems.iter().map(|p| p.pointer.as_str()).collect();
    assert_eq!(said, ["/connections/0/server"], "{:?}", judged.problems);
}

#[test]
fn what_could_not_be_read_is_doubted_and_the_rest_is_judged() {
    let wrong = [
        // Another execution was meant: whether it suits is not judged, its connections are.
        (r#""rate_hz": 500"#, r#""rate_hz": 100000, "cpu": 1"#),
        (r#""gain": 2"#, r#""gain": -2"#),
        // Without its client it is not known which component waits for a connection, so no Start is judged.
        (r#""client": "host/c/robot""#, r#""clint": "host/c/robot""#),
        (
            r#""connections": ["#,
            r#""connections": [
    { "client": "host/c/input", "server": "host/d/value" },
    { "client": "host/a/input", "server": "host/c/robot", "adpat": true },
    { "client": "host/c/inputs", "server": "host/a/value", "queue": 7 },"#,
        ),
    ];
    let text = wrong.iter().fold(WIRED.to_owned(), |text, (part, by)| text.replacen(part, by, 1));
    let judged = draft(&text).judge(&processes(&["host"]));
    let places: Vec<&str> = judged.problems.iter().map(|p| p.pointer.as_str()).collect();
    assert_eq!(
        places,
        [
            "/components/host~1b/config/gain",
            "/components/host~1b/execution/cpu",
            "/connections/0/server",
            "/connections/1",
            "/connections/1/adpat",
            "/connections/2/client",
            "/connections/2/queue",
            "/connections/4/clint",
        ],
        "{:#?}",
        judged.problems
    );
}

#[test]
fn classes_of_a_process_whose_plugins_could_not_be_read_are_not_missed() {
    let text = WIRED
        .replacen(r#""components""#, r#""processes": { "host": { "plugins": 7 } }, "components""#, 1)
        .replacen(r#""host/a": { "class": "arm" }"#, r#""host/a": { "class": "leg" }"#, 1);
    let judged = draft(&text).judge(&processes(&["host"]));
    let places: Vec<&str> = judged.problems.iter().map(|p| p.pointer.as_str()).collect();
    assert_eq!(places, ["/processes/host/plugins"], "{:#?}", judged.problems);
}

#[test]
fn a_component_is_judged_by_all_its_settings_though_several_are_refused() {
    let text = WIRED.replacen(
        r#""config": { "gain": 2 }, "execution": { "rate_hz": 500 }"#,
        r#""config": { "gain": -2 }, "execution": { "rate_hz": 100000 }"#,
        1,
    );
    let text = text.replacen("host/b/input", "host/b/inputs", 1);
    let judged = draft(&text).judge(&processes(&["host"]));
    let places: Vec<&str> = judged.problems.iter().map(|p| p.pointer.as_str()).collect();
    let settings = ["/config/gain", "/execution/rate_hz"];
    assert_eq!(places, settings.map(|part| format!("/components/host~1b{part}")), "{:#?}", judged.problems);
    // Its configuration may make ports of this name.
    assert_eq!(judged.unknown.len(), 1);
}
