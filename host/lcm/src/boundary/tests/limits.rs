//! Limits hold and losses are counted: drains, queues that are cut, pools of frames.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::{ThreadId, current};

use serde_json::{Value, json};
use trocar_model::{ConnectOptions, Queue, Refusal, State, Verb};
use trocar_plugin_api::abi::*;

use super::commands::{POKE, client, server};
use super::script::*;
use super::world::*;

/// The client that floods its server, for the server's command.
type Flooder = Arc<OnceLock<&'static Stage>>;

/// A first step or event that waits for a word of the test.
fn gate() -> (impl Fn() + Send + Sync, Receiver<()>, Sender<()>) {
    let (begun, heard) = channel();
    let (go, wait) = channel::<()>();
    let wait = Mutex::new(Some(wait));
    let pass = move || {
        if let Some(wait) = wait.lock().unwrap().take() {
            let _ = begun.send(());
            // The test lets go, or has ended.
            let _ = wait.recv();
        }
    };
    (pass, heard, go)
}

#[test]
fn a_client_that_sends_one_more_for_each_command_that_runs_keeps_its_server_from_no_step() {
    let world = World::new("rounds");
    let (pass, heard, go) = gate();
    let (ran, flooder) = (Arc::new(AtomicU64::new(0)), Flooder::default());
    let (counted, who) = (ran.clone(), flooder.clone());
    let step = move |stage: &Stage| {
        stage.note(counted.load(Ordering::SeqCst));
        pass();
        STATUS_OK
    };
    let command = move |_: &Stage, _: u32, _: u64| {
        if ran.fetch_add(1, Ordering::SeqCst) < 40 {
            assert_eq!(who.get().unwrap().send(POKE, 0), QUEUED);
        }
        Ok(0)
    };
    let script = Script { step: Some(Box::new(step)), command: Some(Box::new(command)), ..Script::default() };
    let server = world.active("server", &server(), on_signal(), script);
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.connect("client/peer", "server/ctl");
    flooder.set(client).unwrap_or_else(|_| panic!("set once"));
    world.instance("server").signal();
    heard.recv().unwrap();
    (0..3).for_each(|_| assert_eq!(client.send(POKE, 0), QUEUED));
    go.send(()).unwrap();
    eventually("the flood's end", || server.seen().last() == Some(&43));
    let steps = server.seen();
    // The calls already there, and once those that came meanwhile: twice three, then a step.
    assert_eq!(steps[..4], [0, 6, 12, 18], "{steps:?}");
}

#[test]
fn a_caller_of_a_passive_server_that_is_flooded_comes_back_and_the_servers_own_thread_goes_on() {
    let world = World::new("passive-rounds");
    let (flooder, over) = (Flooder::default(), Arc::new(AtomicBool::new(false)));
    let ran: Arc<Mutex<Vec<ThreadId>>> = Arc::default();
    let (who, threads, ends) = (flooder.clone(), ran.clone(), over.clone());
    let command = move |_: &Stage, _: u32, _: u64| {
        threads.lock().unwrap().push(current().id());
        if !ends.load(Ordering::SeqCst) {
            let _ = who.get().unwrap().send(POKE, 0);
        }
        Ok(0)
    };
    let script = Script { command: Some(Box::new(command)), ..Script::default() };
    world.active("server", &server(), passive(), script);
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.connect("client/peer", "server/ctl");
    flooder.set(client).unwrap_or_else(|_| panic!("set once"));
    assert_eq!(client.send(POKE, 0), EXECUTED, "and it came back");
    let here = |threads: &[ThreadId]| threads.iter().filter(|id| **id == current().id()).count();
    // Its own call, then twice those already there and once those that came meanwhile.
    assert_eq!(here(&ran.lock().unwrap()), 5);
    eventually("the others, on another thread", || ran.lock().unwrap().len() > 100);
    assert_eq!(here(&ran.lock().unwrap()), 5, "nobody else's commands later on");
    over.store(true, Ordering::SeqCst);
}

#[test]
fn events_that_are_queued_when_their_connection_is_cut_are_counted_as_lost() {
    let world = World::new("cut-events");
    let (pass, heard, go) = gate();
    let on_event = move |stage: &Stage, _: u32, payload: u64| {
        pass();
        stage.note(payload);
        STATUS_OK
    };
    let script = Script { on_event: Some(Box::new(on_event)), ..Script::default() };
    let observer = world.active("observer", &client(false), on_signal(), script);
    let server = world.active("server", &server(), on_signal(), Script::default());
    let options = ConnectOptions { mailbox: Some(2), ..ConnectOptions::default() };
    let connection = world.connection("observer/peer", "server/ctl", options);
    world.apply(trocar_model::Change::Connect { connection: connection.clone() }).unwrap();
    assert_eq!(server.emit(0, 1), EXECUTED);
    heard.recv().unwrap();
    assert_eq!([2, 3, 4].map(|n| server.emit(0, n)), [EXECUTED, EXECUTED, QUEUE_FULL]);
    world.cut(&connection);
    assert_eq!(server.emit(0, 5), UNBOUND, "nobody is there, nothing is lost");
    assert_eq!(world.instance("observer").queue_losses(), [0, 3], "two thrown out, one that found no room");
    go.send(()).unwrap();
    eventually("the event that had begun", || observer.seen() == [1]);
    let lost = world.instance("observer").queue_losses();
    assert_eq!(lost, [0, 3], "one that ran is not lost");
}

fn frames(max_bytes: usize) -> Value {
    json!({"outputs": [{"name": "video", "type": {"frame": "u64", "format": "image", "max_bytes": max_bytes}}]})
}

#[test]
fn frames_that_no_slot_was_left_for_are_counted_whatever_pool_comes_next() {
    let world = World::new("exhausted");
    let source = world.active("source", &frames(64), on_signal(), Script::default());
    let sink =
        json!({"inputs": [{"name": "video", "type": {"frame": "u64", "format": "image", "max_bytes": 64}}]});
    let sink = world.active("sink", &sink, on_signal(), Script::default());
    world.connect("sink/video", "source/video");
    let slot = source.output(0);
    let loan = || {
        let mut loan = Loan::EMPTY;
        // SAFETY: a slot of this instance, and room for a loan.
        let outcome = unsafe { (slot.loan)(slot.ctx, &raw mut loan) };
        (outcome, loan)
    };
    let mut lent: Vec<Loan> = Vec::new();
    let refused = loop {
        match loan() {
            (EXECUTED, loan) => lent.push(loan),
            (refused, _) => break refused,
        }
    };
    assert_eq!((refused, lent.len()), (EXHAUSTED, 8));
    assert_eq!(source.frame(0, 1, b"no room"), EXHAUSTED);
    let dropped = || world.instance("source").described.now().slots.output(0).exhausted();
    assert_eq!(dropped(), 2);
    // SAFETY: a slot of this instance.
    assert_eq!(unsafe { (slot.reserve)(slot.ctx, 64, 2) }, EXECUTED, "another pool");
    assert_eq!(source.frame(0, 2, b"room"), EXECUTED);
    assert_eq!(dropped(), 2, "what was refused before is not forgotten");
    let (a, b, c) = (loan(), loan(), loan());
    assert_eq!((a.0, b.0, c.0), (EXECUTED, EXHAUSTED, EXHAUSTED), "one is at the sink");
    assert_eq!(dropped(), 4);
    assert_eq!(sink.next(0, 8).unwrap().bytes, b"room");
    for mut loan in lent.into_iter().chain([a.1]) {
        // SAFETY: a loan of this output, whichever of its pools it is from.
        unsafe { (slot.cancel)(slot.ctx, &raw mut loan) };
    }
    assert_eq!(loan().0, EXECUTED);
}

/// Frames of a gigabyte at so many outputs that no machine has the memory.
fn too_many_frames() -> Value {
    let output = |n| json!({"name": format!("video{n}"), "type": {"frame": "u64", "format": "image", "max_bytes": 1 << 30}});
    json!({"outputs": (0..5000).map(output).collect::<Vec<_>>()})
}

/// The refusal says how much was asked for and how much there is.
fn says_how_much(refusal: &Refusal) {
    let Refusal::NoMemory { outputs, bytes, why, .. } = refusal else { panic!("{refusal}") };
    assert_eq!((outputs.len(), refusal.code()), (5000, trocar_model::Code::ResourceExhausted));
    assert!(*bytes >= 5000 << 33 && why.contains("bytes of memory are available"), "{bytes}: {why}");
}

#[test]
fn frames_that_there_is_no_memory_for_are_refused_by_create_and_leave_nothing() {
    let world = World::new("no-room");
    let refusal = world.try_create("camera", &too_many_frames(), on_signal(), Script::default()).unwrap_err();
    says_how_much(&refusal);
    assert!(world.lcm.instance(&world.id("camera")).is_err());
    world.try_create("camera", &frames(64), on_signal(), Script::default()).unwrap();
}

#[test]
fn a_configuration_whose_frames_have_no_room_is_taken_back_and_one_that_is_wished_for_is_a_fault() {
    let world = World::new("no-room-later");
    let huge = json!({"types": types(), "class": class("camera", &too_many_frames())}).to_string();
    let (configured, camera) = (Arc::new(AtomicU64::new(0)), world.id("camera"));
    let (count, text, id) = (configured.clone(), huge.clone(), camera.clone());
    // The first and the third configuration ask for too much.
    let configure = move |_: &Stage| {
        let too_much = matches!(count.fetch_add(1, Ordering::SeqCst), 0 | 2);
        *script_of(&id).described.lock() = if too_much { text.clone() } else { String::new() };
        STATUS_OK
    };
    let script = Script { configure: Some(Box::new(configure)), ..Script::default() };
    let stage = world.create("camera", &frames(64), on_signal(), script);
    says_how_much(&world.configure("camera").unwrap_err());
    assert_eq!(world.instance("camera").state(), State::Created);
    world.configure("camera").unwrap();
    world.run("camera", Verb::Start).unwrap();
    says_how_much(&world.configure("camera").unwrap_err());
    assert_eq!(configured.load(Ordering::SeqCst), 4, "it was given its former configuration again");
    assert_eq!((world.instance("camera").state(), stage().counts()[0]), (State::Active, 1));
    world.describes("camera", huge);
    assert_eq!(stage().ports_changed(), QUEUED);
    eventually("FAULT", || world.instance("camera").state() == State::Fault);
    let fault = world.instance("camera").report(false).fault;
    let says = |part: &str| assert!(fault.contains(part), "{part}: {fault}");
    ["describe", "video0, video1, video2 and 4997 more", "are available"].into_iter().for_each(says);
}

#[test]
fn a_pool_a_component_asks_for_and_does_not_get_is_told_with_the_output_and_the_bytes() {
    let world = World::new("no-room-asked");
    let outcomes = Arc::new(Mutex::new(Vec::new()));
    let told = outcomes.clone();
    let configure = move |stage: &Stage| {
        let slot = stage.output(0);
        let ask = |bytes, slots| {
            // SAFETY: a slot of this instance.
            unsafe { (slot.reserve)(slot.ctx, bytes, slots) }
        };
        told.lock().unwrap().extend([ask(1 << 40, 4096), ask(1, 4097), ask(64, 2)]);
        STATUS_OK
    };
    let script = Script { configure: Some(Box::new(configure)), ..Script::default() };
    world.try_create("camera", &frames(64), on_signal(), script).unwrap();
    let warnings = world.configure("camera").unwrap().warnings;
    assert_eq!(*outcomes.lock().unwrap(), [EXHAUSTED, INVALID_ARGUMENT, EXECUTED]);
    let says = |parts: &[&str]| {
        assert!(warnings.iter().any(|w| parts.iter().all(|p| w.contains(p))), "{parts:?}: {warnings:?}");
    };
    says(&["video:", "4096 frames of 1099511627776 bytes", "are available"]);
    says(&["video:", "4097 frames", "at most 4096"]);
}

#[test]
fn a_sample_stamped_ahead_of_time_does_not_hide_that_nothing_comes_after_it() {
    let world = World::new("ahead");
    let plain = json!({"name": "x", "type": {"plain": "u64"}});
    let source = world.active("source", &json!({"outputs": [plain]}), on_signal(), Script::default());
    world.active("sink", &json!({"inputs": [plain]}), on_signal(), Script::default());
    const MAX_AGE_NS: u64 = 1_000_000_000;
    let options = ConnectOptions { max_age_ns: Some(MAX_AGE_NS), ..ConnectOptions::default() };
    let connection = world.connection("sink/x", "source/x", options);
    world.apply(trocar_model::Change::Connect { connection }).unwrap();
    let write = |stamp_ns: u64| {
        let slot = source.output(0);
        // SAFETY: a slot of this instance, a value of its size.
        unsafe { (slot.write)(slot.ctx, (&raw const stamp_ns).cast(), stamp_ns) }
    };
    let stale = |at_ns| world.instance("sink").stale_inputs(at_ns);
    for ahead in [trocar_rt::now_ns() + 3_600_000_000_000, u64::MAX] {
        assert_eq!(write(ahead), EXECUTED);
        let now_ns = trocar_rt::now_ns();
        assert!(stale(now_ns).is_empty(), "it has just come");
        assert_eq!(stale(now_ns + MAX_AGE_NS + 1), ["x"], "nothing came for longer than max_age");
    }
}

/// A clock that is ahead, a queue, and a reader that did not look: a sample is as old as its wait in the
/// queue.
#[test]
fn a_sample_stamped_ahead_of_time_grows_old_in_a_queue_although_newer_ones_come() {
    const MAX_AGE_NS: u64 = 20_000_000;
    for carrier in ["heap", "memfd"] {
        let world = World::new(&format!("ahead_{carrier}"));
        let plain = json!({"name": "x", "type": {"plain": "u64"}});
        let queue = json!({"name": "x", "type": {"plain": "u64"}, "fifo": 4});
        let source = world.active("source", &json!({"outputs": [plain]}), on_signal(), Script::default());
        // The sink never steps by itself, as if it were frozen: the test looks in its place.
        let sink = world.active("sink", &json!({"inputs": [queue]}), passive(), Script::default());
        let options = ConnectOptions {
            queue: Some(Queue::Fifo { depth: 4, drop_oldest: true }),
            max_age_ns: Some(MAX_AGE_NS),
            carrier: carrier.into(),
            ..ConnectOptions::default()
        };
        let connection = world.connection("sink/x", "source/x", options);
        world.apply(trocar_model::Change::Connect { connection }).unwrap();
        let slot = source.output(0);
        let write = |stamp_ns: u64| {
            // SAFETY: a slot of this instance, a value of its size.
            unsafe { (slot.write)(slot.ctx, (&raw const stamp_ns).cast(), stamp_ns) }
        };
        let next = || {
            let slot = sink.input(0);
            let mut view = SampleView::EMPTY;
            // SAFETY: a slot of this instance, which nobody else is inside; room for a view.
            assert_eq!(unsafe { (slot.next)(slot.ctx, &raw mut view) }, IN_SAMPLE, "{carrier}");
            (view.stamp_ns, view.flags & SAMPLE_STALE != 0)
        };
        let hour_ns = 3_600_000_000_000;
        let first = trocar_rt::now_ns() + hour_ns;
        assert_eq!(write(first), EXECUTED);
        let until_ns = trocar_rt::now_ns() + MAX_AGE_NS;
        eventually("the first one has waited", || trocar_rt::now_ns() > until_ns);
        assert_eq!(write(first + 1), EXECUTED);
        assert_eq!(next(), (first, true), "{carrier}: it has waited longer than max_age");
        assert_eq!(next().0, first + 1, "{carrier}: its stamp is shown as it was given");
    }
}
