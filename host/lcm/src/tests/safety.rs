//! Safe components stay safe whatever hangs, and no command that was only sent is lost without a report.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use trocar_model::StopReason;
use trocar_plugin_api::abi::{QUEUE_FULL, QUEUED, Tick};

use super::super::News;
use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Stays inside its first step or command until the test lets go.
struct Gate {
    entry: &'static str,
    door: Mutex<Option<Receiver<()>>>,
    inside: AtomicBool,
    steps: AtomicU64,
}

impl Gate {
    fn at(entry: &'static str) -> (Arc<Gate>, Sender<()>) {
        let (open, door) = channel();
        let door = Mutex::new(Some(door));
        (Arc::new(Gate { entry, door, inside: AtomicBool::new(false), steps: AtomicU64::new(0) }), open)
    }

    fn pass(&self, entry: &str) {
        if self.entry == entry
            && let Some(door) = self.door.lock().unwrap().take()
        {
            self.inside.store(true, Ordering::SeqCst);
            // The test lets go, or has ended.
            let _ = door.recv();
        }
    }

    async fn is_inside(&self) {
        eventually("somebody inside", || self.inside.load(Ordering::SeqCst)).await;
    }
}

impl Behaviour for Gate {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.steps.fetch_add(1, Ordering::SeqCst);
        self.pass("step");
        Ok(())
    }
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.pass("command");
        Ok(())
    }
}

/// Moves something: counts how often it was made safe, and fails at that as told.
#[derive(Default)]
struct Arm {
    made_safe: AtomicU64,
    fails: bool,
    panics: bool,
}

impl Arm {
    fn made_safe(&self) -> u64 {
        self.made_safe.load(Ordering::SeqCst)
    }
}

impl Behaviour for Arm {
    fn make_safe(&self) -> Result<(), String> {
        self.made_safe.fetch_add(1, Ordering::SeqCst);
        assert!(!self.panics, "no brake");
        if self.fails { Err("the brake does not close".into()) } else { Ok(()) }
    }
}

fn arm_class(any_thread: bool) -> ClassInfo {
    ClassInfo { safe_from_any_thread: any_thread, ..class(ctl(), Safety::Actuator) }
}

/// Number of calls that wait in the component's queues.
fn queued(world: &World, name: &str) -> u64 {
    let instance = world.lcm.instance(&world.id(name)).unwrap();
    instance.queues().iter().map(|q| q.mailbox.stats().queued).sum()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actuator_whose_thread_is_held_by_another_is_given_up_as_one_that_hangs_itself() {
    let world = World::new("f_held");
    let (head, open) = Gate::at("step");
    let [near, remote] = [Arc::new(Arm::default()), Arc::new(Arm::default())];
    world.create("head", periodic(1000), head).await;
    let inside = |how| inside(how, &world.id("head"));
    world.create_as("near", arm_class(true), inside(ExecutionModel::ExecOut), near.clone()).await;
    world.create_as("far", arm_class(false), inside(ExecutionModel::ExecIn), remote.clone()).await;
    let broken = Arc::new(Arm { fails: true, ..Arm::default() });
    world.create_as("broken", arm_class(true), inside(ExecutionModel::ExecOut), broken).await;
    let watcher = Arc::new(Arm::default());
    world.create("watcher", inside(ExecutionModel::ExecOut), watcher.clone()).await;
    for name in ["near", "far", "broken", "watcher", "head"] {
        world.start(name).await;
    }
    for name in ["near", "far"] {
        let report = world.eventually("FAULT", name, |r| r.state == State::Fault).await;
        assert_eq!(report.fault, "its thread is held by f_held/head inside its step");
    }
    eventually("made safe from another thread", || near.made_safe() == 1).await;
    assert_eq!(remote.made_safe(), 0, "nobody but its own thread may");
    let said = "make_safe from another thread: the brake does not close";
    let report = world.eventually("a word about it", "broken", |r| r.fault.ends_with(said)).await;
    assert!(report.warnings.contains(&said.to_owned()), "{report:?}");
    let report = world.eventually("UNRESPONSIVE", "watcher", |r| r.health == Health::Unresponsive).await;
    assert_eq!((report.state, watcher.made_safe()), (State::Active, 0));
    open.send(()).unwrap();
    eventually("made safe once the thread is back", || near.made_safe() == 2 && remote.made_safe() == 1)
        .await;
    world.eventually("OK", "watcher", |r| r.health == Health::Ok).await;
    assert_eq!(world.report("near").await.state, State::Fault, "it waits for Reset");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn actuators_of_a_thread_that_broke_down_are_made_safe_on_it_and_nobody_waits_for_it() {
    let world = World::new("f_broke");
    let mut news = world.lcm.news();
    let [near, remote] = [Arc::new(Arm { panics: true, ..Arm::default() }), Arc::new(Arm::default())];
    world.create_as("near", arm_class(false), periodic(1000), near.clone()).await;
    let inside = inside(ExecutionModel::ExecOut, &world.id("near"));
    world.create_as("far", arm_class(false), inside, remote.clone()).await;
    for name in ["far", "near"] {
        world.start(name).await;
    }
    let executor = world.lcm.executor_of(&world.lcm.instance(&world.id("near")).unwrap()).unwrap();
    executor.submit(|_| panic!("as no job should"));
    for name in ["near", "far"] {
        let report = world.eventually("FAULT", name, |r| r.state == State::Fault).await;
        let why = format!("the thread {} of the host broke down: as no job should", executor.name);
        assert!(report.fault.starts_with(&why), "{report:?}");
    }
    eventually("made safe", || near.made_safe() == 1 && remote.made_safe() == 1).await;
    // A program that embeds the host goes on, and is told.
    let told = loop {
        if let News::Warnings(told) = news.recv().await.unwrap() {
            break told;
        }
    };
    assert!(told.unfit && told.sentences[0].contains("broke down: as no job should"), "{told:?}");
    let refused = world.run("far", Verb::Reset).await.unwrap_err();
    assert!(refused.to_string().contains("far"), "{refused}");
    world.end().await;
}

/// A gate that moves something.
struct Passive(Arc<Gate>, Arc<Arm>);

impl Behaviour for Passive {
    fn command(&self, id: u32, data: ArgRet, own: &Own) -> Result<(), String> {
        self.0.command(id, data, own)
    }
    fn make_safe(&self) -> Result<(), String> {
        self.1.make_safe()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actuator_that_hangs_in_a_callers_thread_is_made_safe_by_that_caller_when_it_comes_back() {
    let world = World::new("f_passive");
    let (gate, open) = Gate::at("command");
    let arm = Arc::new(Arm::default());
    let passive = Arc::new(Passive(gate, arm.clone()));
    world.create_as("arm", arm_class(false), model(ExecutionModel::None), passive).await;
    world.start("arm").await;
    let let_go = async {
        world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
        assert_eq!(arm.made_safe(), 0);
        open.send(()).unwrap();
    };
    let (answer, ()) = tokio::join!(world.call("arm"), let_go);
    assert!(answer.is_ok(), "{answer:?}");
    eventually("made safe", || arm.made_safe() == 1).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actuator_that_is_removed_after_its_thread_broke_down_is_kept_and_made_safe_by_the_caller_inside()
{
    let world = World::new("f_broke_inside");
    let (gate, open) = Gate::at("command");
    let arm = Arc::new(Arm::default());
    let passive = Arc::new(Passive(gate.clone(), arm.clone()));
    world.create_as("arm", arm_class(false), model(ExecutionModel::None), passive).await;
    world.start("arm").await;
    let executor = world.lcm.executor_of(&world.lcm.instance(&world.id("arm")).unwrap()).unwrap();
    let remove = async {
        gate.is_inside().await;
        executor.submit(|_| panic!("as no job should"));
        world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
        let removed = world.apply(super::removal::destroy(&world, "arm")).await.unwrap();
        assert!(removed.warnings.iter().any(|w| w.contains("not destroyed")), "{removed:?}");
        assert_eq!((world.lcm.retired(), arm.made_safe()), (1, 0), "the caller is inside");
        open.send(()).unwrap();
    };
    let (_answer, ()) = tokio::join!(world.call("arm"), remove);
    eventually("made safe", || arm.made_safe() == 1).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_still_runs_is_an_overrun_as_soon_as_its_period_is_over() {
    let world = World::new("f_overrun");
    let (slow, open) = Gate::at("step");
    // Patience is five periods: long enough for a busy machine to see the one before the other.
    world.create("slow", periodic(400_000), slow.clone()).await;
    let mut news = world.lcm.news();
    world.start("slow").await;
    let first = loop {
        if let News::State(report) = news.recv().await.unwrap()
            && report.health != Health::Ok
        {
            break report.health;
        }
    };
    assert_eq!((first, slow.steps.load(Ordering::SeqCst)), (Health::Overrun, 1), "while it is still inside");
    let detail = world.detail("slow").await;
    assert_eq!(detail.overruns, 0, "its thread counts it, when it ends");
    open.send(()).unwrap();
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn stopping_a_component_answers_its_callers_at_once_though_its_thread_is_inside_another() {
    let world = World::new("f_stop");
    let (head, open) = Gate::at("step");
    world.create("head", periodic(1000), head.clone()).await;
    let child = inside(ExecutionModel::ExecOut, &world.id("head"));
    world.create_as("arm", arm_class(false), child, Arc::new(Arm::default())).await;
    world.start("arm").await;
    world.start("head").await;
    head.is_inside().await;
    let stop = async {
        eventually("a call that waits", || queued(&world, "arm") == 1).await;
        let id = world.id("arm");
        let stop = Change::Run { id, verb: Verb::Stop, from: State::Active, to: State::Ready };
        world.lcm.apply(stop, (Instant::now() + Duration::from_millis(20)).into()).await
    };
    let (answer, stopped) = tokio::join!(world.call("arm"), stop);
    assert!(matches!(answer, Err(Refusal::NotActive { .. })), "{answer:?}");
    assert!(matches!(stopped, Err(Refusal::LcmTimeout { .. })), "{stopped:?}");
    let report = world.report("arm").await;
    assert!(report.fault.contains("inside the code of f_stop/head"), "{report:?}");
    open.send(()).unwrap();
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_does_not_come_to_its_safe_condition_is_shown_with_its_state() {
    let world = World::new("f_unsafe");
    let said = "make_safe: the brake does not close";
    let fails = || Arc::new(Arm { fails: true, ..Arm::default() });
    world.create_as("arm", arm_class(false), periodic(1000), fails()).await;
    world.create("lamp", periodic(1000), fails()).await;
    world.create("panics", periodic(1000), Arc::new(Arm { panics: true, ..Arm::default() })).await;
    for name in ["arm", "lamp", "panics"] {
        world.start(name).await;
    }
    let refused = world.run("arm", Verb::Stop).await.unwrap_err();
    assert!(refused.to_string().contains(said), "{refused}");
    let report = world.report("arm").await;
    assert_eq!((report.state, report.fault.as_str()), (State::Fault, said));
    assert!(report.warnings.contains(&said.to_owned()), "{report:?}");
    world.run("lamp", Verb::Stop).await.unwrap();
    let report = world.report("lamp").await;
    assert_eq!(report.state, State::Stopped(StopReason::Requested), "what moves nothing is only told of");
    assert!(report.warnings.contains(&said.to_owned()), "{report:?}");
    assert!(world.run("panics", Verb::Stop).await.is_err(), "what panicked is not trusted");
    let report = world.report("panics").await;
    assert_eq!((report.state, report.fault.as_str()), (State::Fault, "make_safe: no brake"));
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_the_process_makes_an_active_actuator_safe() {
    let world = World::new("f_end");
    let arm = Arc::new(Arm::default());
    world.create_as("arm", arm_class(false), periodic(1000), arm.clone()).await;
    world.start("arm").await;
    assert_eq!(arm.made_safe(), 0);
    world.end().await;
    assert_eq!(arm.made_safe(), 1);
}

/// Sends a command in each of its first steps, and counts the outcomes.
struct Sends {
    left: AtomicU64,
    queued: AtomicU64,
    full: AtomicU64,
}

impl Sends {
    fn times(n: u64) -> Arc<Sends> {
        Arc::new(Sends { left: AtomicU64::new(n), queued: AtomicU64::new(0), full: AtomicU64::new(0) })
    }
}

impl Behaviour for Sends {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        if self.left.load(Ordering::SeqCst) > 0 {
            match own.send(0) {
                QUEUED => self.queued.fetch_add(1, Ordering::SeqCst),
                QUEUE_FULL => self.full.fetch_add(1, Ordering::SeqCst),
                // The server is not ACTIVE yet.
                _ => return Ok(()),
            };
            self.left.fetch_sub(1, Ordering::SeqCst);
        }
        Ok(())
    }
}

/// Its command fails.
struct Refuses;

impl Behaviour for Refuses {
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        Err("no paper".into())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_that_were_only_sent_and_failed_are_counted_and_told_at_both_ends() {
    let world = World::new("f_failed");
    let sends = Sends::times(3);
    world.create_as("a", class(requires_ctl(), Safety::None), periodic(1000), sends).await;
    world.create_as("b", class(ctl(), Safety::None), periodic(1000), Arc::new(Refuses)).await;
    world.connect(1, "a/peer", "b/ctl", ConnectOptions::default()).await;
    world.start("b").await;
    world.start("a").await;
    let names = |said: &'static str| move |r: &Report| r.warnings.iter().any(|w| w == said);
    let by = "commands sent by f_failed/a failed: 3 so far, the last one: no paper";
    world.eventually("a word about it", "b", names(by)).await;
    let to = "commands it sent to f_failed/b failed: 3 so far, the last one: no paper";
    world.eventually("a word about it", "a", names(to)).await;
    let link = &world.lcm.links().await.unwrap()[0];
    assert_eq!((link.failed, link.unexecuted, link.dropped, link.passed), (3, 0, 0, 3), "{link:?}");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_that_a_disconnect_throws_out_and_those_a_full_queue_refused_are_counted_and_told() {
    let world = World::new("f_thrown");
    let (gate, open) = Gate::at("command");
    let sends = Sends::times(0);
    world.create_as("a", class(requires_ctl(), Safety::None), periodic(1000), sends.clone()).await;
    world.create_as("b", class(ctl(), Safety::None), periodic(1000), gate.clone()).await;
    let options = ConnectOptions { mailbox: Some(2), ..ConnectOptions::default() };
    world.connect(1, "a/peer", "b/ctl", options.clone()).await;
    world.start("b").await;
    world.start("a").await;
    // The first is taken and does not return, two are queued, two find the queue full.
    sends.left.store(1, Ordering::SeqCst);
    gate.is_inside().await;
    sends.left.store(4, Ordering::SeqCst);
    eventually("all sent", || sends.left.load(Ordering::SeqCst) == 0).await;
    let count = |n: &AtomicU64| n.load(Ordering::SeqCst);
    assert_eq!((count(&sends.queued), count(&sends.full)), (3, 2));
    let link = world.lcm.links().await.unwrap().remove(0);
    assert_eq!((link.depth, link.high_water, link.rejected, link.dropped), (2, 2, 2, 2), "{link:?}");
    let port = |path: &str| PortId::parse(&format!("f_thrown/{path}")).unwrap();
    let (client, server) = (port("a/peer"), port("b/ctl"));
    let connection = Connection { id: ConnectionId(1), client, server, options };
    world.apply(Change::Disconnect { connection, replaced: false }).await.unwrap();
    let said = "commands it sent to f_thrown/b never ran: 2 so far were still queued when it stopped or was cut off, or had waited too long";
    world.eventually("a word about it", "a", |r| r.warnings.iter().any(|w| w == said)).await;
    let later = world.run("a", Verb::Stop).await.unwrap();
    assert_eq!(later.warnings, Vec::<String>::new(), "an answer repeats what was told before");
    let detail = world.detail("b").await;
    assert_eq!(
        (detail.commands_rejected, detail.events_dropped),
        (4, 0),
        "the connection's end forgets nothing, and counts what never ran"
    );
    open.send(()).unwrap();
    world.end().await;
}

/// The head of a stream: writes 1, 2, 3, …
struct Counts(AtomicU64);

impl Behaviour for Counts {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        own.write(0, &(self.0.fetch_add(1, Ordering::SeqCst) + 1));
        Ok(())
    }
}

/// Hands on its samples, or keeps them: values with their numbers.
#[derive(Default)]
struct Takes(Mutex<Vec<(u64, u64)>>);

impl Takes {
    fn len(&self) -> usize {
        self.0.lock().unwrap().len()
    }

    async fn grows(&self, what: &str) {
        let then = self.len();
        eventually(what, || self.len() > then + 20).await;
    }
}

impl Behaviour for Takes {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        while let Some((value, seq)) = own.take(0) {
            self.0.lock().unwrap().push((value, seq));
            if own.has_output() {
                own.write(0, &value);
            }
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_filter_comes_into_a_running_stream_and_goes_again_and_every_frame_arrives_or_is_a_counted_gap() {
    let world = World::new("f_stream");
    let (head, sink, filter) =
        (Arc::new(Counts(AtomicU64::new(0))), Arc::new(Takes::default()), Arc::new(Takes::default()));
    let execution = Execution { period_ns: Some(1_000_000), ..model(ExecutionModel::Stream) };
    world.create_as("head", class(plain(false, true), Safety::None), execution, head.clone()).await;
    let of_head = stream_of(&world.id("head"));
    world.create_as("sink", class(plain(true, false), Safety::None), of_head.clone(), sink.clone()).await;
    let wire = |id: u64, client: &str, server: &str| {
        let port = |path: &str| PortId::parse(&format!("f_stream/{path}")).unwrap();
        let (client, server) = (port(client), port(server));
        let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
        Connection { id: ConnectionId(id), client, server, options }
    };
    let connect = async |connection| world.apply(Change::Connect { connection }).await.unwrap();
    let disconnect =
        async |connection| world.apply(Change::Disconnect { connection, replaced: false }).await.unwrap();
    connect(wire(1, "sink/in", "head/out")).await;
    world.start("sink").await;
    world.start("head").await;
    sink.grows("frames straight from the head").await;

    world.create_as("filter", class(plain(true, true), Safety::None), of_head, filter.clone()).await;
    connect(wire(2, "filter/in", "head/out")).await;
    world.start("filter").await;
    // The two halves of `replace`: the old wire is removed, the new one is made.
    disconnect(wire(1, "sink/in", "head/out")).await;
    connect(wire(3, "sink/in", "filter/out")).await;
    sink.grows("frames through the filter").await;
    disconnect(wire(3, "sink/in", "filter/out")).await;
    connect(wire(4, "sink/in", "head/out")).await;
    sink.grows("frames past the filter").await;
    disconnect(wire(2, "filter/in", "head/out")).await;
    let component = Box::new(Component {
        class: Arc::new(class(plain(true, true), Safety::None)),
        config: serde_json::json!({}),
        execution: stream_of(&world.id("head")),
        ports: Arc::default(),
        state: State::Active,
        health: Health::Ok,
        fault: String::new(),
    });
    world.apply(Change::Destroy { id: world.id("filter"), component }).await.unwrap();
    sink.grows("frames without a filter").await;
    world.run("head", Verb::Stop).await.unwrap();

    let (through, arrived) = (filter.0.lock().unwrap().clone(), sink.0.lock().unwrap().clone());
    assert!(through.windows(2).all(|w| w[0].0 + 1 == w[1].0), "the filter's frames: {through:?}");
    let (mut gaps, mut jumps) = (0, 0);
    for w in arrived.windows(2) {
        assert!(w[0].0 < w[1].0, "twice, or out of order: {w:?}");
        gaps += w[1].0 - w[0].0 - 1;
        jumps += u64::from(w[1].0 > w[0].0 + 1);
    }
    assert!(jumps <= 2, "frames are missing elsewhere than at the two rewirings: {arrived:?}");
    let written = head.0.load(Ordering::SeqCst);
    assert_eq!(arrived.len() as u64 + gaps + arrived[0].0 - 1, written, "none is lost without a gap");
    // On one wire the number of a frame is the head's count: a gap in the values is a gap in the numbers.
    for (value, seq) in arrived.iter().filter(|(value, _)| !through.iter().any(|(v, _)| v == value)) {
        assert_eq!(value, seq);
    }
    world.end().await;
}
