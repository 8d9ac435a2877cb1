//! Removing a component that hangs or has failed: it is ended when it comes back, not entered after that, and
//! kept while it may still use handles of the host.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_lcm_api::News;
use trocar_plugin_api::abi::{NOT_ACTIVE, Tick, UNBOUND};

use super::super::boundary::puppet::Own;
use super::standing::Held;
use super::*;

pub(super) fn destroy(world: &World, name: &str) -> Change {
    let info = class(ctl(), Safety::None);
    let component = Box::new(Component {
        ports: Arc::new(info.ports.clone()),
        class: Arc::new(info),
        config: serde_json::json!({}),
        execution: Execution::default(),
        state: State::Active,
        health: Health::Ok,
        fault: String::new(),
    });
    Change::Destroy { id: world.id(name), component }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_removed_while_its_step_hangs_is_stopped_and_destroyed_when_it_comes_back() {
    let world = World::new("rm_step");
    let (held, open) = Held::at("step", "");
    world.create_as("c", class(ctl(), Safety::None), periodic(1000), held.clone()).await;
    world.start("c").await;
    held.is_inside().await;
    let gone = Arc::downgrade(&world.lcm.instance(&world.id("c")).unwrap());
    let report = world
        .lcm
        .apply(destroy(&world, "c"), (Instant::now() + Duration::from_millis(20)).into())
        .await
        .unwrap();
    assert!(
        report.warnings.iter().any(|w| w.contains("has not come back out of its own code")),
        "{report:?}"
    );
    assert!(gone.upgrade().is_some(), "what the host gave it goes before it does");
    open.send(()).unwrap();
    eventually("destroyed", || held.destroyed.load(Ordering::SeqCst)).await;
    assert_eq!(held.stops.load(Ordering::SeqCst), 1);
    eventually("the host's side of it gone", || gone.upgrade().is_none()).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_passive_component_removed_while_a_caller_hangs_in_it_is_destroyed_when_that_comes_back() {
    let world = World::new("rm_passive");
    let (held, open) = Held::at("command", "");
    world.create_as("c", class(ctl(), Safety::None), model(ExecutionModel::None), held.clone()).await;
    world.start("c").await;
    let rest = async {
        held.is_inside().await;
        let soon = Instant::now() + Duration::from_millis(20);
        world.lcm.apply(destroy(&world, "c"), soon.into()).await.unwrap();
        assert!(!held.destroyed.load(Ordering::SeqCst));
        open.send(()).unwrap();
    };
    let (_, ()) = tokio::join!(world.call("c"), rest);
    eventually("destroyed", || held.destroyed.load(Ordering::SeqCst)).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_failed_is_not_described_again_whatever_it_wishes() {
    let world = World::new("rm_wish");
    let (held, open) = Held::at("step", "it broke");
    world.create("c", periodic(1000), held.clone()).await;
    world.start("c").await;
    held.is_inside().await;
    let device = held.device();
    open.send(()).unwrap();
    world.eventually("FAULT", "c", |r| r.state == State::Fault).await;
    device.ports_changed();
    let instance = world.lcm.instance(&world.id("c")).unwrap();
    eventually("its wish was looked at", || !instance.described.is_wished()).await;
    assert_eq!(world.report("c").await.fault, "step: it broke");
    world.run("c", Verb::Reset).await.unwrap();
    world.end().await;
}

/// Wishes for other ports while it is being destroyed.
#[derive(Default)]
struct Wisher {
    device: std::sync::Mutex<Option<Own>>,
}

impl Behaviour for Wisher {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        Ok(())
    }
    fn destroyed(&self) {
        self.device.lock().unwrap().take().unwrap().ports_changed();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wish_of_one_that_goes_enters_nobody() {
    let world = World::new("rm_going");
    for _ in 0..20 {
        let wisher = Arc::new(Wisher::default());
        world.create("c", periodic(1000), wisher.clone()).await;
        world.start("c").await;
        eventually("a step", || wisher.device.lock().unwrap().is_some()).await;
        // Otherwise an instance that is gone would be asked for its description, which ends this process.
        world.apply(destroy(&world, "c")).await.unwrap();
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_instance_owes_ends_with_it() {
    let world = World::new("rm_debt");
    let (arm, open) = Held::at("command", "");
    world.create_as("arm", class(ctl(), Safety::Actuator), model(ExecutionModel::None), arm.clone()).await;
    world.start("arm").await;
    let member = MemberId::parse(&format!("{}/arm/ctl/do", world.process)).unwrap();
    let mut watchdog = Watchdog::of("a call that has begun");
    while !arm.was_entered() {
        let (member, arg) = (member.clone(), Payload::None);
        let late = world.lcm.invoke(Invoke { member, arg, send: false, deadline_ns: 1_000_000 }).await;
        watchdog.saw(late.expect_err("nobody lets go"));
    }
    world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
    open.send(()).unwrap();
    eventually("made safe", || arm.made_safe.load(Ordering::SeqCst) > 0).await;
    world.run("arm", Verb::Reset).await.unwrap();
    world.start("arm").await;
    world.call("arm").await.unwrap();
    assert_eq!(arm.made_safe.load(Ordering::SeqCst), 1, "made safe while it runs, for what another one owed");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn threads_that_outlive_their_component_keep_what_the_host_gave_it() {
    let world = World::new("rm_threads");
    let children = Arc::new(Children::default());
    world.create("c", periodic(1000), children.clone()).await;
    world.start("c").await;
    assert_eq!(world.lcm.retired(), 0);
    let gone = Arc::downgrade(&world.lcm.instance(&world.id("c")).unwrap());
    let report = world.apply(destroy(&world, "c")).await.unwrap();
    assert!(report.warnings.iter().any(|w| w.contains("of its own threads still run")), "{report:?}");
    assert!(gone.upgrade().is_some());
    assert_eq!(world.lcm.retired(), 1);
    assert!(!children.destroyed.load(Ordering::SeqCst), "its threads use an instance that is not there");
    children.child.lock().unwrap().take();
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn threads_that_outlive_a_reset_keep_the_instance_that_was() {
    let world = World::new("rm_reset");
    let children = Arc::new(Children::default());
    world.create("c", periodic(1000), children.clone()).await;
    world.start("c").await;
    world.run("c", Verb::Stop).await.unwrap();
    let report = world.run("c", Verb::Reset).await.unwrap();
    assert!(!children.destroyed.load(Ordering::SeqCst), "its threads use an instance that is not there");
    assert!(report.warnings.iter().any(|w| w.contains("threads of its own still run")), "{report:?}");
    children.child.lock().unwrap().take();
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thread_of_configure_may_be_ended_by_destroy() {
    let world = World::new("rm_early");
    let children = Arc::new(Children { early: true, ..Children::default() });
    world.create("c", periodic(1000), children.clone()).await;
    world.start("c").await;
    world.apply(destroy(&world, "c")).await.unwrap();
    assert!(children.destroyed.load(Ordering::SeqCst));
    assert_eq!(world.lcm.retired(), 0);
    world.end().await;
}

/// Steps, and leaves handles behind if told to.
struct Leaves {
    some: bool,
    steps: AtomicU64,
}

impl Behaviour for Leaves {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        if self.some {
            own.keep();
        }
        self.steps.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_to_which_handles_are_left_is_not_that_of_the_instance_made_anew() {
    for (some, lost) in [(false, &[][..]), (true, &[1])] {
        let world = World::new(if some { "rm_left" } else { "rm_clean" });
        let (source, reader) =
            (class(plain(false, true), Safety::None), class(plain(true, false), Safety::None));
        let leaves = |some| Arc::new(Leaves { some, steps: AtomicU64::new(0) });
        let left = leaves(some);
        world.create_as("s", source, periodic(1000), leaves(false)).await;
        world.create_as("c", reader, periodic(1000), left.clone()).await;
        world.connect(1, "c/in", "s/out", ConnectOptions::default()).await;
        world.start("c").await;
        eventually("it has stepped", || left.steps.load(Ordering::SeqCst) > 0).await;
        world.run("c", Verb::Stop).await.unwrap();
        let report = world.run("c", Verb::Reset).await.unwrap();
        assert_eq!(report.lost_connections, lost, "{report:?}");
        world.end().await;
    }
}

/// Keeps the host's pointers in a place of its own, as code in C does in a static.
#[derive(Default)]
struct Hoards(std::sync::Mutex<Option<Own>>);

impl Behaviour for Hoards {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        *self.0.lock().unwrap() = Some(*own);
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn handles_that_code_keeps_when_its_component_is_gone_are_refused_counted_and_named() {
    let world = World::new("rm_hoards");
    let mut news = world.lcm.news();
    let hoards = Arc::new(Hoards::default());
    let ports =
        Ports { outputs: plain(true, true).outputs, inputs: plain(true, true).inputs, ..requires_ctl() };
    world.create_as("c", class(ports, Safety::None), periodic(1000), hoards.clone()).await;
    world.start("c").await;
    eventually("it has stepped", || hoards.0.lock().unwrap().is_some()).await;
    let gone = Arc::downgrade(&world.lcm.instance(&world.id("c")).unwrap());
    world.apply(destroy(&world, "c")).await.unwrap();
    eventually("the host's side of it gone", || gone.upgrade().is_none()).await;
    let own = hoards.0.lock().unwrap().unwrap();
    let late = std::thread::spawn(move || {
        let ten = (0..7).map(|_| own.send(0)).chain([own.write(0, &1)]);
        (ten.collect::<Vec<_>>(), own.take(0), own.enter(), own.ports_changed())
    });
    assert_eq!(late.join().unwrap(), (vec![UNBOUND; 8], None, NOT_ACTIVE, NOT_ACTIVE));
    for times in ["1 so far", "10 so far"] {
        let said = loop {
            match news.recv().await.unwrap() {
                News::Log(line) if line.message.contains("still uses its ports") => break line.message,
                _ => {}
            }
        };
        assert!(said.starts_with("rm_hoards/c is removed") && said.contains(times), "{said}");
    }
    world.end().await;
}

/// Starts a thread and leaves it running until the test lets go.
#[derive(Default)]
struct Children {
    child: std::sync::Mutex<Option<std::sync::mpsc::Sender<()>>>,
    /// True to start the thread in `configure`: then it may live until `destroy`.
    early: bool,
    destroyed: std::sync::atomic::AtomicBool,
}

impl Behaviour for Children {
    fn configure(&self, _: &str, _: &Own) -> Result<(), String> {
        if self.early { self.raise() } else { Ok(()) }
    }
    fn start(&self) -> Result<(), String> {
        if self.early { Ok(()) } else { self.raise() }
    }
    fn destroyed(&self) {
        self.destroyed.store(true, Ordering::SeqCst);
        self.child.lock().unwrap().take();
    }
}

impl Children {
    fn raise(&self) -> Result<(), String> {
        let (end, ended) = std::sync::mpsc::channel::<()>();
        std::thread::spawn(move || ended.recv());
        *self.child.lock().unwrap() = Some(end);
        Ok(())
    }
}
