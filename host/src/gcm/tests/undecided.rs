//! Changes that were done and never decided when their GCM ended: nobody was told, and nothing stays.

use trocar_model::{ConnectionId, Request};

use super::super::{Standing, Unusable};
use super::journal::{Process, STOPPED, all_run, connect, ended_within, gcm_with, shown};
use super::kept::Kept;
use super::*;

fn create_cam(path: &str) -> Request {
    Request::Create { id: id(path), class: "cam".into(), config: None, execution: Execution::default() }
}

#[tokio::test]
async fn a_refusal_is_told_when_what_it_rests_on_is_on_record() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    Process::come(&gcm, "host").await;
    gcm.flush().await;
    let (release, hangs) = std::sync::mpsc::channel::<()>();
    store.0.lock().hangs = Some(hangs);
    let (first, second) = (gcm.clone(), gcm.clone());
    let made = tokio::spawn(async move { ask(&first, vec![create("host/a")]).await });
    until(&gcm, "it is made", |graph| graph.components.len() == 1).await;
    let refused = tokio::spawn(async move { ask(&second, vec![create("host/a")]).await });
    all_run().await;
    assert!(!made.is_finished() && !refused.is_finished(), "the next GCM would know of neither");
    drop(release);
    assert_eq!(refused.await.unwrap().unwrap_err().reason(), "COMPONENT_EXISTS");
    assert_eq!(store.wanted().components.len(), 1, "it is on record when that was told");
    made.await.unwrap().unwrap();
    // One that rests on nothing new waits for nothing.
    let (_release, hangs) = std::sync::mpsc::channel::<()>();
    gcm.flush().await;
    store.0.lock().hangs = Some(hangs);
    assert_eq!(ask(&gcm, vec![create("host/a")]).await.unwrap_err().reason(), "COMPONENT_EXISTS");
    assert_eq!(*gcm.journal().borrow(), Standing::Written);
}

/// A GCM with an actuator and a camera that run.
async fn running(store: &Kept) -> (Gcm, Process) {
    let gcm = gcm_with(store).await;
    let host = Process::come(&gcm, "host").await;
    ask(&gcm, vec![create("host/arm"), create_cam("host/cam"), start("host/*")]).await.unwrap();
    gcm.flush().await;
    (gcm, host)
}

#[tokio::test]
async fn what_was_stopped_by_a_request_that_was_not_decided_goes_on_unless_it_moves_something() {
    let store = Kept::default();
    let (first, mut host) = running(&store).await;
    host.lcm.hold("Create host/new");
    let asking = tokio::spawn({
        let first = first.clone();
        async move { ask(&first, vec![stop("host/cam"), stop("host/arm"), create("host/new")]).await }
    });
    host.lcm.hangs("Create host/new").await;
    assert_eq!((host.lcm.state("host/cam"), host.lcm.state("host/arm")), (Some(STOPPED), Some(STOPPED)));
    host.was_told(&first.graph());
    let second = ended_within(asking, first, &store).await;
    host.lcm.release("Create host/new");
    host.is_back(&second).await;
    let goes_on = |graph: &SystemGraph| component(graph, "host/cam").state == State::Active;
    until(&second, "the camera goes on", goes_on).await;
    all_run().await;
    assert_eq!(host.lcm.state("host/arm"), Some(STOPPED));
    let done = host.lcm.done();
    assert!(!done.contains(&"Resume host/arm".to_owned()), "{done:?}");
    assert_eq!(done.iter().filter(|d| *d == "Resume host/cam").count(), 1, "{done:?}");
    second.flush().await;
    let wanted = store.wanted();
    let granted = |path: &str| wanted.components[&id(path)].grant.is_some();
    assert_eq!((granted("host/cam"), granted("host/arm")), (true, false));
}

#[tokio::test]
async fn what_a_stop_has_stopped_stands_still_although_that_was_lost_with_the_record() {
    let store = Kept::default();
    let (first, mut host) = running(&store).await;
    store.fail(Some(Unusable::Now));
    ask(&first, vec![stop("host/cam")]).await.unwrap();
    host.was_told(&first.graph());
    drop(first);
    store.fail(None);
    let second = gcm_with(&store).await;
    assert_eq!(
        shown(&second.graph()),
        ["host/arm ACTIVE Lost", "host/cam ACTIVE Lost"],
        "it knows of no Stop"
    );
    host.is_back(&second).await;
    let stopped = |graph: &SystemGraph| component(graph, "host/cam").state == STOPPED;
    until(&second, "it is seen", stopped).await;
    all_run().await;
    second.flush().await;
    assert_eq!(host.lcm.state("host/cam"), Some(STOPPED), "{:?}", host.lcm.done());
    assert!(store.wanted().components[&id("host/cam")].grant.is_none(), "it goes on by another grant alone");
    assert_eq!(host.lcm.state("host/arm"), Some(State::Active));
}

#[tokio::test]
async fn what_a_refused_request_had_taken_away_comes_back_when_its_process_is_started_again() {
    for gone in ["Create host/new", "Remove host/cam"] {
        let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
        let host = Process::come(&gcm, "host").await;
        let session = gcm.inner.sessions.lock().holder(&name("host")).unwrap();
        ask(&gcm, vec![create("host/arm"), create_cam("host/cam"), start("host/cam")]).await.unwrap();
        host.lcm.hold(gone);
        let requests = match gone {
            "Remove host/cam" => vec![stop("host/cam"), Request::Remove { id: id("host/cam"), force: true }],
            _ => vec![Request::Remove { id: id("host/cam"), force: true }, create("host/new")],
        };
        let asking = tokio::spawn({
            let gcm = gcm.clone();
            async move { ask(&gcm, requests).await }
        });
        host.lcm.hangs(gone).await;
        gcm.lost(&name("host"), session);
        host.lcm.lose_at(gone);
        host.lcm.release(gone);
        assert_eq!(asking.await.unwrap().unwrap_err().reason(), "PROCESS_LOST", "{gone}");
        let again = Process::come(&gcm, "host").await;
        until(&gcm, "it is whole", |graph| graph.processes[&name("host")].state == ProcessState::Attached)
            .await;
        assert_eq!(shown(&gcm.graph()), ["host/arm READY Ok", "host/cam ACTIVE Ok"], "{gone}");
        assert_eq!(again.lcm.state("host/cam"), Some(State::Active), "{gone}: {:?}", again.lcm.done());
    }
}

#[tokio::test]
async fn what_a_process_did_not_take_back_in_time_is_made_up_for_when_it_comes_again() {
    let undone = ["Remove host/new", "Create host/cam", "Disconnect host/arm/input from host/cam/value"];
    for undo in undone {
        let store = Kept::default();
        let (gcm, mut host) = running(&store).await;
        let other = Process::come(&gcm, "other").await;
        let before = (shown(&gcm.graph()), store.wanted());
        other.lcm.refuse("Create other/bad");
        host.lcm.hold(undo);
        let first = match undo {
            "Remove host/new" => create("host/new"),
            "Create host/cam" => Request::Remove { id: id("host/cam"), force: true },
            _ => connect("host/arm/input", "host/cam/value"),
        };
        let asking = tokio::spawn({
            let gcm = gcm.clone();
            async move { ask(&gcm, vec![first, create("other/bad")]).await }
        });
        host.lcm.hangs(undo).await;
        host.was_told(&gcm.graph());
        // The time that it gets goes by at once.
        tokio::time::pause();
        let refusal = asking.await.unwrap().unwrap_err();
        tokio::time::resume();
        assert_eq!(refusal.reason(), "COMPONENT_REFUSED", "{undo}: {refusal}");
        assert_eq!(gcm.graph().processes[&name("host")].state, ProcessState::Lost, "{undo}");
        host.lcm.release(undo);
        host.is_back(&gcm).await;
        until(&gcm, undo, |graph| shown(graph) == before.0 && graph.connections.is_empty()).await;
        all_run().await;
        gcm.flush().await;
        let wanted = store.wanted();
        assert_eq!(wanted.components, before.1.components, "{undo}: that was decided");
        assert!(wanted.connections.is_empty(), "{undo}");
    }
}

#[tokio::test]
async fn connections_of_different_processes_are_made_side_by_side_and_one_that_fails_takes_all_with_it() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    let (a, b) = (Process::come(&gcm, "a").await, Process::come(&gcm, "b").await);
    ask(&gcm, vec![create("a/x"), create("a/y"), create("b/x"), create("b/y")]).await.unwrap();
    let wires = ["Connect a/x/input to a/y/value", "Connect b/x/input to b/y/value"];
    for refuses in [false, true] {
        a.lcm.hold(wires[0]);
        b.lcm.hold(wires[1]);
        if refuses {
            b.lcm.refuse(wires[1]);
        }
        let asking = tokio::spawn({
            let gcm = gcm.clone();
            let both = vec![connect("a/x/input", "a/y/value"), connect("b/x/input", "b/y/value")];
            async move { ask(&gcm, both).await }
        });
        // Neither is answered yet, and both are asked for.
        a.lcm.hangs(wires[0]).await;
        b.lcm.hangs(wires[1]).await;
        b.lcm.release(wires[1]);
        all_run().await;
        assert!(!asking.is_finished(), "it waits for the other one");
        a.lcm.release(wires[0]);
        let done = asking.await.unwrap();
        assert_eq!(done.is_err(), refuses, "{done:?}");
        if refuses {
            assert_eq!(a.lcm.done().last().unwrap(), "Disconnect a/x/input from a/y/value");
            assert!(gcm.graph().connections.is_empty(), "all or nothing");
        } else {
            let numbers: Vec<u64> = gcm.graph().connections.keys().map(|id| id.0).collect();
            assert_eq!(numbers, [1, 2]);
            ask(
                &gcm,
                vec![
                    Request::Disconnect { which: trocar_model::Which::Id(ConnectionId(1)) },
                    Request::Disconnect { which: trocar_model::Which::Id(ConnectionId(2)) },
                ],
            )
            .await
            .unwrap();
        }
    }
}
