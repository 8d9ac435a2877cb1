//! The reported state of a component is true, whatever comes late: a configuration, a device's thread, a
//! handler that fails, a restart.

use std::ffi::c_void;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use trocar_loader::system;
use trocar_model::{Handler, StopReason};
use trocar_plugin_api::abi::{EXECUTED, NOT_ACTIVE, Outcome, Tick};

use super::super::When;
use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Stays inside the first entry of one kind until the test lets go; counts later entries.
#[derive(Default)]
pub(super) struct Held {
    entry: &'static str,
    /// Failure that the entry then returns; empty = success.
    says: &'static str,
    door: Mutex<Option<Receiver<()>>>,
    pub(super) inside: AtomicBool,
    pub(super) steps: AtomicU64,
    pub(super) stops: AtomicU64,
    pub(super) made_safe: AtomicU64,
    pub(super) destroyed: AtomicBool,
    device: Mutex<Option<Own>>,
}

impl Held {
    pub(super) fn at(entry: &'static str, says: &'static str) -> (Arc<Held>, Sender<()>) {
        let (open, door) = channel();
        (Arc::new(Held { entry, says, door: Mutex::new(Some(door)), ..Held::default() }), open)
    }

    fn pass(&self, entry: &str) -> Result<(), String> {
        if self.entry == entry
            && let Some(door) = self.door.lock().unwrap().take()
        {
            self.inside.store(true, Ordering::SeqCst);
            // The test lets go, or has ended.
            let _ = door.recv();
            if !self.says.is_empty() {
                return Err(self.says.into());
            }
        }
        Ok(())
    }

    pub(super) async fn is_inside(&self) {
        eventually("somebody inside", || self.was_entered()).await;
    }

    pub(super) fn was_entered(&self) -> bool {
        self.inside.load(Ordering::SeqCst)
    }

    pub(super) fn device(&self) -> Own {
        self.device.lock().unwrap().unwrap()
    }
}

impl Behaviour for Held {
    fn stop(&self) -> Result<(), String> {
        self.stops.fetch_add(1, Ordering::SeqCst);
        self.pass("stop")
    }
    fn make_safe(&self) -> Result<(), String> {
        self.made_safe.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        self.steps.fetch_add(1, Ordering::SeqCst);
        self.pass("step")
    }
    fn command(&self, _: u32, _: ArgRet, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        self.pass("command")
    }
    fn destroyed(&self) {
        self.destroyed.store(true, Ordering::SeqCst);
    }
}

fn live_configure(world: &World, name: &str) -> Change {
    let (from, to) = (serde_json::json!({}), serde_json::json!({}));
    let (from_state, to_state) = (State::Active, State::Active);
    Change::Configure { id: world.id(name), from, to, from_state, to_state }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_configure_that_waited_while_the_step_failed_is_refused_and_revives_nothing() {
    let world = World::new("st_revive");
    let (held, open) = Held::at("step", "it broke");
    world.create("c", periodic(1_000_000), held.clone()).await;
    world.start("c").await;
    held.is_inside().await;
    let configure = world.apply(live_configure(&world, "c"));
    let opener = async {
        tokio::task::yield_now().await;
        open.send(()).unwrap();
    };
    let (refused, ()) = tokio::join!(configure, opener);
    let report = world.report("c").await;
    assert_eq!(report.state, State::Fault, "{refused:?}");
    match refused {
        Err(Refusal::WrongState { state: State::Fault, verb: Verb::Configure, .. }) => {}
        other => panic!("not refused for its state: {other:?}"),
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_stands_still_is_not_stopped_again_when_the_host_ends() {
    let world = World::new("st_twice");
    let (held, _open) = Held::at("", "");
    world.create("c", periodic(1_000_000), held.clone()).await;
    world.start("c").await;
    world.run("c", Verb::Stop).await.unwrap();
    world.run("c", Verb::Stop).await.unwrap();
    assert_eq!(held.stops.load(Ordering::SeqCst), 1, "it stood still when it was asked again");
    world.run("c", Verb::Resume).await.unwrap();
    world.run("c", Verb::Stop).await.unwrap();
    assert_eq!(held.stops.load(Ordering::SeqCst), 2, "it ran in between");
    world.end().await;
    assert_eq!(held.stops.load(Ordering::SeqCst), 2, "the host's end stopped what stood still");
}

#[tokio::test(flavor = "multi_thread")]
async fn no_thread_of_a_device_that_waited_comes_in_after_stop() {
    let world = World::new("st_device");
    let (held, open) = Held::at("command", "");
    let patient = Execution { max_step_ns: Some(60_000_000_000), ..model(ExecutionModel::OnCallback) };
    world.create_as("arm", class(ctl(), Safety::Actuator), patient, held.clone()).await;
    world.start("arm").await;
    let rest = async {
        held.is_inside().await;
        let device = held.device();
        let comes_in = std::thread::spawn(move || -> Outcome {
            let outcome = device.enter();
            if outcome == EXECUTED {
                device.leave();
            }
            outcome
        });
        let (from, to) = (State::Active, State::Stopped(StopReason::Requested));
        let stop = world.apply(Change::Run { id: world.id("arm"), verb: Verb::Stop, from, to });
        let opener = async {
            let arm = world.lcm.instance(&world.id("arm")).unwrap();
            eventually("it counts as stopped", || !arm.is_active()).await;
            open.send(()).unwrap();
        };
        let (stopped, ()) = tokio::join!(stop, opener);
        stopped.unwrap();
        comes_in.join().unwrap()
    };
    let (_, outcome) = tokio::join!(world.call("arm"), rest);
    assert_eq!(outcome, NOT_ACTIVE, "let in after Stop");
    assert_eq!(held.made_safe.load(Ordering::SeqCst), 1);
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_is_found_by_its_tick_after_a_restart_as_well() {
    let world = World::new("st_tick");
    let (held, _open) = Held::at("", "");
    let ports = Ports { state: Some(Type::Prim(Prim::U64)), ..Ports::default() };
    world.create_as("c", class(ports, Safety::None), periodic(1000), held.clone()).await;
    for _ in 0..2 {
        world.start("c").await;
        let then = held.steps.load(Ordering::SeqCst);
        eventually("some steps", || held.steps.load(Ordering::SeqCst) > then + 20).await;
        world.run("c", Verb::Stop).await.unwrap();
        let path = format!("{}/c", world.process);
        let soon = Instant::now() + PATIENCE;
        // A row that exists: on a busy machine some ticks are skipped.
        let tick = world.lcm.read(path.clone(), When::Delayed(5), false, soon).await.unwrap().seq;
        let row = world.lcm.read(path, When::Tick(tick), false, soon).await.unwrap();
        assert_eq!(row.seq, tick);
    }
    world.end().await;
}

/// Its handler fails every time.
#[derive(Default)]
struct Failing {
    heard: AtomicU64,
    on: Mutex<Vec<String>>,
}

impl Behaviour for Failing {
    fn on_event(&self, _: u32, _: *const c_void, _: &Own) -> Result<(), String> {
        self.heard.fetch_add(1, Ordering::SeqCst);
        self.on.lock().unwrap().push(std::thread::current().name().unwrap_or("?").to_owned());
        Err("no use for it".into())
    }
}

/// A required interface with a direct handler of the system interface's event of that number.
fn hears(event: usize) -> Ports {
    let event = system::interface().events[event].clone();
    let handler = Handler {
        name: event.name,
        doc: String::new(),
        payload: event.payload,
        optional: false,
        direct: true,
    };
    let (name, doc) = ("peer".into(), String::new());
    Ports {
        required: vec![Required {
            name,
            doc,
            optional: false,
            functions: Vec::new(),
            handlers: vec![handler],
        }],
        ..Ports::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_watchdog_tells_a_passive_component_is_handled_on_its_own_thread_and_failures_are_counted() {
    let world = World::new("st_told");
    let (held, open) = Held::at("step", "");
    world.create("c", periodic(1000), held.clone()).await;
    let listener = Arc::new(Failing::default());
    let info = class(hears(system::WARNING), Safety::None);
    world.create_as("listener", info, model(ExecutionModel::None), listener.clone()).await;
    world.connect(1, "listener/peer", "c/system", ConnectOptions::default()).await;
    world.start("listener").await;
    world.start("c").await;
    eventually("it hears that the other hangs", || listener.heard.load(Ordering::SeqCst) > 0).await;
    open.send(()).unwrap();
    let on = listener.on.lock().unwrap().clone();
    assert!(on.iter().all(|thread| thread == "listener"), "handled on {on:?}");
    let said = |r: &Report| {
        r.warnings.iter().any(|w| w.contains("its event handlers failed") && w.contains("no use for it"))
    };
    let report = world.eventually("saying that its handler failed", "listener", said).await;
    assert_eq!(report.state, State::Active, "a handler that says no ends nothing");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_stands_since_its_process_was_started_again_is_stopped_by_request_once_somebody_does_that() {
    let world = World::new("st_again");
    let (held, _open) = Held::at("", "");
    world.create_as("arm", class(ctl(), Safety::Actuator), periodic(1_000_000), held.clone()).await;
    let (from, to) = (serde_json::json!({}), serde_json::json!({}));
    let (from_state, to_state) = (State::Ready, State::Stopped(StopReason::Restarted));
    let stands = Change::Configure { id: world.id("arm"), from, to, from_state, to_state };
    assert_eq!(world.apply(stands).await.unwrap().state, to_state);
    let stopped = world.run("arm", Verb::Stop).await.unwrap();
    assert_eq!(stopped.state, State::Stopped(StopReason::Requested));
    assert_eq!(world.report("arm").await.state, stopped.state);
    world.start("arm").await;
    world.end().await;
}
