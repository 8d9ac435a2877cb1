//! Components a restarted process gets back, and the news of its supervisor.

use std::sync::Arc;

use trocar_model::{Health, ProcessState, State, StopReason, SystemGraph};

use super::super::fake::{FakeLcm, id, name, until};
use super::super::{Fate, Gcm, GcmConfig, Told};
use super::{ask, component, create, host, register, start, stop, system};

pub(super) fn is(state: ProcessState) -> impl Fn(&SystemGraph) -> bool {
    move |graph| graph.processes[&name("host")].state == state
}

pub(super) fn fate(fate: Fate, pid: u32) -> Told {
    Told { process: name("host"), fate, pid, last_exit: "was killed by SIGSEGV".into(), restarts: 1 }
}

/// A GCM whose process `host` has an actuator that ran, and the session of that.
pub(super) async fn running() -> (Gcm, Arc<FakeLcm>, u64) {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let session = register(&gcm, host(), lcm.clone()).await.unwrap().session;
    ask(&gcm, vec![create("host/a"), create("host/b"), start("host/a")]).await.unwrap();
    (gcm, lcm, session)
}

#[tokio::test]
async fn another_incarnation_gets_its_components_back_and_what_moves_waits_for_somebody() {
    let (gcm, _lcm, session) = running().await;
    gcm.lost(&name("host"), session);
    let again = FakeLcm::new("host");
    register(&gcm, host(), again.clone()).await.unwrap();
    let graph = until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    let (a, b) = (component(&graph, "host/a"), component(&graph, "host/b"));
    assert_eq!((a.state, a.health), (State::Stopped(StopReason::Restarted), Health::Ok));
    assert_eq!(b.state, State::Ready);
    assert_eq!(again.state("host/a"), Some(State::Stopped(StopReason::Restarted)));
    assert!(!again.done().iter().any(|d| d.starts_with("Start")), "{:?}", again.done());
    ask(&gcm, vec![start("host/a")]).await.unwrap();
    assert_eq!(again.state("host/a"), Some(State::Active), "somebody who names it may start it");
}

#[tokio::test]
async fn what_cannot_be_made_again_is_in_fault_and_the_others_come_back() {
    let (gcm, _lcm, session) = running().await;
    gcm.lost(&name("host"), session);
    let again = FakeLcm::new("host");
    again.refuse("Create host/a");
    register(&gcm, host(), again.clone()).await.unwrap();
    let graph = until(&gcm, "what can be made again", is(ProcessState::Attached)).await;
    let a = component(&graph, "host/a");
    assert_eq!(a.state, State::Fault);
    assert!(a.fault.contains("the cable is out") && a.fault.contains("remove it"), "{}", a.fault);
    assert_eq!(again.state("host/b"), Some(State::Ready));
    ask(&gcm, vec![trocar_model::Request::Remove { id: id("host/a"), force: true }]).await.unwrap();
    assert!(!gcm.graph().components.contains_key(&id("host/a")), "it can be removed");
}

#[tokio::test]
async fn a_process_that_dies_again_while_it_gets_its_components_back_loses_none() {
    let (gcm, _lcm, mut session) = running().await;
    for _ in 0..3 {
        gcm.lost(&name("host"), session);
        let again = FakeLcm::new("host");
        again.hold("Create host/b");
        session = register(&gcm, host(), again.clone()).await.unwrap().session;
        again.hangs("Create host/b").await;
    }
    gcm.lost(&name("host"), session);
    register(&gcm, host(), FakeLcm::new("host")).await.unwrap();
    let graph = until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    assert_eq!(component(&graph, "host/a").state, State::Stopped(StopReason::Restarted));
    assert_eq!(component(&graph, "host/b").state, State::Ready);
}

#[tokio::test]
async fn what_is_stopped_while_its_process_is_away_stays_stopped() {
    let (gcm, _lcm, session) = running().await;
    gcm.lost(&name("host"), session);
    ask(&gcm, vec![stop("host/**")]).await.unwrap();
    register(&gcm, host(), FakeLcm::new("host")).await.unwrap();
    let graph = until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    assert_eq!(component(&graph, "host/a").state, State::Stopped(StopReason::Requested));
}

#[tokio::test]
async fn a_process_its_supervisor_saw_end_is_lost_at_once() {
    let (gcm, _lcm) = system().await;
    gcm.told(&fate(Fate::Restarting, std::process::id() + 1));
    let process = gcm.graph().processes[&name("host")].clone();
    assert_eq!(process.state, ProcessState::Attached, "that was another incarnation");
    gcm.told(&fate(Fate::Running, std::process::id()));
    let process = gcm.graph().processes[&name("host")].clone();
    assert_eq!((process.last_exit.as_str(), process.restarts), ("was killed by SIGSEGV", 1));
    gcm.told(&fate(Fate::Restarting, std::process::id()));
    assert_eq!(gcm.graph().processes[&name("host")].state, ProcessState::Restarting);
    let lost = gcm.lcm_of(&name("host")).err().unwrap();
    assert_eq!(lost.reason(), "PROCESS_LOST");
    assert!(lost.to_string().contains("is being restarted: it was killed by SIGSEGV"), "{lost}");
    gcm.told(&fate(Fate::Failed, std::process::id()));
    let lost = ask(&gcm, vec![create("host/new")]).await.unwrap_err();
    assert!(lost.to_string().contains("has failed and is not started again: it was killed"), "{lost}");
    assert_eq!(gcm.graph().processes[&name("host")].state, ProcessState::Failed);
}

#[tokio::test]
async fn a_process_that_never_came_up_is_listed_with_what_became_of_it() {
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    gcm.told(&fate(Fate::Running, 7));
    assert!(gcm.graph().processes.is_empty(), "it registers by itself");
    gcm.told(&fate(Fate::Failed, 7));
    let process = gcm.graph().processes[&name("host")].clone();
    assert_eq!((process.state, process.epoch), (ProcessState::Failed, 0));
    gcm.told(&fate(Fate::Dismissed, 7));
    assert!(gcm.graph().processes.is_empty(), "it was taken down");
}

#[tokio::test]
async fn what_is_taken_down_leaves_nothing_in_the_graph() {
    let (gcm, _lcm, _) = running().await;
    gcm.told(&fate(Fate::Dismissed, std::process::id() + 1));
    assert_eq!(gcm.graph().components.len(), 2, "that was somebody else's");
    gcm.told(&fate(Fate::Dismissed, std::process::id()));
    let graph = gcm.graph();
    assert!(graph.processes.is_empty() && graph.components.is_empty() && graph.connections.is_empty());
}

#[tokio::test]
async fn a_process_keeps_its_epoch_through_a_gcm_that_was_restarted() {
    let first = Gcm::start(GcmConfig::default()).await.unwrap();
    let who = host();
    for _ in 0..3 {
        first.told(&fate(Fate::Dismissed, 0));
        let other = super::Registration { process: name("other"), ..host() };
        register(&first, other, FakeLcm::new("other")).await.ok();
    }
    let before = register(&first, who.clone(), FakeLcm::new("host")).await.unwrap();
    let second = Gcm::start(GcmConfig::default()).await.unwrap();
    let again = super::Registration { epoch: before.epoch, ..who };
    let after = register(&second, again, FakeLcm::new("host")).await.unwrap();
    assert_eq!(after.epoch, before.epoch);
    let other = super::Registration { process: name("other"), ..host() };
    let other = register(&second, other, FakeLcm::new("other")).await.unwrap();
    assert!(other.epoch > before.epoch, "a number is given once: {other:?}");
}

#[tokio::test]
async fn what_is_told_late_of_an_incarnation_does_not_touch_the_one_after_it() {
    let (gcm, _lcm, session) = running().await;
    gcm.lost(&name("host"), session);
    let (again, old, new) = (FakeLcm::new("host"), std::process::id(), std::process::id() + 1);
    again.hold("Create host/b");
    register(&gcm, super::Registration { pid: new, ..host() }, again.clone()).await.unwrap();
    again.hangs("Create host/b").await;
    for late in [Fate::Running, Fate::Restarting, Fate::Failed, Fate::Ended, Fate::Dismissed] {
        gcm.told(&fate(late, old));
        let graph = gcm.graph();
        assert_eq!(graph.components.len(), 2, "{late:?} took its components");
        assert_eq!(graph.processes[&name("host")].state, ProcessState::Restarting, "{late:?}");
        gcm.lcm_of(&name("host")).map(|_| ()).unwrap_or_else(|refusal| panic!("{late:?}: {refusal}"));
    }
    again.release("Create host/b");
    until(&gcm, "all is made again", is(ProcessState::Attached)).await;
}

#[tokio::test]
async fn what_is_told_of_a_process_after_it_was_taken_down_does_not_bring_it_back() {
    let (gcm, _lcm, _) = running().await;
    let (old, new) = (std::process::id(), std::process::id() + 1);
    gcm.told(&fate(Fate::Dismissed, old));
    assert_eq!(gcm.lcm_of(&name("host")).err().unwrap().reason(), "PROCESS_NOT_FOUND");
    for late in [Fate::Running, Fate::Restarting, Fate::Failed, Fate::Ended, Fate::Dismissed] {
        gcm.told(&fate(late, old));
        assert!(gcm.graph().processes.is_empty(), "{late:?}: {:?}", gcm.graph().processes);
    }
    gcm.told(&fate(Fate::Failed, new));
    assert_eq!(gcm.graph().processes[&name("host")].state, ProcessState::Failed, "that is another one");
    register(&gcm, host(), FakeLcm::new("host")).await.unwrap();
    assert_eq!(gcm.graph().processes[&name("host")].state, ProcessState::Attached);
    gcm.told(&fate(Fate::Restarting, old));
    assert_eq!(gcm.graph().processes[&name("host")].state, ProcessState::Restarting, "it is here again");
}
