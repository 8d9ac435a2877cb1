//! Stop, against every Start that it can meet.
//!
//! Promise: after a Stop was answered, nothing that was decided before it sets in motion what it named.

use std::sync::atomic::Ordering;

use tokio::sync::watch;
use trocar_model::{StopReason, Target};

use super::super::watch::Entry;
use super::super::{Decision, Halted, Lease, News, Order, Stop};
use super::supervision::{Stuck, comes};
use super::*;

const STOPPED: State = State::Stopped(StopReason::Requested);

fn order(decision: u64) -> Order {
    Order { decision: Decision(decision), ..Order::from(Instant::now() + PATIENCE) }
}

impl World {
    fn named(&self, name: &str, known_here: u64) -> Stop {
        let path = format!("{}/{name}", self.process);
        Stop { targets: vec![Target::parse(&path).unwrap()], known_here }
    }

    async fn stop_by(&self, name: &str, decision: Decision) -> Vec<Halted> {
        let order = Order { decision, ..order(0) };
        self.lcm.stop(self.named(name, 0), order).await.unwrap()
    }

    async fn run_by(&self, name: &str, verb: Verb, order: Order) -> Result<Report, Refusal> {
        let (from, to) = (State::Ready, State::Active);
        self.lcm.apply(Change::Run { id: self.id(name), verb, from, to }, order).await
    }

    async fn start_by(&self, name: &str, decision: u64) -> Result<Report, Refusal> {
        self.run_by(name, Verb::Start, order(decision)).await
    }

    /// Waits until the component is inside an entry that its thread does not come out of.
    async fn is_inside(&self, name: &str) {
        let instance = self.lcm.instance(&self.id(name)).unwrap();
        eventually("it is inside its entry", || instance.watch.busy().is_some()).await;
    }
}

fn held_off(refused: Result<Report, Refusal>, why: &str) {
    let refusal = refused.unwrap_err();
    assert_eq!(refusal.reason(), "WRONG_STATE", "{refusal}");
    assert!(refusal.to_string().contains(why), "{refusal}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_that_a_stop_meets_takes_itself_back_and_is_waited_for() {
    for verb in [Verb::Start, Verb::Resume] {
        let world = World::new(if verb == Verb::Start { "st_meets" } else { "st_meets2" });
        let (arm, open) = Stuck::in_entry(if verb == Verb::Start { "start" } else { "resume" });
        world.create_as("arm", class(ctl(), Safety::Actuator), periodic(1000), arm.clone()).await;
        if verb == Verb::Resume {
            world.start_by("arm", 1).await.unwrap();
            world.stop_by("arm", Decision(2)).await;
        }
        let before = (arm.steps.load(Ordering::SeqCst), arm.made_safe(), world.report("arm").await.state);
        let starting = world.run_by("arm", verb, order(5));
        let stopping = async {
            world.is_inside("arm").await;
            let mut stopping = std::pin::pin!(world.stop_by("*", Decision(6)));
            tokio::select! {
                biased;
                early = &mut stopping => panic!("{early:?} although it may be moving"),
                () = std::future::ready(()) => {}
            }
            open.send(()).unwrap();
            stopping.await
        };
        let (started, stopped) = tokio::join!(starting, stopping);
        held_off(started, "stopped while this was being carried out");
        let [Halted { done: Ok(report), .. }] = stopped.as_slice() else { panic!("{stopped:?}") };
        assert_eq!(report.state, before.2, "it is as it was");
        assert_eq!((arm.steps.load(Ordering::SeqCst), arm.made_safe()), (before.0, before.1 + 1));
        assert_eq!(world.run_by("arm", verb, order(7)).await.unwrap().state, State::Active, "asked later");
        world.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_only_made_after_a_stop_named_it_is_held_off_too() {
    let world = World::new("st_later");
    assert!(world.stop_by("**", Decision(6)).await.is_empty());
    let (arm, _open) = Stuck::in_entry("");
    world.create("arm", periodic(1000), arm.clone()).await;
    held_off(world.start_by("arm", 5).await, "stopped while this was being carried out");
    assert_eq!((arm.steps.load(Ordering::SeqCst), arm.made_safe()), (0, 0), "it was not begun");
    assert_eq!(world.lcm.inventory().await.unwrap().decision, Decision(6), "a GCM counts on from there");
    world.start_by("arm", 7).await.unwrap();
    let halted = world.stop_by("arm", Decision(8)).await;
    assert!(matches!(&halted[..], [Halted { was: State::Active, done: Ok(r), .. }] if r.state == STOPPED));
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_whose_gcm_is_lost_meanwhile_is_taken_back() {
    let world = World::new("st_lease");
    for (name, is_told) in [("told", true), ("silent", false)] {
        let (arm, open) = Stuck::in_entry("start");
        world.create_as(name, class(ctl(), Safety::Actuator), periodic(1000), arm.clone()).await;
        let (session, heard) = watch::channel(Instant::now());
        let lease = Lease::new(heard, PATIENCE);
        let starting = world.run_by(name, Verb::Start, Order { lease, ..order(5) });
        let losing = async {
            world.is_inside(name).await;
            // One that stood still finds out by the clock: nobody tells it before its code comes back.
            let long_ago = Instant::now() - 2 * PATIENCE;
            let session = match is_told {
                true => {
                    drop(session);
                    None
                }
                false => {
                    session.send_replace(long_ago);
                    Some(session)
                }
            };
            open.send(()).unwrap();
            session
        };
        let (started, _session) = tokio::join!(starting, losing);
        let refusal = started.unwrap_err();
        assert!(["LCM_TIMEOUT", "WRONG_STATE"].contains(&refusal.reason()), "{refusal}");
        world.eventually("READY", name, |r| r.state == State::Ready).await;
        assert_eq!(arm.steps.load(Ordering::SeqCst), 0, "{name} moved");
        world.start_by(name, 6).await.unwrap();
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_at_the_process_holds_until_the_gcm_has_answered_it() {
    let world = World::new("st_here");
    let (arm, _open) = Stuck::in_entry("");
    world.create("arm", periodic(1000), arm.clone()).await;
    world.start_by("arm", 1).await.unwrap();
    let mut news = world.lcm.news();
    world.stop_by("arm", Decision::HERE).await;
    assert_eq!(world.report("arm").await.state, STOPPED);
    let told = loop {
        if let News::StoppedHere(told) = comes("it is told", news.recv()).await.unwrap() {
            break told;
        }
    };
    assert_eq!(world.lcm.inventory().await.unwrap().stopped_here, told, "a GCM that comes later hears of it");
    held_off(world.start_by("arm", 9).await, "the GCM does not know it yet");
    let (targets, numbers): (Vec<_>, Vec<_>) = told.targets.into_iter().unzip();
    assert_eq!(numbers, [told.number]);
    let answer = Stop { targets, known_here: told.number };
    world.lcm.stop(answer, order(10)).await.unwrap();
    held_off(world.start_by("arm", 9).await, "stopped while this was being carried out");
    world.start_by("arm", 11).await.unwrap();
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_waits_for_no_entry_that_sets_nothing_in_motion() {
    let world = World::new("st_config");
    let (slow, open) = Stuck::in_entry("configure");
    world.create("other", periodic(1000), Arc::new(Stuck::default())).await;
    world.start("other").await;
    let configuring = world.create("slow", periodic(1000), slow.clone());
    let stopping = async {
        eventually("it is made", || world.lcm.instance(&world.id("slow")).is_ok()).await;
        world.is_inside("slow").await;
        let stopped = world.stop_by("**", Decision(6)).await;
        assert_eq!(stopped.len(), 2, "{stopped:?}");
        assert!(stopped.iter().all(|halted| halted.done.is_ok()), "{stopped:?}");
        open.send(()).unwrap();
    };
    let ((), ()) = tokio::join!(configuring, stopping);
    assert_eq!(world.report("other").await.state, STOPPED);
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_stop_is_answered_when_the_first_has_brought_it_to_rest() {
    let world = World::new("st_twice");
    let (arm, open) = Stuck::in_entry("stop");
    world.create_as("arm", class(ctl(), Safety::Actuator), periodic(1000), arm.clone()).await;
    world.start_by("arm", 1).await.unwrap();
    let first = world.stop_by("arm", Decision(2));
    let second = async {
        let instance = world.lcm.instance(&world.id("arm")).unwrap();
        let stopping = || instance.watch.busy().is_some_and(|busy| busy.entry == Entry::Stop);
        eventually("its stop is entered", stopping).await;
        let mut second = std::pin::pin!(world.stop_by("arm", Decision(3)));
        tokio::select! {
            biased;
            early = &mut second => panic!("{early:?} although it is not at rest"),
            () = std::future::ready(()) => {}
        }
        open.send(()).unwrap();
        let second = second.await;
        assert_eq!(arm.made_safe(), 1, "answered before it was made safe");
        second
    };
    let (first, second) = tokio::join!(first, second);
    for halted in first.iter().chain(&second) {
        assert_eq!(halted.done.as_ref().unwrap().state, STOPPED);
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_that_comes_late_leaves_running_what_was_started_after_it_was_decided() {
    let world = World::new("st_older");
    world.create("arm", periodic(1000), Arc::new(Stuck::default())).await;
    world.start_by("arm", 7).await.unwrap();
    let halted = world.stop_by("arm", Decision(6)).await;
    assert!(
        matches!(&halted[..], [Halted { was: State::Active, done: Ok(r), .. }] if r.state == State::Active)
    );
    world.stop_by("arm", Decision(8)).await;
    assert_eq!(world.report("arm").await.state, STOPPED);
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_configuration_that_comes_back_late_sets_nothing_in_motion_that_was_stopped_meanwhile() {
    let world = World::new("st_back");
    let (arm, open) = Stuck::in_entry("configure");
    // The first one is let through.
    open.send(()).unwrap();
    world.create("arm", periodic(1000), arm.clone()).await;
    world.start_by("arm", 1).await.unwrap();
    let (again, door) = std::sync::mpsc::channel();
    arm.close(door);
    let (from, to) = (serde_json::json!({}), serde_json::json!({"gain": 2}));
    let (from_state, to_state) = (State::Active, State::Active);
    let change = Change::Configure { id: world.id("arm"), from, to, from_state, to_state };
    let soon = Instant::now() + Duration::from_millis(20);
    let refused = world.lcm.apply(change, soon.into()).await.unwrap_err();
    assert_eq!(refused.reason(), "LCM_TIMEOUT", "{refused}");
    let mut news = world.lcm.news();
    {
        let mut stopping = std::pin::pin!(world.stop_by("arm", Decision(2)));
        tokio::select! {
            biased;
            early = &mut stopping => panic!("{early:?} although its code does not come back"),
            () = std::future::ready(()) => {}
        }
        again.send(()).unwrap();
        stopping.await;
    }
    assert_eq!(world.report("arm").await.state, STOPPED);
    let mut told = Vec::new();
    while let Ok(next) = news.try_recv() {
        told.extend(if let News::State(report) = next { Some(report.state) } else { None });
    }
    assert_eq!((told.first(), told.contains(&State::Active)), (Some(&STOPPED), false), "{told:?}");
    world.end().await;
}
