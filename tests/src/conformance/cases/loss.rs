//! A server goes away in the middle of a call: the caller is told at once, and what never ran is counted.

use std::thread;

use serde_json::json;
use trocar::model::{ConnectOptions, State, StopReason};
use trocar_sdk::Outcome;

use super::super::waiting::{self, While};
use super::super::{Call, Function, Lab, Way};
use super::commands::waiting;
use crate::eventually;

/// A write that waits in the server's queue, or for whoever is inside a server without a thread, when `what`
/// happens.
fn waiting_when(way: &Way, what: While) -> Lab {
    let lab = Lab::running(way);
    let answer = waiting::ended(way, &lab, Call::call(Function::Write, 9.0).within_ms(20_000), what);
    let expected = match what {
        While::Cut | While::Removed => Outcome::PeerLost,
        While::Stopped | While::Failed => Outcome::NotActive,
    };
    assert_eq!((answer.only(), answer.may_still_run), (expected, 0), "{answer:?}");
    lab
}

pub fn a_call_whose_connection_is_cut_has_lost_its_peer(way: &Way) {
    let lab = waiting_when(way, While::Cut);
    assert_eq!(lab.count("server", "writes"), 0, "it never ran");
    if lab.graph().connections.is_empty() {
        assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::Unbound);
    }
}

pub fn a_call_whose_server_is_removed_is_told_so_and_never_runs(way: &Way) {
    let lab = waiting_when(way, While::Removed);
    assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::Unbound);
    lab.create("server", "Server", lab.gated(json!({})), way.deployment.server());
    lab.connect("client/peer", "server/ctl");
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::Executed);
}

pub fn a_call_whose_server_is_stopped_finds_it_not_active(way: &Way) {
    let lab = waiting_when(way, While::Stopped);
    assert_eq!(lab.count("server", "writes"), 0, "it never ran");
    assert_eq!(lab.perform(Call::send(Function::Poke, 0.0)).only(), Outcome::NotActive);
}

pub fn a_call_that_waits_in_a_server_that_goes_into_fault_is_answered(way: &Way) {
    let lab = waiting_when(way, While::Failed);
    assert_eq!(lab.count("server", "writes"), 0, "it never ran");
    assert_eq!(lab.stands("client").map(|(state, _)| state), Some(State::Active), "nobody else changed");
}

pub fn a_client_that_is_removed_while_its_call_waits_is_answered_and_the_call_never_runs(way: &Way) {
    let lab = Lab::running(way);
    let answer = waiting::leaving(way, &lab, Call::call(Function::Write, 9.0).within_ms(300));
    // A component that goes waits for its own call, which has its deadline; a server that rides on its thread
    // is stopped first.
    let rides = way.deployment.client_leads();
    let expected = if rides { Outcome::NotActive } else { Outcome::Deadline };
    assert_eq!(answer.only(), expected, "{answer:?}");
    assert!(answer.may_still_run <= way.may_have_begun(), "{answer:?}");
    if rides {
        assert_eq!(lab.stands("server").map(|s| s.0), Some(State::Stopped(StopReason::Requested)));
    } else {
        lab.invoke("server/ctl/poke", None, false).expect("the server goes on");
    }
    assert_eq!(lab.count("server", "writes"), 0, "it never ran");
}

pub fn rewiring_while_calls_go_on_loses_none_and_answers_each(way: &Way) {
    let lab = Lab::running(way);
    lab.create("other", "Server", lab.gated(json!({})), super::own_thread());
    lab.start("other");
    // Deep enough that nothing is refused for want of room.
    let deep = || ConnectOptions { mailbox: Some(4_096), replace: true, ..ConnectOptions::default() };
    lab.connect_with("client/peer", "server/ctl", deep());
    let calls = Call::send(Function::Poke, 0.0).from_threads(2).times(2_000);
    let answer = thread::scope(|scope| {
        let asked = scope.spawn(|| lab.perform(calls));
        for round in 0..20 {
            let server = if round % 2 == 0 { "other/ctl" } else { "server/ctl" };
            lab.connect_with("client/peer", server, deep());
        }
        asked.join().expect("the client performs")
    });
    let of = |outcome| answer.count(outcome);
    let refused = of(Outcome::PeerLost) + of(Outcome::Unbound);
    let arrived = of(Outcome::Queued) + of(Outcome::Executed);
    assert_eq!((answer.total(), arrived + refused), (4_000, 4_000), "{answer:?}");
    // What was queued when its connection was cut never runs: a send has nobody to tell, so it is counted.
    eventually("each that arrived was executed or counted as lost", || {
        let pokes = lab.count("server", "pokes") + lab.count("other", "pokes");
        let lost = lab.lost_commands("server") + lab.lost_commands("other");
        if pokes + lost == arrived {
            Ok(())
        } else {
            Err(format!("{arrived} arrived: {pokes} executed, {lost} lost"))
        }
    });
    assert_eq!(lab.graph().connections.len(), 1);
}
