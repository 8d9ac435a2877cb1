//! Promises of a GCM, against an LCM that does as it is told.
#![allow(clippy::unwrap_used)]

mod away;
mod between;
mod hanging;
mod hearing;
mod holding;
mod interrupted;
mod isolated;
mod journal;
mod keeping_stopped;
mod kept;
mod late;
mod leading;
mod phases;
mod ports;
mod restarted;
mod stopping;
mod undecided;

use std::future::{Future, ready};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_lcm_api::Lcm;
use trocar_model::{
    Component, Execution, Health, ProcessState, Refusal, Request, State, StopReason, SystemGraph, Target,
};

use super::fake::{FakeLcm, comes, id, name, until};
use super::{ExecuteOptions, Gcm, GcmConfig, Registered, Registration, Slice, plan_lines};

async fn register(gcm: &Gcm, who: Registration, lcm: Arc<FakeLcm>) -> Result<Registered, Refusal> {
    let inventory = lcm.inventory().await.unwrap();
    gcm.register(who, lcm, inventory).await
}

fn host() -> Registration {
    Registration::new(name("host"), "127.0.0.1:1".into())
}

async fn system() -> (Gcm, Arc<FakeLcm>) {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    register(&gcm, host(), lcm.clone()).await.unwrap();
    (gcm, lcm)
}

fn create(path: &str) -> Request {
    Request::Create { id: id(path), class: "arm".into(), config: None, execution: Execution::default() }
}

fn start(path: &str) -> Request {
    Request::Start { targets: vec![Target::parse(path).unwrap()] }
}

fn stop(path: &str) -> Request {
    Request::Stop { targets: vec![Target::parse(path).unwrap()] }
}

async fn ask(gcm: &Gcm, requests: Vec<Request>) -> Result<super::Executed, Refusal> {
    gcm.execute(requests, ExecuteOptions::default()).await
}

fn within(ms: u64) -> ExecuteOptions {
    ExecuteOptions { deadline: Some(Instant::now() + Duration::from_millis(ms)), ..ExecuteOptions::default() }
}

fn component(graph: &SystemGraph, path: &str) -> Component {
    graph.components[&id(path)].clone()
}

/// Polls once, so that it has begun.
async fn begun<T: std::fmt::Debug>(mut future: Pin<&mut impl Future<Output = T>>) {
    tokio::select! {
        biased;
        early = &mut future => panic!("it must wait, and answered {early:?}"),
        () = ready(()) => {}
    }
}

#[tokio::test]
async fn a_plan_reads_as_lines_and_each_change_is_done_once() {
    let (gcm, lcm) = system().await;
    let done = ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    assert_eq!(done.revision, 1);
    let lines = plan_lines(&done.plan);
    assert!(lines[0].starts_with("+ create host/a (toy/arm)"), "{lines:?}");
    assert!(lines.last().unwrap().starts_with("+ start host/a"), "{lines:?}");
    assert!(lines.iter().any(|l| l.starts_with("~ configure host/a")), "{lines:?}");
    let done = ask(&gcm, vec![stop("host/a")]).await.unwrap();
    assert!(plan_lines(&done.plan)[0].starts_with("- stop host/a"), "{:?}", plan_lines(&done.plan));
    assert_eq!(done.revision, 2);
    assert_eq!(lcm.done().iter().filter(|d| *d == "Start host/a").count(), 1, "{:?}", lcm.done());
}

#[tokio::test]
async fn a_dry_run_asks_no_lcm() {
    let (gcm, lcm) = system().await;
    let options = ExecuteOptions { validate_only: true, ..ExecuteOptions::default() };
    let done = gcm.execute(vec![create("host/a")], options).await.unwrap();
    assert!(!done.plan.changes.is_empty());
    assert_eq!((done.revision, lcm.done().len(), gcm.graph().components.len()), (0, 0, 0));
}

#[tokio::test]
async fn what_was_done_is_undone_when_a_later_step_is_refused() {
    let (gcm, lcm) = system().await;
    lcm.refuse("Start host/b");
    let all = vec![create("host/a"), create("host/b"), start("host/*")];
    let refusal = ask(&gcm, all).await.unwrap_err();
    assert_eq!(refusal.reason(), "COMPONENT_REFUSED");
    assert_eq!(gcm.graph().components.len(), 0, "something was left in the graph");
    assert_eq!((lcm.state("host/a"), lcm.state("host/b")), (None, None), "something was left in the process");
    assert_eq!(gcm.graph().revision, 0, "a refused request is no change");
}

#[tokio::test]
async fn the_same_request_id_at_the_same_time_is_done_once() {
    let (gcm, lcm) = system().await;
    lcm.hold("Create host/a");
    let options = ExecuteOptions { request_id: "r1".into(), ..ExecuteOptions::default() };
    let first = tokio::spawn({
        let (gcm, options) = (gcm.clone(), options.clone());
        async move { gcm.execute(vec![create("host/a")], options).await }
    });
    lcm.hangs("Create host/a").await;
    let other = gcm.execute(vec![create("host/b")], options.clone()).await.unwrap_err();
    assert_eq!(other.reason(), "ARGUMENT_INVALID", "one id for two requests: {other}");
    let second = gcm.execute(vec![create("host/a")], options.clone());
    let mut second = std::pin::pin!(second);
    begun(second.as_mut()).await;
    lcm.release("Create host/a");
    let (first, second) = (first.await.unwrap().unwrap(), second.await.unwrap());
    assert_eq!((first.revision, second.revision), (1, 1));
    let later = gcm.execute(vec![create("host/a")], options).await.unwrap();
    assert_eq!(later.revision, 1, "a repeated request must get its first answer");
    assert_eq!(lcm.done().iter().filter(|d| *d == "Create host/a").count(), 1);
}

#[tokio::test]
async fn a_stale_revision_is_refused_for_all_but_stop() {
    let (gcm, _lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    let stale = ExecuteOptions { expected_revision: Some(0), ..ExecuteOptions::default() };
    let refusal = gcm.execute(vec![create("host/b")], stale.clone()).await.unwrap_err();
    assert_eq!(refusal, Refusal::RevisionConflict { expected: 0, actual: 1 });
    gcm.execute(vec![stop("host/a")], stale).await.unwrap();
    assert_eq!(component(&gcm.graph(), "host/a").state, State::Stopped(StopReason::Requested));
}

#[tokio::test]
async fn a_stop_wins_over_a_start_in_flight() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    lcm.hold("Start host/a");
    let starting = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![start("host/a")]).await }
    });
    lcm.hangs("Start host/a").await;
    let mut stopping = std::pin::pin!(ask(&gcm, vec![stop("host/**")]));
    begun(stopping.as_mut()).await;
    comes("the Stop is ordered", lcm.is_told_to_stop()).await;
    lcm.release("Start host/a");
    stopping.await.unwrap();
    let refusal = starting.await.unwrap().unwrap_err();
    assert_eq!(refusal.reason(), "WRONG_STATE");
    assert!(refusal.to_string().contains("stopped while"), "{refusal}");
    assert_eq!(lcm.state("host/a"), Some(State::Ready), "it moves although it was stopped: {:?}", lcm.done());
    assert_eq!(component(&gcm.graph(), "host/a").state, State::Ready);
}

#[tokio::test]
async fn what_a_stop_named_is_not_started_any_more() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), create("host/b")]).await.unwrap();
    lcm.hold("Start host/a");
    let starting = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![start("host/*")]).await }
    });
    lcm.hangs("Start host/a").await;
    let mut stopping = std::pin::pin!(ask(&gcm, vec![stop("host/b")]));
    begun(stopping.as_mut()).await;
    lcm.release("Start host/a");
    stopping.await.unwrap();
    starting.await.unwrap().unwrap_err();
    assert!(!lcm.done().contains(&"Start host/b".to_owned()), "{:?}", lcm.done());
}

#[tokio::test]
async fn stop_stops_what_it_can_and_names_what_it_cannot() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), create("host/b"), start("host/*")]).await.unwrap();
    lcm.refuse("Stop host/a");
    let done = ask(&gcm, vec![stop("**")]).await.unwrap();
    assert_eq!(done.failed.len(), 1);
    assert_eq!(done.failed[0].0, Target::One(id("host/a")));
    assert_eq!(lcm.state("host/b"), Some(State::Stopped(StopReason::Requested)));
}

#[tokio::test]
async fn stop_does_not_wait_for_a_request_that_hangs() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    lcm.hold("Create host/b");
    let hanging = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![create("host/b")]).await }
    });
    lcm.hangs("Create host/b").await;
    ask(&gcm, vec![stop("host/a")]).await.unwrap();
    lcm.release("Create host/b");
    hanging.await.unwrap().unwrap();
}

#[tokio::test]
async fn an_lcm_that_hangs_costs_a_caller_no_more_than_its_deadline() {
    let (gcm, lcm) = system().await;
    lcm.hold("Create host/a");
    let first = tokio::spawn({
        let gcm = gcm.clone();
        async move { gcm.execute(vec![create("host/a")], within(200)).await }
    });
    lcm.hangs("Create host/a").await;
    let waiting = gcm.execute(vec![create("host/a")], within(10)).await.unwrap_err();
    assert_eq!(waiting.reason(), "BUSY", "{waiting}");
    assert!(waiting.to_string().contains("Create host/a is still being carried out"), "{waiting}");
    let hung = first.await.unwrap().unwrap_err();
    assert_eq!(hung, Refusal::LcmTimeout { process: name("host"), what: "Create host/a".into() });
}

#[tokio::test]
async fn a_start_that_took_too_long_is_stopped_behind_the_callers_back() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    lcm.hold("Start host/a");
    let late = gcm.execute(vec![start("host/a")], within(10)).await.unwrap_err();
    assert_eq!(late.reason(), "LCM_TIMEOUT");
    comes("somebody stops it", lcm.is_told_to_stop()).await;
}

#[tokio::test]
async fn a_name_is_taken_once_even_by_two_at_the_same_time() {
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    let (a, b) = (FakeLcm::new("host"), FakeLcm::new("host"));
    let (first, second) = tokio::join!(register(&gcm, host(), a), register(&gcm, host(), b));
    let refusal = first.err().or(second.err()).unwrap();
    let Refusal::ProcessExists { endpoint, pid, .. } = refusal else { panic!("{refusal}") };
    assert_eq!((endpoint.as_str(), pid), ("127.0.0.1:1", std::process::id()));
    assert_eq!(gcm.graph().revision, 0, "a process is no change of the system");
}

#[tokio::test]
async fn a_lost_process_stays_listed_and_its_name_is_free() {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let first = register(&gcm, host(), lcm).await.unwrap();
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    gcm.lost(&name("host"), first.session - 1);
    assert_eq!(
        gcm.graph().processes[&name("host")].state,
        ProcessState::Attached,
        "an older session has no say"
    );
    gcm.lost(&name("host"), first.session);
    let graph = gcm.graph();
    assert_eq!(graph.processes[&name("host")].state, ProcessState::Lost);
    assert_eq!(component(&graph, "host/a").health, Health::Lost);
    assert_eq!(graph.revision, 1, "losing a process is no change that was asked for");
    assert_eq!(gcm.lcm_of(&name("host")).err().unwrap().reason(), "PROCESS_LOST");
    assert_eq!(gcm.lcm_of(&name("hots")).err().unwrap().reason(), "PROCESS_NOT_FOUND");
    assert_eq!(ask(&gcm, vec![start("host/a")]).await.unwrap_err().reason(), "PROCESS_LOST");
    let registered = register(&gcm, host(), FakeLcm::new("host")).await.unwrap();
    assert!(registered.epoch > first.epoch);
}

#[tokio::test]
async fn a_process_that_comes_back_keeps_its_components_as_they_are_now() {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let who = host();
    let registered = register(&gcm, who.clone(), lcm.clone()).await.unwrap();
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    gcm.lost(&name("host"), registered.session);
    lcm.become_state("host/a", State::Fault, "the cable is out");
    let again = register(&gcm, who, lcm.clone()).await.unwrap();
    assert_eq!(again.epoch, registered.epoch, "it is the same incarnation");
    let a = component(&gcm.graph(), "host/a");
    assert_eq!((a.state, a.health), (State::Fault, Health::Ok));
    gcm.lost(&name("host"), registered.session);
    gcm.lcm_of(&name("host")).map(|_| ()).expect("the old session has no say any more");
}

#[tokio::test]
async fn a_gcm_that_was_restarted_learns_components_and_connections_from_the_process() {
    let (gcm, lcm) = system().await;
    let (a, b) = ("host/a", "host/b");
    let connect = Request::Connect {
        client: trocar_model::PortId::parse("host/b/robot").unwrap(),
        server: trocar_model::PortId::parse("host/a/arm").unwrap(),
        options: Default::default(),
    };
    ask(&gcm, vec![create(a), create(b), connect, start("host/*")]).await.unwrap();
    let before = gcm.graph();
    let slice = Slice {
        components: before.components.iter().map(|(id, c)| (id.clone(), c.clone())).collect(),
        connections: before.connections.values().cloned().collect(),
    };
    let restarted = Gcm::start(GcmConfig::default()).await.unwrap();
    register(&restarted, Registration { slice, ..host() }, lcm).await.unwrap();
    let after = restarted.graph();
    assert_eq!(after.components, before.components);
    assert_eq!(after.connections, before.connections);
    assert_eq!(after.next_connection, before.next_connection, "a number must not be given twice");
}

#[tokio::test]
async fn what_an_lcm_tells_is_seen_and_its_end_is_noticed() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    lcm.log("host/a", 3, "hello");
    lcm.become_state("host/a", State::Fault, "the cable is out");
    let wanted = [State::Fault];
    let graph = gcm.wait_for(&id("host/a"), &wanted, Instant::now() + Duration::from_secs(60)).await.unwrap();
    assert_eq!(component(&graph, "host/a").fault, "the cable is out");
    let (kept, _live) = gcm.lines().tail();
    assert_eq!(kept.last().unwrap().message, "hello");
}

#[tokio::test]
async fn waiting_ends_at_the_deadline_or_at_a_fault_that_nobody_waits_for() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    let (a, wanted) = (id("host/a"), [State::Active]);
    let late = gcm.wait_for(&a, &wanted, Instant::now() + Duration::from_millis(5)).await.unwrap_err();
    let Refusal::NotReached { state, wanted: said, .. } = &late else { panic!("{late}") };
    assert_eq!((*state, said.as_slice()), (State::Ready, wanted.as_slice()));
    let mut waiting = std::pin::pin!(gcm.wait_for(&a, &wanted, Instant::now() + Duration::from_secs(60)));
    begun(waiting.as_mut()).await;
    lcm.become_state("host/a", State::Fault, "the cable is out");
    assert_eq!(
        waiting.await.unwrap_err(),
        Refusal::ComponentFault { id: a.clone(), text: "the cable is out".into() }
    );
}

#[tokio::test]
async fn terms_and_epochs_go_on_where_the_last_gcm_ended() {
    let dir = tempfile::tempdir().unwrap();
    let config = GcmConfig { state: Some(dir.path().to_owned()), ..GcmConfig::default() };
    let first = Gcm::start(config.clone()).await.unwrap();
    let before = register(&first, host(), FakeLcm::new("host")).await.unwrap();
    let second = Gcm::start(config).await.unwrap();
    let after = register(&second, host(), FakeLcm::new("host")).await.unwrap();
    assert_eq!((before.term, after.term), (1, 2));
    assert!(after.epoch > before.epoch, "an epoch was given twice: {before:?} {after:?}");
}
