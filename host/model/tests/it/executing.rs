//! Execution settings: their limits, where each means something, whose thread it is, and changing them later.

use serde_json::json;
use trocar_model::*;

use crate::scene::*;

fn e() -> Execution {
    Execution::default()
}

fn of(class: &str, execution: Execution) -> Request {
    Request::Create { id: id("host/x"), class: class.into(), config: None, execution }
}

fn change(path: &str, execution: Execution) -> Request {
    Request::Configure { id: id(path), patch: json!({}), execution: Some(execution) }
}

fn blamed(graph: &SystemGraph, request: &Request) -> (String, String) {
    match refused(graph, request) {
        Refusal::ArgumentInvalid { field, why, .. } => (field, why),
        other => panic!("{request:?} was refused otherwise: {other}"),
    }
}

fn execution<'a>(graph: &'a SystemGraph, path: &str) -> &'a Execution {
    &graph.components[&id(path)].execution
}

fn inside(host: &str, model: Option<ExecutionModel>) -> Execution {
    Execution { model, inside: Some(host.into()), ..e() }
}

#[test]
fn every_setting_is_refused_outside_its_limits_with_field_value_and_limits() {
    let cases = [
        (
            "eyerobot",
            Execution { period_ns: Some(0), ..e() },
            "rate_hz",
            "a period of 0 ns is outside 1 µs to 3600 s",
        ),
        ("eyerobot", Execution { period_ns: Some(u64::MAX), ..e() }, "rate_hz", "is outside 1 µs to 3600 s"),
        ("eyerobot", Execution { phase_ns: Some(u64::MAX), ..e() }, "phase", "is not below the period, 1 ms"),
        (
            "eyerobot",
            Execution { catch_up: Some(1001), ..e() },
            "catch_up",
            "1001 late periods are more than 1000",
        ),
        ("logger", Execution { catch_up: Some(1), ..e() }, "catch_up", "model on_signal has no rate here"),
        ("image_source", Execution { catch_up: Some(1), ..e() }, "catch_up", "model stream has no rate here"),
        ("image_source", Execution { threads: Some(0), ..e() }, "threads", "0 is outside 1 to 64"),
        ("image_source", Execution { threads: Some(65), ..e() }, "threads", "65 is outside 1 to 64"),
        ("eyerobot", Execution { threads: Some(2), ..e() }, "threads", "this is model periodic"),
        (
            "eyerobot",
            Execution { max_step_ns: Some(0), ..e() },
            "max_step",
            "0 ns is outside 100 µs to 3600 s",
        ),
        (
            "eyerobot",
            Execution { max_step_ns: Some(u64::MAX), ..e() },
            "max_step",
            "is outside 100 µs to 3600 s",
        ),
        (
            "eyerobot",
            Execution { max_step_ns: Some(5_000_000), ..e() },
            "max_step",
            "it is for a component without a period",
        ),
        (
            "eyerobot",
            Execution { cpus: vec![4096], ..e() },
            "cpus",
            "4096 is no number of a processor, 0 to 4095",
        ),
        ("device", Execution { cpus: vec![0], ..e() }, "cpus", "has no thread"),
        ("eyerobot", Execution { history: Some(0), ..e() }, "history", "0 rows is outside 3 to 65536"),
        ("eyerobot", Execution { history: Some(2), ..e() }, "history", "2 rows is outside 3 to 65536"),
        ("eyerobot", Execution { history: Some(u32::MAX), ..e() }, "history", "rows is outside 3 to 65536"),
        (
            "eyerobot",
            Execution { on_failure: Some(OnFailure::Bypass), ..e() },
            "on_failure",
            "filters of a stream",
        ),
        (
            "eyerobot",
            Execution { model: Some(ExecutionModel::ExecIn), ..e() },
            "inside",
            "model exec_in needs",
        ),
        (
            "eyerobot",
            Execution { model: Some(ExecutionModel::ExecOut), ..e() },
            "inside",
            "model exec_out needs",
        ),
        ("logger", Execution { phase_ns: Some(1), ..e() }, "phase", "1 ns: there is no grid to shift"),
        ("logger", Execution { wake: Some(Wake::Poll), ..e() }, "wake", "would never look"),
        (
            "eyerobot",
            Execution { model: Some(ExecutionModel::None), wake: Some(Wake::Signal), ..e() },
            "wake",
            "no thread to wake",
        ),
    ];
    for (class, execution, field, want) in cases {
        let request = of(class, execution);
        let (blame, why) = blamed(&empty(), &request);
        assert_eq!(blame, format!("execution.{field}"), "{request:?}");
        assert!(why.contains(want), "{why:?} should contain {want:?}");
    }
}

/// A graph whose process offers `servo`: it steps on a grid of 100 Hz to 8 kHz, in its own thread or in
/// another component's step.
fn with_servo() -> SystemGraph {
    let mut graph = empty();
    let servo = class("arms", "servo", ExecutionModel::Periodic, Ports::default());
    let limits = ExecutionLimits {
        models: vec![ExecutionModel::Periodic, ExecutionModel::ExecIn],
        min_period_ns: Some(125_000),
        max_period_ns: Some(10_000_000),
    };
    let host = graph.processes.get_mut(&name("host")).unwrap();
    host.classes.push(std::sync::Arc::new(ClassInfo { limits, ..servo }));
    done(&mut graph, &[create("host/robot", "eyerobot"), create("host/log", "logger")]);
    graph
}

#[test]
fn a_class_is_run_only_by_what_it_is_made_for() {
    let graph = with_servo();
    let slow = |hz: u64| Execution { period_ns: Some(1_000_000_000 / hz), ..e() };
    let model = |model| Execution { model: Some(model), ..e() };
    for (execution, field, why) in [
        (
            model(ExecutionModel::OnSignal),
            "model",
            "class `servo` is made to run as periodic or exec_in, not as on_signal",
        ),
        (model(ExecutionModel::Continuous), "model", "not as continuous"),
        (model(ExecutionModel::None), "model", "not as none"),
        (slow(50), "rate_hz", "50 Hz: class `servo` is made for 100 Hz to 8000 Hz"),
        (slow(10_000), "rate_hz", "10000 Hz: class `servo` is made for 100 Hz to 8000 Hz"),
        (inside("host/robot", Some(ExecutionModel::ExecOut)), "model", "not as exec_out"),
        (
            inside("host/log", None),
            "model",
            "is made for steps on a grid, 100 Hz to 8000 Hz; exec_in has none here",
        ),
    ] {
        let (blame, said) = blamed(&graph, &of("servo", execution));
        assert_eq!(blame, format!("execution.{field}"), "{said}");
        assert!(said.contains(why), "{said:?} should contain {why:?}");
    }
    for execution in [e(), slow(100), slow(8000), inside("host/robot", None)] {
        plan(&graph, &of("servo", execution.clone()))
            .unwrap_or_else(|refusal| panic!("{execution:?}: {refusal}"));
    }
}

#[test]
fn a_change_of_execution_keeps_to_what_a_class_is_made_for_whoever_gives_the_pace() {
    let mut graph = with_servo();
    done(&mut graph, &[of("servo", e())]);
    let asked = Execution { period_ns: Some(20_000_000), ..e() };
    assert!(blamed(&graph, &change("host/x", asked.clone())).1.contains("50 Hz: class `servo` is made for"));
    done(&mut graph, &[change("host/x", inside("host/robot", None))]);
    // In the step of another component, that component's rate counts.
    let refusal = refused(&graph, &change("host/robot", asked));
    assert!(
        matches!(&refusal, Refusal::InUse { by, .. } if by[0].contains("50 Hz in the step of `host/robot`: class `servo` is made for")),
        "{refusal}"
    );
    done(&mut graph, &[change("host/robot", Execution { period_ns: Some(5_000_000), ..e() })]);
}

#[test]
fn a_class_whose_own_execution_is_outside_its_limits_is_no_class() {
    let servo = class("arms", "servo", ExecutionModel::Periodic, Ports::default());
    let of = |models: &[ExecutionModel], max_period_ns| ClassInfo {
        limits: ExecutionLimits { models: models.to_vec(), min_period_ns: None, max_period_ns },
        ..servo.clone()
    };
    assert_eq!(class_fault(&of(&[ExecutionModel::Periodic], Some(1_000_000))), None);
    let said = class_fault(&of(&[ExecutionModel::Stream], None)).unwrap();
    assert_eq!(said, "execution.model: class `servo` is made to run as stream, not as periodic");
    let said = class_fault(&of(&[], Some(500_000))).unwrap();
    assert_eq!(said, "execution.rate_hz: 1000 Hz: class `servo` is made for at least 2000 Hz");
}

#[test]
fn inside_without_a_model_is_exec_in_and_exec_out_is_kept_where_it_is_said() {
    let mut graph = empty();
    done(&mut graph, &[create("host/robot", "eyerobot"), of("logger", inside("host/robot", None))]);
    assert_eq!(execution(&graph, "host/x").model, Some(ExecutionModel::ExecIn));
    let after = inside("host/x", Some(ExecutionModel::ExecOut));
    done(
        &mut graph,
        &[Request::Create { id: id("host/y"), class: "logger".into(), config: None, execution: after }],
    );
    assert_eq!(
        execution(&graph, "host/y").model,
        Some(ExecutionModel::ExecOut),
        "a hierarchy may be deeper than one"
    );
}

#[test]
fn a_model_with_a_thread_of_its_own_does_not_run_inside_another() {
    let mut graph = empty();
    done(&mut graph, &[create("host/robot", "eyerobot"), create("host/source", "image_source")]);
    let (field, why) = blamed(&graph, &of("logger", inside("host/robot", Some(ExecutionModel::Periodic))));
    assert_eq!(field, "execution.model");
    assert!(why.contains("model periodic has a thread of its own; only exec_in or exec_out fit"), "{why}");
    let in_stream =
        Execution { stream_of: Some("host/source".into()), model: Some(ExecutionModel::ExecIn), ..e() };
    assert!(blamed(&graph, &of("logger", in_stream)).1.contains("only model stream fits"));
    let threads = Execution { stream_of: Some("host/source".into()), threads: Some(2), ..e() };
    assert!(blamed(&graph, &of("vision/gray", threads)).1.contains("where the stream begins"));
}

#[test]
fn a_circle_through_a_step_and_a_pinned_stream_is_named_with_its_path() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            of("vision/gray", inside("host/source", Some(ExecutionModel::ExecIn))),
        ],
    );
    let pinned = |carrier: &str| Request::Connect {
        client: port("host/x/raw"),
        server: port("host/source/image"),
        options: ConnectOptions { carrier: carrier.into(), ..ConnectOptions::default() },
    };
    let refusal = refused(&graph, &pinned("inline"));
    let Refusal::SyncCycle { path } = &refusal else { panic!("{refusal}") };
    assert_eq!(path.first(), path.last(), "{refusal}");
    done(&mut graph, &[pinned("")]);
}

#[test]
fn a_change_of_thread_that_closes_a_circle_is_refused() {
    let mut graph = empty();
    let gray = |path: &str| create(path, "vision/gray");
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            gray("host/a"),
            gray("host/b"),
            connect("host/a/raw", "host/b/image"),
            connect("host/b/raw", "host/a/image"),
            change("host/a", Execution { stream_of: Some("host/source".into()), ..e() }),
        ],
    );
    let refusal =
        refused(&graph, &change("host/b", Execution { stream_of: Some("host/source".into()), ..e() }));
    assert_eq!(refusal.reason(), "SYNC_CYCLE", "{refusal}");
}

#[test]
fn configure_changes_the_execution_and_keeps_configuration_and_connections() {
    let mut graph = theatre();
    let before = graph.clone();
    done(&mut graph, &[change("host/robot", Execution { period_ns: Some(2_000_000), ..e() })]);
    assert_eq!(execution(&graph, "host/robot").period_ns, Some(2_000_000));
    assert_eq!(graph.connections, before.connections, "the wires are the same as before");
    assert_eq!(graph.components[&id("host/robot")].config, before.components[&id("host/robot")].config);
    assert_eq!(graph.components[&id("host/robot")].state, State::Ready);
    let again = plan(&graph, &change("host/robot", Execution { period_ns: Some(2_000_000), ..e() })).unwrap();
    assert_eq!(again, Plan::default(), "nothing changes, so nothing is done");
}

#[test]
fn a_change_of_model_takes_the_class_defaults_for_what_it_leaves_open() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/robot", "eyerobot"),
            create("host/lead", "eyerobot"),
            change("host/robot", Execution { priority: Some(50), ..e() }),
            change("host/robot", Execution { inside: Some("host/lead".into()), ..e() }),
        ],
    );
    assert_eq!(
        (execution(&graph, "host/robot").model, execution(&graph, "host/robot").priority),
        (Some(ExecutionModel::ExecIn), None)
    );
    done(&mut graph, &[change("host/robot", Execution { model: Some(ExecutionModel::ExecOut), ..e() })]);
    assert_eq!(
        execution(&graph, "host/robot").inside.as_deref(),
        Some("host/lead"),
        "it stays with its host"
    );
    done(&mut graph, &[change("host/robot", Execution { model: Some(ExecutionModel::Periodic), ..e() })]);
    let own = execution(&graph, "host/robot");
    assert_eq!((own.inside.clone(), own.period_ns), (None, Some(1_000_000)));
}

#[test]
fn the_execution_of_a_component_that_runs_is_refused_and_so_is_that_of_its_host() {
    let mut graph = theatre();
    done(&mut graph, &[of("logger", inside("host/robot", None)), start(&["host/x"])]);
    let faster = || Execution { period_ns: Some(500_000), ..e() };
    let refusal = refused(&graph, &change("host/robot", faster()));
    assert!(
        refusal.to_string().contains("Configure of `host/x` is not allowed in state ACTIVE"),
        "{refusal}"
    );
    set_state(&mut graph, "host/x", State::Fault);
    assert_eq!(refused(&graph, &change("host/robot", faster())).reason(), "WRONG_STATE");
    set_state(&mut graph, "host/x", State::Stopped(StopReason::Requested));
    done(&mut graph, &[change("host/robot", faster())]);
    assert_eq!(
        graph.components[&id("host/x")].state,
        State::Ready,
        "whoever runs in its thread is made anew too"
    );
    done(&mut graph, &[start(&["host/robot"])]);
    let slower = Execution { period_ns: Some(5_000_000), ..e() };
    let refusal = refused(&graph, &change("host/robot", slower));
    assert!(refusal.to_string().contains("its execution cannot change while it runs"), "{refusal}");
}

#[test]
fn an_active_actuator_is_not_stopped_by_a_change_of_somebody_elses_thread() {
    let mut graph = theatre();
    done(&mut graph, &[start(&["host/controller"])]);
    let mut actuator = (*graph.components[&id("host/controller")].class).clone();
    actuator.safety = Safety::Actuator;
    graph.components.get_mut(&id("host/controller")).unwrap().class = std::sync::Arc::new(actuator);
    let refusal = refused(&graph, &change("host/robot", Execution { period_ns: Some(500_000), ..e() }));
    assert!(refusal.to_string().contains("it is an actuator and requires `host/robot`"), "{refusal}");
}

#[test]
fn a_thread_may_be_chosen_before_the_configuration_is_complete() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/dev", "device"),
            change("host/dev", Execution { model: Some(ExecutionModel::OnSignal), ..e() }),
        ],
    );
    let device = &graph.components[&id("host/dev")];
    assert_eq!((device.state, device.execution.model), (State::Created, Some(ExecutionModel::OnSignal)));
}

#[test]
fn a_host_whose_new_model_lends_no_thread_keeps_its_old_one_while_somebody_needs_it() {
    let mut graph = empty();
    done(
        &mut graph,
        &[create("host/source", "image_source"), create_in("host/a", "vision/gray", "host/source")],
    );
    let refusal =
        refused(&graph, &change("host/source", Execution { model: Some(ExecutionModel::OnSignal), ..e() }));
    assert_eq!(refusal.reason(), "IN_USE");
    assert!(
        refusal.to_string().contains("host/a: it was made to run in the thread of `host/source`"),
        "{refusal}"
    );
}

#[test]
fn a_thread_and_a_configuration_given_together_are_configured_once() {
    let graph = theatre();
    let both = Request::Configure {
        id: id("host/robot"),
        patch: json!({"limit": 5, "joints": 6}),
        execution: Some(Execution { period_ns: Some(2_000_000), ..e() }),
    };
    let plan = plan(&graph, &both).unwrap();
    let configured = |c: &&Change| matches!(c, Change::Configure { to_state: State::Ready, .. });
    assert_eq!(plan.changes.iter().filter(configured).count(), 1, "{:?}", plan.changes);
    let mut after = graph.clone();
    after.apply(&plan);
    let robot = &after.components[&id("host/robot")];
    assert_eq!((robot.state, &robot.config), (State::Ready, &json!({"limit": 5, "joints": 6})));
    let bad = Request::Configure {
        id: id("host/robot"),
        patch: json!({"limit": 500}),
        execution: Some(Execution { period_ns: Some(2_000_000), ..e() }),
    };
    assert_eq!(refused(&graph, &bad).reason(), "CONFIG_INVALID");
}

#[test]
fn only_a_class_that_devices_call_back_is_run_by_their_calls() {
    let graph = empty();
    let called = Execution { model: Some(ExecutionModel::OnCallback), ..e() };
    let (field, why) = blamed(&graph, &of("eyerobot", called));
    assert_eq!(field, "execution.model");
    assert!(why.contains("`eyerobot` is none and would never run"), "{why}");
}

#[test]
fn a_thread_looks_by_itself_when_asked_to_or_when_its_period_is_short() {
    let every = |period_ns: u64, wake| Execution {
        model: Some(ExecutionModel::Periodic),
        period_ns: Some(period_ns),
        wake,
        ..e()
    };
    let (short, long) = (10_000_000, 10_000_001);
    assert!(every(short, None).polls() && !every(long, None).polls());
    assert!(every(long, Some(Wake::Poll)).polls() && !every(short, Some(Wake::Signal)).polls());
    let mut graph = empty();
    done(&mut graph, &[of("eyerobot", every(long, Some(Wake::Poll)))]);
    assert_eq!(execution(&graph, "host/x").wake, Some(Wake::Poll));
    let on_signal = Execution { model: Some(ExecutionModel::OnSignal), ..e() };
    done(&mut graph, &[change("host/x", on_signal)]);
    let now = execution(&graph, "host/x");
    assert!(now.wake.is_none() && !now.polls(), "without a period it falls away: {now:?}");
}

#[test]
fn a_processor_named_twice_is_a_mistake() {
    let graph = empty();
    let (field, why) = blamed(&graph, &of("eyerobot", Execution { cpus: vec![0, 1, 0], ..e() }));
    assert_eq!(
        (field.as_str(), why.as_str()),
        ("execution.cpus", "execution.cpus: processor 0 is named twice")
    );
}

#[test]
fn a_class_whose_own_execution_or_defaults_no_create_could_accept_has_a_fault() {
    for class in [robot(), controller(), logger(), source(), filter(), device()] {
        assert_eq!(class_fault(&class), None, "{}", class.name);
    }
    let mut open = robot();
    open.execution.period_ns = None;
    assert_eq!(class_fault(&open), None, "the rate may come with Create");

    let mut signalled = logger();
    signalled.execution.period_ns = Some(250_000_000);
    let why = class_fault(&signalled).unwrap();
    assert_eq!(why, "execution.rate_hz: a rate means nothing to model on_signal");

    let mut impossible = robot();
    impossible.config_schema = json!({"type": "object", "properties": {
        "gain": {"type": "number", "minimum": 3, "maximum": 1, "default": 5},
    }});
    let why = class_fault(&impossible).unwrap();
    assert!(why.contains("defaults are not valid: gain: 5 is above 1"), "{why}");
}
