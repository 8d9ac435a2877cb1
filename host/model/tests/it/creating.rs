//! Create: the right class, the right process, a configuration, a thread.

use serde_json::json;
use trocar_model::*;

use crate::scene::*;

fn with(execution: Execution) -> Request {
    Request::Create { id: id("host/x"), class: "eyerobot".into(), config: None, execution }
}

fn blamed(graph: &SystemGraph, execution: Execution) -> (String, String) {
    match refused(graph, &with(execution)) {
        Refusal::ArgumentInvalid { field, why, .. } => (field, why),
        other => panic!("{other}"),
    }
}

#[test]
fn a_component_with_complete_defaults_is_created_and_made_ready() {
    let graph = empty();
    let plan = plan(&graph, &create("host/robot", "eyerobot")).unwrap();
    let [Change::Create { component, .. }, Change::Configure { to, to_state: State::Ready, .. }] =
        &plan.changes[..]
    else {
        panic!("{plan:?}")
    };
    assert_eq!((component.state, to), (State::Created, &json!({"limit": 2, "joints": 5})));
}

#[test]
fn a_missing_setting_leaves_it_created_but_a_given_configuration_must_be_whole() {
    let mut graph = empty();
    let given = |config| Request::Create {
        id: id("host/dev"),
        class: "device".into(),
        config: Some(config),
        execution: Execution::default(),
    };
    let refusal = refused(&graph, &given(json!({})));
    assert!(
        matches!(&refusal, Refusal::ConfigInvalid { violations, .. } if violations[0].pointer == "/port"),
        "{refusal}"
    );
    assert_eq!(refused(&graph, &given(json!(3))).reason(), "CONFIG_INVALID");
    done(&mut graph, &[create("host/dev", "device")]);
    assert_eq!(graph.components[&id("host/dev")].state, State::Created);
    assert!(refused(&graph, &start(&["host/dev"])).to_string().contains("port is missing"));
}

#[test]
fn an_unknown_process_is_found_before_anything_else() {
    let refusal = refused(&empty(), &create("hots/robot", "nonsense"));
    assert!(matches!(&refusal, Refusal::ProcessNotFound { .. }), "{refusal}");
    assert_eq!(refusal.to_string(), "there is no process `hots`; did you mean `host`? There are gui, host");
}

#[test]
fn a_lost_process_takes_no_components() {
    let mut graph = empty();
    graph.processes.get_mut(&name("host")).unwrap().state = ProcessState::Lost;
    assert_eq!(refused(&graph, &create("host/robot", "eyerobot")).reason(), "PROCESS_LOST");
}

#[test]
fn an_unknown_class_names_its_neighbour_and_where_else_it_is() {
    let graph = empty();
    let refusal = refused(&graph, &create("host/robot", "eyerobt"));
    assert!(refusal.to_string().contains("did you mean `eyerobot`?"), "{refusal}");
    let refusal = refused(&graph, &create("gui/robot", "eyerobot"));
    assert!(refusal.to_string().ends_with("it is available in host"), "{refusal}");
    assert_eq!(refusal.metadata()["elsewhere"], "host");
}

#[test]
fn a_class_is_found_by_its_short_name_only_where_that_is_unique() {
    let mut graph = empty();
    let refusal = refused(&graph, &create("host/x", "gray"));
    assert!(
        matches!(&refusal, Refusal::ClassNotFound { ambiguous, .. } if ambiguous.len() == 2),
        "{refusal}"
    );
    assert!(refusal.to_string().contains("vision/gray, extra/gray"), "{refusal}");
    done(
        &mut graph,
        &[create("host/x", "vision/gray"), create("host/y", "twin"), create("host/z", "other/twin")],
    );
}

#[test]
fn a_name_is_taken_once() {
    assert_eq!(refused(&theatre(), &create("host/robot", "eyerobot")).reason(), "COMPONENT_EXISTS");
}

#[test]
fn the_execution_overlays_the_class_defaults() {
    let mut graph = empty();
    done(
        &mut graph,
        &[with(Execution { period_ns: Some(500_000), priority: Some(80), ..Execution::default() })],
    );
    let execution = &graph.components[&id("host/x")].execution;
    assert_eq!(execution.model, Some(ExecutionModel::Periodic));
    assert_eq!((execution.period_ns, execution.priority), (Some(500_000), Some(80)));
}

#[test]
fn a_default_rate_falls_away_with_the_model_it_was_for() {
    let mut graph = empty();
    done(&mut graph, &[with(Execution { model: Some(ExecutionModel::OnSignal), ..Execution::default() })]);
    assert_eq!(graph.components[&id("host/x")].execution.period_ns, None);
}

#[test]
fn settings_out_of_bounds_are_refused_with_the_bounds() {
    let graph = empty();
    let e = Execution::default;
    let (field, why) = blamed(&graph, Execution { period_ns: Some(999), ..e() });
    assert_eq!(
        (field.as_str(), why.as_str()),
        ("execution.rate_hz", "execution.rate_hz: a period of 999 ns is outside 1 µs to 3600 s",)
    );
    let cases = [
        (Execution { period_ns: Some(3_600_000_000_001), ..e() }, "execution.rate_hz"),
        (
            Execution { model: Some(ExecutionModel::OnSignal), period_ns: Some(1_000_000), ..e() },
            "execution.rate_hz",
        ),
        (Execution { priority: Some(0), ..e() }, "execution.priority"),
        (Execution { priority: Some(100), ..e() }, "execution.priority"),
        (Execution { model: Some(ExecutionModel::None), priority: Some(5), ..e() }, "execution.priority"),
        (Execution { phase_ns: Some(1_000_000), ..e() }, "execution.phase"),
    ];
    for (execution, want) in cases {
        assert_eq!(blamed(&graph, execution.clone()).0, want, "{execution:?}");
    }
    let periodic = Request::Create {
        id: id("host/x"),
        class: "logger".into(),
        config: None,
        execution: Execution { model: Some(ExecutionModel::Periodic), ..e() },
    };
    assert!(refused(&graph, &periodic).to_string().contains("model periodic needs a rate in Hz"));
}

#[test]
fn a_thread_can_only_be_shared_with_a_component_that_has_one_to_share() {
    let mut graph = empty();
    done(
        &mut graph,
        &[create("host/robot", "eyerobot"), create("host/dev", "device"), create("gui/log", "logger")],
    );
    let stream_of = |host: &str| Execution { stream_of: Some(host.into()), ..Execution::default() };
    let inside = |host: &str| Execution { inside: Some(host.into()), ..Execution::default() };
    let cases = [
        (stream_of("host/robot"), "only a component of model stream leads a stream"),
        (stream_of("host/nobody"), "there is no component `host/nobody`"),
        (stream_of("nobody"), "too few parts"),
        (inside("gui/log"), "is in another process"),
        (inside("host/dev"), "it has no step to run inside"),
        (Execution { inside: Some("host/robot".into()), ..stream_of("host/robot") }, "one thread"),
        (Execution { period_ns: Some(1_000_000), ..inside("host/robot") }, "a rate cannot be set"),
        (Execution { cpus: vec![1], ..inside("host/robot") }, "processors cannot be chosen"),
    ];
    for (execution, want) in cases {
        let (field, why) = blamed(&graph, execution);
        assert!(why.contains(want), "{field}: {why} should contain {want:?}");
    }
    done(&mut graph, &[with(inside("host/robot"))]);
}

#[test]
fn a_component_in_its_own_thread_is_a_circle() {
    let refusal = refused(&empty(), &create_in("host/x", "vision/gray", "host/x"));
    assert_eq!(refusal.reason(), "SYNC_CYCLE");
    assert!(refusal.to_string().ends_with("`host/x` → `host/x`"), "{refusal}");
}

#[test]
fn a_head_made_anew_in_the_stream_of_its_own_filter_is_a_circle() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create_in("host/a", "vision/gray", "host/source"),
            Request::Remove { id: id("host/source"), force: true },
        ],
    );
    assert_eq!(refused(&graph, &create_in("host/source", "image_source", "host/a")).reason(), "SYNC_CYCLE");
}

#[test]
fn a_set_of_requests_may_name_the_head_of_a_stream_after_its_filters() {
    let graph = empty();
    let set = [
        create_in("host/b", "vision/gray", "host/a"),
        create_in("host/a", "vision/gray", "host/source"),
        create("host/source", "image_source"),
        connect("host/a/raw", "host/source/image"),
        connect("host/b/raw", "host/a/image"),
        start(&["host/**"]),
    ];
    let plan = plan_all(&graph, &set).unwrap();
    let created: Vec<String> = plan
        .changes
        .iter()
        .filter_map(|c| if let Change::Create { id, .. } = c { Some(id.to_string()) } else { None })
        .collect();
    assert_eq!(created, ["host/source", "host/a", "host/b"]);
}

#[test]
fn filters_that_wait_for_each_other_are_a_circle() {
    let set = [create_in("host/a", "vision/gray", "host/b"), create_in("host/b", "vision/gray", "host/a")];
    let refusal = plan_all(&empty(), &set).unwrap_err();
    assert_eq!(refusal.reason(), "SYNC_CYCLE", "{refusal}");
}

#[test]
fn a_set_is_planned_whole_or_not_at_all() {
    let graph = empty();
    let set = [create("host/robot", "eyerobot"), connect("host/log/force", "host/robot/force")];
    assert_eq!(plan_all(&graph, &set).unwrap_err().reason(), "COMPONENT_NOT_FOUND");
}

fn isolated(path: &str, class: &str) -> Request {
    let (written, class, execution) = (id(path), class.to_owned(), Execution::default());
    Request::CreateIsolated {
        id: written.isolated().unwrap(),
        home: written.process,
        class,
        config: None,
        execution,
    }
}

#[test]
fn an_isolated_component_is_planned_in_a_process_that_is_not_there_yet() {
    let graph = empty();
    let requests = [isolated("host/robot", "eyerobot"), create("host/robot", "eyerobot")];
    let plan = plan_all(&graph, &requests).unwrap();
    let made: Vec<String> = plan
        .changes
        .iter()
        .filter_map(|change| match change {
            Change::Create { id, .. } => Some(id.to_string()),
            _ => None,
        })
        .collect();
    assert_eq!(made, ["host.robot/robot", "host/robot"]);
    let before = graph.clone();
    let mut after = graph.clone();
    after.apply(&plan);
    after.apply(&inverse(&plan));
    assert_eq!((after.components, after.processes), (before.components, before.processes));
}

#[test]
fn an_isolated_component_is_refused_for_what_it_would_be_refused_beside_its_process() {
    let mut graph = empty();
    done(&mut graph, &[create("host/robot", "eyerobot")]);
    assert_eq!(refused(&graph, &isolated("host/robot", "eyerobot")).reason(), "COMPONENT_EXISTS");
    assert_eq!(refused(&graph, &isolated("hots/x", "eyerobot")).reason(), "PROCESS_NOT_FOUND");
    let refusal = refused(&graph, &isolated("host/x", "eyerobt"));
    assert!(refusal.to_string().contains("did you mean `eyerobot`?"), "{refusal}");
    let taken = graph.processes[&name("gui")].clone();
    graph.processes.insert(name("host.x"), taken);
    assert_eq!(refused(&graph, &isolated("host/x", "eyerobot")).reason(), "PROCESS_EXISTS");
    graph.processes.get_mut(&name("host")).unwrap().state = ProcessState::Restarting;
    let refusal = refused(&graph, &isolated("host/y", "eyerobot"));
    assert!(refusal.to_string().contains("is being restarted"), "{refusal}");
    let long = id(&format!("host/{}", "x".repeat(60))).isolated().unwrap_err();
    assert!(long.to_string().contains("at most 63"), "{long}");
}
