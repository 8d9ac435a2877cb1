//! Remove: not while another component depends on it, unless forced.

use trocar_model::*;

use crate::scene::*;

fn remove(path: &str, force: bool) -> Request {
    Request::Remove { id: id(path), force }
}

#[test]
fn a_connected_component_is_in_use_by_its_connections_at_either_end() {
    let graph = theatre();
    for path in ["host/robot", "host/controller"] {
        let refusal = refused(&graph, &remove(path, false));
        let Refusal::InUse { by, .. } = &refusal else { panic!("{refusal}") };
        assert!(by[0].starts_with("connection 1 (host/robot/arm → host/controller/robot)"), "{by:?}");
    }
}

#[test]
fn force_stops_disconnects_and_destroys_in_that_order() {
    let mut graph = theatre();
    done(&mut graph, &[start(&["**"])]);
    let plan = plan(&graph, &remove("host/robot", true)).unwrap();
    let kinds: Vec<&str> = plan
        .changes
        .iter()
        .map(|c| match c {
            Change::Run { verb: Verb::Stop, .. } => "stop",
            Change::Disconnect { .. } => "disconnect",
            Change::Destroy { component, .. } if component.state == State::Stopped(StopReason::Requested) => {
                "destroy"
            }
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(kinds, ["stop", "disconnect", "disconnect", "destroy"]);
    graph.apply(&plan);
    assert!(graph.connections.is_empty() && !graph.components.contains_key(&id("host/robot")));
    assert_eq!(graph.components[&id("host/log")].state, State::Active, "a disconnect changes nobody's state");
}

#[test]
fn an_unconnected_component_goes_without_force_even_while_it_runs() {
    let mut graph = empty();
    done(
        &mut graph,
        &[create("host/robot", "eyerobot"), start(&["host/robot"]), remove("host/robot", false)],
    );
    assert!(graph.components.is_empty());
}

#[test]
fn who_lends_its_thread_is_in_use_and_force_stops_the_borrowers() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create_in("host/a", "vision/gray", "host/source"),
            create("host/other", "image_source"),
            connect("host/a/raw", "host/other/image"),
            start(&["**"]),
        ],
    );
    let refusal = refused(&graph, &remove("host/source", false));
    assert!(refusal.to_string().contains("host/a, which runs in its thread"), "{refusal}");
    done(&mut graph, &[remove("host/source", true)]);
    assert_eq!(graph.components[&id("host/a")].state, State::Stopped(StopReason::Requested));
    let refusal = refused(&graph, &start(&["host/a"]));
    assert!(
        refusal.to_string().contains("thread of `host/source`, which does not exist any more"),
        "{refusal}"
    );
    done(&mut graph, &[create("host/source", "image_source"), start(&["host/source", "host/a"])]);
}

#[test]
fn a_head_that_came_back_as_something_else_starts_no_filters() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create_in("host/a", "vision/gray", "host/source"),
            create("host/other", "image_source"),
            connect("host/a/raw", "host/other/image"),
            remove("host/source", true),
            create("host/source", "eyerobot"),
        ],
    );
    let refusal = refused(&graph, &start(&["host/a"]));
    assert!(refusal.to_string().contains("which now runs as periodic"), "{refusal}");
}

#[test]
fn filters_whose_head_is_gone_cannot_be_wired_in_a_circle() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create_in("host/a", "vision/gray", "host/source"),
            create_in("host/b", "vision/gray", "host/source"),
            remove("host/source", true),
            connect("host/a/raw", "host/b/image"),
        ],
    );
    assert_eq!(refused(&graph, &connect("host/b/raw", "host/a/image")).reason(), "SYNC_CYCLE");
}

#[test]
fn what_is_removed_in_a_set_can_be_made_again_in_the_same_set() {
    let graph = theatre();
    let set = [
        remove("host/robot", true),
        create("host/robot", "eyerobot"),
        connect("host/controller/robot", "host/robot/arm"),
    ];
    let mut after = graph.clone();
    after.apply(&plan_all(&graph, &set).unwrap());
    assert_eq!((after.revision, after.connections.len()), (graph.revision + 1, 1));
}
