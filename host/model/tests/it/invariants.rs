//! The graph under random requests: whatever is asked, in whatever order, it stays sound.

use proptest::prelude::*;
use serde_json::json;
use trocar_model::*;

use crate::scene::*;

/// Components and the class that makes them fit the wires below.
const CAST: [(&str, &str); 9] = [
    ("host/r1", "eyerobot"),
    ("host/r2", "eyerobot"),
    ("host/c", "controller"),
    ("host/l", "logger"),
    ("host/s", "image_source"),
    ("host/f1", "vision/gray"),
    ("host/f2", "vision/gray"),
    ("host/d", "device"),
    ("gui/l", "logger"),
];
const CLIENTS: [&str; 6] =
    ["host/c/robot", "host/l/force", "host/f1/raw", "host/f2/raw", "host/s/feedback", "gui/l/force"];
const SERVERS: [&str; 7] = [
    "host/r1/arm",
    "host/r2/arm",
    "host/r1/force",
    "host/r2/force",
    "host/s/image",
    "host/f1/image",
    "host/f2/image",
];
/// Never right, each in its own way.
const STRANGERS: [&str; 4] = ["none/a", "host/nobody", "host/r1", "gui/l"];
const GLOBS: [&str; 5] = ["**", "host/**", "host/*", "*/l", "gui/**"];

fn any_id() -> impl Strategy<Value = ComponentId> {
    let cast = prop::sample::select(CAST.to_vec()).prop_map(|(path, _)| id(path));
    prop_oneof![8 => cast, 1 => prop::sample::select(STRANGERS.to_vec()).prop_map(id)]
}

fn any_cast() -> impl Strategy<Value = (ComponentId, &'static str)> {
    let fitting = prop::sample::select(CAST.to_vec()).prop_map(|(path, class)| (id(path), class));
    let class = prop::sample::select(vec!["eyerobot", "logger", "nonsense", "gray"]);
    prop_oneof![6 => fitting, 1 => (any_id(), class)]
}

/// A client and a server, of one kind as often as not.
fn any_ends() -> impl Strategy<Value = (PortId, PortId)> {
    let end = |all: &[&'static str]| prop::sample::select(all.to_vec()).prop_map(port);
    let fitting = prop_oneof![
        (end(&CLIENTS[..1]), end(&SERVERS[..2])),
        (end(&CLIENTS[1..2]), end(&SERVERS[2..4])),
        (end(&CLIENTS[2..5]), end(&SERVERS[4..])),
        (end(&CLIENTS[2..5]), end(&SERVERS[4..])),
    ];
    prop_oneof![4 => fitting, 1 => (end(&CLIENTS), end(&SERVERS)), 1 => (end(&SERVERS), end(&CLIENTS))]
}

/// All components are there, the filters in the source's stream, nothing is connected.
pub(crate) fn stage() -> SystemGraph {
    let mut graph = empty();
    let requests: Vec<Request> = CAST
        .iter()
        .map(|(path, class)| match *path {
            "host/f1" => create_in(path, class, "host/s"),
            "host/f2" => create_in(path, class, "host/f1"),
            _ => create(path, class),
        })
        .collect();
    done(&mut graph, &requests);
    graph
}

fn any_graph() -> impl Strategy<Value = SystemGraph> {
    prop_oneof![1 => Just(()).prop_map(|()| empty()), 3 => Just(()).prop_map(|()| stage())]
}

fn any_execution() -> impl Strategy<Value = Execution> {
    let host = || prop::option::weighted(0.3, any_id().prop_map(|id| id.to_string()));
    let period = prop::option::weighted(0.1, prop::sample::select(vec![0u64, 500, 1_000_000]));
    (host(), host(), period).prop_map(|(stream_of, inside, period_ns)| Execution {
        stream_of,
        inside,
        period_ns,
        ..Execution::default()
    })
}

/// An execution to change to, mostly one that may be.
fn any_change() -> impl Strategy<Value = Option<Execution>> {
    use ExecutionModel::{ExecIn, ExecOut, OnSignal, Periodic, Stream};
    let model = prop::sample::select(vec![
        None,
        Some(Periodic),
        Some(OnSignal),
        Some(Stream),
        Some(ExecIn),
        Some(ExecOut),
    ]);
    let change = (any_execution(), model, prop::option::weighted(0.3, 0u32..70))
        .prop_map(|(e, model, threads)| Execution { model, threads, ..e });
    prop::option::weighted(0.5, change)
}

fn any_targets() -> impl Strategy<Value = Vec<Target>> {
    let one =
        prop_oneof![any_id().prop_map(Target::One), prop::sample::select(GLOBS.to_vec()).prop_map(target)];
    prop::collection::vec(one, 1..3)
}

fn any_options() -> impl Strategy<Value = ConnectOptions> {
    let carrier = prop::sample::select(vec!["", "", "", "inline", "heap", "memfd", "net", "x"]);
    (any::<bool>(), prop::option::weighted(0.1, 0usize..4), carrier).prop_map(
        |(replace, mailbox, carrier)| ConnectOptions {
            replace,
            mailbox,
            carrier: carrier.into(),
            ..ConnectOptions::default()
        },
    )
}

pub(crate) fn any_request() -> impl Strategy<Value = Request> {
    let given = prop::sample::select(vec![None, None, Some(json!({})), Some(json!({"port": "x"}))]);
    let patch = prop::sample::select(vec![
        json!({}),
        json!({"limit": 3}),
        json!({"joints": 4}),
        json!({"port": "y"}),
        json!({"limit": null}),
        json!(1),
    ]);
    let which = prop_oneof![
        (0u64..12).prop_map(|n| Which::Id(ConnectionId(n))),
        any_ends().prop_map(|(client, server)| Which::Pair { client, server }),
    ];
    prop_oneof![
        4 => (any_cast(), given, any_execution()).prop_map(|((id, class), config, execution)| Request::Create {
            id, class: class.into(), config, execution
        }),
        1 => (any_id(), any::<bool>()).prop_map(|(id, force)| Request::Remove { id, force }),
        3 => (any_id(), patch, any_change()).prop_map(|(id, patch, execution)| Request::Configure { id, patch, execution }),
        2 => any_targets().prop_map(|targets| Request::Start { targets }),
        2 => any_targets().prop_map(|targets| Request::Stop { targets }),
        1 => any_targets().prop_map(|targets| Request::Resume { targets }),
        1 => any_targets().prop_map(|targets| Request::Reset { targets }),
        9 => (any_ends(), any_options()).prop_map(|((client, server), options)| {
            Request::Connect { client, server, options }
        }),
        1 => which.prop_map(|which| Request::Disconnect { which }),
    ]
}

/// An object without null, as a configuration is.
fn any_json() -> impl Strategy<Value = serde_json::Value> {
    let leaf = prop::sample::select(vec![json!(1), json!(2.5), json!("x"), json!([1, 2]), json!({})]);
    let object = |inner| prop::collection::btree_map("[a-c]", inner, 0..4);
    let value = leaf.prop_recursive(3, 24, 4, move |inner| object(inner).prop_map(|m| json!(m)));
    object(value.boxed()).prop_map(|m| json!(m))
}

/// Returns any report of an LCM between two requests.
fn any_report() -> impl Strategy<Value = (ComponentId, State)> {
    (any_id(), prop::sample::select(State::ALL.to_vec()))
}

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a handful per test case")]
enum Step {
    Ask(Request),
    Report(ComponentId, State),
}

fn any_steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        12 => any_request().prop_map(Step::Ask),
        1 => any_report().prop_map(|(id, state)| Step::Report(id, state)),
    ];
    prop::collection::vec(step, 1..60)
}

fn check(graph: &SystemGraph) -> Result<(), TestCaseError> {
    let mut clients = std::collections::BTreeSet::new();
    for (number, connection) in &graph.connections {
        prop_assert_eq!(*number, connection.id);
        prop_assert!(number.0 >= 1 && number.0 < graph.next_connection, "{:?} was not counted", number);
        let ports = |end: &PortId| graph.components.get(&end.component).map(|c| c.ports.clone());
        let (client, server) = (ports(&connection.client), ports(&connection.server));
        prop_assert!(client.is_some() && server.is_some(), "{:?} has lost an end", connection);
        let (client, server) = (client.unwrap(), server.unwrap());
        let link = bindings(&client, &connection.client, &server, &connection.server, &connection.options);
        prop_assert!(link.is_ok(), "{:?} does not fit: {:?}", connection, link);
        prop_assert!(clients.insert(connection.client.clone()), "{} has two sources", connection.client);
        let pinned = connection.options.carrier.as_str();
        let fits: &[&str] =
            if connection.is_near() { &["", "inline", "heap", "memfd"] } else { &["", "memfd", "net"] };
        prop_assert!(fits.contains(&pinned), "{:?} cannot have its carrier", connection);
    }
    for (id, component) in &graph.components {
        let host = |id: &ComponentId| {
            let e = &graph.components.get(id)?.execution;
            ComponentId::parse(e.stream_of.as_deref().or(e.inside.as_deref())?).ok()
        };
        let hosts = std::iter::successors(host(id), host).take(graph.components.len() + 1).count();
        prop_assert!(hosts <= graph.components.len(), "{} runs in its own thread of threads", id);
        prop_assert!(graph.processes.contains_key(&id.process), "{} is nowhere", id);
        if component.state != State::Created && component.state != State::Fault {
            let open = validate(&component.class.config_schema, &component.config);
            prop_assert!(open.is_empty(), "{} is {} with {:?}", id, component.state, open);
        }
    }
    Ok(())
}

/// A graph as far as an undone change must restore it.
fn comparable(graph: &SystemGraph) -> SystemGraph {
    SystemGraph { revision: 0, next_connection: 0, ..graph.clone() }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 192, ..ProptestConfig::default() })]

    #[test]
    fn the_graph_stays_sound_whatever_is_asked(start in any_graph(), steps in any_steps()) {
        let mut graph = start;
        for step in steps {
            let request = match step {
                Step::Ask(request) => request,
                Step::Report(id, state) => {
                    // An LCM never reports a component without its configuration as more than CREATED.
                    if let Some(c) = graph.components.get_mut(&id).filter(|c| c.state != State::Created) {
                        c.state = if state == State::Created { State::Ready } else { state };
                    }
                    continue;
                }
            };
            let before = graph.clone();
            let planned = plan(&graph, &request);
            prop_assert_eq!(&graph, &before, "planning changed the graph");
            prop_assert_eq!(&planned, &plan(&graph, &request), "the same question got two answers");
            match planned {
                Err(refusal) => {
                    let stop = matches!(request, Request::Stop { .. });
                    let unknown = matches!(refusal.code(), Code::NotFound);
                    prop_assert!(!stop || unknown, "Stop was refused with {}", refusal);
                    prop_assert!(refusal.code() != Code::Internal, "{}", refusal);
                }
                Ok(plan) => {
                    graph.apply(&plan);
                    let grown = u64::from(!plan.changes.is_empty());
                    prop_assert_eq!(graph.revision, before.revision + grown);
                    let mut undone = graph.clone();
                    undone.apply(&inverse(&plan));
                    prop_assert_eq!(comparable(&undone), comparable(&before), "not undone: {:?}", plan);
                }
            }
            check(&graph)?;
        }
    }

    #[test]
    fn a_set_of_requests_is_one_plan_that_can_be_undone(
        graph in any_graph(),
        requests in prop::collection::vec(any_request(), 1..6),
    ) {
        if let Ok(plan) = plan_all(&graph, &requests) {
            let mut after = graph.clone();
            after.apply(&plan);
            check(&after)?;
            after.apply(&inverse(&plan));
            prop_assert_eq!(comparable(&after), comparable(&graph));
        }
    }

    #[test]
    fn requests_planned_one_after_another_come_to_what_each_of_them_does_alone(
        start in any_graph(),
        requests in prop::collection::vec(any_request(), 1..12),
    ) {
        let (mut planning, mut graph, mut changes) = (Planning::of(&start), start, Vec::new());
        for request in &requests {
            let alone = plan(&graph, request);
            prop_assert_eq!(planning.add(request).err(), alone.as_ref().err().cloned());
            if let Ok(plan) = alone {
                graph.apply(&plan);
                changes.extend(plan.changes);
            }
            let as_planned = SystemGraph { revision: graph.revision, ..planning.graph().clone() };
            prop_assert_eq!(&as_planned, &graph);
        }
        prop_assert_eq!(planning.plan().changes, changes);
    }

    #[test]
    fn what_is_left_of_a_component_without_its_defaults_makes_it_again(steps in any_steps()) {
        let mut graph = stage();
        for step in steps {
            if let Step::Ask(request) = step
                && let Ok(plan) = plan(&graph, &request)
            {
                graph.apply(&plan);
            }
        }
        for (id, was) in &graph.components {
            let class = &was.class;
            let config = (was.state != State::Created)
                .then(|| without_defaults(&class.config_schema, &was.config));
            let execution = least_execution(&class.execution, &was.execution);
            let made = |config, execution| {
                Request::Create { id: id.clone(), class: class.full_name(), config, execution }
            };
            let mut without = graph.clone();
            without.components.remove(id);
            without.connections.clear();
            // With all of it: its thread may have gone with another component, or be none by now.
            let whole = (was.state != State::Created).then(|| was.config.clone());
            let can_be = plan(&without, &made(whole, was.execution.clone()));
            let anew = plan(&without, &made(config, execution));
            prop_assert_eq!(anew.is_ok(), can_be.is_ok(), "{}: {:?}, {:?}", id, anew, can_be);
            let Ok(plan) = anew else { continue };
            without.apply(&plan);
            let again = &without.components[id];
            prop_assert_eq!((&again.config, &again.execution), (&was.config, &was.execution), "{}", id);
        }
    }

    #[test]
    fn a_patch_of_the_difference_leads_there(from in any_json(), to in any_json()) {
        prop_assert_eq!(merge(&from, &difference(&from, &to)), to.clone());
        prop_assert_eq!(difference(&to, &to), if to.is_object() { json!({}) } else { to });
    }

    #[test]
    fn no_glob_moves_what_waits_for_a_name(steps in any_steps(), glob in prop::sample::select(GLOBS.to_vec())) {
        let mut graph = stage();
        for step in steps {
            if let Step::Ask(request) = step
                && let Ok(plan) = plan(&graph, &request)
            {
                graph.apply(&plan);
            }
        }
        let waiting = State::Stopped(StopReason::Interlock);
        graph.components.change(|_, _| true, |component| component.state = waiting);
        let targets = vec![target(glob)];
        let asked = [
            Request::Start { targets: targets.clone() },
            Request::Resume { targets: targets.clone() },
            Request::Reset { targets },
        ];
        for request in asked {
            if let Ok(plan) = plan(&graph, &request) {
                prop_assert!(plan.changes.is_empty(), "{:?} moved {:?}", request, plan);
            }
        }
    }
}
