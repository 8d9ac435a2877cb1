//! An actuator whose required connection is replaced: it goes on, unless the second half fails.
//!
//! Promise: no clock decides about an announced replacement; a connection that was not made counts as lost
//! all the same.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_model::StopReason;
use trocar_plugin_api::abi::Tick;
use trocar_rt::os;

use super::super::boundary::puppet::Own;
use super::*;

/// A time longer than a plain Disconnect is tolerated, ns.
const HELD_UP_NS: u64 = 60_000_000;
const LOST: State = State::Stopped(StopReason::PeerLost);

#[derive(Default)]
struct Arm {
    steps: AtomicU64,
    made_safe: AtomicU64,
}

impl Arm {
    fn made_safe(&self) -> u64 {
        self.made_safe.load(Ordering::SeqCst)
    }
}

impl Behaviour for Arm {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.steps.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }

    fn make_safe(&self) -> Result<(), String> {
        self.made_safe.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

/// An ACTIVE actuator `arm` that requires `in`, connected to `a/out` by connection 1; there is a `b`, too.
async fn armed(process: &'static str) -> (World, Arc<Arm>) {
    let (world, arm) = (World::new(process), Arc::new(Arm::default()));
    for source in ["a", "b"] {
        let info = class(plain(false, true), Safety::None);
        world.create_as(source, info, periodic(1000), Arc::new(Arm::default())).await;
    }
    world.create_as("arm", class(plain(true, false), Safety::Actuator), periodic(1000), arm.clone()).await;
    world.connect(1, "arm/in", "a/out", ConnectOptions::default()).await;
    world.start("arm").await;
    (world, arm)
}

fn wire(world: &World, number: u64, source: &str) -> Connection {
    let port = |path: &str| PortId::parse(&format!("{}/{path}", world.process)).unwrap();
    let (client, server) = (port("arm/in"), port(&format!("{source}/out")));
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    Connection { id: ConnectionId(number), client, server, options }
}

/// Waits as a slow machine would: until a plain Disconnect would have been judged, and the arm has stepped
/// on.
async fn held_up(arm: &Arm) {
    let (then, steps) = (os::now_ns(), arm.steps.load(Ordering::SeqCst));
    let over = || os::now_ns() > then + HELD_UP_NS && arm.steps.load(Ordering::SeqCst) > steps;
    eventually("the arm steps on between the halves of a replace", over).await;
}

/// Checks that the arm is ACTIVE and has its input; its punctuality on this machine is another matter.
async fn undisturbed(world: &World, when: &str) {
    let report = world.report("arm").await;
    assert_eq!(report.state, State::Active, "{when}: {report:?}");
    assert_ne!(report.health, Health::StaleInput, "{when}: {report:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_active_actuator_is_rewired_twenty_times_however_long_the_halves_lie_apart() {
    let (world, arm) = armed("r_twenty").await;
    for number in 1..=20 {
        let (old, new) = if number % 2 == 1 { ("a", "b") } else { ("b", "a") };
        let connection = wire(&world, number, old);
        world.apply(Change::Disconnect { connection, replaced: true }).await.unwrap();
        held_up(&arm).await;
        undisturbed(&world, "between the halves").await;
        world.apply(Change::Connect { connection: wire(&world, number + 1, new) }).await.unwrap();
    }
    held_up(&arm).await;
    undisturbed(&world, "at the end").await;
    assert_eq!(arm.made_safe(), 0, "it never was without what it requires");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replace_that_is_refused_and_taken_back_disturbs_nobody_however_long_that_takes() {
    let (world, arm) = armed("r_back").await;
    let connection = wire(&world, 1, "a");
    world.apply(Change::Disconnect { connection, replaced: true }).await.unwrap();
    held_up(&arm).await;
    world.apply(Change::Connect { connection: wire(&world, 2, "nobody") }).await.unwrap_err();
    held_up(&arm).await;
    undisturbed(&world, "after the refusal").await;
    world.apply(Change::Connect { connection: wire(&world, 1, "a") }).await.unwrap();
    held_up(&arm).await;
    undisturbed(&world, "with the former connection").await;
    assert_eq!(arm.made_safe(), 0, "what was refused has changed nothing");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replace_whose_second_half_fails_or_never_comes_is_a_lost_peer() {
    let (world, arm) = armed("r_half").await;
    let connection = wire(&world, 1, "a");
    world.apply(Change::Disconnect { connection, replaced: true }).await.unwrap();
    world.apply(Change::Connect { connection: wire(&world, 2, "nobody") }).await.unwrap_err();
    world.eventually("STOPPED{peer_lost}", "arm", |r| r.state == LOST).await;
    eventually("made safe", || arm.made_safe() == 1).await;
    // The manager died between the halves.
    world.apply(Change::Connect { connection: wire(&world, 3, "b") }).await.unwrap();
    world.run("arm", Verb::Resume).await.unwrap();
    let connection = wire(&world, 3, "b");
    world.apply(Change::Disconnect { connection, replaced: true }).await.unwrap();
    world.eventually("STOPPED{peer_lost}", "arm", |r| r.state == LOST).await;
    eventually("made safe", || arm.made_safe() == 2).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_fails_where_none_was_taken_away_loses_nothing() {
    let (world, arm) = armed("r_extra").await;
    world.apply(Change::Connect { connection: wire(&world, 2, "nobody") }).await.unwrap_err();
    held_up(&arm).await;
    undisturbed(&world, "with the connection it has").await;
    assert_eq!(arm.made_safe(), 0);
    world.end().await;
}
