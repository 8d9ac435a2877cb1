//! Properties two ends must agree on beyond names: units, coordinate frames, types that one of them takes
//! from the other, ages.

use std::sync::Arc;

use trocar_model::*;

use crate::scene::*;

/// A position in `unit`, in coordinate frame `tag`.
fn pose(unit: &str, tag: &str) -> Type {
    let mut p = field("p", 0, Type::Array { item: Box::new(f64_type()), n: 3 }, unit);
    p.frame = tag.into();
    structure("Pose", 24, vec![p])
}

fn bound(client: Type, server: Type) -> Result<Link, Refusal> {
    let client = Ports { inputs: vec![input("i", PortType::Plain(client))], ..Ports::default() };
    let server = Ports { outputs: vec![output("o", PortType::Plain(server))], ..Ports::default() };
    bindings(&client, &port("a/c/i"), &server, &port("a/s/o"), &ConnectOptions::default())
}

/// Process host with a class of one optional input `i` and one output `o` of these types for each, made at
/// once.
fn stage(parts: &[(&str, PortType, PortType)]) -> SystemGraph {
    let mut graph = empty();
    let mut classes = graph.processes[&name("host")].classes.clone();
    let mut requests = Vec::new();
    for (path, i, o) in parts {
        let mut i = input("i", i.clone());
        i.optional = true;
        let ports = Ports { inputs: vec![i], outputs: vec![output("o", o.clone())], ..Ports::default() };
        let plugin = id(path).component.as_str().to_owned();
        classes.push(Arc::new(class(&plugin, "part", ExecutionModel::Periodic, ports)));
        requests.push(create(path, &format!("{plugin}/part")));
    }
    graph.processes.get_mut(&name("host")).unwrap().classes = classes;
    done(&mut graph, &requests);
    graph
}

#[test]
fn units_agree_by_what_they_mean_and_differ_with_both_named() {
    assert!(bound(pose("N*m", ""), pose("Nm", "")).is_ok(), "one unit in two spellings");
    let text = bound(pose("N", ""), pose("mN", "")).unwrap_err().to_string();
    assert!(text.contains("unit N here and unit mN there"), "{text}");
}

#[test]
fn coordinate_frames_agree_when_they_are_equal_or_one_end_names_none() {
    assert!(bound(pose("m", "retina"), pose("m", "retina")).is_ok());
    assert!(bound(pose("m", ""), pose("m", "retina")).is_ok(), "an untagged input takes any frame");
    assert!(bound(pose("m", "retina"), pose("m", "")).is_ok(), "an untagged output fits any frame");
    let refusal = bound(pose("m", "retina"), pose("m", "robot")).unwrap_err();
    assert_eq!(refusal.reason(), "TYPE_MISMATCH");
    assert!(refusal.to_string().contains("is in frame retina here and frame robot there"), "{refusal}");
}

#[test]
fn two_untyped_ends_have_nothing_to_agree_on() {
    let plain = |unit: &str| PortType::Plain(force(unit));
    let mut graph = stage(&[
        ("host/recorder", PortType::Any, plain("N")),
        ("host/player", plain("N"), PortType::Any),
        ("host/sink", plain("N"), plain("N")),
        ("host/other", plain("mN"), plain("N")),
    ]);
    let refusal = refused(&graph, &connect("host/recorder/i", "host/player/o"));
    assert_eq!(refusal.reason(), "FORMAT_MISMATCH");
    assert!(refusal.to_string().contains("connect it to an input that has a type first"), "{refusal}");
    done(&mut graph, &[connect("host/sink/i", "host/player/o"), connect("host/recorder/i", "host/player/o")]);
    let refusal = refused(&graph, &connect("host/other/i", "host/player/o"));
    assert_eq!(refusal.reason(), "TYPE_MISMATCH", "the first input has settled the type: {refusal}");
    assert!(refusal.to_string().contains("unit mN here and unit N there"), "{refusal}");
    let replace = Request::Connect {
        client: port("host/other/i"),
        server: port("host/player/o"),
        options: ConnectOptions { replace: true, ..ConnectOptions::default() },
    };
    done(
        &mut graph,
        &[Request::Disconnect {
            which: Which::Pair { client: port("host/sink/i"), server: port("host/player/o") },
        }],
    );
    done(&mut graph, &[replace]);
}

#[test]
fn an_untyped_input_takes_plain_samples_and_frames_alike() {
    let mut graph =
        stage(&[("host/recorder", PortType::Any, PortType::Any), ("host/b", PortType::Any, PortType::Any)]);
    done(
        &mut graph,
        &[
            create("host/robot", "eyerobot"),
            create("host/source", "image_source"),
            connect("host/recorder/i", "host/robot/force"),
            connect("host/b/i", "host/source/image"),
        ],
    );
}

#[test]
fn an_actuator_fed_by_a_grid_gets_an_age_of_three_periods_and_nobody_else_does() {
    let plain = || PortType::Plain(force("N"));
    let mut graph = stage(&[("host/arm", plain(), plain()), ("host/log", plain(), plain())]);
    let arm = graph.components.get_mut(&id("host/arm")).unwrap();
    let actuator = ClassInfo { safety: Safety::Actuator, ..(*arm.class).clone() };
    arm.class = Arc::new(actuator);
    done(
        &mut graph,
        &[
            create("host/robot", "eyerobot"),
            connect("host/arm/i", "host/robot/force"),
            connect("host/log/i", "host/robot/force"),
        ],
    );
    let age = |graph: &SystemGraph, client: &str| graph.source_of(&port(client)).unwrap().options.max_age_ns;
    assert_eq!(age(&graph, "host/arm/i"), Some(3_000_000));
    assert_eq!(age(&graph, "host/log/i"), None, "a logger may wait for ever");
    let slower = Execution { period_ns: Some(5_000_000), ..Execution::default() };
    let request =
        Request::Configure { id: id("host/robot"), patch: serde_json::json!({}), execution: Some(slower) };
    done(&mut graph, &[request]);
    assert_eq!(age(&graph, "host/arm/i"), Some(15_000_000), "the default follows the period");
    let given = Request::Connect {
        client: port("host/arm/i"),
        server: port("host/robot/force"),
        options: ConnectOptions {
            replace: true,
            max_age_ns: Some(1_000_000_000),
            ..ConnectOptions::default()
        },
    };
    done(&mut graph, &[given]);
    assert_eq!(age(&graph, "host/arm/i"), Some(1_000_000_000), "what was asked for is kept");
}

#[test]
fn connections_that_no_longer_fit_are_found_with_the_reason() {
    let mut graph = theatre();
    assert!(graph.loose_ends(&[&id("host/robot")].into()).is_empty());
    let robot = graph.components.get_mut(&id("host/robot")).unwrap();
    let mut ports = (*robot.ports).clone();
    ports.outputs[0].ty = PortType::Plain(force("mN"));
    ports.provided.retain(|p| p.name != "arm");
    robot.ports = Arc::new(ports);
    let loose = graph.loose_ends(&[&id("host/robot")].into());
    let reasons: Vec<(u64, &str)> = loose.iter().map(|(id, why)| (id.0, why.reason())).collect();
    assert_eq!(reasons, [(1, "INTERFACE_NOT_FOUND"), (2, "TYPE_MISMATCH")]);
    let from_the_other_end = graph.loose_ends(&[&id("host/log")].into());
    assert_eq!(from_the_other_end.len(), 1, "a connection is loose at both of its ends");
}
