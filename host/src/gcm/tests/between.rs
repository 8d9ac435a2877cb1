//! Connections between processes: what a GCM knows of them again, and what it has cut.

use std::sync::Arc;

use trocar_model::{
    ComponentId, ConnectOptions, Connection, ConnectionId, PortId, ProcessState, Request, SystemGraph, Which,
};

use super::super::fake::{FakeLcm, comes, id, name, until};
use super::super::{Fate, Gcm, GcmConfig, Registered, Registration, Slice, Told};
use super::{ask, create, register};

fn port(text: &str) -> PortId {
    PortId::parse(text).unwrap()
}

fn who(process: &str) -> Registration {
    Registration::new(name(process), String::new())
}

/// Process `a` gives its value to `b`: connection 1.
async fn connected() -> (Gcm, [Arc<FakeLcm>; 2], [Registration; 2], [Registered; 2]) {
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    let lcms = [FakeLcm::new("a"), FakeLcm::new("b")];
    let whos = [who("a"), who("b")];
    let a = register(&gcm, whos[0].clone(), lcms[0].clone()).await.unwrap();
    let b = register(&gcm, whos[1].clone(), lcms[1].clone()).await.unwrap();
    let connect = Request::Connect {
        client: port("b/x/input"),
        server: port("a/x/value"),
        options: ConnectOptions::default(),
    };
    ask(&gcm, vec![create("a/x"), create("b/x"), connect]).await.unwrap();
    until(&gcm, "both halves are told of", |graph| graph.proxies.len() == 2).await;
    (gcm, lcms, whos, [a, b])
}

/// Returns the registration of a process that was told of all this.
fn brings(graph: &SystemGraph, who: &Registration) -> Registration {
    let mine = |id: &ComponentId| id.process == who.process;
    let components = graph.components.iter().filter(|(id, _)| mine(id));
    let connections: Vec<Connection> =
        graph.connections.values().filter(|c| c.ends_in(&who.process)).cloned().collect();
    let components = components.map(|(id, c)| (id.clone(), c.clone())).collect();
    Registration { slice: Slice { components, connections }, ..who.clone() }
}

async fn has_cut(lcm: &FakeLcm) {
    let cut = async {
        while !lcm.done().iter().any(|done| done.starts_with("Disconnect")) {
            tokio::task::yield_now().await;
        }
    };
    comes("its half is cut", cut).await;
}

#[tokio::test]
async fn a_gcm_that_was_started_again_knows_a_connection_once_both_processes_have_brought_it() {
    let (before, lcms, whos, _) = connected().await;
    let graph = before.graph();
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    register(&gcm, brings(&graph, &whos[0]), lcms[0].clone()).await.unwrap();
    assert!(gcm.graph().connections.is_empty(), "one end is not a connection");
    register(&gcm, brings(&graph, &whos[1]), lcms[1].clone()).await.unwrap();
    assert_eq!(gcm.graph().connections, graph.connections);
    assert_eq!(gcm.graph().proxies, graph.proxies);
    assert!(!lcms.iter().any(|lcm| lcm.done().iter().any(|d| d.starts_with("Disconnect"))));
    assert_eq!(gcm.graph().next_connection, 2, "its number is not used again");
}

#[tokio::test]
async fn a_half_whose_other_end_comes_back_without_it_is_cut() {
    let (before, lcms, whos, _) = connected().await;
    let graph = before.graph();
    for present in [0, 1] {
        let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
        register(&gcm, brings(&graph, &whos[present]), lcms[present].clone()).await.unwrap();
        let other = ["b", "a"][present];
        register(&gcm, who(other), FakeLcm::new(other)).await.unwrap();
        has_cut(&lcms[present]).await;
        assert!(gcm.graph().connections.is_empty());
        assert_eq!(gcm.graph().next_connection, 2);
    }
}

#[tokio::test]
async fn a_half_whose_other_process_is_taken_down_is_cut() {
    let gone =
        |pid| Told { process: name("b"), fate: Fate::Dismissed, pid, last_exit: String::new(), restarts: 0 };
    let (gcm, lcms, whos, _) = connected().await;
    let graph = gcm.graph();
    gcm.told(&gone(whos[1].pid));
    assert!(gcm.graph().connections.is_empty());
    has_cut(&lcms[0]).await;
    // Also when only a GCM before this one knew of it.
    let (again, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("a"));
    register(&again, brings(&graph, &whos[0]), lcm.clone()).await.unwrap();
    again.told(&gone(0));
    has_cut(&lcm).await;
}

#[tokio::test]
async fn a_half_made_for_an_earlier_run_of_the_other_process_is_made_anew() {
    let (before, lcms, whos, _) = connected().await;
    let graph = before.graph();
    // The GCM was killed when the server had its half again, and the client had not.
    lcms[1].halves_are_stale();
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    for (who, lcm) in whos.iter().zip(&lcms) {
        register(&gcm, brings(&graph, who), lcm.clone()).await.unwrap();
    }
    let is_stale = |graph: &SystemGraph| graph.proxies.values().any(|half| half.peer == "an earlier run");
    until(&gcm, "both have halves for each other", |g| g.proxies.len() == 2 && !is_stale(g)).await;
    assert_eq!(gcm.graph().connections, graph.connections);
}

#[tokio::test]
async fn what_was_disconnected_while_a_process_was_away_stays_disconnected() {
    let (gcm, lcms, whos, sessions) = connected().await;
    let brought = brings(&gcm.graph(), &whos[0]);
    gcm.lost(&name("a"), sessions[0].session);
    assert_eq!(gcm.graph().proxies.len(), 1, "its half is not known any more");
    ask(&gcm, vec![Request::Disconnect { which: Which::Id(ConnectionId(1)) }]).await.unwrap();
    has_cut(&lcms[1]).await;
    register(&gcm, brought, lcms[0].clone()).await.unwrap();
    has_cut(&lcms[0]).await;
    assert!(gcm.graph().connections.is_empty());
}

#[tokio::test]
async fn both_processes_started_again_are_connected_again() {
    let (gcm, _, _, sessions) = connected().await;
    let graph = gcm.graph();
    gcm.lost(&name("a"), sessions[0].session);
    gcm.lost(&name("b"), sessions[1].session);
    assert!(gcm.graph().proxies.is_empty());
    let again = [FakeLcm::new("a"), FakeLcm::new("b")];
    register(&gcm, who("b"), again[1].clone()).await.unwrap();
    until(&gcm, "b waits for nobody", |g| g.processes[&name("b")].state == ProcessState::Attached).await;
    register(&gcm, who("a"), again[0].clone()).await.unwrap();
    until(&gcm, "both halves are there", |g| g.proxies.len() == 2).await;
    assert_eq!(gcm.graph().connections, graph.connections);
}

#[tokio::test]
async fn a_half_that_was_not_made_while_a_process_was_away_is_made_when_it_is_back() {
    let (gcm, lcms, whos, sessions) = connected().await;
    let brought = brings(&gcm.graph(), &whos[0]);
    gcm.lost(&name("a"), sessions[0].session);
    gcm.lost(&name("b"), sessions[1].session);
    // Another incarnation of b, made anew while a cannot be asked.
    register(&gcm, who("b"), FakeLcm::new("b")).await.unwrap();
    until(&gcm, "b is there", |g| g.processes[&name("b")].state == ProcessState::Attached).await;
    assert!(gcm.graph().proxies.is_empty());
    register(&gcm, brought, lcms[0].clone()).await.unwrap();
    until(&gcm, "both halves are there", |g| g.proxies.len() == 2).await;
    assert!(gcm.graph().components.contains_key(&id("b/x")));
}

#[tokio::test]
async fn a_connection_that_cannot_be_made_again_says_why_and_is_tried_once_more_later() {
    let (gcm, _, _, sessions) = connected().await;
    gcm.lost(&name("a"), sessions[0].session);
    let again = FakeLcm::new("a");
    again.unreachable("Connect b/x/input to a/x/value");
    let session = register(&gcm, who("a"), again).await.unwrap().session;
    let graph = until(&gcm, "it is said", |g| {
        g.proxies.len() == 2 && g.processes[&name("a")].state == ProcessState::Attached
    })
    .await;
    let shown = graph.proxies_of(&graph.connections[&ConnectionId(1)]);
    assert!(shown.iter().any(|(_, half)| half.why.contains("no socket")), "{shown:?}");
    gcm.lost(&name("a"), session);
    register(&gcm, who("a"), FakeLcm::new("a")).await.unwrap();
    until(&gcm, "both halves are there", |g| g.proxies.values().filter(|half| half.is_linked()).count() == 2)
        .await;
}
