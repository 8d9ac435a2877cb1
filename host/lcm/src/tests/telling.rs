//! Reports of a failure, and their order: a device is made safe before the failure is reported, unless only
//! the report is possible; every failure keeps its own sentence.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Barrier, Mutex, OnceLock, Weak};

use trocar_loader::system;
use trocar_model::StopReason;
use trocar_plugin_api::abi::Tick;
use trocar_rt::mailbox::Mailbox;

use super::super::News;
use super::super::boundary::puppet::{ArgRet, Own};
use super::super::boundary::{EventSink, Tap};
use super::super::instance::Instance;
use super::*;

/// All reports that can be received about one component.
struct Ear {
    news: tokio::sync::broadcast::Receiver<News>,
    changes: Arc<Tap>,
    instance: Weak<Instance>,
}

impl Ear {
    fn at(world: &World, name: &str) -> Ear {
        let instance = world.lcm.instance(&world.id(name)).unwrap();
        let changes = Arc::new(Tap { mailbox: Mailbox::new(64, system::MAX_BYTES, 0) });
        let sink = Arc::new(EventSink::Tap(changes.clone()));
        instance.described.now().system_event(system::STATE_CHANGED).edit(|sinks| sinks.push(sink));
        Ear { news: world.lcm.news(), changes, instance: Arc::downgrade(&instance) }
    }

    /// Tells whether news, an event, or the row behind GetState has reported FAULT.
    fn hears_of_fault(&mut self) -> bool {
        let instance = self.instance.upgrade().unwrap();
        let mut heard = false;
        while let Ok(news) = self.news.try_recv() {
            heard |= matches!(news, News::State(r) if r.id == instance.id && r.state == State::Fault);
        }
        let says = |row: &[u8]| row.windows(5).any(|word| word == b"FAULT");
        self.changes.mailbox.drain(|_, row| heard |= says(row), |_| ());
        let mut row = [0; system::MAX_BYTES];
        instance.system_read(system::GET_STATE, &mut row);
        heard || says(&row)
    }
}

/// Situation at the moment it was made safe.
#[derive(Debug, PartialEq)]
struct Moment {
    state: State,
    told: bool,
}

/// Moves something, and fails or hangs at its first step.
struct Arm {
    hangs: Mutex<Option<Receiver<()>>>,
    ear: OnceLock<Mutex<Ear>>,
    safe: Mutex<Vec<Moment>>,
    steps: AtomicU64,
}

impl Arm {
    fn new() -> (Arc<Arm>, Sender<()>) {
        let (open, door) = channel();
        let arm = Arm {
            hangs: Mutex::new(Some(door)),
            ear: OnceLock::new(),
            safe: Mutex::default(),
            steps: AtomicU64::new(0),
        };
        (Arc::new(arm), open)
    }
}

impl Behaviour for Arm {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.steps.fetch_add(1, Ordering::SeqCst);
        let Some(door) = self.hangs.lock().unwrap().take() else { return Ok(()) };
        // Released by a message: it fails. Released by a dropped sender: it goes on.
        if door.recv().is_ok() { Err("it slipped".into()) } else { Ok(()) }
    }
    fn make_safe(&self) -> Result<(), String> {
        let mut ear = self.ear.get().unwrap().lock().unwrap();
        let state = ear.instance.upgrade().unwrap().state();
        let told = ear.hears_of_fault();
        self.safe.lock().unwrap().push(Moment { state, told });
        Ok(())
    }
}

async fn armed(world: &World, any_thread: bool) -> (Arc<Arm>, Sender<()>) {
    let (arm, open) = Arm::new();
    let info = ClassInfo { safe_from_any_thread: any_thread, ..class(ctl(), Safety::Actuator) };
    world.create_as("arm", info, periodic(1000), arm.clone()).await;
    let _ = arm.ear.set(Mutex::new(Ear::at(world, "arm")));
    world.start("arm").await;
    (arm, open)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_fails_is_shut_then_made_safe_and_only_then_the_world_hears_of_it() {
    let world = World::new("tl_fails");
    let (arm, open) = armed(&world, false).await;
    open.send(()).unwrap();
    eventually("made safe", || !arm.safe.lock().unwrap().is_empty()).await;
    assert_eq!(*arm.safe.lock().unwrap(), [Moment { state: State::Fault, told: false }]);
    let heard = || arm.ear.get().unwrap().lock().unwrap().hears_of_fault();
    eventually("told after it", heard).await;
    assert_eq!(arm.steps.load(Ordering::SeqCst), 1, "nothing ran in between");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_hangs_is_told_of_first_and_made_safe_by_whoever_may_then() {
    for (process, any_thread) in [("tl_hangs", true), ("tl_hangs_alone", false)] {
        let world = World::new(process);
        let (arm, open) = armed(&world, any_thread).await;
        world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
        if any_thread {
            eventually("made safe from another thread", || arm.safe.lock().unwrap().len() == 1).await;
        }
        // The arm returns as if nothing had happened, and is made safe before anything else.
        drop(open);
        let times = if any_thread { 2 } else { 1 };
        eventually("made safe by its own thread", || arm.safe.lock().unwrap().len() == times).await;
        {
            let moments = arm.safe.lock().unwrap();
            assert!(
                moments.iter().all(|m| m.state == State::Fault),
                "shut before anybody touches it: {moments:?}"
            );
            assert!(moments[0].told, "nobody knows how long it hangs, so nobody waits for it");
            assert_eq!(arm.steps.load(Ordering::SeqCst), 1);
        }
        world.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_stopped_is_made_safe_when_no_step_can_begin_any_more() {
    let world = World::new("tl_stops");
    let (arm, open) = armed(&world, false).await;
    drop(open);
    eventually("some steps", || arm.steps.load(Ordering::SeqCst) > 3).await;
    world.run("arm", Verb::Stop).await.unwrap();
    let state = State::Stopped(StopReason::Requested);
    assert_eq!(*arm.safe.lock().unwrap(), [Moment { state, told: false }]);
    world.end().await;
}

/// Hangs in its step, and in `make_safe`; dropping the sender releases both.
struct Seized(Mutex<Receiver<()>>);

impl Seized {
    fn hang(&self) -> Result<(), String> {
        // The first of the two threads holds the lock; the other waits for it.
        let _ = self.0.lock().unwrap().recv();
        Ok(())
    }
}

impl Behaviour for Seized {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.hang()
    }
    fn make_safe(&self) -> Result<(), String> {
        self.hang()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_hangs_and_cannot_be_made_safe_from_another_thread_either_is_named_with_that() {
    let world = World::new("tl_seized");
    let (open, door) = channel();
    let info = ClassInfo { safe_from_any_thread: true, ..class(ctl(), Safety::Actuator) };
    world.create_as("arm", info, periodic(1000), Arc::new(Seized(Mutex::new(door)))).await;
    world.start("arm").await;
    let words = "make_safe from another thread: it has not come back for 1 s";
    let report = world.eventually(words, "arm", |r| r.fault.contains(words)).await;
    assert!(report.fault.contains("its step"), "what it hung in first is still said: {}", report.fault);
    assert_eq!(report.state, State::Fault);
    assert!(report.warnings.iter().any(|w| w == words), "{:?}", report.warnings);
    drop::<Sender<()>>(open);
    world.end().await;
}

/// Panics in its command, and cannot be made safe either.
struct Clumsy;

impl Behaviour for Clumsy {
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        panic!("first");
    }
    fn make_safe(&self) -> Result<(), String> {
        Err("the brake does not close".into())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_caller_hears_why_its_command_failed_and_not_what_failed_after_it() {
    let world = World::new("tl_words");
    world.create_as("arm", class(ctl(), Safety::Actuator), periodic(1000), Arc::new(Clumsy)).await;
    world.start("arm").await;
    match world.call("arm").await {
        Err(Refusal::CommandFailed { text, .. }) => assert_eq!(text, "first"),
        other => panic!("{other:?}"),
    }
    let report = world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
    assert!(report.fault.contains("first") && report.fault.contains("brake"), "{report:?}");
    world.end().await;
}

/// A filter that fails at its first step.
struct Torn;

impl Behaviour for Torn {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        Err("torn".into())
    }
}

/// A head of a stream that writes in each step.
struct Head;

impl Behaviour for Head {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        own.write(0, &1);
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_filter_that_failed_says_what_becomes_of_its_frames_with_its_state_and_by_an_event() {
    let world = World::new("tl_filter");
    let head = Execution { period_ns: Some(1_000_000), ..model(ExecutionModel::Stream) };
    world.create_as("head", class(plain(false, true), Safety::None), head, Arc::new(Head)).await;
    let filters = [
        ("passes", OnFailure::Bypass, "frames pass it unchanged until Reset (on_failure bypass)"),
        ("stops", OnFailure::StopBranch, "its branch stands still until Reset (on_failure stop_branch)"),
    ];
    for (number, (name, on_failure, said)) in filters.into_iter().enumerate() {
        let execution = Execution { on_failure: Some(on_failure), ..stream_of(&world.id("head")) };
        world.create_as(name, class(plain(true, true), Safety::None), execution, Arc::new(Torn)).await;
        let end = format!("{name}/in");
        world.connect(number as u64 + 1, &end, "head/out", ConnectOptions::default()).await;
        let warnings = Arc::new(Tap { mailbox: Mailbox::new(64, system::MESSAGE_BYTES, 0) });
        let sink = Arc::new(EventSink::Tap(warnings.clone()));
        let instance = world.lcm.instance(&world.id(name)).unwrap();
        instance.described.now().system_event(system::WARNING).edit(|sinks| sinks.push(sink));
        world.start(name).await;
        if number == 0 {
            world.start("head").await;
        }
        let report =
            world.eventually("FAULT", name, |r| r.state == State::Fault && !r.warnings.is_empty()).await;
        assert_eq!(report.warnings, [said]);
        let heard = AtomicBool::new(false);
        eventually("the event", || {
            let says = |row: &[u8]| row.windows(said.len()).any(|text| text == said.as_bytes());
            warnings.mailbox.drain(|_, row| _ = heard.fetch_or(says(row), Ordering::SeqCst), |_| ());
            heard.load(Ordering::SeqCst)
        })
        .await;
    }
    world.end().await;
}

/// Does nothing.
struct Idle;

impl Behaviour for Idle {}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_that_comes_with_the_end_of_a_start_keeps_its_reason() {
    let world = World::new("tl_race");
    world.create("c", periodic(1_000_000), Arc::new(Idle)).await;
    let instance = world.lcm.instance(&world.id("c")).unwrap();
    let both = Barrier::new(2);
    for _ in 0..2_000 {
        instance.set_state(State::Ready, "");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                both.wait();
                instance.set_state_from(State::Ready, State::Active, "");
            });
            both.wait();
            // As the watchdog does it.
            while !instance.set_state_from(State::Active, State::Fault, "it hangs") {
                std::hint::spin_loop();
            }
        });
        let report = instance.report(false);
        assert_eq!((report.state, report.fault.as_str()), (State::Fault, "it hangs"));
    }
    world.end().await;
}
