//! A process that was started again is interrupted, refused or held up while it gets back what it was to
//! have.
//!
//! Promise: it gets the rest, each thing once; a component that does not come back is named with the reason,
//! and keeps no other from coming back.

use trocar_lcm_api::{Inventory, Lcm};
use trocar_model::{
    Change, ClassInfo, ConnectionId, Health, Plan, PortId, ProcessState, Safety, State, StopReason,
};

use super::super::fake::{FakeLcm, class, comes, id, name, until};
use super::restarted::is;
use super::{
    Arc, Duration, Execution, Gcm, GcmConfig, Registered, Registration, Request, Slice, ask, component,
    create, host, register, start, within,
};

const RESTARTED: State = State::Stopped(StopReason::Restarted);

fn connect(client: &str, server: &str) -> Request {
    Request::Connect {
        client: PortId::parse(client).unwrap(),
        server: PortId::parse(server).unwrap(),
        options: Default::default(),
    }
}

/// A sensor that needs an input, and may have a robot.
fn eye() -> Arc<ClassInfo> {
    let mut eye = (*class()).clone();
    (eye.name, eye.safety) = ("eye".into(), Safety::Sensor);
    eye.ports.inputs[0].optional = false;
    Arc::new(eye)
}

async fn register_with_eye(gcm: &Gcm, who: Registration, lcm: &Arc<FakeLcm>) -> Registered {
    let inventory = Inventory { classes: vec![class(), eye()], ..lcm.inventory().await.unwrap() };
    gcm.register(who, lcm.clone(), inventory).await.unwrap()
}

const WIRES: [&str; 2] = ["Connect host/e/input to host/a/value", "Connect host/e/robot to host/a/arm"];

/// An actuator, and a sensor that looks at it and runs; then their process is gone.
async fn crashed() -> Gcm {
    crashed_where(GcmConfig::default()).await
}

/// A GCM that waits only `ms` for each change.
async fn impatient(ms: u64) -> Gcm {
    crashed_where(GcmConfig { each_change: Duration::from_millis(ms), ..GcmConfig::default() }).await
}

async fn crashed_where(config: GcmConfig) -> Gcm {
    let (gcm, lcm) = (Gcm::start(config).await.unwrap(), FakeLcm::new("host"));
    let session = register_with_eye(&gcm, host(), &lcm).await.session;
    let eye = Request::Create {
        id: id("host/e"),
        class: "eye".into(),
        config: None,
        execution: Execution::default(),
    };
    let wires = [connect("host/e/input", "host/a/value"), connect("host/e/robot", "host/a/arm")];
    ask(&gcm, [create("host/a"), eye].into_iter().chain(wires).chain([start("host/*")]).collect())
        .await
        .unwrap();
    gcm.lost(&name("host"), session);
    gcm
}

/// Returns the slice a process registers with: as far as its LCM did it.
fn slice(gcm: &Gcm, lcm: &FakeLcm) -> Slice {
    let (graph, done) = (gcm.graph(), lcm.done());
    let did = |what: String| done.contains(&what);
    let components = graph.components.iter().filter(|(id, _)| did(format!("Create {id}")));
    let connections =
        graph.connections.values().filter(|c| did(format!("Connect {} to {}", c.client, c.server)));
    Slice {
        components: components.map(|(id, c)| (id.clone(), c.clone())).collect(),
        connections: connections.cloned().collect(),
    }
}

fn all_is_back(gcm: &Gcm, lcm: &FakeLcm, when: &str) {
    let graph = gcm.graph();
    let (a, e) = (component(&graph, "host/a"), component(&graph, "host/e"));
    assert_eq!((a.state, a.health), (RESTARTED, Health::Ok), "{when}");
    assert_eq!((e.state, e.health), (State::Active, Health::Ok), "{when}");
    assert_eq!((a.fault.as_str(), e.fault.as_str()), ("", ""), "{when}");
    let mine = graph.connections.values().filter(|c| c.ends_in(&name("host")));
    let numbers: Vec<u64> = mine.map(|c| c.id.0).collect();
    assert_eq!(numbers, [1, 2], "{when}");
    let done = lcm.done();
    for change in ["Create host/a", "Create host/e", "Start host/e", WIRES[0], WIRES[1]] {
        assert_eq!(done.iter().filter(|d| *d == change).count(), 1, "{change}, {when}: {done:?}");
    }
}

#[tokio::test]
async fn a_process_that_says_hello_again_at_any_moment_of_it_gets_the_rest_and_nothing_twice() {
    let steps = ["Create host/a", "Configure host/a", "Create host/e", "Configure host/e", "Start host/e"];
    for at in steps.into_iter().chain(WIRES) {
        for lost_between in [true, false] {
            let (gcm, lcm, who) = (crashed().await, FakeLcm::new("host"), host());
            lcm.hold(at);
            let first = register_with_eye(&gcm, who.clone(), &lcm).await;
            lcm.hangs(at).await;
            if lost_between {
                gcm.lost(&name("host"), first.session);
                // Nothing is begun for a session that is over.
                tokio::task::yield_now().await;
            }
            let again = Registration { slice: slice(&gcm, &lcm), epoch: first.epoch, ..who };
            let second = register_with_eye(&gcm, again, &lcm).await;
            assert_eq!(second.epoch, first.epoch, "it is the same incarnation");
            lcm.release(at);
            until(&gcm, "all is made again", is(ProcessState::Attached)).await;
            all_is_back(&gcm, &lcm, at);
        }
    }
}

#[tokio::test]
async fn a_process_that_has_ended_its_session_before_that_is_noticed_gets_the_rest_in_the_next() {
    let steps = ["Create host/a", "Configure host/a", "Create host/e", "Configure host/e", "Start host/e"];
    for at in steps.into_iter().chain(WIRES) {
        let (gcm, lcm, who) = (crashed().await, FakeLcm::new("host"), host());
        lcm.hold(at);
        let first = register_with_eye(&gcm, who.clone(), &lcm).await;
        lcm.hangs(at).await;
        lcm.lose_at(at);
        lcm.release(at);
        // Whatever its refusal leads to has happened by now.
        for _ in 0..100 {
            tokio::task::yield_now().await;
        }
        gcm.lost(&name("host"), first.session);
        let again = Registration { slice: slice(&gcm, &lcm), epoch: first.epoch, ..who };
        register_with_eye(&gcm, again, &lcm).await;
        until(&gcm, "all is made again", is(ProcessState::Attached)).await;
        all_is_back(&gcm, &lcm, at);
    }
}

#[tokio::test]
async fn a_process_that_says_hello_again_and_again_gets_everything() {
    let (gcm, lcm, who) = (crashed().await, FakeLcm::new("host"), host());
    let mut before = None;
    for at in ["Create host/a", "Configure host/e", WIRES[0], WIRES[1], "Start host/e"] {
        lcm.hold(at);
        let again = Registration { slice: slice(&gcm, &lcm), ..who.clone() };
        register_with_eye(&gcm, again, &lcm).await;
        if let Some(before) = before.replace(at) {
            lcm.release(before);
        }
        comes(at, lcm.hangs(at)).await;
    }
    let again = Registration { slice: slice(&gcm, &lcm), ..who.clone() };
    register_with_eye(&gcm, again, &lcm).await;
    lcm.release("Start host/e");
    until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    all_is_back(&gcm, &lcm, "five times");
}

#[tokio::test]
async fn a_connection_that_is_refused_takes_no_other_with_it_and_is_named() {
    let (gcm, lcm) = (crashed().await, FakeLcm::new("host"));
    lcm.refuse(WIRES[1]);
    register_with_eye(&gcm, host(), &lcm).await;
    let graph = until(&gcm, "the rest is made again", is(ProcessState::Attached)).await;
    let e = component(&graph, "host/e");
    assert_eq!(e.state, State::Active, "it does not need what it lost");
    assert_eq!(graph.connections.keys().collect::<Vec<_>>(), [&ConnectionId(1)]);
    let named = ["connection 2", "host/a/arm", "the cable is out"];
    assert!(named.iter().all(|part| e.fault.contains(part)), "{}", e.fault);
}

#[tokio::test]
async fn what_lost_something_it_requires_is_not_started_and_says_why() {
    let (gcm, lcm) = (crashed().await, FakeLcm::new("host"));
    lcm.refuse(WIRES[0]);
    register_with_eye(&gcm, host(), &lcm).await;
    let graph = until(&gcm, "the rest is made again", is(ProcessState::Attached)).await;
    let e = component(&graph, "host/e");
    assert_eq!((e.state, e.health), (State::Ready, Health::Ok));
    let named = ["connection 1", "the cable is out", "nothing gives it input"];
    assert!(named.iter().all(|part| e.fault.contains(part)), "{}", e.fault);
    assert!(lcm.done().contains(&WIRES[1].to_owned()), "the other one is made: {:?}", lcm.done());
    ask(&gcm, vec![connect("host/e/input", "host/a/value")]).await.unwrap_err();
    assert_eq!(component(&gcm.graph(), "host/a").fault, "", "nothing is missing there");
}

#[tokio::test]
async fn what_is_told_beside_a_component_goes_with_its_next_change() {
    let (gcm, lcm) = (crashed().await, FakeLcm::new("host"));
    lcm.refuse("Start host/e");
    register_with_eye(&gcm, host(), &lcm).await;
    let graph = until(&gcm, "the rest is made again", is(ProcessState::Attached)).await;
    let e = component(&graph, "host/e");
    assert!(e.fault.contains("not started") && e.fault.contains("the cable is out"), "{}", e.fault);
    let plan = Plan {
        changes: vec![Change::Run {
            id: id("host/e"),
            verb: trocar_model::Verb::Reset,
            from: State::Ready,
            to: State::Ready,
        }],
        skipped: vec![],
    };
    ask(&gcm, vec![Request::Reset { targets: vec![trocar_model::Target::parse("host/e").unwrap()] }])
        .await
        .unwrap_or_else(|refusal| panic!("{plan:?}: {refusal}"));
    assert_eq!(component(&gcm.graph(), "host/e").fault, "");
}

#[tokio::test]
async fn what_was_to_look_at_something_that_cannot_be_made_says_so() {
    let (gcm, lcm) = (crashed().await, FakeLcm::new("host"));
    lcm.refuse("Create host/a");
    register_with_eye(&gcm, host(), &lcm).await;
    let graph = until(&gcm, "the rest is made again", is(ProcessState::Attached)).await;
    let (a, e) = (component(&graph, "host/a"), component(&graph, "host/e"));
    assert_eq!((a.state, e.state), (State::Fault, State::Ready));
    assert!(a.fault.contains("the cable is out"), "{}", a.fault);
    let named = ["connection 1", "connection 2", "host/a could not be made again", "nothing gives it input"];
    assert!(named.iter().all(|part| e.fault.contains(part)), "{}", e.fault);
    assert!(graph.connections.is_empty());
}

#[tokio::test]
async fn one_that_hangs_in_its_constructor_keeps_no_other_away() {
    let (gcm, lcm) = (impatient(500).await, FakeLcm::new("host"));
    lcm.hold("Create host/a");
    register_with_eye(&gcm, host(), &lcm).await;
    let graph = until(&gcm, "the rest is made again", is(ProcessState::Attached)).await;
    let (a, e) = (component(&graph, "host/a"), component(&graph, "host/e"));
    assert_eq!(a.state, State::Fault);
    assert!(a.fault.contains("Create host/a"), "{}", a.fault);
    assert_eq!((e.state, lcm.state("host/e")), (State::Ready, Some(State::Ready)));
}

#[tokio::test]
async fn a_process_that_waits_for_a_request_that_hangs_gets_everything_once_that_is_over() {
    let (gcm, other) = (impatient(500).await, FakeLcm::new("other"));
    register(&gcm, Registration { process: name("other"), ..host() }, other.clone()).await.unwrap();
    ask(&gcm, vec![create("other/x"), create("other/y")]).await.unwrap();
    let wire = "Connect other/x/robot to other/y/arm";
    other.hold(wire);
    let hanging = tokio::spawn({
        let gcm = gcm.clone();
        async move { gcm.execute(vec![connect("other/x/robot", "other/y/arm")], within(600_000)).await }
    });
    other.hangs(wire).await;
    let lcm = FakeLcm::new("host");
    register_with_eye(&gcm, host(), &lcm).await;
    // Longer than the process waits for its first turns.
    let late = gcm.execute(vec![connect("other/y/robot", "other/x/arm")], within(1300)).await.unwrap_err();
    assert_eq!(late.reason(), "BUSY", "{late}");
    let graph = gcm.graph();
    assert_eq!(graph.processes[&name("host")].state, ProcessState::Restarting, "it has nothing yet");
    assert_eq!(graph.components[&id("host/a")].health, Health::Lost);
    other.release(wire);
    hanging.await.unwrap().unwrap();
    until(&gcm, "all is made again", is(ProcessState::Attached)).await;
    all_is_back(&gcm, &lcm, "after its turn");
}
