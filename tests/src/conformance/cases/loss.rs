//! A server goes away in the middle of a call: the caller is told, by its deadline at the latest.

use std::thread;

use serde_json::json;
use trocar::model::{ConnectOptions, Request, Target};
use trocar_sdk::Outcome;

use super::super::world::id;
use super::super::{Answer, Call, Function, Lab, Way};
use super::commands::waiting;
use crate::eventually;

/// Does `end` while a call of the client waits in the server's queue, and says what the call came to.
fn waiting_when(way: &Way, end: impl FnOnce(&Lab) + Send) -> (Lab, Answer) {
    let lab = Lab::running(way);
    let call = Call::call(Function::Write, 9.0).from_threads(1).within_ms(3_000);
    let run = || {
        thread::scope(|scope| {
            let before = passed(&lab);
            let asked = scope.spawn(|| lab.perform(call));
            if way.deployment.queues_when_busy() {
                eventually("the call waits", || if passed(&lab) > before { Ok(()) } else { Err("not yet") });
            }
            end(&lab);
            asked.join().expect("the client performs")
        })
    };
    let answer = if way.deployment.client_leads() { run() } else { lab.occupied(run) };
    (lab, answer)
}

fn passed(lab: &Lab) -> u64 {
    lab.links().iter().map(|l| l.passed).sum()
}

/// A call that waits for a passive server's lock has no queue to be thrown out of.
fn expect(way: &Way, answer: &Answer, outcome: Outcome) {
    if way.deployment.queues_when_busy() {
        assert_eq!((answer.only(), answer.may_still_run), (outcome, 0), "{answer:?}");
    } else {
        assert_eq!(answer.total(), 1, "{answer:?}");
    }
}

pub fn a_call_whose_connection_is_cut_has_lost_its_peer(way: &Way) {
    let (lab, answer) = waiting_when(way, |lab| lab.disconnect("client/peer", "server/ctl"));
    expect(way, &answer, Outcome::PeerLost);
    assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::Unbound);
}

pub fn a_call_whose_server_is_removed_is_told_so_and_never_runs(way: &Way) {
    let (lab, answer) = waiting_when(way, |lab| lab.remove("server"));
    // It is stopped first, then cut off; the first of the two that finds the call answers it.
    let stopped = answer.count(Outcome::NotActive) == 1;
    expect(way, &answer, if stopped { Outcome::NotActive } else { Outcome::PeerLost });
    assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::Unbound);
    lab.open_gate();
    lab.create("server", "Server", lab.gated(json!({})), way.deployment.server());
    lab.connect("client/peer", "server/ctl");
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::Executed);
}

pub fn a_call_whose_server_is_stopped_finds_it_not_active(way: &Way) {
    let (lab, answer) = waiting_when(way, |lab| {
        // It waits for the command to come back; the call does not wait for it.
        thread::scope(|scope| {
            let stop = scope.spawn(|| lab.ask(Request::Stop { targets: vec![Target::One(id("server"))] }));
            eventually("the server is told to stop", || match lab.stands("server") {
                Some((state, _)) if state != trocar::model::State::Active => Ok(()),
                other if stop.is_finished() => Err(format!("stop came back, {other:?}")),
                other => {
                    // Stop is asked; let the busy command end so that it can be done.
                    lab.open_gate();
                    Err(format!("{other:?}"))
                }
            });
            // Its answer is the state that was just seen.
            let _ = stop.join();
        });
    });
    assert_eq!(answer.total(), 1, "{answer:?}");
    // Where both share a thread that waits for the call, the call's own deadline ends it.
    let fitting = [Outcome::NotActive, Outcome::PeerLost, Outcome::Executed, Outcome::Deadline];
    let known = &fitting[..if way.deployment.client_leads() { 4 } else { 3 }];
    assert!(known.contains(&answer.only()), "{answer:?}");
    assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::NotActive);
}

pub fn a_call_that_waits_in_a_server_that_goes_into_fault_is_answered(way: &Way) {
    let lab = Lab::running(way);
    if way.deployment.client_leads() {
        // One thread: the crash is over before the next call is made.
        assert_eq!(lab.perform(Call::call(Function::Crash, 0.0)).only(), Outcome::Failed);
        assert_eq!(lab.perform(Call::call(Function::Write, 1.0)).only(), Outcome::NotActive);
        return;
    }
    let answers = thread::scope(|scope| {
        let others = scope.spawn(|| lab.perform(Call::call(Function::Poke, 0.0).from_threads(4).times(50)));
        let crash = lab.invoke("server/ctl/crash", None, false);
        assert!(crash.is_err(), "a panic is no answer");
        others.join().expect("the client performs")
    });
    let known = answers.count(Outcome::Executed) + answers.count(Outcome::NotActive);
    assert_eq!(known, 200, "each call was executed or found the server not active: {answers:?}");
}

pub fn rewiring_while_calls_go_on_loses_none_and_answers_each(way: &Way) {
    let lab = Lab::running(way);
    lab.create("other", "Server", lab.gated(json!({})), super::own_thread());
    lab.start("other");
    let calls = Call::send(Function::Poke, 0.0).from_threads(2).times(2_000);
    let answer = thread::scope(|scope| {
        let asked = scope.spawn(|| lab.perform(calls));
        for round in 0..20 {
            let server = if round % 2 == 0 { "other/ctl" } else { "server/ctl" };
            let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
            lab.connect_with("client/peer", server, options);
        }
        asked.join().expect("the client performs")
    });
    assert_eq!(answer.total(), 4_000, "{answer:?}");
    let refused =
        answer.count(Outcome::QueueFull) + answer.count(Outcome::PeerLost) + answer.count(Outcome::Unbound);
    let arrived = answer.count(Outcome::Queued) + answer.count(Outcome::Executed);
    assert_eq!(arrived + refused, 4_000, "{answer:?}");
    // What was queued when its connection was cut is answered PEER_LOST, unexecuted; a send has nobody to tell.
    let pokes = || lab.count("server", "pokes") + lab.count("other", "pokes");
    assert!(pokes() <= arrived, "{} were executed, {arrived} sent", pokes());
    assert_eq!(lab.graph().connections.len(), 1);
}
