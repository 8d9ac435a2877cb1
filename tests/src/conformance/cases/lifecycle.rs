//! States: who may start, what a stop, a failure and a reset leave behind.

use serde_json::json;
use trocar::model::{Execution, ExecutionModel, Health, Request, State, StopReason, Target};
use trocar_sdk::Outcome;

use super::super::{Call, Function, Lab, Way};
use super::commands::waiting;
use crate::eventually;

const STOPPED: State = State::Stopped(StopReason::Requested);

/// A periodic actuator, wired to the server.
fn with_arm(way: &Way) -> Lab {
    let lab = Lab::running(way);
    lab.create("arm", "Arm", json!({}), Execution::default());
    lab.connect("arm/drive", "server/ctl");
    lab.connect("arm/set_point", "server/value_out");
    lab.start("arm");
    lab
}

pub fn start_is_refused_while_something_required_is_not_connected(way: &Way) {
    let lab = Lab::running(way);
    lab.create("arm", "Arm", json!({}), Execution::default());
    let start = || lab.ask(Request::Start { targets: vec![Target::One(lab.id("arm"))] });
    let refused = start().expect_err("an arm without its peer does not start");
    assert!(refused.to_string().contains("drive"), "the answer lists what is missing: {refused}");
    lab.connect("arm/drive", "server/ctl");
    let refused = start().expect_err("an arm without set points does not start");
    assert!(refused.to_string().contains("set_point"), "the answer lists what is missing: {refused}");
    lab.connect("arm/set_point", "server/value_out");
    lab.start("arm");
}

pub fn an_actuator_that_loses_its_peer_is_made_safe_and_stops(way: &Way) {
    let lab = with_arm(way);
    lab.await_count("arm", "steps", |n| n > 2);
    lab.disconnect("arm/drive", "server/ctl");
    lab.await_state("arm", State::Stopped(StopReason::PeerLost));
    lab.await_count("arm", "safed", |n| n >= 1);
    assert_eq!(lab.stands("client").map(|s| s.0), Some(State::Active), "nobody else changed");
    lab.connect("arm/drive", "server/ctl");
    lab.resume("arm");
    lab.await_state("arm", State::Active);
}

pub fn an_actuator_whose_peer_is_removed_is_made_safe_and_stops(way: &Way) {
    let lab = with_arm(way);
    lab.remove("server");
    lab.await_state("arm", State::Stopped(StopReason::PeerLost));
    lab.await_count("arm", "safed", |n| n >= 1);
}

pub fn an_actuator_whose_source_falls_silent_has_stale_input_and_goes_on(way: &Way) {
    let lab = Lab::running(way);
    let grid = Execution {
        model: Some(ExecutionModel::Periodic),
        period_ns: Some(5_000_000),
        ..Execution::default()
    };
    lab.create("source", "Server", json!({ "flow": true }), grid);
    lab.create("arm", "Arm", json!({}), Execution::default());
    lab.connect("arm/drive", "server/ctl");
    lab.connect("arm/set_point", "source/value_out");
    let graph = lab.graph();
    let wire =
        graph.connections.values().find(|c| c.client.port.as_str() == "set_point").expect("it is there");
    assert_eq!(wire.options.max_age_ns, Some(15_000_000), "three periods, from a grid to an actuator");
    lab.start("source");
    lab.start("arm");
    lab.await_count("source", "samples", |n| n > 0);
    lab.configure("source", json!({ "flow": false })).expect("flow is live");
    let stands = |health| move |now: Option<(State, Health)>| now == Some((State::Active, health));
    let until = |what: &str, is: &dyn Fn(Option<(State, Health)>) -> bool| {
        eventually(what, || match lab.stands("arm") {
            now if is(now) => Ok(()),
            now => Err(format!("{now:?}")),
        });
    };
    until("the arm has stale input", &stands(Health::StaleInput));
    lab.await_count("arm", "stale", |n| n > 0);
    assert_eq!(lab.count("arm", "safed"), 0, "its peer is there; what to do is the arm's to choose");
    lab.configure("source", json!({ "flow": true })).expect("flow is live");
    until("the arm is well again", &|now| now.is_some_and(|(_, health)| health != Health::StaleInput));
}

pub fn one_can_wait_for_a_state_and_is_told_when_it_cannot_come(way: &Way) {
    let lab = Lab::running(way);
    let wait = |state, ms| lab.wait_for("server", state, std::time::Duration::from_millis(ms));
    wait(State::Active, 60_000).expect("it is ACTIVE already");
    let late = wait(STOPPED, 5).expect_err("nobody stops it");
    assert_eq!(late.reason(), "NOT_REACHED", "{late}");
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| wait(STOPPED, 60_000));
        lab.stop("server");
        waiting.join().expect("it comes back").expect("it is STOPPED");
    });
    lab.start("server");
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| wait(STOPPED, 60_000));
        assert!(lab.invoke("server/ctl/crash", None, false).is_err(), "a panic is no answer");
        let fault = waiting.join().expect("it comes back").expect_err("it is in FAULT");
        assert_eq!(fault.reason(), "COMPONENT_FAULT", "{fault}");
    });
}

pub fn a_disconnect_changes_no_other_component_s_state(way: &Way) {
    let lab = Lab::running(way);
    lab.disconnect("client/peer", "server/ctl");
    for name in ["client", "server"] {
        assert_eq!(lab.stands(name), Some((State::Active, Health::Ok)), "{name}");
    }
    assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::Unbound);
}

pub fn stop_makes_safe_and_resume_keeps_what_start_makes_anew(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Write, 4.0)).only(), Outcome::Executed);
    lab.stop("server");
    assert_eq!(lab.stands("server").map(|s| s.0), Some(STOPPED));
    assert_eq!((lab.count("server", "safed"), lab.count("server", "starts")), (1, 1));
    lab.resume("server");
    assert_eq!(lab.perform(waiting(way, Function::Take, 0.0)).value, 4.0, "Resume keeps the run-time state");
    assert_eq!(lab.count("server", "starts"), 1);
    lab.stop("server");
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::Executed);
    assert_eq!(lab.count("server", "starts"), 2, "Start is a fresh start");
}

/// The server's step goes wrong, where it has one; what is known of it afterwards.
fn fault(way: &Way, on_step: &str) -> Option<String> {
    let lab = Lab::pair_with(way, json!({ "on_step": on_step }));
    lab.connect("client/peer", "server/ctl");
    lab.start("client");
    lab.start("server");
    // Something to step for, for the server and for a client it may run inside of.
    for member in ["server/ctl/poke", "client/run/clear"] {
        let sent = lab.invoke(member, None, true);
        // A server that steps unasked may have failed already.
        let late = member.starts_with("server") && way.deployment.server_steps_unasked();
        if !late || sent.as_ref().is_err_and(|refusal| refusal.reason() != "NOT_ACTIVE") {
            sent.expect("both take commands");
        }
    }
    if !way.deployment.server_steps() {
        lab.await_count("server", "pokes", |n| n == 1);
        assert_eq!((lab.count("server", "steps"), lab.count("server", "safed")), (0, 0));
        assert_eq!(
            lab.stands("server"),
            Some((State::Active, Health::Ok)),
            "without a step nothing goes wrong in it"
        );
        return None;
    }
    lab.await_state("server", State::Fault);
    // It is said to be in FAULT first, then made safe.
    lab.await_count("server", "safed", |n| n == 1);
    assert_eq!(lab.stands("client").map(|s| s.0), Some(State::Active), "nobody else changed");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::NotActive);
    Some(lab.graph().components[&lab.id("server")].fault.clone())
}

pub fn a_step_that_fails_is_a_fault_with_its_sentence(way: &Way) {
    let expected = way.deployment.server_steps().then(|| "step: failed on request".to_owned());
    assert_eq!(fault(way, "fail"), expected);
}

pub fn a_step_that_panics_is_a_fault_with_its_sentence(way: &Way) {
    let text = fault(way, "panic");
    assert_eq!(text.is_some(), way.deployment.server_steps());
    assert!(text.is_none_or(|t| t.starts_with("step: ") && t.contains("step panics on request")));
}

pub fn a_command_that_does_not_come_back_is_unresponsive_and_the_host_goes_on(way: &Way) {
    let lab = Lab::running(way);
    lab.occupied(|| {
        eventually("the server is UNRESPONSIVE", || match lab.stands("server") {
            Some((_, Health::Unresponsive)) => Ok(()),
            other => Err(format!("{other:?}")),
        });
        lab.create("late", "Server", json!({}), super::own_thread());
        lab.start("late");
        lab.invoke("late/ctl/poke", None, false).expect("others are served");
    });
    eventually("the server is well again", || match lab.stands("server") {
        Some((State::Active, Health::Ok)) => Ok(()),
        other => Err(format!("{other:?}")),
    });
}

pub fn everything_is_counted_from_a_reset_anew(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Write, 4.0)).only(), Outcome::Executed);
    lab.reset("server");
    assert_eq!(lab.stands("server").map(|s| s.0), Some(State::Ready));
    assert_eq!((lab.count("server", "writes"), lab.count("server", "starts")), (0, 0));
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Take, 0.0)).value, 0.0, "its connections survived");
}
