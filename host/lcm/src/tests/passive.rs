//! Components that run in their callers' threads: no queued call is forgotten, no caller is kept to run the
//! calls of others, and a caller that hangs in one gets an answer.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_plugin_api::abi::{EXECUTED, QUEUED, Tick};

use super::super::boundary::puppet::{ArgRet, Own};
use super::standing::Held;
use super::*;

/// Sends one command each time the test says so.
#[derive(Default)]
struct Client {
    round: AtomicU64,
    done: AtomicU64,
    accepted: AtomicU64,
}

impl Behaviour for Client {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        let round = self.round.load(Ordering::SeqCst);
        if self.done.load(Ordering::SeqCst) < round {
            if matches!(own.send(0), EXECUTED | QUEUED) {
                self.accepted.fetch_add(1, Ordering::SeqCst);
            }
            self.done.store(round, Ordering::SeqCst);
        }
        Ok(())
    }
}

/// Counts its commands; panics at them when told.
#[derive(Default)]
struct Server {
    ran: AtomicU64,
    panics: bool,
}

impl Behaviour for Server {
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.ran.fetch_add(1, Ordering::SeqCst);
        assert!(!self.panics, "the reason");
        Ok(())
    }
}

/// Rounds in which two clients call at the same moment. A forgotten command is a matter of luck: many runs
/// find more than one long one, which would starve on a busy machine.
const ROUNDS: u64 = 2_000;

#[tokio::test(flavor = "multi_thread")]
async fn two_clients_that_meet_in_a_passive_server_forget_no_command() {
    let world = World::new("pa_meet");
    let server = Arc::new(Server::default());
    world.create_as("server", class(ctl(), Safety::None), model(ExecutionModel::None), server.clone()).await;
    let clients = [Arc::new(Client::default()), Arc::new(Client::default())];
    for (number, (name, client)) in ["a", "b"].into_iter().zip(&clients).enumerate() {
        let info = class(requires_ctl(), Safety::None);
        world.create_as(name, info, model(ExecutionModel::Continuous), client.clone()).await;
        let (id, end) = (number as u64 + 1, format!("{name}/peer"));
        world.connect(id, &end, "server/ctl", ConnectOptions::default()).await;
    }
    for name in ["server", "a", "b"] {
        world.start(name).await;
    }
    let accepted = || clients.iter().map(|c| c.accepted.load(Ordering::SeqCst)).sum::<u64>();
    for round in 1..=ROUNDS {
        clients.iter().for_each(|c| c.round.store(round, Ordering::SeqCst));
        let mut watchdog = Watchdog::of(format!("all commands of round {round} have run"));
        while clients.iter().any(|c| c.done.load(Ordering::SeqCst) < round)
            || server.ran.load(Ordering::SeqCst) < accepted()
        {
            let ran = server.ran.load(Ordering::SeqCst);
            watchdog.saw(format_args!("accepted {}, ran {ran}", accepted()));
            std::thread::yield_now();
        }
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_reason_of_a_panic_in_a_command_that_was_only_sent_is_kept() {
    let world = World::new("pa_panic");
    let server = Arc::new(Server { panics: true, ..Server::default() });
    world.create_as("server", class(ctl(), Safety::None), model(ExecutionModel::None), server).await;
    let client = Arc::new(Client::default());
    world.create_as("a", class(requires_ctl(), Safety::None), periodic(1000), client.clone()).await;
    world.connect(1, "a/peer", "server/ctl", ConnectOptions::default()).await;
    world.start("server").await;
    world.start("a").await;
    client.round.store(1, Ordering::SeqCst);
    let report = world.eventually("FAULT", "server", |r| r.state == State::Fault).await;
    assert!(report.fault.contains("the reason"), "{:?}", report.fault);
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_from_outside_into_a_passive_component_that_hangs_ends_with_its_deadline() {
    let world = World::new("pa_hung");
    let (held, open) = Held::at("command", "");
    world.create_as("arm", class(ctl(), Safety::Actuator), model(ExecutionModel::None), held.clone()).await;
    world.start("arm").await;
    let member = MemberId::parse(&format!("{}/arm/ctl/do", world.process)).unwrap();
    let mut watchdog = Watchdog::of("a call that has begun");
    loop {
        let (member, arg) = (member.clone(), Payload::None);
        match world.lcm.invoke(Invoke { member, arg, send: false, deadline_ns: 20_000_000 }).await {
            Err(Refusal::Deadline { may_still_run: true, .. }) => break,
            // On a busy machine a call may not begin within that time: it is asked again.
            Err(Refusal::Deadline { may_still_run: false, .. }) => watchdog.saw("one that has not begun"),
            other => panic!("no deadline: {:?}", other.map(|r| r.executed)),
        }
    }
    world.eventually("FAULT", "arm", |r| r.state == State::Fault).await;
    open.send(()).unwrap();
    eventually("made safe by whoever comes back", || held.made_safe.load(Ordering::SeqCst) > 0).await;
    world.end().await;
}
