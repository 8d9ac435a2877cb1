//! The ways a program lets a host go: dropped at an early return, in a panic, without its runtime, or shut
//! down.
//!
//! Promise: on each of them an actuator is made safe, steps no more and is destroyed before the program goes
//! on.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use serde_json::json;
use tokio::runtime::{Builder, Runtime};
use trocar::Host;
use trocar::StaticPlugin;
use trocar::host::{HostError, StateChoice};
use trocar::model::State;
use trocar_sdk::{prelude::*, static_plugin};

const LONG: Duration = Duration::from_secs(20);

/// What became of one motor, seen from outside.
#[derive(Default)]
struct Tally {
    steps: AtomicU64,
    made_safe: AtomicU64,
    destroyed: AtomicBool,
    /// It hangs in its step until this is taken back.
    hangs: Mutex<bool>,
    /// It does.
    inside: AtomicBool,
    freed: Condvar,
}

impl Tally {
    fn of(component: &str) -> Arc<Tally> {
        static ALL: Mutex<BTreeMap<String, Arc<Tally>>> = Mutex::new(BTreeMap::new());
        ALL.lock().unwrap().entry(component.to_owned()).or_default().clone()
    }

    fn step(&self) {
        self.steps.fetch_add(1, Ordering::AcqRel);
        let hangs = self.hangs.lock().unwrap();
        self.inside.store(*hangs, Ordering::Release);
        drop(self.freed.wait_while(hangs, |hangs| *hangs).unwrap());
    }

    fn is_at_rest(&self) {
        assert!(self.made_safe.load(Ordering::Acquire) > 0, "it was not made safe");
        assert!(self.destroyed.load(Ordering::Acquire), "its Drop did not run");
        // Nobody is left who could step it: whoever holds it has counted it as destroyed.
        assert!(self.steps.load(Ordering::Acquire) > 0, "it never ran, so nothing was shown");
    }
}

impl MakeSafe for Tally {
    fn make_safe(&self) -> Result {
        self.made_safe.fetch_add(1, Ordering::AcqRel);
        Ok(())
    }
}

/// Drives something at 200 Hz.
#[derive(Component)]
#[component(rate_hz = 200, safety = "actuator", safe_from_any_thread)]
struct Driven {
    #[host]
    host: trocar_sdk::Host,
    #[state]
    turns: u64,
}

impl SafeFromAnyThread for Driven {
    fn safe_handle(&self) -> Arc<dyn MakeSafe> {
        Tally::of(self.host.instance_name())
    }
}

impl Component for Driven {
    fn step(&mut self, _: &Tick) -> Result {
        self.turns += 1;
        Tally::of(self.host.instance_name()).step();
        Ok(())
    }
}

impl Drop for Driven {
    fn drop(&mut self) {
        Tally::of(self.host.instance_name()).destroyed.store(true, Ordering::Release);
    }
}

/// Its making takes until it is let through.
#[derive(Component)]
#[component(model = "on_signal")]
struct Slow {
    _door: Door,
    #[state]
    made: u64,
}

impl Component for Slow {}

/// Stands for a device that takes its time to be opened.
struct Door;

/// Somebody stands before it; it is open; whoever came in is gone again.
static DOOR: [AtomicBool; 3] = [const { AtomicBool::new(false) }; 3];

fn seen(what: usize) -> std::result::Result<(), &'static str> {
    if DOOR[what].load(Ordering::Acquire) { Ok(()) } else { Err("not yet") }
}

impl Default for Door {
    fn default() -> Door {
        DOOR[0].store(true, Ordering::Release);
        trocar_tests::eventually("the door opens", || seen(1));
        Door
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        DOOR[2].store(true, Ordering::Release);
    }
}

const DRIVES: StaticPlugin = static_plugin!(name = "drives", Driven, Slow);

/// A host called `name` with a running motor, `name/motor`.
async fn running(name: &str) -> std::result::Result<Host, HostError> {
    let host = Host::builder().name(name).plugin(DRIVES).listen("127.0.0.1:0").start().await?;
    let motor = format!("{name}/motor");
    host.create(&motor, "driven", json!({})).await?;
    host.start(&motor).await?;
    host.wait_for(&motor, State::Active, LONG).await?;
    let mut watchdog = trocar_tests::Watchdog::of(format!("{motor} turns"));
    while host.read(&motor).await?.value["turns"] == json!(0) {
        watchdog.saw("it has not turned yet");
        tokio::task::yield_now().await;
    }
    Ok(host)
}

fn runtime() -> Runtime {
    Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_host_dropped_inside_its_runtime_leaves_its_actuator_at_rest() {
    drop(running("inside").await.unwrap());
    Tally::of("inside/motor").is_at_rest();
}

#[tokio::test]
async fn a_host_dropped_on_the_only_thread_of_its_runtime_leaves_its_actuator_at_rest() {
    drop(running("single").await.unwrap());
    Tally::of("single/motor").is_at_rest();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_early_return_with_a_question_mark_leaves_the_actuator_at_rest() {
    async fn program() -> std::result::Result<(), HostError> {
        let host = running("early").await?;
        host.start("early/nobody").await?;
        host.shutdown().await;
        Ok(())
    }
    assert_eq!(program().await.unwrap_err().reason(), "COMPONENT_NOT_FOUND");
    Tally::of("early/motor").is_at_rest();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_leaves_the_actuator_at_rest() {
    let program = tokio::spawn(async {
        let _host = running("panic").await.unwrap();
        panic!("meant to be");
    });
    assert!(program.await.unwrap_err().is_panic());
    Tally::of("panic/motor").is_at_rest();
}

#[test]
fn a_host_dropped_outside_its_runtime_leaves_its_actuator_at_rest() {
    let runtime = runtime();
    let host = runtime.block_on(running("outside")).unwrap();
    drop(host);
    Tally::of("outside/motor").is_at_rest();
}

#[test]
fn a_host_dropped_after_its_runtime_leaves_its_actuator_at_rest() {
    let runtime = runtime();
    let host = runtime.block_on(running("orphan")).unwrap();
    drop(runtime);
    let motor = Tally::of("orphan/motor");
    assert!(!motor.destroyed.load(Ordering::Acquire), "the runtime's end is not the host's");
    drop(host);
    motor.is_at_rest();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_host_is_shut_down_through_a_shared_reference_any_number_of_times() {
    let host = Arc::new(running("shared").await.unwrap());
    let other = host.clone();
    let first = tokio::spawn(async move { other.shutdown().await });
    host.shutdown().await;
    Tally::of("shared/motor").is_at_rest();
    first.await.unwrap();
    host.shutdown().await;
    assert!(host.has_ended());
    let lost = host.create("shared/late", "driven", json!({})).await.unwrap_err();
    assert_eq!(lost.reason(), "PROCESS_LOST", "{lost}");
    assert_eq!(host.read("shared/motor").await.unwrap_err().reason(), "PROCESS_LOST");
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_made_any_more_by_who_kept_the_manager_of_a_dropped_host() {
    let host = running("kept").await.unwrap();
    let (gcm, lcm) = (host.gcm().unwrap().clone(), host.lcm().unwrap().clone());
    drop(host);
    Tally::of("kept/motor").is_at_rest();
    let id = trocar::model::ComponentId::parse("kept/late").unwrap();
    let late = trocar::model::Request::Create {
        id,
        class: "driven".into(),
        config: None,
        execution: trocar::model::Execution::default(),
    };
    let refused = gcm.execute(vec![late], trocar::gcm::ExecuteOptions::default()).await.unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_LOST", "{refused}");
    let inventory = trocar::lcm::Lcm::inventory(&*lcm).await.unwrap();
    assert!(inventory.components.is_empty(), "{inventory:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn two_hosts_of_one_program_with_components_of_one_name_end_apart() {
    let (left, right) = (running("left").await.unwrap(), running("right").await.unwrap());
    drop(left);
    Tally::of("left/motor").is_at_rest();
    let other = Tally::of("right/motor");
    assert!(!other.destroyed.load(Ordering::Acquire));
    assert_eq!(right.state("right/motor").await.unwrap(), State::Active);
    drop(right);
    other.is_at_rest();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_that_is_still_being_made_at_the_end_is_taken_back() {
    let host = Arc::new(running("slow").await.unwrap());
    let maker = host.clone();
    let making = tokio::spawn(async move { maker.create("slow/late", "slow", json!({})).await });
    trocar_tests::eventually("it is being made", || seen(0));
    host.shutdown().await;
    DOOR[1].store(true, Ordering::Release);
    let refused = making.await.unwrap().unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_LOST", "{refused}");
    trocar_tests::eventually("what was made is destroyed", || seen(2));
}

#[test]
fn a_shutdown_that_nobody_waits_for_any_more_goes_on_and_needs_no_runtime() {
    let runtime = runtime();
    let host = runtime.block_on(running("begun")).unwrap();
    let mut shutdown = Box::pin(host.shutdown());
    let begun = shutdown.as_mut().poll(&mut Context::from_waker(Waker::noop()));
    drop(shutdown);
    drop(host);
    Tally::of("begun/motor").is_at_rest();
    assert!(matches!(begun, Poll::Pending | Poll::Ready(())));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hanging_actuator_is_made_safe_and_does_not_hold_up_whoever_drops_the_host() {
    let host = running("hung").await.unwrap();
    let motor = Tally::of("hung/motor");
    *motor.hangs.lock().unwrap() = true;
    trocar_tests::eventually("it hangs", || {
        if motor.inside.load(Ordering::Acquire) { Ok(()) } else { Err("not yet") }
    });
    drop(host);
    // Coming back is the proof: it hangs still.
    assert!(*motor.hangs.lock().unwrap());
    assert!(motor.made_safe.load(Ordering::Acquire) > 0, "it was not made safe");
    *motor.hangs.lock().unwrap() = false;
    motor.freed.notify_all();
    trocar_tests::eventually("it is destroyed when it comes back", || {
        if motor.destroyed.load(Ordering::Acquire) { Ok(()) } else { Err("not yet") }
    });
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_that_is_given_up_leaves_nothing_behind() {
    // A GCM that takes the call and says nothing.
    let silent = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let temp = tempfile::tempdir().unwrap();
    let state = temp.path().join("state");
    let builder = Host::builder().name("half").plugin(DRIVES).state(StateChoice::Durable(state.clone()));
    let start = builder.gcm(silent.local_addr().unwrap().to_string()).start();
    tokio::select! {
        _ = start => panic!("nobody answered it"),
        called = silent.accept() => drop(called),
    }
    assert!(!state.exists(), "its directory is still there");
}

#[test]
fn a_host_started_without_a_runtime_or_with_half_a_one_says_what_it_lacks() {
    let start = pin!(Host::builder().start());
    let Poll::Ready(Err(refused)) = start.poll(&mut Context::from_waker(Waker::noop())) else {
        panic!("it was started");
    };
    assert_eq!(refused.reason(), "NO_RUNTIME");
    assert!(refused.help().contains("enable_all"), "{}", refused.help());
    let half = |runtime: Runtime| runtime.block_on(Host::builder().start()).err().map(|e| e.to_string());
    let clockless = half(Builder::new_current_thread().build().unwrap());
    assert!(clockless.as_ref().is_some_and(|e| e.contains("no clock")), "{clockless:?}");
    let deaf = half(Builder::new_current_thread().enable_time().build().unwrap());
    assert!(deaf.as_ref().is_some_and(|e| e.contains("no network")), "{deaf:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_is_none_is_refused_as_a_name() {
    let refused = Host::builder().name("").start().await.err().unwrap();
    assert_eq!(
        (refused.reason(), refused.to_string().as_str()),
        ("BAD_NAME", "`` is no name for a process: it is empty")
    );
    assert!(!refused.help().contains("process/component"), "{}", refused.help());
}
