//! Components that misbehave, and the effects on others.

use std::pin::pin;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use trocar_model::StopReason;
use trocar_plugin_api::abi::Tick;
use trocar_rt::os;

use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Time between two looks at a change that comes by itself.
const LOOK: Duration = Duration::from_secs(1);

/// Waits for a result that comes by itself, under the watchdog.
pub(super) async fn comes<F: Future>(what: &str, coming: F) -> F::Output {
    let (mut coming, mut watchdog) = (pin!(coming), Watchdog::of(what));
    loop {
        match tokio::time::timeout(LOOK, &mut coming).await {
            Ok(come) => return come,
            Err(_) => watchdog.saw("nothing has come"),
        }
    }
}

/// Stays inside the given entry until the test lets go; counts later calls.
#[derive(Default)]
pub(super) struct Stuck {
    pub(super) entry: &'static str,
    door: Mutex<Option<Receiver<()>>>,
    pub(super) steps: AtomicU64,
    made_safe: AtomicU64,
}

impl Stuck {
    pub(super) fn in_entry(entry: &'static str) -> (Arc<Stuck>, Sender<()>) {
        let (open, door) = channel();
        (Arc::new(Stuck { entry, door: Mutex::new(Some(door)), ..Stuck::default() }), open)
    }

    /// The next time it is inside that entry it stays there again.
    pub(super) fn close(&self, door: Receiver<()>) {
        *self.door.lock().unwrap() = Some(door);
    }

    fn pass(&self, entry: &str) {
        if self.entry == entry
            && let Some(door) = self.door.lock().unwrap().take()
        {
            // The test lets go, or has ended.
            let _ = door.recv();
        }
    }

    pub(super) fn made_safe(&self) -> u64 {
        self.made_safe.load(Ordering::SeqCst)
    }
}

impl Behaviour for Stuck {
    fn configure(&self, _: &str, _: &Own) -> Result<(), String> {
        self.pass("configure");
        Ok(())
    }
    fn start(&self) -> Result<(), String> {
        self.pass("start");
        Ok(())
    }
    fn resume(&self) -> Result<(), String> {
        self.pass("resume");
        Ok(())
    }
    fn stop(&self) -> Result<(), String> {
        self.pass("stop");
        Ok(())
    }
    fn make_safe(&self) -> Result<(), String> {
        self.made_safe.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
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

#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_does_not_come_back_is_named_while_everybody_else_goes_on_and_forgiven_when_it_does() {
    let world = World::new("s_hung");
    let (stuck, open) = Stuck::in_entry("step");
    let other = Arc::new(Stuck::default());
    world.create("stuck", periodic(1000), stuck.clone()).await;
    world.create("other", periodic(1000), other.clone()).await;
    world.start("other").await;
    world.start("stuck").await;
    let mut news = world.lcm.news();
    world.eventually("UNRESPONSIVE", "stuck", |r| r.health == Health::Unresponsive).await;
    let then = other.steps.load(Ordering::SeqCst);
    eventually("the other goes on", || other.steps.load(Ordering::SeqCst) > then + 50).await;
    assert_ne!(world.report("other").await.health, Health::Unresponsive);
    open.send(()).unwrap();
    let back = world.eventually("OK", "stuck", |r| r.health == Health::Ok).await;
    assert_eq!(back.state, State::Active);
    // The inventory may be ahead of the news.
    let mut told = Vec::new();
    while !told.contains(&Health::Unresponsive) || told.last() != Some(&Health::Ok) {
        let said = comes(&format!("news beside {told:?}"), news.recv()).await;
        if let super::super::News::State(report) = said.unwrap()
            && report.id == world.id("stuck")
        {
            told.push(report.health);
        }
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_that_does_not_come_back_is_named_too_and_its_caller_gets_an_answer() {
    let world = World::new("s_start");
    let (stuck, open) = Stuck::in_entry("start");
    world.create("stuck", periodic(1000), stuck).await;
    let id = world.id("stuck");
    let start = Change::Run { id, verb: Verb::Start, from: State::Ready, to: State::Active };
    let refused =
        world.lcm.apply(start, (Instant::now() + Duration::from_millis(20)).into()).await.unwrap_err();
    assert!(matches!(refused, Refusal::LcmTimeout { .. }), "{refused}");
    world.eventually("UNRESPONSIVE", "stuck", |r| r.health == Health::Unresponsive).await;
    open.send(()).unwrap();
    world.eventually("OK", "stuck", |r| r.health == Health::Ok).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_back_after_its_caller_gave_up_is_taken_back_and_told() {
    let world = World::new("s_back");
    let given_up = async |name: &str, change: Change, open: &Sender<()>| {
        let refused =
            world.lcm.apply(change, (Instant::now() + Duration::from_millis(20)).into()).await.unwrap_err();
        assert!(matches!(refused, Refusal::LcmTimeout { .. }), "{name}: {refused}");
        open.send(()).unwrap();
    };
    let said = |what: &'static str| move |r: &Report| r.warnings.iter().any(|w| w.contains(what));

    let (arm, open) = Stuck::in_entry("start");
    world.create_as("arm", class(ctl(), Safety::Actuator), periodic(1000), arm.clone()).await;
    let id = world.id("arm");
    let start = Change::Run { id, verb: Verb::Start, from: State::Ready, to: State::Active };
    given_up("arm", start, &open).await;
    let report = world.eventually("being stopped again", "arm", said("it was stopped again")).await;
    assert_eq!(report.state, State::Ready, "as before");
    assert_eq!((arm.made_safe(), arm.steps.load(Ordering::SeqCst)), (1, 0));
    world.run("arm", Verb::Stop).await.unwrap();
    assert_eq!(arm.made_safe(), 1, "there is nothing to stop");

    let (arm, open) = Stuck::in_entry("resume");
    world.create_as("again", class(ctl(), Safety::Actuator), periodic(1000), arm.clone()).await;
    world.start("again").await;
    let stopped = world.run("again", Verb::Stop).await.unwrap().state;
    let id = world.id("again");
    let resume = Change::Run { id, verb: Verb::Resume, from: stopped, to: State::Active };
    given_up("again", resume, &open).await;
    let report = world.eventually("being stopped again", "again", said("it was stopped again")).await;
    assert_eq!((report.state, arm.made_safe()), (stopped, 2));
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_configuration_that_comes_too_late_gives_way_to_the_one_before() {
    let world = World::new("s_config");
    let slow = Arc::new(Configured::default());
    world.create("slow", periodic(1000), slow.clone()).await;
    let (open, door) = channel();
    *slow.door.lock().unwrap() = Some(door);
    let (from, to) = (serde_json::json!({}), serde_json::json!({"gain": 2}));
    let (from_state, to_state) = (State::Ready, State::Ready);
    let change = Change::Configure { id: world.id("slow"), from, to, from_state, to_state };
    let refused =
        world.lcm.apply(change, (Instant::now() + Duration::from_millis(20)).into()).await.unwrap_err();
    assert!(matches!(refused, Refusal::LcmTimeout { .. }), "{refused}");
    open.send(()).unwrap();
    let said = |r: &Report| r.warnings.iter().any(|w| w.contains("former configuration again"));
    let report = world.eventually("its former configuration", "slow", said).await;
    assert_eq!(report.state, State::Ready);
    assert_eq!(*slow.given.lock().unwrap(), ["{}", r#"{"gain":2}"#, "{}"]);
    world.end().await;
}

/// Keeps its configurations; waits for the test if there is a door.
#[derive(Default)]
struct Configured {
    given: Mutex<Vec<String>>,
    door: Mutex<Option<Receiver<()>>>,
}

impl Behaviour for Configured {
    fn configure(&self, json: &str, _: &Own) -> Result<(), String> {
        self.given.lock().unwrap().push(json.into());
        let door = self.door.lock().unwrap().take();
        door.into_iter().for_each(|door| door.recv().unwrap());
        Ok(())
    }
}

fn actuator(any_thread: bool) -> ClassInfo {
    ClassInfo { safe_from_any_thread: any_thread, ..class(ctl(), Safety::Actuator) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stuck_actuator_is_in_fault_and_made_safe_from_another_thread_when_its_class_allows_it() {
    let world = World::new("s_reach");
    let (stuck, open) = Stuck::in_entry("step");
    world.create_as("arm", actuator(true), periodic(1000), stuck.clone()).await;
    world.start("arm").await;
    let report = world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
    assert!(report.fault.contains("out of its step"), "{}", report.fault);
    eventually("made safe while stuck", || stuck.made_safe() == 1).await;
    open.send(()).unwrap();
    eventually("made safe again once back", || stuck.made_safe() == 2).await;
    assert_eq!(stuck.steps.load(Ordering::SeqCst), 1, "no further step");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stuck_actuator_that_nobody_can_reach_is_made_safe_by_its_own_thread_when_it_comes_back() {
    let world = World::new("s_late");
    let (stuck, open) = Stuck::in_entry("step");
    world.create_as("arm", actuator(false), periodic(1000), stuck.clone()).await;
    world.start("arm").await;
    world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
    assert_eq!(stuck.made_safe(), 0);
    open.send(()).unwrap();
    eventually("made safe once back", || stuck.made_safe() == 1).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn removing_a_component_that_hangs_in_a_command_answers_the_caller_and_the_remover() {
    let world = World::new("s_remove");
    let (stuck, open) = Stuck::in_entry("command");
    world.create_as("stuck", class(ctl(), Safety::None), periodic(1000), stuck).await;
    world.start("stuck").await;
    let member = MemberId::parse("s_remove/stuck/ctl/do").unwrap();
    let call = Invoke { member, arg: Payload::None, send: false, deadline_ns: 300_000_000 };
    let caller = world.lcm.invoke(call);
    let remover = async {
        world.eventually("UNRESPONSIVE", "stuck", |r| r.health == Health::Unresponsive).await;
        let component = Box::new(Component {
            class: Arc::new(class(ctl(), Safety::None)),
            config: serde_json::json!({}),
            execution: periodic(1000),
            ports: Arc::default(),
            state: State::Active,
            health: Health::Ok,
            fault: String::new(),
        });
        world.apply(Change::Destroy { id: world.id("stuck"), component }).await.unwrap()
    };
    let (answer, report) = tokio::join!(caller, remover);
    assert!(matches!(answer, Err(Refusal::Deadline { may_still_run: true, .. })), "{answer:?}");
    assert!(
        report.warnings.iter().any(|w| w.contains("its thread has not come back")),
        "{:?}",
        report.warnings
    );
    open.send(()).unwrap();
    world.end().await;
}

/// Panics in the given entry.
struct Panics(&'static str);

impl Panics {
    fn strike(&self, entry: &str) -> Result<(), String> {
        assert!(self.0 != entry, "chaos");
        Ok(())
    }
}

impl Behaviour for Panics {
    fn configure(&self, _: &str, _: &Own) -> Result<(), String> {
        self.strike("configure")
    }
    fn start(&self) -> Result<(), String> {
        self.strike("start")
    }
    fn stop(&self) -> Result<(), String> {
        self.strike("stop")
    }
    fn resume(&self) -> Result<(), String> {
        self.strike("resume")
    }
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.strike("step")
    }
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.strike("command")
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_any_entry_is_a_fault_that_names_it_and_reset_makes_it_ready_again() {
    let world = World::new("s_panics");
    for entry in ["start", "stop", "resume", "step", "command"] {
        let info = class(ctl(), Safety::None);
        world.create_as(entry, info, periodic(1000), Arc::new(Panics(entry))).await;
        let started = world.run(entry, Verb::Start).await;
        match entry {
            "start" => assert!(started.is_err()),
            "command" => assert!(world.call(entry).await.is_err()),
            "stop" => assert!(world.run(entry, Verb::Stop).await.is_err()),
            "resume" => {
                world.run(entry, Verb::Stop).await.unwrap();
                assert!(world.run(entry, Verb::Resume).await.is_err());
            }
            _ => {}
        }
        let report = world.eventually("FAULT", entry, |r| r.state == State::Fault).await;
        // The command that did it is named.
        let named = if entry == "command" { "command ctl/do" } else { entry };
        assert!(report.fault.starts_with(&format!("{named}: chaos")), "{entry}: {}", report.fault);
        let report = world.run(entry, Verb::Reset).await.unwrap();
        assert_eq!((report.state, report.fault.as_str()), (State::Ready, ""));
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actuator_that_loses_what_it_requires_is_made_safe_and_stopped_and_others_only_say_so() {
    let world = World::new("s_peer");
    let (arm, watcher) = (Arc::new(Stuck::default()), Arc::new(Stuck::default()));
    let source = class(plain(false, true), Safety::None);
    world.create_as("source", source, periodic(1000), Arc::new(Stuck::default())).await;
    world.create_as("arm", class(plain(true, false), Safety::Actuator), periodic(1000), arm.clone()).await;
    world.create_as("watcher", class(plain(true, false), Safety::None), periodic(1000), watcher).await;
    for (number, name) in [(1, "arm"), (2, "watcher")] {
        world.connect(number, &format!("{name}/in"), "source/out", ConnectOptions::default()).await;
        world.start(name).await;
    }
    for (number, name) in [(1, "arm"), (2, "watcher")] {
        let port = |path: &str| PortId::parse(&format!("s_peer/{path}")).unwrap();
        let (client, server) = (port(&format!("{name}/in")), port("source/out"));
        let id = ConnectionId(number);
        let connection = Connection { id, client, server, options: ConnectOptions::default() };
        world.apply(Change::Disconnect { connection, replaced: false }).await.unwrap();
    }
    let lost = State::Stopped(StopReason::PeerLost);
    world.eventually("STOPPED{peer_lost}", "arm", |r| r.state == lost).await;
    eventually("made safe", || arm.made_safe() == 1).await;
    for verb in [Verb::Resume, Verb::Start] {
        let refusal = world.run("arm", verb).await.unwrap_err();
        assert!(
            matches!(&refusal, Refusal::Unconnected { ports, verb: v, .. } if ports == &["in"] && *v == verb),
            "{verb}: {refusal}"
        );
        assert_eq!(world.report("arm").await.state, lost, "a {verb} that is refused changes nothing");
    }
    world.connect(4, "arm/in", "source/out", ConnectOptions::default()).await;
    assert_eq!(world.run("arm", Verb::Resume).await.unwrap().state, State::Active);
    let report = world.eventually("STALE_INPUT", "watcher", |r| r.health == Health::StaleInput).await;
    assert_eq!(report.state, State::Active, "Disconnect changes nobody's state");
    world.connect(3, "watcher/in", "source/out", ConnectOptions::default()).await;
    world.eventually("OK", "watcher", |r| r.health == Health::Ok).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_input_that_brings_nothing_for_max_age_is_told_and_so_is_its_recovery() {
    let world = World::new("s_stale");
    let talks = Arc::new(Talks::default());
    let source = class(plain(false, true), Safety::None);
    world.create_as("source", source, periodic(1000), talks.clone()).await;
    let sink = class(plain(true, false), Safety::None);
    world.create_as("sink", sink, periodic(1000), Arc::new(Stuck::default())).await;
    let options = ConnectOptions { max_age_ns: Some(50_000_000), ..ConnectOptions::default() };
    world.connect(1, "sink/in", "source/out", options).await;
    world.start("sink").await;
    world.start("source").await;
    world.eventually("STALE_INPUT", "sink", |r| r.health == Health::StaleInput).await;
    talks.0.store(true, Ordering::SeqCst);
    world.eventually("OK", "sink", |r| r.health == Health::Ok).await;
    world.end().await;
}

/// Writes its output once it is told to.
#[derive(Default)]
struct Talks(AtomicBool);

impl Behaviour for Talks {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        if self.0.load(Ordering::SeqCst) {
            own.write(0, &tick.cycle);
        }
        Ok(())
    }
}

/// Takes longer than its period, a given number of times.
struct Slow(AtomicU64);

impl Behaviour for Slow {
    fn step(&self, tick: &Tick, _: &Own) -> Result<(), String> {
        if self.0.load(Ordering::SeqCst) > 0 {
            self.0.fetch_sub(1, Ordering::SeqCst);
            while os::now_ns() < tick.now_ns + 2 * tick.period_ns {
                std::hint::spin_loop();
            }
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn overruns_are_counted_and_told_and_the_health_recovers() {
    let world = World::new("s_overrun");
    let slow = Arc::new(Slow(AtomicU64::new(3)));
    world.create("slow", periodic(20_000), slow.clone()).await;
    world.start("slow").await;
    world.eventually("OVERRUN", "slow", |r| r.health == Health::Overrun).await;
    world.eventually("OK", "slow", |r| r.health == Health::Ok).await;
    let detail = world.detail("slow").await;
    assert!(detail.overruns >= 3, "each of the three slow cycles counts: {}", detail.overruns);
    world.end().await;
}

/// Changes state of its thread.
struct Rude(&'static str, Mutex<Vec<Sender<()>>>);

impl Rude {
    fn strike(&self, entry: &str) {
        let offend = |what: &str| self.0 == format!("{what} in {entry}");
        if offend("rounding") {
            os::reset_rounding(os::rounding() ^ (1 << 14 | u32::from(cfg!(target_arch = "aarch64")) << 22));
        } else if offend("signals") {
            os::set_sigmask(os::thread_hygiene().sigmask | 1 << 9);
        } else if offend("thread") {
            let (leave, door) = channel::<()>();
            self.1.lock().unwrap().push(leave);
            std::thread::spawn(move || door.recv());
        }
    }
}

impl Behaviour for Rude {
    fn start(&self) -> Result<(), String> {
        self.strike("start");
        Ok(())
    }
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.strike("step");
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_leaves_its_thread_otherwise_than_it_found_it_is_named_and_nobody_else() {
    let world = World::new("s_rude");
    world.create("polite", periodic(1000), Arc::new(Stuck::default())).await;
    world.start("polite").await;
    let cases = [
        ("rounding in start", "start: it changed the rounding mode"),
        ("rounding in step", "step: it changed the rounding mode"),
        ("signals in start", "start: it changed the signal mask"),
        ("signals in step", "the signal mask of its thread was changed"),
        ("thread in start", "own threads still run"),
        ("thread in step", "own threads still run"),
    ];
    for (n, (offence, said)) in cases.into_iter().enumerate() {
        let name = format!("rude{n}");
        let rude = Arc::new(Rude(offence, Mutex::new(Vec::new())));
        world.create(&name, periodic(10_000), rude.clone()).await;
        world.start(&name).await;
        if offence.starts_with("thread") {
            eventually("a thread", || !rude.1.lock().unwrap().is_empty()).await;
            world.run(&name, Verb::Stop).await.unwrap();
        }
        let named = |r: &Report| r.warnings.iter().any(|w| w.contains(said));
        world.eventually(said, &name, named).await;
        world.run(&name, Verb::Stop).await.unwrap();
        rude.1.lock().unwrap().clear();
    }
    assert_eq!(world.report("polite").await.warnings, Vec::<String>::new());
    world.end().await;
}

/// Changes the signal mask of its thread in each step, once it is told to.
#[derive(Default)]
struct Masks(AtomicBool);

impl Behaviour for Masks {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        if self.0.load(Ordering::SeqCst) {
            os::set_sigmask(os::thread_hygiene().sigmask | 1 << 9);
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_several_on_one_thread_the_one_that_keeps_changing_its_signal_mask_is_found_out() {
    let world = World::new("s_mask");
    let rude = Arc::new(Masks::default());
    world.create("head", periodic(1000), Arc::new(Stuck::default())).await;
    let head = world.id("head");
    world.create("rude", inside(ExecutionModel::ExecIn, &head), rude.clone()).await;
    world.create("polite", inside(ExecutionModel::ExecOut, &head), Arc::new(Stuck::default())).await;
    for name in ["polite", "rude", "head"] {
        world.start(name).await;
    }
    rude.0.store(true, Ordering::SeqCst);
    let said = |what: &'static str| move |r: &Report| r.warnings.iter().any(|w| w.contains(what));
    world.eventually("being suspected", "polite", said("by one of")).await;
    world.eventually("being found out", "rude", said("step: it changed the signal mask")).await;
    for name in ["head", "polite"] {
        let report = world.report(name).await;
        assert!(!said("step: it changed")(&report), "{name}: {:?}", report.warnings);
    }
    world.end().await;
}
