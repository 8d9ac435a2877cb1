//! Components and connections that a restarted process gets back.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_model::*;

use super::scene::*;

fn back(graph: &SystemGraph) -> Plan {
    restore(graph, &name("host"), &BTreeMap::new(), &Here::default())
}

fn steps(plan: &Plan) -> Vec<String> {
    let step = |change: &Change| match change {
        Change::Create { id, .. } => format!("create {id}"),
        Change::Configure { id, to_state, .. } => format!("{id} {to_state}"),
        Change::Connect { connection } => format!("connect {}", connection.id.0),
        Change::Run { id, to, .. } => format!("{id} {to}"),
        other => panic!("{other:?} makes nothing anew"),
    };
    plan.changes.iter().map(step).collect()
}

/// All three run, and the robot can move.
fn running() -> SystemGraph {
    let mut graph = theatre();
    done(&mut graph, &[start(&["host/**"])]);
    let robot = graph.components.get_mut(&id("host/robot")).unwrap();
    Arc::make_mut(&mut robot.class).safety = Safety::Actuator;
    graph
}

#[test]
fn what_ran_runs_again_and_what_moves_waits_for_somebody() {
    let plan = back(&running());
    let wanted = [
        "create host/controller",
        "host/controller READY",
        "create host/log",
        "host/log READY",
        "create host/robot",
        "host/robot STOPPED{restarted}",
        "connect 1",
        "connect 2",
        "host/controller ACTIVE",
        "host/log ACTIVE",
    ];
    assert_eq!(steps(&plan), wanted, "connections keep their numbers, and nothing moves");
    assert_eq!(plan.skipped, []);
}

#[test]
fn the_graph_after_it_is_the_graph_before_but_for_what_stands_still() {
    let mut graph = running();
    let before = graph.clone();
    let plan = back(&graph);
    graph.apply(&plan);
    assert_eq!(graph.connections, before.connections);
    assert_eq!(graph.next_connection, before.next_connection);
    for (id, component) in &graph.components {
        assert_eq!(component.config, before.components[id].config, "{id}");
        assert_eq!(component.execution, before.components[id].execution, "{id}");
    }
    assert_eq!(graph.components[&id("host/robot")].state, State::Stopped(StopReason::Restarted));
}

#[test]
fn every_state_comes_back_as_itself_or_standing_still() {
    for state in State::ALL {
        for safety in [Safety::None, Safety::Sensor, Safety::Actuator] {
            let mut graph = running();
            set_state(&mut graph, "host/robot", state);
            Arc::make_mut(&mut graph.components.get_mut(&id("host/robot")).unwrap().class).safety = safety;
            let plan = back(&graph);
            graph.apply(&plan);
            let now = graph.components[&id("host/robot")].state;
            let wanted = match (state, safety) {
                (State::Active | State::Fault, Safety::Actuator) => State::Stopped(StopReason::Restarted),
                (State::Fault, _) => State::Ready,
                (other, _) => other,
            };
            assert_eq!(now, wanted, "{state} {safety:?}");
        }
    }
}

#[test]
fn what_is_wanted_counts_more_than_what_was_seen_last() {
    let mut graph = running();
    set_state(&mut graph, "host/controller", State::Ready);
    let wanted = BTreeMap::from([
        (id("host/log"), State::Stopped(StopReason::Requested)),
        (id("host/controller"), State::Active),
    ]);
    let plan = restore(&graph, &name("host"), &wanted, &Here::default());
    graph.apply(&plan);
    assert_eq!(graph.components[&id("host/log")].state, State::Stopped(StopReason::Requested));
    assert_eq!(graph.components[&id("host/controller")].state, State::Active);
}

#[test]
fn a_class_that_is_gone_keeps_only_its_own_components_away() {
    let mut graph = running();
    graph.processes.get_mut(&name("host")).unwrap().classes.retain(|c| c.name != "eyerobot");
    let plan = back(&graph);
    let skipped: Vec<String> = plan.skipped.iter().map(|s| format!("{}: {}", s.id, s.why)).collect();
    assert!(skipped[0].starts_with("host/robot: ") && skipped[0].contains("eyerobot"), "{skipped:?}");
    assert!(skipped[1].starts_with("host/controller: ") && skipped[1].contains("robot"), "{skipped:?}");
    assert!(steps(&plan).contains(&"host/log ACTIVE".to_owned()), "{plan:?}");
    assert!(
        !steps(&plan).contains(&"host/controller ACTIVE".to_owned()),
        "what it requires is away: {plan:?}"
    );
}

#[test]
fn whoever_lends_its_thread_is_made_first() {
    let mut graph = empty();
    let filters = [create("host/z", "image_source"), create_in("host/a", "vision/gray", "host/z")];
    done(&mut graph, &filters);
    assert_eq!(steps(&back(&graph)), ["create host/z", "host/z READY", "create host/a", "host/a READY"]);
    graph.processes.get_mut(&name("host")).unwrap().classes.retain(|c| c.name != "image_source");
    let plan = back(&graph);
    assert!(plan.changes.is_empty() && plan.skipped[1].why.contains("the thread of host/z"), "{plan:?}");
}

#[test]
fn another_process_is_left_alone() {
    let mut graph = running();
    done(&mut graph, &[create("gui/log", "logger")]);
    assert!(steps(&back(&graph)).iter().all(|step| !step.contains("gui")), "{:?}", back(&graph));
    assert_eq!(restore(&graph, &name("nobody"), &BTreeMap::new(), &Here::default()), Plan::default());
}

#[test]
fn a_class_that_moves_something_only_since_its_file_was_replaced_waits_for_somebody() {
    let mut graph = running();
    let host = graph.processes.get_mut(&name("host")).unwrap();
    for class in host.classes.iter_mut().filter(|c| c.name == "logger") {
        Arc::make_mut(class).safety = Safety::Actuator;
    }
    let plan = back(&graph);
    assert!(steps(&plan).contains(&"host/log STOPPED{restarted}".to_owned()), "{plan:?}");
    assert!(!steps(&plan).contains(&"host/log ACTIVE".to_owned()), "nobody asked it to move: {plan:?}");
}

#[test]
fn what_is_there_already_is_not_made_twice_and_is_brought_to_where_it_should_stand() {
    let graph = running();
    let here = |stand: &[(&str, State)], connections: &[u64]| Here {
        components: stand.iter().map(|(path, state)| (id(path), *state)).collect(),
        connections: connections.iter().map(|number| ConnectionId(*number)).collect(),
    };
    let again = |here: &Here| steps(&restore(&graph, &name("host"), &BTreeMap::new(), here));
    let some = here(&[("host/controller", State::Created), ("host/robot", State::Created)], &[1]);
    let wanted = [
        "host/controller READY",
        "create host/log",
        "host/log READY",
        "host/robot STOPPED{restarted}",
        "connect 2",
        "host/controller ACTIVE",
        "host/log ACTIVE",
    ];
    assert_eq!(again(&some), wanted);
    let most = here(
        &[
            ("host/controller", State::Active),
            ("host/log", State::Ready),
            ("host/robot", State::Stopped(StopReason::Restarted)),
        ],
        &[1, 2],
    );
    assert_eq!(again(&most), ["host/log ACTIVE"]);
    let failed = here(&[("host/log", State::Fault)], &[1, 2]);
    assert!(!again(&failed).contains(&"host/log ACTIVE".to_owned()), "what failed is not started by that");
}
