//! Events: ordered, broadcast, bounded, and never into an instance that is busy.

use std::time::Duration;

use serde_json::json;
use trocar::lcm::Selection;
use trocar::model::{ConnectOptions, Execution, ExecutionModel};
use trocar_sdk::Outcome;

use super::super::world::block_on;
use super::super::{Call, Function, Lab, Reach, Way};
use super::commands::waiting;
use crate::eventually;

pub fn an_event_back_into_a_stepping_client_waits_for_the_end_of_the_step(way: &Way) {
    let lab = Lab::running(way);
    lab.perform_in_step(Call::send(Function::Write, 8.0));
    lab.await_count("client", "heard", |n| n == 1);
    // 1 the step begins, 2 it ends, 3 the handler runs.
    assert_eq!(lab.row("client")["log"], json!([1, 2, 3]));
    assert_eq!(lab.row("client")["last_heard"], json!(8.0));
}

pub fn events_arrive_each_once_and_in_order(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Burst, 50.0)).only(), Outcome::Executed);
    lab.await_count("client", "ticks", |n| n == 50);
    assert_eq!(lab.count("client", "disorder"), 0);
    assert_eq!(lab.count("server", "unheard"), 0);
}

pub fn every_observer_hears_every_event(way: &Way) {
    let lab = Lab::running(way);
    let others = ["second", "third", "fourth"];
    for name in others {
        let execution = Execution { model: Some(ExecutionModel::OnSignal), ..Execution::default() };
        lab.create(name, "Client", json!({}), execution);
        lab.connect(&format!("{name}/peer"), "server/ctl");
        lab.start(name);
    }
    assert_eq!(lab.perform(waiting(way, Function::Burst, 30.0)).only(), Outcome::Executed);
    for name in others.iter().chain(&["client"]) {
        lab.await_count(name, "ticks", |n| n == 30);
        assert_eq!(lab.count(name, "disorder"), 0, "{name}");
    }
}

pub fn events_that_find_a_full_queue_are_counted_and_told_to_who_emits(way: &Way) {
    let lab = Lab::pair(way);
    let options = ConnectOptions { mailbox: Some(4), ..ConnectOptions::default() };
    lab.connect_with("client/peer", "server/ctl", options);
    lab.start("server");
    lab.start("client");
    // The client waits for the burst inside its own command, so it takes nothing meanwhile.
    assert_eq!(lab.perform(waiting(way, Function::Burst, 50.0)).only(), Outcome::Executed);
    lab.await_count("client", "ticks", |n| n == 4);
    assert_eq!(lab.count("client", "disorder"), 0, "what arrives is the beginning, in order");
    let unheard = lab.count("server", "unheard");
    if way.reach() == Reach::Machine {
        // The queue on this machine is emptied meanwhile; the one on the other is not.
        assert!(unheard <= 46, "{unheard}");
    } else {
        assert_eq!(unheard, 46, "emitting tells QUEUE_FULL");
    }
    let dropped: u64 = lab.links().iter().map(|l| l.dropped).sum();
    assert_eq!(dropped, 46, "every loss is counted on the connection");
}

pub fn from_outside_one_can_wait_for_an_event(way: &Way) {
    let lab = Lab::running(way);
    let (event, long) = ("server/ctl/written", Duration::from_secs(60));
    let seen = lab.invoke_and_wait("server/ctl/write", json!(6.0), event).expect("it leads to the event");
    assert_eq!((seen.value, seen.skipped), (json!(6.0), 0));
    // The calls of another component are heard as well.
    let seen = std::thread::scope(|scope| {
        let waiting = scope.spawn(|| lab.wait_for_event(event, long));
        eventually("whoever waits is answered", || {
            assert_eq!(lab.perform(waiting_write(way)).only(), Outcome::Executed);
            if waiting.is_finished() { Ok(()) } else { Err("still waiting") }
        });
        waiting.join().expect("it comes back")
    });
    assert_eq!(seen.expect("it was sent").value, json!(7.0));
}

/// A write that is heard.
fn waiting_write(way: &Way) -> Call {
    waiting(way, Function::Write, 7.0)
}

pub fn whoever_waits_for_an_event_is_told_when_it_does_not_come(way: &Way) {
    let lab = Lab::running(way);
    let (event, long) = ("server/ctl/written", Duration::from_secs(60));
    let late = lab.wait_for_event(event, Duration::from_millis(5)).expect_err("nobody writes");
    assert_eq!(late.reason(), "EVENT_NOT_SEEN", "{late}");
    let refused = lab.invoke_and_wait("server/ctl/write", json!(100.5), event).expect_err("it is refused");
    assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{refused}");
    let unknown = lab.wait_for_event("server/ctl/writen", long).expect_err("there is none");
    assert_eq!(unknown.reason(), "MEMBER_NOT_FOUND", "{unknown}");
    assert!(unknown.to_string().contains("written"), "it names what exists: {unknown}");
    let ended = |doing: &dyn Fn()| {
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| lab.wait_for_event(event, long));
            doing();
            waiting.join().expect("it comes back").expect_err("nobody is there to send it")
        })
    };
    let fault = ended(&|| _ = lab.invoke("server/ctl/crash", None, false));
    assert_eq!(fault.reason(), "COMPONENT_FAULT", "{fault}");
    lab.reset("server");
    let gone = ended(&|| lab.remove("server"));
    assert_eq!(gone.reason(), "COMPONENT_NOT_FOUND", "{gone}");
}

pub fn events_are_followed_from_outside_in_order(way: &Way) {
    let lab = Lab::running(way);
    let selection = Selection { path: lab.path("server/ctl/written"), ..Selection::default() };
    let mut items =
        block_on(lab.lcm_of("server").subscribe(vec![selection])).expect("the event can be followed");
    for number in 1..=5_u32 {
        let write = waiting(way, Function::Write, f64::from(number));
        assert_eq!(lab.perform(write).only(), Outcome::Executed);
        let item = block_on(items.recv()).expect("the event is told");
        let value = lab.as_declared("server/ctl/written", item.value);
        assert_eq!((value, item.seq, item.skipped), (json!(f64::from(number)), u64::from(number), 0));
    }
}

pub fn a_client_that_is_disconnected_hears_nothing_more(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Burst, 3.0)).only(), Outcome::Executed);
    lab.await_count("client", "ticks", |n| n == 3);
    lab.disconnect("client/peer", "server/ctl");
    lab.invoke("server/ctl/burst", Some(json!(3.0)), false).expect("the server still serves others");
    // A handler that ran late would have run before this command.
    lab.own("clear");
    assert_eq!(lab.count("client", "ticks"), 0);
}

pub fn events_of_a_command_from_outside_wake_the_client(way: &Way) {
    let lab = Lab::running(way);
    for round in 1..=5_u32 {
        lab.own("clear");
        lab.invoke("server/ctl/burst", Some(json!(f64::from(round))), false)
            .expect("the server serves others");
        lab.await_count("client", "ticks", |n| n == u64::from(round));
    }
}

pub fn a_client_that_was_reset_hears_again(way: &Way) {
    let lab = Lab::running(way);
    lab.reset("client");
    lab.start("client");
    assert_eq!(lab.perform(waiting(way, Function::Burst, 3.0)).only(), Outcome::Executed);
    lab.await_count("client", "ticks", |n| n == 3);
    lab.disconnect("client/peer", "server/ctl");
    lab.reset("client");
    lab.connect("client/peer", "server/ctl");
    lab.start("client");
    assert_eq!(lab.perform(waiting(way, Function::Burst, 3.0)).only(), Outcome::Executed);
    lab.await_count("client", "ticks", |n| n == 3);
}

pub fn a_direct_handler_runs_inside_emit_where_both_share_a_thread(way: &Way) {
    let lab = Lab::pair(way);
    let options = ConnectOptions { mailbox: Some(4), ..ConnectOptions::default() };
    lab.connect_with("client/near", "server/ctl", options);
    lab.start("server");
    lab.start("client");
    // From outside, so that nobody is inside the client when its handler is called.
    lab.invoke("server/ctl/burst", Some(json!(50.0)), false).expect("the server serves others");
    let lost = lab.count("server", "unheard");
    lab.await_count("client", "ticks", |n| n + lost == 50);
    if way.deployment.client_leads() {
        assert_eq!(lost, 0, "a queue of four had never held them");
    }
    let log = lab.row("client")["log"].clone();
    assert!(log.as_array().is_some_and(|l| l.iter().all(|mark| *mark == json!(13))), "{log}");
}

pub fn a_direct_handler_of_a_client_that_is_busy_waits_like_any_other(way: &Way) {
    let lab = Lab::running(way);
    lab.connect("client/near", "server/ctl");
    lab.perform_in_step(Call::send(Function::Burst, 1.0));
    lab.await_count("client", "ticks", |n| n == 2);
    // 1 the step begins, 2 it ends, 3 and 13 the handlers run, the direct one in its own connection's turn.
    let mut log: Vec<u64> = serde_json::from_value(lab.row("client")["log"].clone()).expect("numbers");
    let mut late = log.split_off(2);
    assert_eq!(log, [1, 2], "nobody is entered twice: {late:?} came later");
    if way.reach().queues() {
        // Both come while the client looks at its queues, and the order of connections is nobody's promise.
        late.sort_unstable();
    }
    assert_eq!(late, [3, 13]);
}
