//! Tags of ports: simulated devices are joined to each other only, and the truth reaches no actuator.

use trocar_model::*;

use crate::scene::*;

/// An actuator with a simulated tip, the truth about it, and commands.
fn arm() -> ClassInfo {
    let mut class = robot();
    class.safety = Safety::Actuator;
    class.ports.outputs.push(Output { tag: Tag::Sim, ..output("tip", PortType::Plain(force("N"))) });
    let really = command("force", CommandKind::Read, None, Some(force("N")));
    class.ports.provided.push(Provided { tag: Tag::Truth, ..provided("truth", vec![really], vec![]) });
    class.name = "arm".into();
    class
}

/// A simulated sensor: takes the tip, gives a measurement and the truth.
fn sensor() -> ClassInfo {
    let ports = Ports {
        inputs: vec![Input { tag: Tag::Sim, ..input("tip", PortType::Plain(force("N"))) }],
        outputs: vec![
            output("force", PortType::Plain(force("N"))),
            Output { tag: Tag::Truth, ..output("truth", PortType::Plain(force("N"))) },
        ],
        ..Ports::default()
    };
    class("sim", "sensor", ExecutionModel::Periodic, ports)
}

/// Takes samples, and hands them on; has a reading to ask for.
fn relay() -> ClassInfo {
    let ports = Ports {
        inputs: vec![input("in", PortType::Plain(force("N")))],
        outputs: vec![output("out", PortType::Plain(force("N")))],
        required: vec![required("truth", vec![function("force", None, Some(force("N")))], vec![])],
        provided: vec![provided(
            "reading",
            vec![command("latest", CommandKind::Read, None, Some(force("N")))],
            vec![],
        )],
        ..Ports::default()
    };
    class("plain", "relay", ExecutionModel::Periodic, ports)
}

/// Commands the arm, listens to samples, and asks a relay.
fn leader() -> ClassInfo {
    let ports = Ports {
        inputs: vec![input("in", PortType::Plain(force("N")))],
        required: vec![
            required("arm", vec![function("hold", None, None)], vec![]),
            required("reading", vec![function("latest", None, Some(force("N")))], vec![]),
        ],
        ..Ports::default()
    };
    class("plain", "leader", ExecutionModel::Periodic, ports)
}

/// All of them once, `host/plot` as a second relay, not connected.
fn theatre() -> SystemGraph {
    let mut graph = empty();
    graph.processes.insert(name("host"), process(vec![arm(), sensor(), relay(), leader(), logger()]));
    for (path, class) in [
        ("host/arm", "arm"),
        ("host/sensor", "sensor"),
        ("host/relay", "relay"),
        ("host/plot", "relay"),
        ("host/leader", "leader"),
    ] {
        done(&mut graph, create(path, class));
    }
    graph
}

fn done(graph: &mut SystemGraph, request: Request) {
    let plan = plan(graph, &request).unwrap_or_else(|refusal| panic!("{request:?}: {refusal}"));
    graph.apply(&plan);
}

fn refused(graph: &SystemGraph, client: &str, server: &str) -> Refusal {
    plan(graph, &connect(client, server)).expect_err("refused")
}

#[test]
fn a_port_for_simulated_devices_takes_only_what_is_tagged_sim() {
    let mut graph = theatre();
    let refusal = refused(&graph, "host/sensor/tip", "host/arm/force");
    assert_eq!(
        refusal.to_string(),
        "`host/sensor/tip` is tagged sim and takes only what is, too, but `host/arm/force` has no tag"
    );
    let refusal = refused(&graph, "host/sensor/tip", "host/sensor/truth");
    assert!(refusal.to_string().ends_with("`host/sensor/truth` is tagged truth"), "{refusal}");
    done(&mut graph, connect("host/sensor/tip", "host/arm/tip"));
}

#[test]
fn whoever_commands_an_actuator_is_not_told_the_truth_in_whatever_order_it_is_connected() {
    let mut graph = theatre();
    done(&mut graph, connect("host/leader/arm", "host/arm/arm"));
    let refusal = refused(&graph, "host/leader/in", "host/sensor/truth");
    assert_eq!(
        refusal.to_string(),
        "`host/sensor/truth` is tagged truth, and what it tells `host/leader/in` would reach an actuator: \
         `host/leader` → `host/arm`"
    );
    assert_eq!(refusal.reason(), "TRUTH_TO_ACTUATOR");
    let mut graph = theatre();
    done(&mut graph, connect("host/leader/in", "host/sensor/truth"));
    let refusal = refused(&graph, "host/leader/arm", "host/arm/arm");
    assert_eq!(refusal.reason(), "TRUTH_TO_ACTUATOR", "{refusal}");
}

#[test]
fn what_is_handed_on_by_streams_or_reads_is_followed() {
    for (client, server) in
        [("host/leader/in", "host/relay/out"), ("host/leader/reading", "host/relay/reading")]
    {
        for told in ["host/relay/in", "host/relay/truth"] {
            let from = if told.ends_with("in") { "host/sensor/truth" } else { "host/arm/truth" };
            let mut graph = theatre();
            done(&mut graph, connect(told, from));
            done(&mut graph, connect(client, server));
            let refusal = refused(&graph, "host/leader/arm", "host/arm/arm");
            assert!(
                refusal.to_string().ends_with("`host/relay` → `host/leader` → `host/arm`"),
                "{told}, {client}: {refusal}"
            );
        }
    }
}

#[test]
fn a_plot_may_be_told_the_truth_beside_a_closed_loop_and_may_watch_simulated_ports() {
    let mut graph = theatre();
    done(&mut graph, connect("host/sensor/tip", "host/arm/tip"));
    done(&mut graph, connect("host/leader/in", "host/sensor/force"));
    done(&mut graph, connect("host/leader/arm", "host/arm/arm"));
    done(&mut graph, connect("host/plot/truth", "host/arm/truth"));
    done(&mut graph, connect("host/plot/in", "host/sensor/truth"));
    done(&mut graph, connect("host/relay/in", "host/arm/tip"));
    // The relay has seen the simulated tip: a leader of the arm may not ask it.
    let refusal = refused(&graph, "host/leader/reading", "host/relay/reading");
    assert!(refusal.to_string().contains("is tagged sim"), "{refusal}");
}

#[test]
fn a_source_that_is_replaced_no_longer_counts() {
    let mut graph = theatre();
    done(&mut graph, connect("host/leader/in", "host/sensor/truth"));
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    let (client, server) = (port("host/leader/in"), port("host/sensor/force"));
    done(&mut graph, Request::Connect { client, server, options });
    done(&mut graph, connect("host/leader/arm", "host/arm/arm"));
}

/// The relay is told untagged data, and hands it to the leader of the arm.
fn led_by_a_measurement() -> SystemGraph {
    let mut graph = theatre();
    for (client, server) in [
        ("host/relay/in", "host/sensor/force"),
        ("host/leader/in", "host/relay/out"),
        ("host/leader/arm", "host/arm/arm"),
    ] {
        done(&mut graph, connect(client, server));
    }
    graph
}

/// The sensor's output `force` is tagged truth from now on.
fn tell_the_truth(ports: &mut Ports) {
    ports.outputs[0].tag = Tag::Truth;
}

#[test]
fn a_port_that_gets_a_tag_while_it_is_connected_loses_what_the_tag_forbids_and_nothing_else() {
    let mut graph = led_by_a_measurement();
    assert_eq!(graph.loose_ends(&[&id("host/sensor")].into()), []);
    let sensor = graph.components.get_mut(&id("host/sensor")).unwrap();
    tell_the_truth(std::sync::Arc::make_mut(&mut sensor.ports));
    let loose = graph.loose_ends(&[&id("host/sensor")].into());
    assert_eq!(loose.len(), 1, "{loose:?}");
    assert_eq!((loose[0].0, loose[0].1.reason()), (ConnectionId(1), "TRUTH_TO_ACTUATOR"), "{loose:?}");

    let mut graph = theatre();
    done(&mut graph, connect("host/sensor/tip", "host/arm/tip"));
    let arm = graph.components.get_mut(&id("host/arm")).unwrap();
    for output in &mut std::sync::Arc::make_mut(&mut arm.ports).outputs {
        output.tag = Tag::None;
    }
    let loose = graph.loose_ends(&[&id("host/arm")].into());
    assert_eq!(loose.iter().map(|(_, why)| why.reason()).collect::<Vec<_>>(), ["TAG_MISMATCH"]);
}

#[test]
fn a_process_that_comes_back_with_a_class_of_another_tag_is_not_connected_to_what_that_forbids() {
    let mut graph = led_by_a_measurement();
    let mut sensor = sensor();
    tell_the_truth(&mut sensor.ports);
    let others = vec![arm(), sensor, relay(), leader(), logger()];
    graph.processes.insert(name("host"), process(others));
    let plan = restore(&graph, &name("host"), &Default::default(), &Here::default());
    let again = |change: &Change| match change {
        Change::Connect { connection } => Some(connection.id.0),
        _ => None,
    };
    assert_eq!(plan.changes.iter().filter_map(again).collect::<Vec<_>>(), [2, 3]);
    let skipped: Vec<_> = plan.skipped.iter().filter(|s| s.id == id("host/relay")).collect();
    assert!(skipped.len() == 1 && skipped[0].why.contains("is tagged truth"), "{:?}", plan.skipped);
}
