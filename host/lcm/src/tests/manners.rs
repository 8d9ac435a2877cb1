//! Bad manners towards others: each is named in the state of the component that did it, and no component pays
//! for the fault of another.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};

use trocar_plugin_api::abi::{QUEUE_FULL, Tick, WOULD_BLOCK};

use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Counts its steps; panics at one of them.
#[derive(Default)]
struct Counts {
    steps: AtomicU64,
    panics_at: u64,
}

impl Counts {
    fn steps(&self) -> u64 {
        self.steps.load(Ordering::SeqCst)
    }
}

impl Behaviour for Counts {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        let n = self.steps.fetch_add(1, Ordering::SeqCst) + 1;
        assert!(n != self.panics_at, "chaos");
        if own.has_output() {
            own.write(0, &tick.cycle);
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_panics_on_a_shared_thread_costs_the_others_not_one_cycle() {
    let world = World::new("m_group");
    let head = Execution { period_ns: Some(1_000_000), ..model(ExecutionModel::Stream) };
    let all: Vec<Arc<Counts>> = [0, 7, 0, 11, 0]
        .map(|panics_at| Arc::new(Counts { panics_at, ..Counts::default() }))
        .into_iter()
        .collect();
    world.create_as("head", class(plain(false, true), Safety::None), head, all[0].clone()).await;
    let id = world.id("head");
    world.create("before", inside(ExecutionModel::ExecIn, &id), all[1].clone()).await;
    world.create("after", inside(ExecutionModel::ExecOut, &id), all[2].clone()).await;
    for (name, counts) in [("filter", &all[3]), ("sink", &all[4])] {
        let ports = class(plain(true, name == "filter"), Safety::None);
        world.create_as(name, ports, stream_of(&id), counts.clone()).await;
    }
    world.connect(1, "filter/in", "head/out", ConnectOptions::default()).await;
    world.connect(2, "sink/in", "head/out", ConnectOptions::default()).await;
    for name in ["sink", "filter", "after", "before", "head"] {
        world.start(name).await;
    }
    for name in ["before", "filter"] {
        let report = world.eventually("FAULT", name, |r| r.state == State::Fault).await;
        assert_eq!(report.fault, "step: chaos");
    }
    let then = all[0].steps();
    eventually("the head goes on", || all[0].steps() > then + 50).await;
    world.run("head", Verb::Stop).await.unwrap();
    let [head, before, after, filter, sink] = [0, 1, 2, 3, 4].map(|i| all[i].steps());
    assert_eq!((before, filter), (7, 11), "no step after the panic");
    assert_eq!((after, sink), (head, head), "each stepped in every cycle of the head");
    for name in ["after", "sink"] {
        assert_eq!(world.report(name).await.state, State::Active, "{name}");
    }
    world.end().await;
}

/// Asks for a service in each step.
struct AsksInStep;

impl Behaviour for AsksInStep {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        match own.service(1, r#"{"verb":"List"}"#) {
            WOULD_BLOCK => Ok(()),
            other => Err(format!("the service came to {other}")),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_asks_for_services_from_its_step_is_named_with_how_often() {
    let world = World::new("m_service");
    world.create("asks", periodic(1000), Arc::new(AsksInStep)).await;
    world.start("asks").await;
    let named = |r: &Report| {
        let said: Vec<_> = r.warnings.iter().filter(|w| w.contains("its step asked for services")).collect();
        assert!(said.len() < 2, "one sentence about it is kept: {said:?}");
        said.first().is_some_and(|w| w.contains("so far"))
    };
    let report = world.eventually("being named", "asks", named).await;
    assert_eq!(report.state, State::Active);
    world.end().await;
}

/// Hangs in its command until the test lets go.
struct Hangs(Mutex<Receiver<()>>);

impl Behaviour for Hangs {
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        // The test lets go, or has ended.
        let _ = self.0.lock().unwrap().recv();
        Ok(())
    }
}

/// Sends in each step; counts refusals.
#[derive(Default)]
struct Floods(AtomicU64);

impl Behaviour for Floods {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        if own.send(0) == QUEUE_FULL {
            self.0.fetch_add(1, Ordering::SeqCst);
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_floods_a_peer_is_named_at_both_ends() {
    let world = World::new("m_flood");
    let (open, door) = channel();
    let info = class(ctl(), Safety::None);
    world.create_as("slow", info, model(ExecutionModel::OnSignal), Arc::new(Hangs(Mutex::new(door)))).await;
    let floods = Arc::new(Floods::default());
    world.create_as("floods", class(requires_ctl(), Safety::None), periodic(1000), floods.clone()).await;
    world.connect(1, "floods/peer", "slow/ctl", ConnectOptions::default()).await;
    world.start("slow").await;
    world.start("floods").await;
    let says = |what: &'static str| move |r: &Report| r.warnings.iter().any(|w| w.contains(what));
    world.eventually("being named", "slow", says("from m_flood/floods was full")).await;
    world.eventually("being named", "floods", says("it flooded m_flood/slow with commands")).await;
    assert!(floods.0.load(Ordering::SeqCst) > 0);
    world.run("floods", Verb::Stop).await.unwrap();
    drop(open);
    world.end().await;
}
