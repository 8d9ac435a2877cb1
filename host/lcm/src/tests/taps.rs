//! Taps: rows, events and commands of a component reach every connected reader, decoded by the type alone,
//! and the component notices nothing.
//!
//! Promise: each row, event and command is told once, with its stamp and its number, or is a counted drop.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::{Value, json};
use trocar_model::{Arg, Queue, StructType, TAPS, Type, decode};
use trocar_plugin_api::abi::Tick;
use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::os;

use super::super::boundary::puppet::{ArgRet, Own};
use super::super::inbox::ENTRY_COMMAND;
use super::*;

/// Takes samples of so many words that wait.
#[derive(Default)]
struct Taker<const N: usize>(Mutex<Vec<([u64; N], u64)>>);

impl<const N: usize> Behaviour for Taker<N> {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.0.lock().unwrap().extend(std::iter::from_fn(|| own.take_words(0)));
        Ok(())
    }
}

impl<const N: usize> Taker<N> {
    fn len(&self) -> usize {
        self.0.lock().unwrap().len()
    }

    fn all(&self) -> Vec<(Vec<u8>, u64)> {
        let bytes = |words: &[u64; N]| words.iter().flat_map(|word| word.to_le_bytes()).collect();
        self.0.lock().unwrap().iter().map(|(words, seq)| (bytes(words), *seq)).collect()
    }
}

/// Refuses commands when told so.
#[derive(Default)]
struct Moody(AtomicBool);

impl Behaviour for Moody {
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        if self.0.load(Ordering::SeqCst) { Err("not now".into()) } else { Ok(()) }
    }
}

fn any() -> Ports {
    let mut ports = plain(true, false);
    ports.inputs[0].ty = PortType::Any;
    ports
}

/// `ctl` with the void command `do`, a read, and `set`, which takes a number up to 9.
fn settable() -> Ports {
    let mut ports = ctl();
    let commands = &mut ports.provided[0].commands;
    let number = Type::Prim(Prim::U64);
    commands.push(Command {
        name: "value".into(),
        kind: CommandKind::Read,
        ret: Some(number.clone()),
        ..commands[0].clone()
    });
    let arg = Arg {
        name: "to".into(),
        doc: String::new(),
        ty: number,
        unit: "mm".into(),
        min: Some(0.0),
        max: Some(9.0),
    };
    let kind = CommandKind::Write;
    commands.push(Command { name: "set".into(), kind, arg: Some(arg), ..commands[0].clone() });
    ports
}

fn queue() -> ConnectOptions {
    ConnectOptions { queue: Some(Queue::Fifo { depth: 64, drop_oldest: true }), ..ConnectOptions::default() }
}

fn tap(info: &ClassInfo, name: &str) -> StructType {
    let output = info.ports.outputs.iter().find(|output| output.name == name).unwrap();
    match &output.ty {
        PortType::Plain(Type::Struct(told)) => StructType::clone(told),
        other => panic!("{other:?}"),
    }
}

/// Name, outcome and payload of a sample, by its type alone.
fn read(told: &StructType, bytes: &[u8]) -> (String, Value, Value) {
    let sample = decode(&Type::Struct(Arc::new(told.clone())), bytes).unwrap();
    let which = sample["which"].as_str().unwrap().to_owned();
    assert_eq!(sample["len"], sample["whole"], "{which}");
    let len = usize::try_from(sample["len"].as_u64().unwrap()).unwrap();
    let payload = told.fields.iter().find(|field| field.name == which).map(|field| {
        let Type::Array { item, n: 0 } = &field.ty else { panic!("{field:?}") };
        assert_eq!(item.size(), len);
        decode(item, &bytes[16..16 + len]).unwrap()
    });
    (which, sample.get("outcome").cloned().unwrap_or_default(), payload.unwrap_or_default())
}

#[tokio::test]
async fn each_command_is_told_with_its_argument_and_what_came_of_it() {
    let world = World::new("tap_commands");
    let (moody, taker) = (Arc::new(Moody::default()), Arc::new(Taker::<3>::default()));
    let info = class(settable(), Safety::None);
    let told = tap(&info, TAPS[2]);
    assert_eq!(told.size, 24, "the head, and room for the largest argument");
    world.create_as("server", info, model(ExecutionModel::OnSignal), moody.clone()).await;
    let sink = class(any(), Safety::None);
    world.create_as("taker", sink, model(ExecutionModel::OnSignal), taker.clone()).await;
    for name in ["server", "taker"] {
        world.start(name).await;
    }
    world.call("server").await.unwrap();
    world.connect(1, "taker/in", "server/tap_commands", queue()).await;
    let set = async |value: u64| {
        let member = MemberId::parse("tap_commands/server/ctl/set").unwrap();
        let arg = Payload::Json(json!(value));
        world.lcm.invoke(Invoke { member, arg, send: false, deadline_ns: 20_000_000_000 }).await.map(|_| ())
    };
    set(7).await.unwrap();
    world.send("server").await;
    world.call("server").await.unwrap();
    moody.0.store(true, Ordering::SeqCst);
    set(8).await.unwrap_err();
    world.run("server", Verb::Stop).await.unwrap();
    set(9).await.unwrap_err();
    eventually("all are told", || taker.len() >= 5).await;
    let all = taker.all();
    let seen: Vec<_> = all.iter().map(|(bytes, _)| read(&told, bytes)).collect();
    let want = [
        ("ctl/set", "EXECUTED", json!(7)),
        ("ctl/do", "EXECUTED", Value::Null),
        ("ctl/do", "EXECUTED", Value::Null),
        ("ctl/set", "FAILED", json!(8)),
        ("ctl/set", "NOT_ACTIVE", json!(9)),
    ];
    let want: Vec<_> =
        want.into_iter().map(|(name, came, arg)| (name.to_owned(), json!(came), arg)).collect();
    assert_eq!(seen, want);
    let numbers: Vec<u64> = all.iter().map(|(_, seq)| *seq).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 5], "what came before anybody listened is not counted");
    world.end().await;
}

#[tokio::test]
async fn a_goal_that_waited_too_long_for_an_actuator_is_told_as_never_run() {
    // 50 Hz: three periods are less than the longest wait of other goals.
    const PERIOD_NS: u64 = 20_000_000;
    const GOAL_NS: u64 = 100_000_000;
    const SET: u32 = 2;
    const SERVO: u32 = 3;
    const STATE: u32 = 4;
    let world = World::new("tap_late");
    let taker = Arc::new(Taker::<7>::default());
    let mut ports = settable();
    let commands = &mut ports.provided[0].commands;
    commands.push(Command { name: "servo_jp".into(), ..commands[SET as usize].clone() });
    let mut state = Command { name: "state_command".into(), ..commands[SET as usize].clone() };
    state.arg.as_mut().unwrap().ty = Type::Text { n: 32 };
    commands.push(state);
    let info = class(ports, Safety::Actuator);
    let told = tap(&info, TAPS[2]);
    world.create_as("arm", info, periodic(50), Arc::new(Moody::default())).await;
    let sink = class(any(), Safety::None);
    world.create_as("taker", sink, model(ExecutionModel::OnSignal), taker.clone()).await;
    for name in ["arm", "taker"] {
        world.start(name).await;
    }
    world.connect(1, "taker/in", "arm/tap_commands", queue()).await;
    let arm = world.lcm.instance(&world.id("arm")).unwrap();
    let inbox = arm.described.now().external.clone();
    let now_ns = os::now_ns();
    // A stamp in the future: these goals are young when they are taken, however late this machine is.
    let young_ns = now_ns + 600_000_000_000;
    let number = |n: u64| n.to_ne_bytes().to_vec();
    let word = |word: &str| {
        let mut text = number(word.len() as u64);
        text.extend(word.bytes());
        text.resize(40, 0);
        text
    };
    for (index, sent_ns, arg) in [
        (SERVO, now_ns - 3 * PERIOD_NS - 1, number(1)),
        (SET, now_ns - GOAL_NS - 1, number(2)),
        // A word that sets it in motion is a goal; one that lets it rest is right however late it comes.
        (STATE, now_ns - GOAL_NS - 1, word("home")),
        (SERVO, young_ns, number(3)),
        (SET, young_ns, number(4)),
        (STATE, young_ns, word("resume")),
        (STATE, now_ns - GOAL_NS - 1, word("disable")),
    ] {
        let head = EntryHead { kind: ENTRY_COMMAND, index, reply: 0, stamp_ns: sent_ns };
        assert_eq!(inbox.mailbox.push(head, &arg, Overflow::Reject), Push::Queued);
    }
    arm.signal();
    eventually("all are told", || taker.len() >= 7).await;
    let seen: Vec<_> = taker.all().iter().map(|(bytes, _)| read(&told, bytes)).collect();
    let want = [
        ("ctl/servo_jp", "DEADLINE", json!(1)),
        ("ctl/set", "DEADLINE", json!(2)),
        ("ctl/state_command", "DEADLINE", json!("home")),
        ("ctl/servo_jp", "EXECUTED", json!(3)),
        ("ctl/set", "EXECUTED", json!(4)),
        ("ctl/state_command", "EXECUTED", json!("resume")),
        ("ctl/state_command", "EXECUTED", json!("disable")),
    ];
    let want: Vec<_> =
        want.into_iter().map(|(name, came, arg)| (name.to_owned(), json!(came), arg)).collect();
    assert_eq!(seen, want);
    assert_eq!(inbox.unexecuted(), 3);
    world.end().await;
}

#[tokio::test]
async fn events_are_told_and_nobody_else_hears_of_it() {
    const WORDS: usize = (16 + trocar_loader::system::MAX_BYTES) / 8;
    let world = World::new("tap_events");
    let taker = Arc::new(Taker::<WORDS>::default());
    let info = class(ctl(), Safety::None);
    let told = tap(&info, TAPS[1]);
    assert_eq!(told.size, WORDS * 8);
    world.create_as("server", info, model(ExecutionModel::OnSignal), Arc::new(Moody::default())).await;
    let sink = class(any(), Safety::None);
    world.create_as("taker", sink, model(ExecutionModel::OnSignal), taker.clone()).await;
    world.start("taker").await;
    world.connect(1, "taker/in", "server/tap_events", queue()).await;
    world.start("server").await;
    world.run("server", Verb::Stop).await.unwrap();
    eventually("both changes are told", || taker.len() >= 2).await;
    let seen: Vec<_> = taker.all().iter().map(|(bytes, _)| read(&told, bytes)).collect();
    let states: Vec<_> =
        seen.iter().map(|(which, _, status)| (which.as_str(), status["state"].clone())).collect();
    let change = "system/state_changed";
    assert_eq!(states, [(change, json!("ACTIVE")), (change, json!("STOPPED{requested}"))]);
    let links = world.lcm.links().await.unwrap();
    assert_eq!((links[0].passed, links[0].dropped), (2, 0));
    world.end().await;
}

#[tokio::test]
async fn what_finds_its_queue_full_is_a_counted_drop() {
    let world = World::new("tap_drops");
    let taker = Arc::new(Taker::<2>::default());
    let server = class(ctl(), Safety::None);
    world.create_as("server", server, model(ExecutionModel::OnSignal), Arc::new(Moody::default())).await;
    world
        .create_as("taker", class(any(), Safety::None), model(ExecutionModel::OnSignal), taker.clone())
        .await;
    world.start("server").await;
    let short = Some(Queue::Fifo { depth: 4, drop_oldest: true });
    let options = ConnectOptions { queue: short, ..ConnectOptions::default() };
    world.connect(1, "taker/in", "server/tap_commands", options).await;
    for _ in 0..10 {
        world.call("server").await.unwrap();
    }
    // The last one is told at the end of the turn that has answered it.
    let mut dropped = 0;
    while dropped < 6 {
        tokio::task::yield_now().await;
        let links = world.lcm.links().await.unwrap();
        assert_eq!(links[0].passed, 0);
        dropped = links[0].dropped;
    }
    assert_eq!(dropped, 6);
    world.end().await;
}
