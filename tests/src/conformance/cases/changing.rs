//! Ports that come and go while their component lives.

use serde_json::{Value, json};
use trocar::model::{Refusal, State};
use trocar_sdk::Outcome;

use super::super::{Answer, Call, Function, Lab, Way};
use super::commands::waiting;
use crate::eventually;

/// A shelf with these slots as the server, connected to none of them, and a probe as the client.
fn shelf(way: &Way, slots: &[&str]) -> Lab {
    let lab = Lab::pair_of(way, "Probe", "Shelf", json!({ "slots": slots }));
    lab.start("server");
    lab.start("client");
    lab
}

/// What `put` at a slot answers to the outside: 100 times the place, and the value.
fn put(lab: &Lab, slot: &str, value: f64) -> Result<Value, Refusal> {
    lab.invoke(&format!("server/slot_{slot}/put"), Some(json!(value)), false)
        .map(|r| r.value.unwrap_or_default())
}

/// The probe's one function has the first place.
pub(super) fn asking(way: &Way, value: f64) -> Call {
    waiting(way, Function::Poke, value)
}

fn ports(lab: &Lab) -> Vec<String> {
    lab.graph().components[&lab.id("server")].ports.names().map(str::to_owned).collect()
}

fn await_ports(lab: &Lab, expected: &[&str]) {
    eventually("the graph has the ports", || match ports(lab) {
        now if now == expected => Ok(()),
        now => Err(now.join(" ")),
    });
}

pub fn a_configuration_makes_ports_that_answer_each_for_itself(way: &Way) {
    let lab = shelf(way, &["left", "right"]);
    assert_eq!(ports(&lab), ["left_out", "right_out", "ctl", "slot_left", "slot_right", "system"]);
    assert_eq!(put(&lab, "left", 1.0).expect("it is there"), json!(1.0));
    assert_eq!(put(&lab, "right", 2.0).expect("it is there"), json!(102.0));
    let held = lab.invoke("server/slot_right/held", None, false).expect("a read is answered");
    assert_eq!(held.value, Some(json!(2.0)));
    let limits = put(&lab, "right", 51.0).expect_err("limits hold for described commands, too");
    assert_eq!(limits.reason(), "ARGUMENT_INVALID", "{limits}");
    let missing = put(&lab, "middle", 1.0).expect_err("there is no such slot");
    assert!(missing.to_string().contains("slot_left"), "it lists what exists: {missing}");
    lab.connect("client/peer", "server/slot_right");
    lab.connect("client/any", "server/right_out");
    let answer = lab.perform(asking(way, 3.0));
    assert_eq!((answer.only(), answer.value), (Outcome::Executed, 103.0), "{answer:?}");
    assert_eq!(lab.own("see")["value"], json!(3.0), "the slot's own output");
}

pub fn what_stays_keeps_its_connections_and_what_goes_loses_them(way: &Way) {
    let lab = shelf(way, &["left", "right"]);
    lab.create("second", "Probe", json!({}), super::own_thread());
    lab.start("second");
    lab.connect("client/peer", "server/slot_right");
    lab.connect("client/any", "server/right_out");
    lab.connect("second/peer", "server/slot_left");
    lab.connect("second/any", "server/left_out");
    lab.configure("server", json!({ "slots": ["right", "new"] })).expect("slots is live");
    await_ports(&lab, &["right_out", "new_out", "ctl", "slot_right", "slot_new", "system"]);
    eventually("the connections of what went are gone", || match lab.graph().connections.len() {
        2 => Ok(()),
        n => Err(format!("{n} connections")),
    });
    let answer = lab.perform(asking(way, 4.0));
    assert_eq!((answer.only(), answer.value), (Outcome::Executed, 4.0), "right has the first place now");
    assert_eq!(lab.own("see")["value"], json!(4.0));
    let patience = super::super::world::PATIENCE;
    await_unbound(&lab, || lab.order("second", asking(way, 5.0), patience).expect("it comes back"));
    assert_eq!(put(&lab, "new", 6.0).expect("it is there"), json!(106.0));
    assert_eq!(lab.stands("server").map(|s| s.0), Some(State::Active), "it ran on meanwhile");
}

/// Nobody is asked any more. Another process may still be about to hear of it.
fn await_unbound(lab: &Lab, ask: impl Fn() -> Answer) {
    eventually("the connection is gone", || {
        let lost = ask();
        match lost.only() {
            Outcome::Unbound => Ok(()),
            Outcome::PeerLost | Outcome::Disabled if lab.is_parted() => Err(format!("{lost:?}")),
            _ => panic!("{lost:?}"),
        }
    });
}

pub fn a_component_changes_its_ports_itself(way: &Way) {
    let lab = shelf(way, &["left"]);
    lab.connect("client/peer", "server/slot_left");
    lab.invoke("server/ctl/rename", Some(json!("new,left")), false).expect("it may");
    await_ports(&lab, &["new_out", "left_out", "ctl", "slot_new", "slot_left", "system"]);
    let answer = lab.perform(asking(way, 4.0));
    assert_eq!(
        (answer.only(), answer.value),
        (Outcome::Executed, 104.0),
        "left has moved, and is still meant"
    );
    lab.invoke("server/ctl/rename", Some(json!("")), false).expect("it may");
    await_ports(&lab, &["ctl", "system"]);
    await_unbound(&lab, || lab.perform(asking(way, 5.0)));
    assert_eq!(lab.count("server", "puts"), 1);
}

pub fn ports_that_contradict_each_other_are_refused_and_the_old_ones_stay(way: &Way) {
    let lab = shelf(way, &["left", "right"]);
    let twice = lab.configure("server", json!({ "slots": ["a", "a"] })).expect_err("one name, two slots");
    assert!(twice.to_string().contains("`a` is given twice"), "{twice}");
    let many = json!({ "slots": ["a", "b", "c", "d", "e"] });
    let many = lab.configure("server", many).expect_err("there is no room");
    assert!(many.to_string().contains("room for 4"), "{many}");
    assert_eq!(ports(&lab), ["left_out", "right_out", "ctl", "slot_left", "slot_right", "system"]);
    assert_eq!(put(&lab, "right", 1.0).expect("it is as before"), json!(101.0));
}

pub fn ports_of_a_configuration_survive_a_reset(way: &Way) {
    let lab = shelf(way, &["left"]);
    lab.connect("client/peer", "server/slot_left");
    lab.reset("server");
    lab.start("server");
    assert_eq!(lab.perform(asking(way, 4.0)).value, 4.0, "and so does what is connected to them");
}

pub fn calls_of_ports_that_come_and_go_are_each_answered_and_none_runs_twice(way: &Way) {
    let lab = shelf(way, &["left"]);
    // Between the look at the description and the call it may go, or there was nothing to be seen.
    let fitting = ["DISABLED", "INTERFACE_NOT_FOUND"];
    std::thread::scope(|scope| {
        let changing = scope.spawn(|| {
            for round in 0..20 {
                let slots = if round % 2 == 0 { json!([]) } else { json!(["left"]) };
                lab.configure("server", json!({ "slots": slots })).expect("slots is live");
            }
        });
        let mut executed = 0;
        while !changing.is_finished() {
            match put(&lab, "left", 1.0) {
                Ok(_) => executed += 1,
                Err(refusal) => {
                    assert!(fitting.contains(&refusal.reason()), "{}: {refusal}", refusal.reason())
                }
            }
        }
        changing.join().expect("each change was made");
        assert_eq!(lab.count("server", "puts"), executed, "what was refused never ran");
    });
    assert_eq!(put(&lab, "left", 2.0).expect("it is there again"), json!(2.0));
}
