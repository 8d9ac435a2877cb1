//! Connections between processes: their possible carriers, and the state of their halves.

use trocar_model::*;

use crate::scene::*;

fn pinned(client: &str, server: &str, carrier: &str) -> Request {
    let options = ConnectOptions { carrier: carrier.into(), ..ConnectOptions::default() };
    Request::Connect { client: port(client), server: port(server), options }
}

fn possible(graph: &SystemGraph, client: &str, server: &str) -> Vec<&'static str> {
    let all = ["inline", "heap", "memfd", "net"];
    all.into_iter().filter(|carrier| plan(graph, &pinned(client, server, carrier)).is_ok()).collect()
}

#[test]
fn a_carrier_is_possible_by_where_the_ends_run() {
    let mut graph = theatre();
    done(
        &mut graph,
        &[
            create("gui/log", "logger"),
            create("host/log2", "logger"),
            create("host/controller2", "controller"),
        ],
    );
    assert_eq!(possible(&graph, "gui/log/force", "host/robot/force"), ["memfd", "net"]);
    assert_eq!(possible(&graph, "host/log2/force", "host/robot/force"), ["heap", "memfd"]);
    assert_eq!(possible(&graph, "host/controller2/robot", "host/robot/arm"), ["heap", "memfd"]);
    graph.components.get_mut(&id("host/robot")).unwrap().execution.model = Some(ExecutionModel::None);
    assert_eq!(possible(&graph, "host/controller2/robot", "host/robot/arm"), ["inline"], "it is passive");
    graph.components.get_mut(&id("host/robot")).unwrap().execution =
        Execution { inside: Some("host/controller2".into()), ..Execution::default() };
    assert_eq!(possible(&graph, "host/controller2/robot", "host/robot/arm"), ["inline"], "one thread");
    let refusal = plan(&graph, &pinned("gui/log/force", "host/robot/force", "heap")).unwrap_err();
    let text = refusal.to_string();
    for part in ["\"heap\"", "two processes, host and gui", "possible is \"memfd\""] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn a_half_nobody_told_of_says_why_and_one_inside_a_process_does_not_exist() {
    let mut graph = theatre();
    done(&mut graph, &[create("gui/log", "logger"), connect("gui/log/force", "host/robot/force")]);
    let far = graph.source_of(&port("gui/log/force")).unwrap().clone();
    let told = Proxy {
        process: name("gui"),
        epoch: 7,
        why: String::new(),
        carrier: "memfd".into(),
        peer: String::new(),
    };
    graph.proxies.insert((far.id, End::Client), told.clone());
    let why = |graph: &SystemGraph| {
        let [(End::Client, client), (End::Server, server)] = &graph.proxies_of(&far)[..] else {
            panic!("not two halves")
        };
        assert_eq!(*client, told);
        assert!(client.is_linked() && !server.is_linked());
        server.why.clone()
    };
    assert_eq!(why(&graph), "process host has not made it");
    let states = [ProcessState::Lost, ProcessState::Restarting, ProcessState::Failed];
    for (state, word) in states.into_iter().zip(["LOST", "RESTARTING", "FAILED"]) {
        graph.processes.get_mut(&name("host")).unwrap().state = state;
        assert_eq!(why(&graph), format!("process host is {word}"));
    }
    let near = graph.connections.values().find(|c| c.is_near()).unwrap();
    assert_eq!(graph.proxies_of(near), []);
}

#[test]
fn a_connection_to_a_lost_process_is_not_made_but_can_be_taken_away() {
    let mut graph = theatre();
    done(
        &mut graph,
        &[
            create("gui/log", "logger"),
            create("gui/log2", "logger"),
            connect("gui/log/force", "host/robot/force"),
        ],
    );
    let number = graph.source_of(&port("gui/log/force")).unwrap().id;
    graph.processes.get_mut(&name("host")).unwrap().state = ProcessState::Lost;
    assert_eq!(refused(&graph, &connect("gui/log2/force", "host/robot/force")).reason(), "PROCESS_LOST");
    let cut = Request::Disconnect { which: Which::Id(number) };
    assert_eq!(plan(&graph, &cut).unwrap().changes.len(), 1);
    assert!(plan(&graph, &Request::Remove { id: id("gui/log"), force: true }).is_ok());
    graph.processes.get_mut(&name("gui")).unwrap().state = ProcessState::Lost;
    assert_eq!(refused(&graph, &cut).reason(), "PROCESS_LOST", "nobody is there who could do it");
}
