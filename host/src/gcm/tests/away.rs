//! Processes that have ended: forgotten, relieved of a component, started again.

use std::collections::BTreeSet;

use trocar_model::{ConnectOptions, PortId};

use super::*;
use crate::gcm::{Fate, Orders, Supervising, Supervisor, Told};

fn who(process: &str) -> Registration {
    Registration { pid: 7, ..Registration::new(name(process), String::new()) }
}

fn forget(process: &str) -> Request {
    Request::Forget { process: name(process) }
}

fn remove(path: &str, force: bool) -> Request {
    Request::Remove { id: id(path), force }
}

fn told(fate: Fate, restarts: u32) -> Told {
    Told { process: name("far"), fate, pid: 7, last_exit: "was killed by SIGSEGV".into(), restarts }
}

fn supervisor(processes: &[&str]) -> Supervisor {
    let processes: BTreeSet<_> = processes.iter().map(|process| name(process)).collect();
    Supervisor { processes, ..Supervisor::default() }
}

/// A host beside process "far", whose component `b` gives its value to `host/a`; that process is gone.
async fn lost() -> (Gcm, Arc<FakeLcm>, Registered) {
    let (gcm, [lcm, _], remote) = lost_with().await;
    (gcm, lcm, remote)
}

/// The same, with what was in the process.
async fn lost_with() -> (Gcm, [Arc<FakeLcm>; 2], Registered) {
    let (gcm, lcm) = system().await;
    let its = FakeLcm::new("far");
    let remote = register(&gcm, who("far"), its.clone()).await.unwrap();
    let connect = Request::Connect {
        client: PortId::parse("host/a/input").unwrap(),
        server: PortId::parse("far/b/value").unwrap(),
        options: ConnectOptions::default(),
    };
    ask(&gcm, vec![create("host/a"), create("far/b"), create("far/c"), connect]).await.unwrap();
    gcm.lost(&name("far"), remote.session);
    (gcm, [lcm, its], remote)
}

async fn has_cut(lcm: &FakeLcm) {
    let cut = async {
        while !lcm.done().iter().any(|done| done.starts_with("Disconnect")) {
            tokio::task::yield_now().await;
        }
    };
    comes("the other half is cut", cut).await;
}

#[tokio::test]
async fn a_process_that_ended_leaves_the_list_with_all_that_was_in_it() {
    let (gcm, lcm, _) = lost().await;
    let dry = ExecuteOptions { validate_only: true, ..ExecuteOptions::default() };
    let planned = gcm.execute(vec![forget("far")], dry).await.unwrap();
    let lines = plan_lines(&planned.plan);
    assert_eq!(lines.len(), 3, "{lines:?}");
    assert_eq!(gcm.graph().processes.len(), 2, "a dry run takes nothing away");
    let done = ask(&gcm, vec![forget("far")]).await.unwrap();
    assert_eq!(plan_lines(&done.plan), lines);
    let graph = gcm.graph();
    assert_eq!(graph.processes.keys().map(ToString::to_string).collect::<Vec<_>>(), ["host"]);
    assert_eq!(graph.components.keys().map(ToString::to_string).collect::<Vec<_>>(), ["host/a"]);
    assert!(graph.connections.is_empty(), "{:?}", graph.connections);
    has_cut(&lcm).await;
    assert_eq!(ask(&gcm, vec![forget("far")]).await.unwrap_err().reason(), "PROCESS_NOT_FOUND");
}

#[tokio::test]
async fn one_that_runs_or_is_being_started_again_is_not_forgotten() {
    let (gcm, _lcm) = system().await;
    let refused = ask(&gcm, vec![forget("host")]).await.unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_RUNS");
    let (gcm, _lcm, _) = lost().await;
    gcm.told(&told(Fate::Restarting, 1));
    let refused = ask(&gcm, vec![forget("far")]).await.unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_RUNS");
    assert!(refused.to_string().contains("being started again"), "{refused}");
    let both = ask(&gcm, vec![create("host/b"), forget("host")]).await.unwrap_err();
    assert_eq!(both.reason(), "PROCESS_RUNS");
    assert_eq!(gcm.graph().components.len(), 3, "nothing of a refused request is done");
}

#[tokio::test]
async fn one_that_was_only_away_is_listed_again_with_what_it_has() {
    let (gcm, [_, its], _) = lost_with().await;
    let graph = gcm.graph();
    let mine = graph.components.iter().filter(|(id, _)| id.process == name("far"));
    let components = mine.map(|(id, c)| (id.clone(), c.clone())).collect();
    ask(&gcm, vec![forget("far")]).await.unwrap();
    let back = Registration { slice: Slice { components, ..Slice::default() }, ..who("far") };
    register(&gcm, back, its).await.unwrap();
    assert_eq!(gcm.graph().processes[&name("far")].state, ProcessState::Attached);
    assert!(gcm.graph().components.contains_key(&id("far/b")), "{:?}", gcm.graph().components);
}

#[tokio::test]
async fn a_component_is_taken_out_of_a_process_that_has_ended_and_of_no_other() {
    let (gcm, lcm, _) = lost().await;
    let refused = ask(&gcm, vec![remove("far/b", true)]).await.unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_LOST", "nobody has seen it end");
    gcm.told(&told(Fate::Failed, 3));
    let refused = ask(&gcm, vec![remove("far/b", false)]).await.unwrap_err();
    assert_eq!(refused.reason(), "IN_USE");
    ask(&gcm, vec![remove("far/b", true)]).await.unwrap();
    assert!(!gcm.graph().components.contains_key(&id("far/b")) && gcm.graph().connections.is_empty());
    has_cut(&lcm).await;
    assert_eq!(gcm.graph().processes[&name("far")].state, ProcessState::Failed);
    let again = FakeLcm::new("far");
    register(&gcm, who("far"), again.clone()).await.unwrap();
    until(&gcm, "the rest is made anew", |graph| {
        graph.processes[&name("far")].state == ProcessState::Attached
    })
    .await;
    assert_eq!((again.state("far/b"), again.state("far/c")), (None, Some(State::Ready)));
}

#[tokio::test]
async fn nothing_is_taken_in_the_graph_alone_out_of_a_process_that_gets_its_components_back() {
    let (gcm, _lcm, _) = lost().await;
    gcm.told(&told(Fate::Restarting, 1));
    let request = [remove("far/c", true)];
    assert!(gcm.only_takes_away(&gcm.graph(), &request), "nobody is there");
    let again = FakeLcm::new("far");
    again.hold("Create far/b");
    register(&gcm, Registration { pid: 8, ..who("far") }, again.clone()).await.unwrap();
    assert_eq!(gcm.graph().processes[&name("far")].state, ProcessState::Restarting);
    assert!(!gcm.only_takes_away(&gcm.graph(), &request), "it may have the component by now");
}

#[tokio::test]
async fn a_reset_for_another_revision_starts_no_process_again() {
    let (gcm, _lcm, _) = lost().await;
    gcm.told(&told(Fate::Failed, 3));
    let mut supervising = gcm.supervise(supervisor(&["far"]));
    assert_eq!(supervising.next().await, Orders::default());
    let reset = Request::Reset { targets: vec![Target::parse("far/c").unwrap()] };
    let options = ExecuteOptions { expected_revision: Some(99), ..ExecuteOptions::default() };
    let refused = gcm.execute(vec![reset], options).await.unwrap_err();
    assert_eq!(refused.reason(), "REVISION_CONFLICT");
    let nothing = tokio::time::timeout(Duration::ZERO, supervising.next()).await;
    assert!(nothing.is_err(), "{nothing:?}");
}

/// Does what it is asked once: the process comes back, or fails anew.
async fn obey(gcm: Gcm, mut supervising: Supervising, comes_back: bool) {
    while !supervising.next().await.restart.contains(&name("far")) {}
    // The supervisor may have missed that the process was RESTARTING.
    gcm.told(&told(Fate::Running, 4));
    assert_eq!(gcm.graph().processes[&name("far")].state, ProcessState::Restarting);
    if comes_back {
        register(&gcm, Registration { pid: 8, ..who("far") }, FakeLcm::new("far")).await.unwrap();
    } else {
        gcm.told(&told(Fate::Failed, 4));
    }
}

#[tokio::test]
async fn a_process_is_started_again_by_who_keeps_it_and_by_nobody_else() {
    let (gcm, _lcm, remote) = lost().await;
    gcm.told(&told(Fate::Failed, 3));
    let deadline = || Instant::now() + Duration::from_secs(60);
    let refused = gcm.restart(&name("far"), deadline()).await.unwrap_err();
    assert_eq!(refused.reason(), "NOT_SUPERVISED");
    let mut other = gcm.supervise(supervisor(&["host"]));
    assert_eq!(other.next().await, Orders::default());
    tokio::spawn(obey(gcm.clone(), gcm.supervise(supervisor(&["far"])), true));
    let graph = gcm.restart(&name("far"), deadline()).await.unwrap();
    assert!(graph.processes[&name("far")].epoch > remote.epoch);
    assert_eq!(graph.processes[&name("far")].state, ProcessState::Attached);
    let mut late = gcm.supervise(supervisor(&["far"]));
    assert_eq!(late.next().await, Orders::default(), "what was asked before it was there is not asked of it");
    let nothing = tokio::time::timeout(Duration::ZERO, other.next()).await;
    assert!(nothing.is_err(), "it does not keep that process: {nothing:?}");
}

#[tokio::test]
async fn one_that_fails_again_says_how_it_ended() {
    let (gcm, _lcm, _) = lost().await;
    gcm.told(&told(Fate::Failed, 3));
    tokio::spawn(obey(gcm.clone(), gcm.supervise(supervisor(&["far"])), false));
    let refused = gcm.restart(&name("far"), Instant::now() + Duration::from_secs(60)).await.unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_NOT_UP");
    assert!(refused.to_string().contains("was killed by SIGSEGV"), "{refused}");
}

#[tokio::test]
async fn a_reset_of_a_component_brings_its_failed_process_back() {
    let (gcm, _lcm, remote) = lost().await;
    gcm.told(&told(Fate::Failed, 3));
    let reset = Request::Reset { targets: vec![Target::parse("far/c").unwrap()] };
    let refused = ask(&gcm, vec![reset.clone()]).await.unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_LOST", "nobody keeps it");
    tokio::spawn(obey(gcm.clone(), gcm.supervise(supervisor(&["far"])), true));
    ask(&gcm, vec![reset]).await.unwrap();
    let graph = gcm.graph();
    assert!(graph.processes[&name("far")].epoch > remote.epoch);
    assert_eq!(component(&graph, "far/c").state, State::Ready);
}
