//! Phases follow the graph: whatever changes it, each process is given those of its components.

use trocar_model::{ConnectOptions, ExecutionModel, Phase, PortId, Which};

use super::*;

const NS: u64 = 1_000_000;

fn beats(path: &str) -> Request {
    let execution =
        Execution { model: Some(ExecutionModel::Periodic), period_ns: Some(NS), ..Execution::default() };
    Request::Create { id: id(path), class: "arm".into(), config: None, execution }
}

fn connect(client: &str, server: &str) -> Request {
    let port = |text| PortId::parse(text).unwrap();
    Request::Connect { client: port(client), server: port(server), options: ConnectOptions::default() }
}

/// Waits until these components of a process step at these places, ns, and others at 0.
async fn steps_at(lcm: &FakeLcm, places: &[(&str, u64)]) {
    let want = places.iter().map(|(path, ns)| (id(path), Phase { phase_ns: *ns, note: String::new() }));
    let want = want.collect();
    let mut given = lcm.phases.subscribe();
    comes(&format!("phases {places:?}"), given.wait_for(|given| *given == want)).await.unwrap();
}

#[tokio::test]
async fn a_reader_steps_behind_its_source_while_they_are_connected() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![beats("host/a"), beats("host/b"), connect("host/a/input", "host/b/value")]).await.unwrap();
    steps_at(&lcm, &[("host/a", 500_000)]).await;
    let both = [Request::Disconnect { which: Which::Id(trocar_model::ConnectionId(1)) }];
    ask(&gcm, [&both[..], &[connect("host/b/input", "host/a/value")]].concat()).await.unwrap();
    steps_at(&lcm, &[("host/b", 500_000)]).await;
    let last = Request::Disconnect { which: Which::Id(trocar_model::ConnectionId(2)) };
    ask(&gcm, vec![last]).await.unwrap();
    steps_at(&lcm, &[]).await;
}

#[tokio::test]
async fn a_chain_through_processes_has_one_order() {
    let (gcm, left) = system().await;
    let right = FakeLcm::new("right");
    register(&gcm, Registration::new(name("right"), "127.0.0.1:2".into()), right.clone()).await.unwrap();
    left.takes.lock().insert(id("host/a"), 200_000);
    let all = ["host/a", "right/b", "host/c"].map(beats);
    let wires = [connect("right/b/input", "host/a/value"), connect("host/c/input", "right/b/value")];
    ask(&gcm, [&all[..], &wires[..]].concat()).await.unwrap();
    // A quarter of a period is kept for what was told of the first one; margins are halved so that all fit.
    steps_at(&right, &[("right/b", 437_500)]).await;
    steps_at(&left, &[("host/c", 750_000)]).await;
}

#[tokio::test]
async fn a_process_that_is_back_is_given_its_phases_again() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![beats("host/a"), beats("host/b"), connect("host/a/input", "host/b/value")]).await.unwrap();
    steps_at(&lcm, &[("host/a", 500_000)]).await;
    let session = gcm.inner.sessions.lock().holder(&name("host")).unwrap();
    gcm.lost(&name("host"), session);
    let anew = FakeLcm::new("host");
    register(&gcm, host(), anew.clone()).await.unwrap();
    steps_at(&anew, &[("host/a", 500_000)]).await;
}
