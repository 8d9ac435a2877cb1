//! Reads from outside that do not return.
//!
//! Promise: their callers are answered, no other work waits for them, they take no more than two threads, and
//! the component is named.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex};

use super::super::boundary::puppet::on_read;
use super::*;

const FREE: u64 = 1000;

/// Gate that holds reads with this argument inside until it is opened.
#[derive(Default)]
struct Gate {
    open: Mutex<bool>,
    opened: Condvar,
    inside: AtomicU64,
    entered: AtomicU64,
}

impl Gate {
    fn at(arg: u64) -> Arc<Gate> {
        let gate = Arc::new(Gate::default());
        let theirs = gate.clone();
        on_read(arg, move || {
            theirs.entered.fetch_add(1, Ordering::SeqCst);
            theirs.inside.fetch_add(1, Ordering::SeqCst);
            let mut open = theirs.open.lock().unwrap();
            while !*open {
                open = theirs.opened.wait(open).unwrap();
            }
            theirs.inside.fetch_sub(1, Ordering::SeqCst);
            7
        });
        on_read(FREE, || 8);
        gate
    }

    fn open(&self) {
        *self.open.lock().unwrap() = true;
        self.opened.notify_all();
    }

    fn inside(&self) -> u64 {
        self.inside.load(Ordering::SeqCst)
    }
}

struct Quiet;

impl Behaviour for Quiet {}

/// An ACTIVE component `server` with the reads `one` and `two` of interface `ctl`.
async fn readable(process: &'static str) -> World {
    let world = World::new(process);
    let number = || Type::Prim(Prim::U64);
    let (mut ports, doc) = (ctl(), String::new);
    ports.state = Some(number());
    let arg = trocar_model::Arg {
        name: String::new(),
        doc: doc(),
        ty: number(),
        unit: String::new(),
        min: None,
        max: None,
    };
    let read = |name: &str| Command {
        name: name.into(),
        kind: CommandKind::QualifiedRead,
        arg: Some(arg.clone()),
        ret: Some(number()),
        ..ports.provided[0].commands[0].clone()
    };
    let reads = [read("one"), read("two")];
    ports.provided[0].commands.extend(reads);
    world.create_as("server", class(ports, Safety::None), periodic(1000), Arc::new(Quiet)).await;
    world.start("server").await;
    world
}

async fn read(
    world: &World,
    name: &str,
    arg: u64,
    within_ms: u64,
) -> Result<Option<serde_json::Value>, Refusal> {
    let member = MemberId::parse(&format!("{}/server/ctl/{name}", world.process)).unwrap();
    let arg = Payload::Json(serde_json::json!(arg));
    let call = Invoke { member, arg, send: false, deadline_ns: within_ms * 1_000_000 };
    world.lcm.invoke(call).await.map(|reply| reply.value)
}

fn late(refused: &Refusal) -> Option<bool> {
    match refused {
        Refusal::Deadline { may_still_run, .. } => Some(*may_still_run),
        _ => None,
    }
}

// One worker, as on a machine with one processor: a read that ran on it would stop everything.
#[tokio::test]
async fn a_read_that_hangs_is_its_caller_s_deadline_and_is_named_and_the_next_ones_are_refused_until_it_is_back()
 {
    let world = readable("q_hangs").await;
    let gate = Gate::at(1);
    let mut watchdog = Watchdog::of("a read that has begun");
    loop {
        let refused = read(&world, "one", 1, 20).await.unwrap_err();
        match late(&refused) {
            Some(true) => break,
            // On a busy machine a read may not begin within that time: the test asks again.
            Some(false) => watchdog.saw(refused),
            None => panic!("no deadline: {refused}"),
        }
    }
    let said = "its reads did not come back in time and their callers got DEADLINE (1 so far), the last one: ctl/one";
    let named = |r: &Report| r.warnings.iter().any(|w| w == said);
    let report = world.eventually("a word about it", "server", named).await;
    assert_eq!(report.state, State::Active, "it was never entered");
    assert_ne!(report.health, Health::Unresponsive, "it was never entered");
    let again = read(&world, "one", 1, 20_000).await.unwrap_err().to_string();
    assert!(again.contains("the read ctl/one of q_hangs/server has not come back for"), "{again}");
    assert_eq!(read(&world, "two", FREE, 20_000).await.unwrap(), Some(serde_json::json!(8)));
    assert_eq!(gate.entered.load(Ordering::SeqCst), 1, "what was refused was not begun");
    gate.open();
    let mut watchdog = Watchdog::of("it came back, and others are answered");
    while let Err(refused) = read(&world, "one", 1, 20_000).await {
        watchdog.saw(refused);
    }
    world.end().await;
}

#[tokio::test]
async fn however_many_reads_hang_at_once_two_threads_are_all_they_get_and_nothing_else_waits() {
    let world = readable("q_many").await;
    let gate = Gate::at(2);
    let mut reads = tokio::task::JoinSet::new();
    for n in 0..50 {
        let (lcm, process) = (world.lcm.clone(), world.process);
        reads.spawn(async move {
            let name = if n % 2 == 0 { "one" } else { "two" };
            read(&World { lcm, process }, name, 2, 300).await
        });
    }
    eventually("two are inside", || gate.inside() == 2).await;
    world.call("server").await.unwrap();
    let refused: Vec<Refusal> = reads.join_all().await.into_iter().map(Result::unwrap_err).collect();
    assert_eq!(refused.iter().filter(|r| late(r) == Some(true)).count(), 2, "{refused:?}");
    let not_begun = |r: &&Refusal| late(r) == Some(false) || matches!(r, Refusal::CommandFailed { .. });
    assert_eq!(refused.iter().filter(not_begun).count(), 48, "{refused:?}");
    let full = read(&world, "one", FREE, 20_000).await.unwrap_err();
    assert!(matches!(full, Refusal::CommandFailed { .. }), "{full}");
    assert_eq!(gate.entered.load(Ordering::SeqCst), 2);
    let named = |r: &Report| r.warnings.iter().any(|w| w.contains("got DEADLINE (2 so far"));
    world.eventually("both are counted", "server", named).await;
    // The process ends although they are still inside.
    world.end().await;
    assert_eq!(gate.inside(), 2);
    gate.open();
}

#[tokio::test]
async fn a_read_whose_caller_left_is_noted_as_late_all_the_same() {
    let world = readable("q_left").await;
    let gate = Gate::at(3);
    let left = tokio::time::timeout(Duration::from_millis(1), read(&world, "one", 3, 20)).await;
    assert!(left.is_err(), "{left:?}");
    let named = |r: &Report| r.warnings.iter().any(|w| w.contains("the last one: ctl/one"));
    world.eventually("a word about it", "server", named).await;
    gate.open();
    eventually("it is back", || gate.inside() == 0).await;
    world.end().await;
}
