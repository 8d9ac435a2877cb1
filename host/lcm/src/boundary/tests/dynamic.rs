//! Ports that come and go while their component lives.

use std::sync::atomic::Ordering;

use serde_json::{Value, json};
use trocar_model::{Refusal, State, Verb};
use trocar_plugin_api::abi::*;

use super::commands::{POKE, SET, TWICE, client, obeys, server};
use super::script::*;
use super::world::*;
use crate::calling::invoke_by;
use crate::{Invoke, News, Payload};

/// `arms` interfaces like the server's own, in front of it or behind it.
fn arms(names: &[&str]) -> Value {
    let own = server()["provided"][0].clone();
    let provided: Vec<Value> = names
        .iter()
        .map(|name| {
            let mut interface = own.clone();
            interface["name"] = json!(name);
            interface
        })
        .collect();
    json!({"provided": provided})
}

fn description(class_name: &str, ports: &Value) -> String {
    json!({"types": types(), "class": class(class_name, ports)}).to_string()
}

#[test]
fn after_configure_the_ports_are_those_of_the_description_and_connections_that_stay_go_on() {
    let world = World::new("describe");
    let caller = world.active("caller", &client(false), on_signal(), Script::default());
    let robot = world.active("robot", &arms(&["ctl", "left"]), on_signal(), obeys());
    let second = world.active("second", &client(false), on_signal(), Script::default());
    let kept = world.connect("caller/peer", "robot/left");
    let lost = world.connect("second/peer", "robot/ctl");
    assert_eq!(robot.counts()[3], 2);
    world.describes("robot", description("robot", &arms(&["left", "right", "wrist"])));
    let report = world.configure("robot").unwrap();
    assert_eq!(report.lost_connections, [lost.id.0]);
    let names: Vec<String> = report.ports.unwrap().provided.iter().map(|p| p.name.clone()).collect();
    assert_eq!(names, ["left", "right", "wrist", "system"]);
    assert_eq!(robot.counts()[3], 3, "it was bound again");
    assert_eq!(second.send(POKE, 0), UNBOUND);
    // `left` has moved from the second place to the first: its commands have other ids now.
    robot.forget();
    assert_eq!(caller.ask(TWICE, 4).ret, 8);
    assert_eq!(robot.seen(), [TWICE as u64]);
    world.cut(&kept);
    world.connect("second/peer", "robot/wrist");
    assert_eq!(second.send(SET, 3), QUEUED);
    eventually("the command of the new interface", || robot.seen().last() == Some(&(8 + SET as u64)));
    assert!(world.configure("robot").unwrap().lost_connections.is_empty(), "the same ports lose nothing");
}

#[test]
fn what_was_queued_for_a_port_that_stays_is_executed_and_for_one_that_went_is_disabled() {
    let world = World::new("disabled");
    let caller = world.active("caller", &client(false), on_signal(), Script::default());
    let second = world.active("second", &client(false), on_signal(), Script::default());
    let robot = world.active("robot", &arms(&["ctl", "left"]), on_signal(), obeys());
    world.connect("caller/peer", "robot/left");
    let gone = world.connect("second/peer", "robot/ctl");
    let instance = world.instance("robot");
    let ports = trocar_model::Ports::clone(&instance.ports());
    let mut fewer = ports.clone();
    fewer.provided.remove(0);
    let set =
        std::sync::Arc::new(crate::described::PortSet::new(fewer, Some(&instance.described.now())).unwrap());
    std::thread::scope(|scope| {
        let (kept, lost) = {
            // While a thread is inside, calls wait in their queues.
            let inside = eventually_inside(&instance);
            let kept = scope.spawn(|| caller.ask(TWICE, 2));
            let lost = scope.spawn(|| second.ask(TWICE, 3));
            let queued = || instance.queues().iter().map(|i| i.mailbox.stats().queued).sum::<u64>();
            eventually("both calls", || queued() == 2);
            set.renumber(&instance.described.now());
            drop(inside);
            instance.signal();
            (kept, lost)
        };
        assert_eq!(lost.join().unwrap().outcome, DISABLED);
        assert_eq!(kept.join().unwrap().ret, 4);
    });
    assert_eq!(robot.seen(), [TWICE as u64], "by the id it has now");
    world.cut(&gone);
}

fn eventually_inside(instance: &std::sync::Arc<crate::instance::Instance>) -> crate::instance::Entered<'_> {
    let until = trocar_rt::os::now_ns() + PATIENCE.as_nanos() as u64;
    instance.object.enter_until(until).unwrap()
}

#[test]
fn a_component_asks_for_other_ports_from_any_thread_and_the_news_say_what_went() {
    let world = World::new("changed");
    let second = world.active("second", &client(false), on_signal(), Script::default());
    let robot = world.active("robot", &arms(&["ctl", "left"]), on_signal(), obeys());
    let lost = world.connect("second/peer", "robot/ctl");
    let mut news = crate::Lcm::news(&*world.lcm);
    world.describes("robot", description("robot", &arms(&["left"])));
    assert_eq!(robot.ports_changed(), QUEUED);
    let mut told = None;
    eventually("the news", || {
        while let Ok(news) = news.try_recv() {
            if let News::State(report) = news
                && let Some(ports) = report.ports
            {
                told = Some((report.lost_connections, ports.provided.len()));
            }
        }
        told.is_some()
    });
    assert_eq!(told, Some((vec![lost.id.0], 2)));
    assert_eq!(second.send(POKE, 0), UNBOUND);
    assert_eq!(world.instance("robot").state(), State::Active, "it went on meanwhile");
}

#[test]
fn reset_keeps_the_ports_of_the_configuration_and_what_is_connected_to_them() {
    let world = World::new("reset");
    let caller = world.active("caller", &client(false), on_signal(), Script::default());
    let robot = world.create("robot", &arms(&["ctl"]), on_signal(), obeys());
    world.describes("robot", description("robot", &arms(&["ctl", "left"])));
    world.configure("robot").unwrap();
    world.connect("caller/peer", "robot/left");
    let report = world.run("robot", Verb::Reset).unwrap();
    assert!(report.lost_connections.is_empty());
    world.run("robot", Verb::Start).unwrap();
    assert_eq!(caller.ask(TWICE, 5).ret, 10);
    assert_eq!(robot().counts()[3], 2, "the fresh instance was bound to both interfaces");
}

#[test]
fn a_call_from_outside_that_looked_up_ports_that_then_changed_looks_again() {
    let world = World::new("again");
    let robot = world.create("robot", &arms(&["ctl", "left"]), on_signal(), obeys());
    world.configure("robot").unwrap();
    world.run("robot", Verb::Start).unwrap();
    let instance = world.instance("robot");
    let call = |path: &str| {
        let member = trocar_model::MemberId::parse(&format!("again/robot/{path}")).unwrap();
        let arg = Payload::Json(json!(4));
        Invoke { member, arg, send: false, deadline_ns: PATIENCE.as_nanos() as u64 }
    };
    let looked_up = instance.described.now();
    let change = |names: &[&str]| {
        world.describes("robot", description("robot", &arms(names)));
        world.configure("robot").unwrap();
    };
    change(&["left", "right"]);
    let ask = |path: &str| world.wait(invoke_by(instance.clone(), call(path), looked_up.clone()));
    assert_eq!(ask("left/twice").unwrap().value, Some(json!(8)), "by the place it has now");
    assert_eq!(robot().seen(), [TWICE as u64]);
    let refusal = ask("ctl/twice").unwrap_err();
    assert!(matches!(refusal, Refusal::Disabled { .. }), "what went is named so: {refusal}");
}

#[test]
fn ports_that_an_entry_is_missing_for_are_refused_by_their_names_and_the_old_ones_stay() {
    let world = World::new("mute");
    let interface = |commands: Value, events: Value| json!({"provided": [{"name": "ctl", "commands": commands, "events": events}]});
    let required = |member: Value| {
        let mut interface = member;
        interface["name"] = json!("peer");
        json!({"required": [interface]})
    };
    let cases = [
        (json!({"inputs": [{"name": "x", "type": {"plain": "u64"}}]}), "the input x", "bind"),
        (json!({"outputs": [{"name": "y", "type": {"plain": "u64"}}]}), "the output y", "bind"),
        (required(json!({"functions": [{"name": "go"}]})), "the function peer/go", "bind"),
        (interface(json!([]), json!([{"name": "done"}])), "the event ctl/done", "bind"),
        (interface(json!([{"name": "go", "kind": "void"}]), json!([])), "the command ctl/go", "command"),
        (
            interface(json!([{"name": "at", "kind": "read", "ret": "u64"}]), json!([])),
            "the read ctl/at",
            "read",
        ),
        (required(json!({"handlers": [{"name": "done"}]})), "the event handler peer/done", "on_event"),
    ];
    for (ports, named, entry) in cases {
        world.try_create(MUTE, &json!({}), on_signal(), Script::default()).unwrap();
        world.describes(MUTE, String::new());
        world.configure(MUTE).unwrap();
        world.describes(MUTE, description(MUTE, &ports));
        let refusal = world.configure(MUTE).unwrap_err().to_string();
        assert!(refusal.contains(named) && refusal.contains(&format!("`{entry}`")), "{ports}: {refusal}");
        let instance = world.instance(MUTE);
        assert_eq!((instance.state(), instance.ports().provided.len()), (State::Fault, 1), "{ports}");
        world.remove(MUTE);
    }
    world.try_create(MUTE, &json!({}), on_signal(), Script::default()).unwrap();
    world.describes(MUTE, description(MUTE, &json!({})));
    world.configure(MUTE).unwrap();
}

#[test]
fn a_description_that_lies_ends_in_fault_with_a_sentence_and_the_old_ports_stay() {
    let world = World::new("lies");
    let mut twice = arms(&["ctl", "ctl"]);
    let mut huge = json!({"inputs": [{"name": "in", "type": {"plain": {"array": "u64", "n": 20_000}}}]});
    huge["provided"] = arms(&["ctl"])["provided"].clone();
    let mut other_state = class("robot", &arms(&["ctl"]));
    other_state["state"] = json!("f64");
    let mut member = arms(&["ctl"]);
    let command = member["provided"][0]["commands"][0].clone();
    member["provided"][0]["commands"].as_array_mut().unwrap().push(command);
    twice["provided"][1]["doc"] = json!("again");
    let cases = [
        ("{not json".to_owned(), "not a class description"),
        (description("robot", &twice), "name of another port"),
        (description("robot", &huge), "larger than"),
        (description("robot", &member), "stands there twice"),
        (description("other", &arms(&["ctl"])), "describes class other"),
        (json!({"types": [], "class": other_state}).to_string(), "state may not change"),
        (" ".repeat(2 << 20), "more than"),
    ];
    for (n, (text, says)) in cases.into_iter().enumerate() {
        let name = format!("robot{n}");
        let robot = world.create(&name, &arms(&["ctl"]), on_signal(), obeys());
        let text = text.replace("\"robot\"", &format!("\"{name}\""));
        world.configure(&name).unwrap();
        let before = robot().counts();
        world.describes(&name, text);
        match world.configure(&name) {
            Err(Refusal::ComponentFault { text, .. }) => {
                assert!(text.contains(says), "{says:?} is not in {text:?}")
            }
            other => panic!("{says:?} gave {other:?}"),
        }
        let instance = world.instance(&name);
        assert_eq!((instance.state(), instance.ports().provided.len()), (State::Fault, 2));
        assert_eq!(robot().counts(), before);
    }
}

#[test]
fn streams_of_ports_that_stay_keep_what_is_in_them() {
    let world = World::new("keeps");
    let one = json!({"name": "ab", "type": {"plain": {"ref": "Ab"}}});
    let two = json!({"name": "ba", "type": {"plain": {"ref": "Ba"}}});
    let source = world.active("source", &json!({"outputs": [one]}), on_signal(), Script::default());
    let mut input = one.clone();
    input["fifo"] = json!(4);
    let sink = world.active("sink", &json!({"inputs": [input]}), on_signal(), Script::default());
    world.connect("sink/ab", "source/ab");
    let value: Vec<u8> = (0..16).collect();
    source.write(0, &value);
    world.describes("source", description("source", &json!({"outputs": [two, one]})));
    world.describes("sink", description("sink", &json!({"inputs": [two, input]})));
    assert!(world.configure("source").unwrap().lost_connections.is_empty());
    assert!(world.configure("sink").unwrap().lost_connections.is_empty());
    source.write(1, &value);
    let seqs: Vec<u64> = std::iter::from_fn(|| sink.next(1, 16)).map(|s| s.seq).collect();
    assert_eq!(seqs, [1, 2], "written before and after");
    assert_eq!(sink.state.load(Ordering::Relaxed), 0);
}

#[test]
fn an_interface_that_gains_or_loses_a_member_keeps_the_connections_that_do_not_need_it() {
    let world = World::new("members");
    let caller = world.active("caller", &client(true), on_signal(), Script::default());
    let only = json!({"required": [{"name": "peer", "functions": [{"name": "poke"}]}]});
    let pokes = world.active("pokes", &only, on_signal(), Script::default());
    let robot = world.active("robot", &arms(&["ctl"]), on_signal(), obeys());
    let (full, poke) = (world.connect("caller/peer", "robot/ctl"), world.connect("pokes/peer", "robot/ctl"));
    let mut more = arms(&["ctl"]);
    let commands = more["provided"][0]["commands"].as_array_mut().unwrap();
    let named = |name: &str| json!({"name": name, "kind": "void"});
    // Four in front of the others: all ids are moved.
    (0..4).for_each(|n| commands.insert(0, named(&format!("extra{n}"))));
    world.describes("robot", description("robot", &more));
    assert!(world.configure("robot").unwrap().lost_connections.is_empty());
    robot.forget();
    assert_eq!(caller.ask(TWICE, 4).ret, 8);
    assert_eq!(robot.seen(), [4 + TWICE as u64], "by its new id");
    assert_eq!(robot.emit(0, 1), EXECUTED, "its handler is still connected");
    let mut fewer = arms(&["ctl"]);
    fewer["provided"][0]["commands"].as_array_mut().unwrap().truncate(2);
    world.describes("robot", description("robot", &fewer));
    assert_eq!(world.configure("robot").unwrap().lost_connections, [full.id.0], "its twice is gone");
    assert_eq!(caller.ask(TWICE, 4).outcome, UNBOUND);
    assert_eq!(pokes.send(POKE, 0), QUEUED);
    world.describes("pokes", description("pokes", &client(false)));
    let lost = world.configure("pokes").unwrap().lost_connections;
    assert_eq!(lost, [poke.id.0], "its new functions find no commands there");
}
