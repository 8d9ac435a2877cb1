//! Every kind of command, sent and called, when all goes well.

use trocar_sdk::Outcome;

use super::super::{Call, Function, Lab, Reach, Way};
use crate::eventually;

/// What is executed or queued without an answer, and how often each is in the server's counts.
const SENT: [Function; 6] = [
    Function::Poke,
    Function::Write,
    Function::WriteLatest,
    Function::WriteNewest,
    Function::Take,
    Function::Twice,
];

/// The outcome of a `send` from the client's own thread.
fn on_its_way(way: &Way) -> Outcome {
    if way.deployment.inline() { Outcome::Executed } else { Outcome::Queued }
}

/// A `call` that may wait: inline from the client's own thread, else from a thread that may block.
pub(super) fn waiting(way: &Way, what: Function, arg: f64) -> Call {
    let call = Call::call(what, arg);
    if way.deployment.inline() { call } else { call.from_threads(1) }
}

pub fn every_kind_that_is_sent_arrives_once(way: &Way) {
    let lab = Lab::running(way);
    for what in SENT {
        assert_eq!(lab.perform(Call::send(what, 7.0)).only(), on_its_way(way), "sending {what:?}");
    }
    lab.await_count("server", "writes", |n| n == 3);
    lab.await_count("server", "pokes", |n| n == 1);
    assert_eq!(lab.row("server")["seen"], serde_json::json!([7.0, 7.0, 7.0]));
}

pub fn every_kind_that_is_sent_from_a_step_arrives_once(way: &Way) {
    let lab = Lab::running(way);
    for what in SENT {
        assert_eq!(lab.perform_in_step(Call::send(what, 7.0)).only(), on_its_way(way), "sending {what:?}");
    }
    lab.await_count("server", "writes", |n| n == 3);
    lab.await_count("server", "pokes", |n| n == 1);
}

pub fn every_kind_that_is_called_gives_its_result(way: &Way) {
    let lab = Lab::running(way);
    let expected = [
        (Function::Poke, 0.0),
        (Function::Write, 0.0),
        (Function::WriteLatest, 0.0),
        (Function::WriteNewest, 0.0),
        (Function::Take, 3.0),
        (Function::Twice, 6.0),
        (Function::Value, 3.0),
        (Function::Scaled, 9.0),
    ];
    for (what, value) in expected {
        let answer = lab.perform(waiting(way, what, 3.0));
        assert_eq!(answer.only(), Outcome::Executed, "calling {what:?}: {}", answer.text);
        assert_eq!(answer.value, value, "calling {what:?}");
    }
    assert_eq!((lab.count("server", "pokes"), lab.count("server", "writes")), (1, 3));
}

pub fn a_call_from_a_step_runs_inline_or_would_block(way: &Way) {
    let lab = Lab::running(way);
    for (what, value) in
        [(Function::Poke, 0.0), (Function::Write, 0.0), (Function::Take, 4.0), (Function::Twice, 8.0)]
    {
        let answer = lab.perform_in_step(Call::call(what, 4.0));
        if way.deployment.inline() {
            assert_eq!((answer.only(), answer.value), (Outcome::Executed, value), "calling {what:?}");
        } else {
            assert_eq!(answer.only(), Outcome::WouldBlock, "calling {what:?}");
        }
    }
    // Reads wait for nobody, so a step may call them.
    assert_eq!(lab.perform_in_step(Call::call(Function::Value, 0.0)).only(), Outcome::Executed);
    let asked = way.reach().asks();
    let qualified = if asked { Outcome::WouldBlock } else { Outcome::Executed };
    assert_eq!(lab.perform_in_step(Call::call(Function::Scaled, 1.0)).only(), qualified);
    let executed = u64::from(way.deployment.inline());
    assert_eq!((lab.count("server", "pokes"), lab.count("server", "writes")), (executed, executed));
}

pub fn commands_of_one_client_keep_their_order(way: &Way) {
    let lab = Lab::running(way);
    let answer = lab.perform(Call::send(Function::Write, 1.0).times(40));
    assert_eq!(answer.count(on_its_way(way)), 40, "{answer:?}");
    lab.await_count("server", "writes", |n| n == 40);
    let seen: Vec<f64> = (1..=40).map(f64::from).collect();
    assert_eq!(lab.row("server")["seen"], serde_json::json!(seen));
}

pub fn several_threads_of_a_client_use_one_function_at_once(way: &Way) {
    let lab = Lab::running(way);
    let sent = lab.perform(Call::send(Function::Poke, 0.0).from_threads(4).times(100));
    assert_eq!(sent.total(), 400, "{sent:?}");
    let arrived = sent.count(Outcome::Queued) + sent.count(Outcome::Executed);
    assert_eq!(arrived + sent.count(Outcome::QueueFull), 400, "{sent:?}");
    lab.await_count("server", "pokes", |n| n == arrived);
    if way.reach() == Reach::Thread {
        // The thread that would run them waits for those that call.
        let called = lab.perform(Call::call(Function::Poke, 0.0).from_threads(4).times(2).within_ms(10));
        assert_eq!(
            (called.only(), called.total(), called.may_still_run),
            (Outcome::Deadline, 8, 0),
            "{called:?}"
        );
        assert_eq!(lab.perform(Call::call(Function::Poke, 0.0)).only(), Outcome::Executed);
        assert_eq!(lab.count("server", "pokes"), arrived + 1, "none of them ran");
    } else {
        let called = lab.perform(Call::call(Function::Poke, 0.0).from_threads(4).times(50));
        assert_eq!(called.count(Outcome::Executed), 200, "{called:?}");
        lab.await_count("server", "pokes", |n| n == arrived + 200);
    }
}

pub fn a_read_is_answered_from_the_published_row_with_its_stamp(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Write, 5.0)).only(), Outcome::Executed);
    // The step that the command brought about may come after its answer. Reads that entered the component
    // would bring about one each time.
    eventually("two reads of one row with no step in between", || {
        let steps = lab.count("server", "steps");
        let first = lab.invoke("server/ctl/value", None, false).expect("a read is answered");
        let scaled =
            lab.invoke("server/ctl/scaled", Some(serde_json::json!(3.0)), false).expect("a read is answered");
        assert_eq!((first.value, scaled.value), (Some(5.0.into()), Some(15.0.into())));
        assert!(first.stamp_ns > 0, "a read tells the stamp of its row");
        let seen = [(steps, first.stamp_ns), (lab.count("server", "steps"), scaled.stamp_ns)];
        if seen[0] == seen[1] { Ok(()) } else { Err(format!("steps and stamps {seen:?}")) }
    });
}

pub fn a_read_waits_for_nobody(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Write, 5.0)).only(), Outcome::Executed);
    let read = |from: u32| {
        let answer = lab.perform(Call::call(Function::Scaled, 2.0).from_threads(from));
        assert_eq!((answer.only(), answer.value), (Outcome::Executed, 10.0));
    };
    if way.deployment.client_leads() {
        // The shared thread waits for the client's own, so the server cannot be entered meanwhile.
        read(1);
    } else {
        // What has to be asked for in another process is asked for from a thread that may wait.
        lab.occupied(|| read(u32::from(way.reach().asks())));
    }
}
