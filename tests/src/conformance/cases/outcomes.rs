//! Every reason why a command is not executed.

use std::time::Instant;

use trocar::model::ConnectOptions;
use trocar_sdk::Outcome;

use super::super::{Answer, Call, Function, Lab, Reach, Way};
use super::commands::waiting;
use crate::eventually;

const ALL: [Function; 9] = [
    Function::Poke,
    Function::Write,
    Function::WriteLatest,
    Function::WriteNewest,
    Function::Take,
    Function::Twice,
    Function::Value,
    Function::Scaled,
    Function::Refuse,
];

/// Makes calls that the server cannot take now: it is busy, or its thread waits for the very thread that
/// calls.
fn crowd(way: &Way, lab: &Lab, call: Call) -> Answer {
    if way.deployment.client_leads() {
        return lab.perform(call.from_threads(1));
    }
    lab.occupied(|| lab.perform(call))
}

/// Both, with room for four commands, running.
fn narrow(way: &Way) -> Lab {
    let lab = Lab::pair(way);
    lab.connect_with(
        "client/peer",
        "server/ctl",
        ConnectOptions { mailbox: Some(4), ..ConnectOptions::default() },
    );
    lab.start("server");
    lab.start("client");
    lab
}

pub fn nothing_connected_is_unbound(way: &Way) {
    let lab = Lab::pair(way);
    lab.start("client");
    for what in ALL {
        assert_eq!(lab.perform(Call::send(what, 1.0)).only(), Outcome::Unbound, "sending {what:?}");
        assert_eq!(lab.perform(Call::call(what, 1.0)).only(), Outcome::Unbound, "calling {what:?}");
        assert_eq!(lab.perform_in_step(Call::call(what, 1.0)).only(), Outcome::Unbound, "calling {what:?}");
    }
}

pub fn a_server_that_is_not_active_says_so_and_can_still_be_read(way: &Way) {
    let lab = Lab::pair(way);
    lab.connect("client/peer", "server/ctl");
    lab.start("client");
    for what in ALL {
        let expected = if what.reads() { Outcome::Executed } else { Outcome::NotActive };
        // A read that is only sent has no place for what it answers.
        let sent = if what.reads() { Outcome::InvalidArgument } else { Outcome::NotActive };
        assert_eq!(lab.perform(Call::send(what, 1.0)).only(), sent, "sending {what:?}");
        assert_eq!(lab.perform(waiting(way, what, 1.0)).only(), expected, "calling {what:?}");
    }
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 1.0)).only(), Outcome::Executed);
    lab.stop("server");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 1.0)).only(), Outcome::NotActive);
    assert_eq!(lab.perform(waiting(way, Function::Value, 1.0)).only(), Outcome::Executed);
}

pub fn an_argument_outside_its_limits_never_reaches_the_server(way: &Way) {
    let lab = Lab::running(way);
    for arg in [-0.5, 100.5, f64::MAX] {
        assert_eq!(lab.perform(Call::send(Function::Write, arg)).only(), Outcome::InvalidArgument, "{arg}");
        assert_eq!(lab.perform(waiting(way, Function::Write, arg)).only(), Outcome::InvalidArgument, "{arg}");
    }
    assert_eq!(lab.perform(waiting(way, Function::Write, 100.0)).only(), Outcome::Executed);
    assert_eq!(lab.count("server", "writes"), 1);
}

pub fn a_command_that_refuses_has_failed_with_its_own_sentence(way: &Way) {
    let lab = Lab::running(way);
    let answer = lab.perform(waiting(way, Function::Refuse, 3.0));
    assert_eq!((answer.only(), answer.text.as_str()), (Outcome::Failed, "refused 3"));
    // Sent, the failure is known only where it ran at once.
    let sent = lab.perform(Call::send(Function::Refuse, 3.0)).only();
    let expected = if way.deployment.inline() { Outcome::Failed } else { Outcome::Queued };
    assert_eq!(sent, expected);
    // It is an answer, not a fault.
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::Executed);
    lab.configure("server", serde_json::json!({ "mood": "refuse" })).expect("mood is live");
    for what in [Function::Value, Function::Scaled] {
        let read = lab.perform(waiting(way, what, 3.0));
        assert_eq!((read.only(), read.text.as_str()), (Outcome::Failed, "refused on request"), "{what:?}");
    }
    let read = lab.perform_in_step(Call::call(Function::Value, 0.0));
    assert_eq!((read.only(), read.text.as_str()), (Outcome::Failed, "refused on request"), "in a step");
}

pub fn a_full_queue_refuses_and_keeps_what_it_has(way: &Way) {
    let lab = narrow(way);
    let answer = crowd(way, &lab, Call::send(Function::Write, 1.0).times(20));
    let (queued, full) = (answer.count(Outcome::Queued), answer.count(Outcome::QueueFull));
    if way.reach() == Reach::Machine {
        // The queue of the other machine takes as many again, as soon as they are there.
        assert!((4..=8).contains(&queued) && queued + full == 20, "{answer:?}");
    } else {
        assert_eq!((queued, full), (4, 16), "{answer:?}");
    }
    lab.await_count("server", "writes", |n| n == queued);
    assert_eq!(
        lab.row("server")["seen"].as_array().expect("a list")[..4],
        serde_json::json!([1.0, 2.0, 3.0, 4.0]).as_array().expect("a list")[..]
    );
    let dropped: u64 = lab.links().iter().map(|l| l.dropped).sum();
    // Each write tells the client, whose queue of events is as short: those of the writes beyond may find it
    // full.
    let unheard = queued - 4;
    assert!(
        (full..=full + unheard).contains(&dropped),
        "every refusal is counted on the connection: {dropped}"
    );
}

pub fn a_full_queue_gives_up_its_oldest_where_the_command_says_so(way: &Way) {
    let lab = narrow(way);
    let answer = crowd(way, &lab, Call::send(Function::WriteNewest, 1.0).times(20));
    assert_eq!(answer.count(Outcome::Queued), 20, "{answer:?}");
    lab.await_count("server", "writes", |n| n == 4);
    assert_eq!(lab.row("server")["seen"], serde_json::json!([17.0, 18.0, 19.0, 20.0]));
    let dropped: u64 = lab.links().iter().map(|l| l.dropped).sum();
    assert_eq!(dropped, 16, "every drop is counted on the connection");
}

pub fn the_latest_wins_where_the_command_says_so(way: &Way) {
    let lab = narrow(way);
    let answer = crowd(way, &lab, Call::send(Function::WriteLatest, 1.0).times(20));
    assert_eq!(answer.count(Outcome::Queued), 20, "{answer:?}");
    lab.await_count("server", "writes", |n| n > 0);
    assert_eq!(lab.row("server")["seen"], serde_json::json!([20.0]));
    let (dropped, skipped) = lab.links().iter().fold((0, 0), |(d, s), l| (d + l.dropped, s + l.skipped));
    assert_eq!((dropped, skipped), (0, 19), "a goal that a newer one superseded is no loss");
}

pub fn a_call_that_was_not_begun_by_its_deadline_never_runs(way: &Way) {
    let lab = Lab::running(way);
    let call = Call::call(Function::Write, 9.0).from_threads(1).within_ms(20);
    let answer =
        if way.deployment.client_leads() { lab.perform(call) } else { lab.occupied(|| lab.perform(call)) };
    assert_eq!(answer.only(), Outcome::Deadline, "{answer:?}");
    assert!(answer.may_still_run <= way.may_have_begun(), "{answer:?}");
    // Whatever is taken after it would have come behind it.
    assert_eq!(lab.perform(waiting(way, Function::Write, 1.0)).only(), Outcome::Executed);
    assert_eq!(lab.row("server")["seen"], serde_json::json!([1.0]));
}

pub fn a_goal_that_was_sent_and_waited_longer_than_its_connection_allows_never_runs(way: &Way) {
    let lab = Lab::pair(way);
    let deadline_ns = 20_000_000;
    let options = ConnectOptions { deadline_ns: Some(deadline_ns), ..ConnectOptions::default() };
    lab.connect_with("client/peer", "server/ctl", options);
    lab.start("server");
    lab.start("client");
    if way.deployment.inline() {
        // Nothing waits there.
        assert_eq!(lab.perform(Call::send(Function::Write, 9.0)).only(), Outcome::Executed);
        return;
    }
    lab.occupied(|| {
        let sent = [Call::send(Function::Write, 9.0), Call::send(Function::Poke, 0.0)];
        for call in sent {
            assert_eq!(lab.perform(call).only(), Outcome::Queued);
        }
        lasts(2 * deadline_ns);
    });
    // A command without numbers, such as one that stops a device, is right however long it waited.
    lab.await_count("server", "pokes", |n| n == 1);
    assert_eq!(lab.perform(waiting(way, Function::Write, 1.0)).only(), Outcome::Executed);
    assert_eq!(lab.row("server")["seen"], serde_json::json!([1.0]), "the old goal was carried out");
    await_unexecuted(&lab, 1);
}

pub fn a_command_that_was_sent_with_a_deadline_of_its_own_never_runs_after_it(way: &Way) {
    let lab = Lab::running(way);
    if way.deployment.inline() {
        // Nothing waits there.
        assert_eq!(lab.perform(Call::send(Function::Write, 9.0).within_ms(20)).only(), Outcome::Executed);
        return;
    }
    lab.occupied(|| {
        let sent = [
            Call::send(Function::Write, 9.0).within_ms(20),
            Call::send(Function::Poke, 0.0).within_ms(20),
            Call::send(Function::Poke, 0.0).within_ms(600_000),
        ];
        for call in sent {
            assert_eq!(lab.perform(call).only(), Outcome::Queued);
        }
        lasts(40_000_000);
    });
    lab.await_count("server", "pokes", |n| n > 0);
    assert_eq!(lab.perform(waiting(way, Function::Write, 1.0)).only(), Outcome::Executed);
    let row = lab.row("server");
    assert_eq!((&row["seen"], &row["pokes"]), (&serde_json::json!([1.0]), &serde_json::json!(1)), "{row}");
    await_unexecuted(&lab, 2);
}

/// Comes back when so many ns have passed.
fn lasts(ns: u64) {
    let since = Instant::now();
    eventually("time passes", || {
        let waited = since.elapsed();
        if waited.as_nanos() > u128::from(ns) { Ok(()) } else { Err(format!("{waited:?}")) }
    });
}

/// The connections count so many commands that were taken and never ran.
fn await_unexecuted(lab: &Lab, n: u64) {
    eventually("the connection counts it", || {
        let never_ran: u64 = lab.links().iter().map(|l| l.unexecuted).sum();
        if never_ran == n { Ok(()) } else { Err(never_ran) }
    });
}

/// What comes of a call that names no deadline of its own while the server cannot take it.
fn endless(way: &Way, lab: &Lab) -> Answer {
    crowd(way, lab, Call::call(Function::Write, 9.0).from_threads(1))
}

pub fn a_call_without_a_deadline_has_that_of_its_connection(way: &Way) {
    let lab = Lab::pair(way);
    let options = ConnectOptions { deadline_ns: Some(20_000_000), ..ConnectOptions::default() };
    lab.connect_with("client/peer", "server/ctl", options);
    lab.start("server");
    lab.start("client");
    let answer = endless(way, &lab);
    assert_eq!(answer.only(), Outcome::Deadline, "{answer:?}");
    assert!(answer.may_still_run <= way.may_have_begun(), "{answer:?}");
    // Within a deadline of its own, as a busy machine needs it.
    let next = waiting(way, Function::Write, 1.0).within_ms(30_000);
    assert_eq!(lab.perform(next).only(), Outcome::Executed);
    assert_eq!(lab.row("server")["seen"], serde_json::json!([1.0]));
}

pub fn a_call_without_any_deadline_ends_all_the_same(way: &Way) {
    let lab = Lab::running(way);
    let answer = endless(way, &lab);
    assert_eq!(answer.only(), Outcome::Deadline, "{answer:?}");
    assert!(answer.may_still_run <= way.may_have_begun(), "{answer:?}");
}

pub fn a_call_that_was_begun_by_its_deadline_may_still_run(way: &Way) {
    let lab = Lab::running(way);
    lab.close_gate();
    let call = waiting(way, Function::Hold, 0.0).within_ms(300);
    std::thread::scope(|scope| {
        let asked = scope.spawn(|| lab.perform(call));
        lab.await_waiting();
        if way.deployment.inline() {
            // The caller's own thread runs it: it comes back when the command does.
            lab.open_gate();
        }
        let answer = asked.join().expect("the client performs");
        if way.deployment.inline() {
            assert_eq!(answer.only(), Outcome::Executed, "{answer:?}");
        } else {
            assert_eq!((answer.only(), answer.may_still_run), (Outcome::Deadline, 1), "{answer:?}");
        }
    });
}

pub fn a_command_that_panics_has_failed_and_puts_only_its_server_in_fault(way: &Way) {
    let lab = Lab::running(way);
    let answer = lab.perform(waiting(way, Function::Crash, 0.0));
    assert_eq!(answer.only(), Outcome::Failed, "{answer:?}");
    assert!(answer.text.contains("crash on request"), "the caller gets the reason: {:?}", answer.text);
    lab.await_state("server", trocar::model::State::Fault);
    lab.await_count("server", "safed", |n| n == 1);
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::NotActive);
    assert_eq!(lab.stands("client").map(|(state, _)| state), Some(trocar::model::State::Active));
    lab.reset("server");
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Poke, 0.0)).only(), Outcome::Executed);
    assert_eq!(lab.count("server", "pokes"), 1, "a Reset made a new instance");
}
