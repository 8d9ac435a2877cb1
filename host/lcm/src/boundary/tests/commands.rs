//! Every outcome a call can have, and events: queued, direct, lost.

use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar_model::{ConnectOptions, Execution, Verb};
use trocar_plugin_api::abi::*;
use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::os;
use trocar_rt::reply::Reply;

use super::super::super::inbox::ENTRY_DUE;
use super::script::*;
use super::world::*;

/// poke, set, twice, value; event rang.
pub(super) fn server() -> Value {
    json!({"provided": [{"name": "ctl", "commands": [
        {"name": "poke", "kind": "void"},
        {"name": "set", "kind": "write", "arg": {"type": "u64", "min": 0.0, "max": 100.0}},
        {"name": "twice", "kind": "write_return", "arg": {"type": "u64"}, "ret": "u64"},
        {"name": "value", "kind": "read", "ret": "u64"},
    ], "events": [{"name": "rang", "payload": "u64"}]}]})
}

pub(super) const POKE: usize = 0;
pub(super) const SET: usize = 1;
pub(super) const TWICE: usize = 2;
pub(super) const VALUE: usize = 3;

pub(super) fn client(direct: bool) -> Value {
    json!({"required": [{"name": "peer", "functions": [
        {"name": "poke"},
        {"name": "set", "arg": "u64"},
        {"name": "twice", "arg": "u64", "ret": "u64"},
        {"name": "value", "ret": "u64"},
    ], "handlers": [{"name": "rang", "payload": "u64", "direct": direct}]}]})
}

/// Keeps arguments, doubles, and fails on 13.
pub(super) fn obeys() -> Script {
    Script {
        command: Some(Box::new(|stage, id, arg| {
            stage.note(u64::from(id));
            match (id as usize % 4, arg) {
                (TWICE, 13) => Err(STATUS_FAILED),
                (TWICE, 14) => Err(STATUS_PANICKED),
                (TWICE, n) => Ok(2 * n),
                (SET, n) => {
                    stage.state.store(n, std::sync::atomic::Ordering::Relaxed);
                    Ok(0)
                }
                _ => Ok(0),
            }
        })),
        ..Script::default()
    }
}

/// A server whose commands wait for a word of the test; the test is told when one has begun.
fn held_up() -> (Script, mpsc::Receiver<()>, mpsc::Sender<()>) {
    let (begun, heard) = mpsc::channel();
    let (go, wait) = mpsc::channel::<()>();
    let wait = Mutex::new(wait);
    let command = move |_: &Stage, _: u32, arg: u64| {
        let _ = begun.send(());
        let _ = wait.lock().unwrap().recv();
        Ok(arg)
    };
    (Script { command: Some(Box::new(command)), ..Script::default() }, heard, go)
}

/// A client, and a server that it has just occupied with a POKE.
struct Busy {
    world: World,
    client: &'static Stage,
    go: mpsc::Sender<()>,
}

impl Busy {
    fn new(process: &'static str) -> Busy {
        let world = World::new(process);
        let client = world.active("client", &client(false), on_signal(), Script::default());
        let (script, heard, go) = held_up();
        world.active("server", &server(), on_signal(), script);
        world.connect("client/peer", "server/ctl");
        assert_eq!(client.send(POKE, 0), QUEUED);
        heard.recv().unwrap();
        Busy { world, client, go }
    }
}

#[test]
fn without_a_connection_every_call_is_unbound_and_after_a_cut_again() {
    let world = World::new("unbound");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.active("server", &server(), passive(), obeys());
    assert_eq!(client.send(POKE, 0), UNBOUND);
    assert_eq!(client.ask(VALUE, 0).outcome, UNBOUND);
    let connection = world.connect("client/peer", "server/ctl");
    assert_eq!(client.send(POKE, 0), EXECUTED);
    world.cut(&connection);
    assert_eq!(client.send(POKE, 0), UNBOUND);
}

#[test]
fn a_passive_server_executes_in_the_callers_thread_and_says_what_failed() {
    let world = World::new("executed");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    let server = world.active("server", &server(), passive(), obeys());
    world.connect("client/peer", "server/ctl");
    assert_eq!(client.send(SET, 42), EXECUTED);
    assert_eq!(client.ask(VALUE, 0).ret, 42, "a read sees what a command has just done");
    assert_eq!(client.ask(TWICE, 4).ret, 8);
    let failed = client.ask(TWICE, 13);
    assert_eq!((failed.outcome, failed.text.as_str()), (FAILED, "as the test wants"));
    assert_eq!(client.send(SET, 101), INVALID_ARGUMENT, "above its declared maximum");
    assert_eq!(server.seen(), [SET as u64, TWICE as u64, TWICE as u64], "a refused argument never arrives");
}

#[test]
fn a_server_on_another_thread_queues_and_answers() {
    let world = World::new("queued");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    let server = world.active("server", &server(), on_signal(), obeys());
    world.connect("client/peer", "server/ctl");
    assert_eq!(client.send(SET, 7), QUEUED);
    assert_eq!(client.ask(TWICE, 21).ret, 42, "queued behind the write of the same client");
    assert_eq!(server.seen(), [SET as u64, TWICE as u64]);
    assert_eq!(client.ask(TWICE, 13).outcome, FAILED);
}

#[test]
fn who_is_not_active_is_named_so_and_a_panic_ends_it() {
    let world = World::new("inactive");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    let _ = world.create("server", &server(), on_signal(), obeys());
    world.connect("client/peer", "server/ctl");
    assert_eq!(client.send(POKE, 0), NOT_ACTIVE);
    world.configure("server").unwrap();
    world.run("server", Verb::Start).unwrap();
    assert_eq!(client.send(POKE, 0), QUEUED);
    assert_eq!(client.ask(TWICE, 14).outcome, FAILED);
    eventually("FAULT", || world.instance("server").state() == trocar_model::State::Fault);
    assert_eq!(client.ask(TWICE, 1).outcome, NOT_ACTIVE);
}

#[test]
fn a_deadline_says_whether_the_command_may_still_run() {
    let world = World::new("deadline");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    let (script, heard, go) = held_up();
    world.active("server", &server(), on_signal(), script);
    world.connect("client/peer", "server/ctl");
    // On a busy machine a server may not come to a command within that time: the client asks again.
    eventually("a command that has begun", || {
        let asked = client.call(TWICE, 1, MODE_CALL, Duration::from_millis(20));
        assert_eq!(asked.outcome, DEADLINE);
        asked.may_still_run
    });
    heard.recv().unwrap();
    let waiting = client.call(TWICE, 2, MODE_CALL, Duration::from_millis(20));
    assert_eq!((waiting.outcome, waiting.may_still_run), (DEADLINE, false));
    go.send(()).unwrap();
    go.send(()).unwrap();
    assert_eq!(client.ask(TWICE, 3).ret, 3, "what was given up is not executed: the next answer is for 3");
}

#[test]
fn an_actuator_carries_out_no_goal_from_before_a_standstill() {
    for (safety, ran) in [("actuator", vec![POKE, POKE, SET]), ("none", vec![POKE, SET, POKE, SET])] {
        let world = World::new(&format!("standstill-{safety}"));
        let client = world.active("client", &client(false), on_signal(), Script::default());
        let (begun, heard) = mpsc::channel();
        let (go, wait) = mpsc::channel::<()>();
        let wait = Mutex::new(wait);
        let command = move |_: &Stage, id: u32, _: u64| {
            begun.send(id as usize % 4).unwrap();
            wait.lock().unwrap().recv().unwrap();
            Ok(0)
        };
        let mut ports = server();
        ports["safety"] = safety.into();
        // Patience enough to wait inside a command.
        let patient = Execution { max_step_ns: Some(60_000_000_000), ..on_signal() };
        world.active(
            "server",
            &ports,
            patient,
            Script { command: Some(Box::new(command)), ..Script::default() },
        );
        world.connect("client/peer", "server/ctl");
        assert_eq!(client.send(POKE, 0), QUEUED);
        let mut seen = vec![heard.recv().unwrap()];
        assert_eq!([client.send(SET, 1), client.send(POKE, 0)], [QUEUED, QUEUED]);
        let since = Instant::now();
        eventually("the goal is old", || since.elapsed() > Duration::from_millis(110));
        assert_eq!(client.send(SET, 2), QUEUED, "what is sent now is right");
        for _ in 1..ran.len() {
            go.send(()).unwrap();
            seen.push(heard.recv().unwrap());
        }
        go.send(()).unwrap();
        assert_eq!(seen, ran, "{safety}");
    }
}

#[test]
fn a_full_queue_refuses_and_is_counted_per_connection() {
    let world = World::new("full");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    let (script, heard, go) = held_up();
    world.active("server", &server(), on_signal(), script);
    let options = ConnectOptions { mailbox: Some(2), ..ConnectOptions::default() };
    let connection = world.connection("client/peer", "server/ctl", options);
    world.apply(trocar_model::Change::Connect { connection }).unwrap();
    assert_eq!(client.send(POKE, 0), QUEUED);
    heard.recv().unwrap();
    assert_eq!([client.send(POKE, 0), client.send(POKE, 0)], [QUEUED, QUEUED]);
    assert_eq!(client.send(POKE, 0), QUEUE_FULL);
    assert_eq!(world.instance("server").queue_losses(), [1, 0]);
    (0..3).for_each(|_| go.send(()).unwrap());
}

#[test]
fn a_caller_is_answered_when_its_server_is_removed_or_its_connection_cut_in_the_middle() {
    let world = World::new("lost");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    let (script, heard, go) = held_up();
    world.active("server", &server(), on_signal(), script);
    let connection = world.connect("client/peer", "server/ctl");
    std::thread::scope(|scope| {
        let running = scope.spawn(|| client.ask(TWICE, 1));
        heard.recv().unwrap();
        let queued = scope.spawn(|| client.ask(TWICE, 2));
        let queue =
            || world.instance("server").queues().iter().map(|i| i.mailbox.stats().queued).sum::<u64>();
        eventually("the second call", || queue() == 1);
        world.cut(&connection);
        assert_eq!(queued.join().unwrap().outcome, PEER_LOST);
        go.send(()).unwrap();
        assert_eq!(running.join().unwrap().ret, 1, "what had begun is answered");
    });
    let connection = world.connect("client/peer", "server/ctl");
    drop(go);
    world.remove("server");
    world.cut(&connection);
    assert_eq!(client.ask(TWICE, 3).outcome, UNBOUND);
}

/// After a standstill of the machine the server's thread may come first: its caller has not given up yet.
#[test]
fn a_call_whose_deadline_has_passed_is_not_begun_although_its_caller_still_waits() {
    let Busy { world, go, .. } = &Busy::new("overdue");
    let inbox = world.instance("server").queues()[0].clone();
    let ask = |until_ns: u64| {
        let ticket = inbox.replies.acquire().unwrap();
        let head =
            EntryHead { kind: ENTRY_DUE, index: TWICE as u32, reply: ticket.token(), stamp_ns: until_ns };
        assert_eq!(inbox.mailbox.push(head, &7u64.to_ne_bytes(), Overflow::Reject), Push::Queued);
        ticket
    };
    let later_ns = os::now_ns() + 60_000_000_000;
    let (overdue, in_time) = (ask(os::now_ns() - 1), ask(later_ns));
    world.instance("server").signal();
    (0..2).for_each(|_| go.send(()).unwrap());
    for (ticket, outcome) in [(overdue, DEADLINE), (in_time, EXECUTED)] {
        let reply = ticket.wait(later_ns, |_, _| ());
        assert!(matches!(reply, Reply::Done(o) if o == outcome), "{reply:?} instead of {outcome}");
    }
}

/// The caller saw the server ACTIVE; then the server was stopped and its queued calls were answered; only
/// then the caller came to the queue.
#[test]
fn a_call_that_comes_to_the_queue_after_its_server_was_stopped_is_answered_although_its_thread_is_held_up() {
    let Busy { world, client, go, .. } = &Busy::new("overtaken");
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| client.ask(TWICE, 1));
        let queue = || world.instance("server").queues().iter().any(|i| !i.mailbox.is_empty());
        eventually("the first call waits", queue);
        let stop = scope.spawn(|| world.run("server", Verb::Stop));
        assert_eq!(waiting.join().unwrap().outcome, NOT_ACTIVE);
        let instance = world.instance("server");
        let set = instance.described.now();
        let target = crate::passage::target(&instance.core, &set, TWICE, &set.external, TWICE, 0);
        let crate::boundary::FnBinding::Command(twice) = &target else { panic!("it is a command") };
        let (arg, mut ret) = (2u64, 0u64);
        let (arg, ret) = ((&raw const arg).cast(), (&raw mut ret).cast());
        // Longer than the test would wait if the call were not answered.
        let overtaken = twice.queue(arg, ret, MODE_CALL, 3_000_000_000, None);
        go.send(()).unwrap();
        assert_eq!(overtaken, NOT_ACTIVE);
        stop.join().unwrap().unwrap();
    });
}

#[test]
fn a_step_never_waits_for_another_thread_but_calls_its_own() {
    let world = World::new("step");
    let step = |stage: &Stage| {
        stage.note(stage.ask(TWICE, 5).outcome as u64);
        stage.note(stage.send(POKE, 0) as u64);
        STATUS_OK
    };
    let script = Script { step: Some(Box::new(step)), ..obeys() };
    let mut class = server();
    class["required"] = client(false)["required"].clone();
    let head = world.active("head", &class, on_signal(), script);
    world.active("near", &server(), with(&world.id("head")), obeys());
    world.active("far", &server(), on_signal(), obeys());
    world.active("rings", &client(false), on_signal(), Script::default());
    world.connect("rings/peer", "head/ctl");
    let wake = |expected: [Outcome; 2]| {
        head.forget();
        world.instance("head").signal();
        let expected: Vec<u64> = expected.iter().map(|o| *o as u64).collect();
        eventually("the step's calls", || head.seen() == expected);
    };
    let near = world.connect("head/peer", "near/ctl");
    wake([EXECUTED, EXECUTED]);
    world.cut(&near);
    world.connect("head/peer", "far/ctl");
    wake([WOULD_BLOCK, QUEUED]);
}

#[test]
fn several_threads_call_through_one_function_and_each_gets_its_own_answer() {
    let world = World::new("threads");
    let client = world.active("client", &client(false), on_signal(), Script::default());
    world.active("server", &server(), on_signal(), obeys());
    world.connect("client/peer", "server/ctl");
    std::thread::scope(|scope| {
        for thread in 0..4u64 {
            scope.spawn(move || {
                for n in (0..200).map(|n| 1000 * (thread + 1) + n) {
                    assert_eq!(client.ask(TWICE, n).ret, 2 * n);
                }
            });
        }
    });
}

#[test]
fn events_are_queued_in_order_and_what_a_full_queue_loses_is_counted_and_told() {
    let world = World::new("events");
    let (begun, heard) = mpsc::channel();
    let (go, wait) = mpsc::channel::<()>();
    let wait = Mutex::new(wait);
    let on_event = move |stage: &Stage, _: u32, payload: u64| {
        let _ = begun.send(());
        let _ = wait.lock().unwrap().recv();
        stage.note(payload);
        STATUS_OK
    };
    let script = Script { on_event: Some(Box::new(on_event)), ..Script::default() };
    let observer = world.active("observer", &client(true), on_signal(), script);
    let server = world.active("server", &server(), on_signal(), obeys());
    assert_eq!(server.emit(0, 0), UNBOUND);
    let options = ConnectOptions { mailbox: Some(2), ..ConnectOptions::default() };
    let connection = world.connection("observer/peer", "server/ctl", options);
    world.apply(trocar_model::Change::Connect { connection }).unwrap();
    let warned = world.instance("observer").described.now();
    let told = Arc::new(crate::boundary::Tap {
        mailbox: trocar_rt::mailbox::Mailbox::new(8, trocar_loader::system::MESSAGE_BYTES, 0),
    });
    let sink = Arc::new(crate::boundary::EventSink::Tap(told.clone()));
    warned.system_event(trocar_loader::system::WARNING).edit(|sinks| sinks.push(sink));
    assert_eq!(server.emit(0, 1), EXECUTED);
    heard.recv().unwrap();
    assert_eq!([server.emit(0, 2), server.emit(0, 3)], [EXECUTED, EXECUTED]);
    assert_eq!(server.emit(0, 4), QUEUE_FULL);
    assert_eq!(world.instance("observer").queue_losses(), [0, 1], "commands and events are told apart");
    eventually("the warning about a lost event", || !told.mailbox.is_empty());
    (0..3).for_each(|_| go.send(()).unwrap());
    eventually("the events", || observer.seen() == [1, 2, 3]);
}

#[test]
fn a_direct_handler_runs_inside_emit_on_its_own_thread_and_is_queued_from_another() {
    let world = World::new("direct");
    let step = |stage: &Stage| {
        stage.emit(0, 1);
        stage.note(stage.ask(VALUE, 0).ret);
        STATUS_OK
    };
    let on_event = |stage: &Stage, _: u32, payload: u64| {
        stage.state.store(payload + 1, std::sync::atomic::Ordering::Relaxed);
        STATUS_OK
    };
    let mut source = server();
    source["required"] = json!([{"name": "peer", "functions": [{"name": "value", "ret": "u64"}]}]);
    source["required"][0]["functions"] = client(false)["required"][0]["functions"].clone();
    let mut observer = server();
    observer["required"] = client(true)["required"].clone();
    let script = |direct_step: bool| Script {
        step: direct_step.then(|| Box::new(step) as Box<dyn Fn(&Stage) -> Status + Send + Sync>),
        on_event: Some(Box::new(on_event)),
        ..obeys()
    };
    let head = world.active("head", &source, on_signal(), script(true));
    world.active("near", &observer, with(&world.id("head")), script(false));
    world.connect("near/peer", "head/ctl");
    world.connect("head/peer", "near/ctl");
    head.forget();
    world.instance("head").signal();
    eventually("the step", || !head.seen().is_empty());
    assert_eq!(head.seen()[0], 2, "the handler had run when emit came back, and its state was there to read");
    assert_eq!(head.emit(0, 5), EXECUTED, "from a foreign thread it is queued");
    eventually("the queued event", || {
        world.instance("near").signal();
        head.ask(VALUE, 0).ret == 6 || head.ask(VALUE, 0).ret == 2
    });
}
