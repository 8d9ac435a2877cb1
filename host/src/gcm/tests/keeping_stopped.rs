//! A component that was stopped stands still, whatever becomes of its process meanwhile.
//!
//! Promise: a Stop is never forgotten, and answered with OK only for what stands still.

use trocar_model::{ProcessState, State, StopReason};

use super::super::ExecuteOptions;
use super::super::fake::{FakeLcm, id, name, until};
use super::restarted::{is, running};
use super::{Arc, Gcm, Request, Target, ask, component, host, register, start, stop};

const REQUESTED: State = State::Stopped(StopReason::Requested);
const RESTARTED: State = State::Stopped(StopReason::Restarted);

fn resume(path: &str) -> Request {
    Request::Resume { targets: vec![Target::parse(path).unwrap()] }
}

/// As [`running`], with a process that can come back as it was.
async fn ours() -> (Gcm, Arc<FakeLcm>, super::Registration, u64) {
    let (gcm, lcm, who) =
        (Gcm::start(super::GcmConfig::default()).await.unwrap(), FakeLcm::new("host"), host());
    let session = register(&gcm, who.clone(), lcm.clone()).await.unwrap().session;
    ask(&gcm, vec![super::create("host/a"), start("host/a")]).await.unwrap();
    (gcm, lcm, who, session)
}

/// A process whose actuator waits for an operator.
async fn restarted() -> (Gcm, Arc<FakeLcm>, u64) {
    let (gcm, _lcm, session) = running().await;
    gcm.lost(&name("host"), session);
    let again = FakeLcm::new("host");
    let session = register(&gcm, host(), again.clone()).await.unwrap().session;
    until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    (gcm, again, session)
}

#[tokio::test]
async fn a_stop_of_what_waits_since_its_process_was_started_again_counts_and_is_kept() {
    for path in ["host/a", "**"] {
        let (gcm, lcm, session) = restarted().await;
        let before = gcm.graph().revision;
        let done = ask(&gcm, vec![stop(path)]).await.unwrap();
        assert_eq!(done.revision, before + 1, "it is one change");
        assert_eq!(component(&gcm.graph(), "host/a").state, REQUESTED);
        assert_eq!(lcm.state("host/a"), Some(REQUESTED), "its LCM knows it, too");
        gcm.lost(&name("host"), session);
        register(&gcm, host(), FakeLcm::new("host")).await.unwrap();
        let graph = until(&gcm, "all is made again", is(ProcessState::Attached)).await;
        assert_eq!(component(&graph, "host/a").state, REQUESTED, "nothing sets it in motion by itself");
    }
}

#[tokio::test]
async fn what_was_decided_before_a_stop_does_not_set_in_motion_what_was_stopped() {
    let (gcm, lcm, _) = restarted().await;
    let options =
        ExecuteOptions { expected_revision: Some(gcm.graph().revision), ..ExecuteOptions::default() };
    // The Stop is under way, and nothing of it is done yet.
    lcm.hold("Stop host/a");
    let stopping = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![stop("host/a")]).await }
    });
    lcm.hangs("Stop host/a").await;
    let refusal = gcm.execute(vec![resume("host/a")], options).await.unwrap_err();
    assert_eq!(refusal.reason(), "REVISION_CONFLICT", "{refusal}");
    lcm.release("Stop host/a");
    stopping.await.unwrap().unwrap();
    assert_eq!(lcm.state("host/a"), Some(REQUESTED));
    ask(&gcm, vec![resume("host/a")]).await.unwrap();
    assert_eq!(lcm.state("host/a"), Some(State::Active), "somebody who knows of the Stop may resume it");
}

#[tokio::test]
async fn what_is_stopped_while_its_process_gets_it_back_stays_stopped() {
    let (gcm, _lcm, session) = running().await;
    gcm.lost(&name("host"), session);
    let again = FakeLcm::new("host");
    again.hold("Create host/b");
    register(&gcm, host(), again.clone()).await.unwrap();
    again.hangs("Create host/b").await;
    assert_eq!(again.state("host/a"), Some(RESTARTED), "it is made already");
    let before = gcm.graph().revision;
    let done = ask(&gcm, vec![stop("host/**")]).await.unwrap();
    assert!(done.revision > before, "what was decided before is not done any more");
    again.release("Create host/b");
    let graph = until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    assert_eq!(component(&graph, "host/a").state, REQUESTED);
    assert_eq!(again.state("host/a"), Some(REQUESTED));
}

#[tokio::test]
async fn what_is_stopped_while_its_process_is_away_is_stopped_when_it_comes_back_as_it_was() {
    let (gcm, lcm, who, session) = ours().await;
    gcm.lost(&name("host"), session);
    let not_told = ask(&gcm, vec![stop("**")]).await.unwrap_err();
    assert_eq!(not_told.reason(), "STOP_NOT_TOLD", "it may be moving: {not_told}");
    assert_eq!(lcm.state("host/a"), Some(State::Active), "nobody could tell it");
    register(&gcm, who, lcm.clone()).await.unwrap();
    until(&gcm, "it is stopped", |graph| graph.components[&id("host/a")].state == REQUESTED).await;
    assert_eq!(lcm.state("host/a"), Some(REQUESTED));
    ask(&gcm, vec![start("host/a")]).await.unwrap();
    assert_eq!(lcm.state("host/a"), Some(State::Active), "it may be started again");
}

#[tokio::test]
async fn a_process_that_goes_away_before_it_was_told_is_told_when_it_comes_back() {
    let (gcm, lcm, who, session) = ours().await;
    gcm.lost(&name("host"), session);
    ask(&gcm, vec![stop("host/a")]).await.unwrap_err();
    lcm.lose_at("Stop host/a");
    lcm.hold("Stop host/a");
    let session = register(&gcm, who.clone(), lcm.clone()).await.unwrap().session;
    lcm.hangs("Stop host/a").await;
    gcm.lost(&name("host"), session);
    lcm.release("Stop host/a");
    register(&gcm, who, lcm.clone()).await.unwrap();
    until(&gcm, "it is stopped", |graph| graph.components[&id("host/a")].state == REQUESTED).await;
    assert_eq!(lcm.state("host/a"), Some(REQUESTED));
}

#[tokio::test]
async fn a_stop_in_the_middle_of_which_its_process_goes_away_is_kept() {
    for comes_back in [true, false] {
        let (gcm, lcm, who, session) = ours().await;
        lcm.lose_at("Stop host/a");
        let refusal = ask(&gcm, vec![stop("host/a")]).await.unwrap_err();
        assert_eq!(refusal.reason(), "STOP_NOT_TOLD", "it cannot be told that it is stopped: {refusal}");
        gcm.lost(&name("host"), session);
        if comes_back {
            register(&gcm, who, lcm.clone()).await.unwrap();
        } else {
            register(&gcm, host(), FakeLcm::new("host")).await.unwrap();
        }
        until(&gcm, "it is stopped", |graph| graph.components[&id("host/a")].state == REQUESTED).await;
    }
}
