//! Ports without a type, and connections whose ends lay a type out in two ways.

use serde_json::{Value, json};
use trocar::model::ConnectOptions;
use trocar_sdk::Outcome;

use super::super::answer::whole;
use super::super::{Call, Function, Lab, Way};
use super::changing::asking;
use crate::eventually;

/// Writes a sample of the server, or a frame.
fn publish(lab: &Lab, command: &str) {
    let done = lab.invoke(&format!("server/ctl/{command}"), Some(json!(1.0)), false);
    done.unwrap_or_else(|refusal| panic!("{command}: {refusal}"));
}

/// A probe as the client.
fn probe(way: &Way) -> Lab {
    let lab = Lab::pair_of(way, "Probe", "Server", json!({}));
    lab.start("server");
    lab.start("client");
    lab
}

pub fn an_untyped_input_takes_samples_and_frames_as_they_are(way: &Way) {
    let lab = probe(way);
    assert_eq!(whole(&lab.own("see")["there"]), 0, "nothing is connected");
    lab.connect("client/any", "server/value_out");
    publish(&lab, "publish");
    let seen = lab.own("see");
    assert_eq!((&seen["value"], whole(&seen["value_len"]), whole(&seen["seq"])), (&json!(1.0), 16, 1));
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    lab.connect_with("client/any", "server/frame_out", options);
    assert_eq!(whole(&lab.own("see")["there"]), 0, "the other connection's sample went with it");
    publish(&lab, "publish_frames");
    let seen = lab.own("see");
    assert_eq!((whole(&seen["value_len"]), whole(&seen["frame_len"])), (32, 4096));
}

/// What a probe says of the frame it keeps: whether there is one, its first byte, its length.
fn kept(lab: &Lab, command: &str) -> (u64, u64, u64) {
    kept_by(lab, "client", command)
}

fn kept_by(lab: &Lab, probe: &str, command: &str) -> (u64, u64, u64) {
    let reply = lab.invoke(&format!("{probe}/run/{command}"), None, false);
    let kept = reply.unwrap_or_else(|refusal| panic!("{command}: {refusal}")).value.unwrap_or_default();
    (whole(&kept["there"]), whole(&kept["byte"]), whole(&kept["len"]))
}

/// More frames than there are slots.
fn go_round(lab: &Lab) {
    let done = lab.invoke("server/ctl/publish_frames", Some(json!(9.0)), false);
    done.unwrap_or_else(|refusal| panic!("publishing frames: {refusal}"));
}

pub fn a_frame_that_an_untyped_input_keeps_stays_whatever_becomes_of_the_input(way: &Way) {
    let lab = probe(way);
    lab.connect("client/any", "server/value_out");
    publish(&lab, "publish");
    assert_eq!(kept(&lab, "keep").0, 0, "a plain sample is no frame");
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    lab.connect_with("client/any", "server/frame_out", options);
    assert_eq!(kept(&lab, "keep").0, 0, "there is none yet");
    publish(&lab, "publish_frames");
    // The first one of a pool comes when its memory is mapped.
    let first = eventually("it keeps the frame", || match kept(&lab, "keep") {
        (0, ..) => Err("it keeps none"),
        some => Ok(some),
    });
    assert_eq!((first.0, first.2), (1, 4096));
    for _ in 0..20 {
        publish(&lab, "publish_frames");
        lab.own("see");
        assert_eq!(kept(&lab, "kept"), first, "it was filled anew");
    }
    assert_eq!(lab.count("server", "exhausted"), 0);
    let next = kept(&lab, "keep");
    assert_eq!((next.0, next.1), (1, first.1 + 20), "the newest instead of it");
    lab.disconnect("client/any", "server/frame_out");
    go_round(&lab);
    assert_eq!(kept(&lab, "kept"), next, "the connection is gone");
    lab.remove("server");
    assert_eq!(kept(&lab, "kept"), next, "its source is gone");
    assert_eq!(kept(&lab, "keep").0, 0, "nothing is connected");
}

pub fn frames_are_held_as_long_as_enough_stay_free_for_their_source(way: &Way) {
    let lab = probe(way);
    lab.create("second", "Probe", json!({}), super::own_thread());
    lab.start("second");
    for name in ["client", "second"] {
        lab.connect(&format!("{name}/any"), "server/frame_out");
    }
    publish(&lab, "publish_frames");
    for name in ["client", "second"] {
        eventually("the first one comes", || match kept_by(&lab, name, "keep") {
            (0, ..) => Err(name),
            _ => Ok(()),
        });
    }
    // One of four slots is held by both; with another one held, one to be shown and one to wait, none would
    // be left to fill.
    publish(&lab, "publish_frames");
    let other = kept_by(&lab, "second", "keep").0;
    assert_eq!(other, u64::from(lab.maps()), "where each has its own link, each holds one");
    go_round(&lab);
    assert_eq!(kept(&lab, "kept").0, 1);
    assert_eq!(lab.count("server", "exhausted"), 0);
}

pub fn an_untyped_output_gives_what_its_peer_takes_and_nothing_of_another_size(way: &Way) {
    let lab = probe(way);
    let told = |value: f64| {
        let reply = lab.invoke("client/run/tell", Some(json!(value)), false).expect("it is told");
        super::super::Answer::of(&reply.value.unwrap_or_default())
    };
    let nobody = lab.try_connect("client/any", "client/any_out", ConnectOptions::default());
    assert!(nobody.is_err(), "two ends without a type agree on none");
    assert_eq!(told(1.0).outcomes, [(Outcome::Unbound, 2)]);
    lab.create("second", "Client", json!({}), super::own_thread());
    lab.start("second");
    lab.connect("second/latest", "client/any_out");
    assert_eq!(told(2.5).outcomes, [(Outcome::Executed, 1), (Outcome::InvalidArgument, 1)]);
    let seen = lab.invoke("second/run/look", None, false).expect("it looks").value.unwrap_or_default();
    assert_eq!((&seen["last"], whole(&seen["count"])), (&json!(2.5), 1));
}

/// What a probe told, and what came of its three bytes and of its sample.
fn told(lab: &Lab, probe: &str, value: f64) -> Vec<(Outcome, u64)> {
    let reply = lab.invoke(&format!("{probe}/run/tell"), Some(json!(value)), false).expect("it is told");
    super::super::Answer::of(&reply.value.unwrap_or_default()).outcomes
}

fn seen(lab: &Lab, probe: &str) -> (u64, Value) {
    let reply = lab.invoke(&format!("{probe}/run/see"), None, false).expect("it looks");
    let seen = reply.value.unwrap_or_default();
    (whole(&seen["there"]), seen["value"].clone())
}

pub fn two_untyped_ends_pass_what_a_third_one_made_of_the_output(way: &Way) {
    let lab = probe(way);
    lab.create_beside("server", "there", "Probe", super::own_thread());
    lab.create("typed", "Client", json!({}), super::own_thread());
    for name in ["there", "typed"] {
        lab.start(name);
    }
    let taken = [(Outcome::Executed, 1), (Outcome::InvalidArgument, 1)];
    // From the client's process to the server's, and back: where there are two, each pair is in both of them.
    for (from, to, input) in [("client", "there", "latest"), ("there", "client", "fifo")] {
        let output = format!("{from}/any_out");
        let connect = || lab.try_connect(&format!("{to}/any"), &output, ConnectOptions::default());
        let nothing = connect().expect_err("two ends without a type agree on none");
        assert_eq!(nothing.reason(), "FORMAT_MISMATCH", "{nothing}");
        lab.connect(&format!("typed/{input}"), &output);
        connect().expect("the output is what the third end made of it");
        assert_eq!(told(&lab, from, 2.5), taken);
        assert_eq!(seen(&lab, to), (1, json!(2.5)), "{from} to {to}");
        lab.disconnect(&format!("typed/{input}"), &output);
        assert_eq!(told(&lab, from, 3.5), taken, "it stays that as long as anybody is there");
        assert_eq!(seen(&lab, to), (1, json!(3.5)), "{from} to {to}");
        lab.disconnect(&format!("{to}/any"), &output);
        assert_eq!(told(&lab, from, 4.5), [(Outcome::Unbound, 2)]);
    }
}

pub fn an_untyped_function_calls_what_it_is_connected_to_and_nothing_of_another_size(way: &Way) {
    let lab = Lab::pair_of(way, "Probe", "Shelf", json!({ "slots": ["left"] }));
    lab.start("server");
    lab.start("client");
    assert_eq!(lab.perform(asking(way, 1.0)).only(), Outcome::Unbound);
    lab.connect("client/peer", "server/slot_left");
    let answer = lab.perform(asking(way, 7.0));
    assert_eq!((answer.only(), answer.value), (Outcome::Executed, 7.0), "{answer:?}");
    assert_eq!(lab.perform(asking(way, 51.0)).only(), Outcome::InvalidArgument, "limits hold for bytes, too");
    for wait in [false, true] {
        // The second place stands for three bytes instead of eight.
        let wrong = Call { wait, ..super::commands::waiting(way, Function::Write, 1.0) };
        assert_eq!(lab.perform(wrong).only(), Outcome::InvalidArgument, "waiting: {wait}");
    }
    let sent = lab.perform(Call::send(Function::Poke, 8.0)).only();
    assert_eq!(sent, if way.deployment.inline() { Outcome::Executed } else { Outcome::Queued });
    lab.await_count("server", "puts", |n| n == 2);
}

pub fn fields_that_only_moved_are_copied_by_name_where_the_connection_adapts(way: &Way) {
    let lab = Lab::running(way);
    let connect = |adapt| {
        let options = ConnectOptions { adapt, ..ConnectOptions::default() };
        lab.try_connect("client/turned", "server/value_out", options)
    };
    let refused = connect(false).expect_err("the fields lie elsewhere");
    assert_eq!(refused.reason(), "TYPE_MISMATCH", "{refused}");
    assert!(refused.to_string().contains("adapt"), "it says what would help: {refused}");
    connect(true).expect("names and kinds agree");
    for round in 1..=3_u32 {
        publish(&lab, "publish");
        let seen = lab.samples("look_turned");
        assert_eq!((seen.last, seen.fresh, seen.gaps), (f64::from(round), 1, 0), "{seen:?}");
    }
    let options = ConnectOptions { adapt: true, ..ConnectOptions::default() };
    let frames =
        lab.try_connect("client/latest", "server/frame_out", options).expect_err("a frame is no sample");
    assert_eq!(frames.reason(), "FORMAT_MISMATCH", "{frames}");
}
