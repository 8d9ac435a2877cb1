//! Taps: a component's rows, events and commands as samples for an untyped input, over every way there is.

use std::time::Duration;

use serde_json::json;
use trocar::model::{ConnectOptions, Queue};
use trocar_sdk::Outcome;

use super::super::answer::whole;
use super::super::{Call, Function, Lab, Way};
use super::changing::asking;
use crate::eventually;

/// A probe as the client, its untyped input at this tap of the server.
fn tapped(way: &Way, tap: &str) -> Lab {
    let lab = Lab::pair_of(way, "Probe", "Server", json!({}));
    lab.start("server");
    lab.start("client");
    lab.connect("client/any", &format!("server/{tap}"));
    lab
}

/// Number and size of the newest sample, as soon as its number satisfies `is`.
fn seen(lab: &Lab, what: &str, is: impl Fn(u64) -> bool) -> (u64, u64) {
    eventually(what, || {
        let seen = lab.own("see");
        let number = whole(&seen["seq"]);
        if is(number) { Ok((number, whole(&seen["value_len"]))) } else { Err(seen.to_string()) }
    })
}

fn poke(lab: &Lab) {
    lab.invoke("server/ctl/poke", None, false).unwrap_or_else(|refusal| panic!("poke: {refusal}"));
}

pub fn each_row_of_a_state_table_is_told_with_its_number(way: &Way) {
    let lab = tapped(way, "tap_rows");
    let mut last = 0;
    for _ in 0..3 {
        poke(&lab);
        let (number, bytes) = seen(&lab, "a later row", |number| number > last);
        // 128 numbers of which it remembers what was written.
        assert!(bytes > 1024 && bytes % 8 == 0, "a whole row: {bytes} bytes");
        last = number;
    }
    lab.stop("server");
    lab.resume("server");
    poke(&lab);
    seen(&lab, "rows after Stop and Resume", |number| number > last);
}

pub fn each_event_is_told_to_its_tap(way: &Way) {
    let lab = tapped(way, "tap_events");
    let burst = |times: f64| {
        let done = lab.invoke("server/ctl/burst", Some(json!(times)), false);
        done.unwrap_or_else(|refusal| panic!("burst: {refusal}"));
    };
    burst(5.0);
    let (first, bytes) = seen(&lab, "five events", |number| number >= 5);
    burst(7.0);
    let (second, _) = seen(&lab, "seven more", |number| number >= first + 7);
    assert_eq!(second - first, 7);
    assert!(bytes > 300, "room for the largest event, of the system interface: {bytes} bytes");
    assert_eq!(lab.count("server", "unheard"), 0, "a tap is no handler that could be too slow");
}

pub fn each_command_is_told_to_its_tap_whoever_gave_it(way: &Way) {
    let lab = tapped(way, "tap_commands");
    lab.create("second", "Client", json!({}), super::own_thread());
    lab.connect("second/peer", "server/ctl");
    lab.start("second");
    poke(&lab);
    seen(&lab, "the command from outside", |number| number == 1);
    for function in [Function::Write, Function::Refuse] {
        let sent = lab.order("second", Call::send(function, 7.0), Duration::from_secs(40));
        let outcome = sent.unwrap_or_else(|refusal| panic!("no order: {refusal}")).only();
        // Of a passive server it is known at once.
        let taken = [Outcome::Queued, Outcome::Executed, Outcome::Failed].contains(&outcome);
        assert!(taken, "{function:?}: {outcome:?}");
    }
    let (_, bytes) = seen(&lab, "one that was executed and one that failed", |number| number == 3);
    assert!(bytes > 16 && bytes % 8 == 0, "{bytes} bytes");
    let value = lab.invoke("server/ctl/value", None, false);
    assert_eq!(value.ok().and_then(|reply| reply.value), Some(json!(7.0)));
    poke(&lab);
    let (number, _) = seen(&lab, "the next command", |number| number > 3);
    assert_eq!(number, 4, "a read is no command that is carried out");
}

pub fn what_a_tap_cannot_queue_is_a_counted_drop(way: &Way) {
    let lab = Lab::pair_of(way, "Probe", "Server", json!({}));
    lab.start("server");
    let queue = Some(Queue::Fifo { depth: 4, drop_oldest: true });
    let options = ConnectOptions { queue, ..ConnectOptions::default() };
    lab.connect_with("client/any", "server/tap_events", options);
    let done = lab.invoke("server/ctl/burst", Some(json!(50.0)), false);
    done.unwrap_or_else(|refusal| panic!("burst: {refusal}"));
    eventually("all but four are dropped", || match lab.links().iter().map(|l| l.dropped).sum::<u64>() {
        46 => Ok(()),
        n => Err(n),
    });
    assert_eq!(lab.count("server", "unheard"), 0);
}

pub fn taps_of_ports_that_change_go_and_those_of_rows_stay(way: &Way) {
    let lab = Lab::pair_of(way, "Probe", "Shelf", json!({ "slots": ["left"] }));
    lab.create("second", "Probe", json!({}), super::own_thread());
    for name in ["server", "client", "second"] {
        lab.start(name);
    }
    lab.connect("client/peer", "server/slot_left");
    lab.connect("client/any", "server/tap_rows");
    lab.connect("second/any", "server/tap_commands");
    assert_eq!(lab.perform(asking(way, 1.0)).only(), Outcome::Executed);
    let (before, _) = seen(&lab, "a row", |number| number > 0);
    lab.configure("server", json!({ "slots": ["left", "right"] })).expect("slots is live");
    eventually("the tap of other commands is another tap", || match lab.graph().connections.len() {
        2 => Ok(()),
        n => Err(n),
    });
    let put = |slot: &str| {
        let done = lab.invoke(&format!("server/slot_{slot}/put"), Some(json!(2.0)), false);
        done.unwrap_or_else(|refusal| panic!("{slot}: {refusal}"));
    };
    put("right");
    seen(&lab, "rows go on", |number| number > before);
    let options = ConnectOptions::default;
    lab.try_connect("second/any", "server/tap_commands", options()).expect("the new one can be connected");
    put("right");
    let second = || lab.invoke("second/run/see", None, false).ok().and_then(|reply| reply.value);
    eventually("the new command is told", || match second() {
        Some(seen) if whole(&seen["there"]) == 1 => Ok(()),
        other => Err(format!("{other:?}")),
    });
}
