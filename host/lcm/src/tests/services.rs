//! Services requested by components whose entries are closures, answered by hand.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use trocar_plugin_api::abi::{
    DISABLED, EXECUTED, INVALID_ARGUMENT, Outcome, QUEUE_FULL, QUEUED, Tick, WOULD_BLOCK,
};

use super::super::boundary::counting;
use super::super::boundary::puppet::{ArgRet, Own};
use super::super::{ReplyTo, Services};
use super::*;

/// Nested and escaped, so that a reader that allocates would be found.
const REQUEST: &str = r#"{"config":{"a\n":[{"b":"\"}"}]},"path":"host/x","verb":"Create"}"#;

/// Keeps the requests until the test answers.
#[derive(Default)]
struct Counter(Mutex<Vec<(ComponentId, String, ReplyTo)>>);

impl Services for Counter {
    fn request(&self, from: ComponentId, request: String, reply: ReplyTo) {
        self.0.lock().unwrap().push((from, request, reply));
    }
}

impl Counter {
    async fn next(&self) -> (ComponentId, String, ReplyTo) {
        eventually("a request arrives", || !self.0.lock().unwrap().is_empty()).await;
        self.0.lock().unwrap().remove(0)
    }
}

/// Asks when its command is called, or from the next step when told so.
#[derive(Default)]
struct Asks {
    /// Requests for one command.
    times: AtomicU64,
    from_step: AtomicBool,
    fail_in_step: AtomicBool,
    outcomes: Mutex<Vec<Outcome>>,
    allocations: AtomicU64,
    replies: Mutex<Vec<(u64, String)>>,
    device: Mutex<Option<Own>>,
}

impl Asks {
    fn ask(&self, own: &Own, request: &str) {
        let mut outcomes = [0; 100];
        let times = self.times.load(Ordering::Relaxed) as usize;
        counting::watch();
        for (token, outcome) in outcomes.iter_mut().enumerate().take(times) {
            *outcome = own.service(token as u64, request);
        }
        self.allocations.fetch_add(counting::watched(), Ordering::Relaxed);
        self.outcomes.lock().unwrap().extend_from_slice(&outcomes[..times]);
    }

    fn outcomes(&self) -> Vec<Outcome> {
        std::mem::take(&mut *self.outcomes.lock().unwrap())
    }

    fn replies(&self) -> Vec<(u64, String)> {
        std::mem::take(&mut *self.replies.lock().unwrap())
    }
}

impl Behaviour for Asks {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        if self.from_step.swap(false, Ordering::Relaxed) {
            self.ask(own, REQUEST);
        }
        if self.fail_in_step.load(Ordering::Relaxed) { Err("told to".into()) } else { Ok(()) }
    }

    fn command(&self, _: u32, _: ArgRet, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        if !self.from_step.load(Ordering::Relaxed) {
            self.ask(own, REQUEST);
            self.ask(own, "{}");
        }
        Ok(())
    }

    fn on_service(&self, token: u64, reply: &str) -> Result<(), String> {
        self.replies.lock().unwrap().push((token, reply.to_owned()));
        Ok(())
    }
}

struct Scene {
    world: World,
    asks: Arc<Asks>,
    counter: Arc<Counter>,
}

impl Scene {
    /// A running component `c` that asks `times` times, with services.
    async fn new(process: &'static str, how: ExecutionModel, times: u64) -> Scene {
        let scene = Scene::without_services(process, how, times).await;
        scene.world.lcm.offer_services(scene.counter.clone()).unwrap();
        scene
    }

    async fn without_services(process: &'static str, how: ExecutionModel, times: u64) -> Scene {
        let (world, asks) = (World::new(process), Arc::new(Asks::default()));
        asks.times.store(times, Ordering::Relaxed);
        world.create_as("c", class(ctl(), Safety::None), model(how), asks.clone()).await;
        world.start("c").await;
        Scene { world, asks, counter: Arc::default() }
    }

    /// Waits until all jobs given to its thread so far are done.
    async fn settled(&self, verb: Verb) {
        self.world.run("c", verb).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_asks_without_allocating_and_hears_the_reply_with_its_token() {
    let scene = Scene::new("sv-ask", ExecutionModel::OnSignal, 3).await;
    scene.world.call("c").await.unwrap();
    assert_eq!(
        scene.asks.outcomes(),
        [QUEUED, QUEUED, QUEUED, INVALID_ARGUMENT, INVALID_ARGUMENT, INVALID_ARGUMENT]
    );
    assert_eq!(scene.asks.allocations.load(Ordering::Relaxed), 0, "asking allocates on the asking thread");
    for token in 0..3 {
        let (from, request, reply) = scene.counter.next().await;
        assert_eq!((from, request.as_str()), (scene.world.id("c"), REQUEST));
        reply(format!("reply {token}"));
    }
    let said = |n: u64| (n, format!("reply {n}"));
    eventually("three replies", || scene.asks.replies.lock().unwrap().len() == 3).await;
    assert_eq!(scene.asks.replies(), [said(0), said(1), said(2)]);
    scene.world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_is_told_that_it_would_block_in_every_execution_model() {
    for (process, how) in
        [("sv-signal", ExecutionModel::OnSignal), ("sv-continuous", ExecutionModel::Continuous)]
    {
        let scene = Scene::new(process, how, 1).await;
        scene.asks.from_step.store(true, Ordering::Relaxed);
        scene.world.call("c").await.unwrap();
        eventually("its step has asked", || !scene.asks.outcomes.lock().unwrap().is_empty()).await;
        // A step may have come before the command, whose own request is allowed.
        assert_eq!(scene.asks.outcomes()[0], WOULD_BLOCK, "{process}");
        scene.world.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_lcm_without_services_says_that_they_are_disabled() {
    let scene = Scene::without_services("sv-none", ExecutionModel::OnSignal, 1).await;
    scene.world.call("c").await.unwrap();
    assert_eq!(scene.asks.outcomes(), [DISABLED, INVALID_ARGUMENT]);
    scene.world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn sixty_four_requests_may_wait_and_a_reply_that_never_comes_frees_its_place() {
    let scene = Scene::new("sv-full", ExecutionModel::OnSignal, 70).await;
    for _ in 0..2 {
        scene.world.call("c").await.unwrap();
        let outcomes = scene.asks.outcomes();
        assert_eq!(outcomes.iter().filter(|o| **o == QUEUED).count(), 64, "{outcomes:?}");
        assert_eq!(outcomes.iter().filter(|o| **o == QUEUE_FULL).count(), 6, "{outcomes:?}");
        for _ in 0..64 {
            drop(scene.counter.next().await);
        }
    }
    scene.world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_is_handed_over_in_stopped_and_dropped_in_fault() {
    let scene = Scene::new("sv-states", ExecutionModel::OnSignal, 2).await;
    scene.world.call("c").await.unwrap();
    let (first, second) = (scene.counter.next().await.2, scene.counter.next().await.2);
    scene.settled(Verb::Stop).await;
    first("in stopped".into());
    eventually("it hears in STOPPED", || scene.asks.replies.lock().unwrap().len() == 1).await;
    scene.asks.fail_in_step.store(true, Ordering::Relaxed);
    scene.settled(Verb::Resume).await;
    let _ = scene.world.call("c").await;
    scene.world.eventually("FAULT", "c", |r| r.state == State::Fault).await;
    scene.asks.replies();
    second("in fault".into());
    scene.settled(Verb::Reset).await;
    assert_eq!(scene.asks.replies(), [], "a component in FAULT hears nothing");
    scene.world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_or_removed_component_never_hears_what_its_predecessor_asked() {
    let scene = Scene::new("sv-gone", ExecutionModel::OnSignal, 2).await;
    scene.world.call("c").await.unwrap();
    let (first, second) = (scene.counter.next().await.2, scene.counter.next().await.2);
    scene.settled(Verb::Reset).await;
    first("too late".into());
    scene.settled(Verb::Reset).await;
    assert_eq!(scene.asks.replies(), []);
    let component = Box::new(Component {
        ports: Arc::default(),
        class: Arc::new(class(ctl(), Safety::None)),
        config: serde_json::json!({}),
        execution: Execution::default(),
        state: State::Created,
        health: Health::Ok,
        fault: String::new(),
    });
    scene.world.apply(Change::Destroy { id: scene.world.id("c"), component }).await.unwrap();
    second("for nobody".into());
    scene.world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_waits_for_a_device_that_is_inside() {
    let scene = Scene::new("sv-device", ExecutionModel::OnCallback, 1).await;
    scene.world.call("c").await.unwrap();
    let reply = scene.counter.next().await.2;
    let device = scene.asks.device.lock().unwrap().unwrap();
    assert_eq!(device.enter(), EXECUTED);
    reply("late".into());
    device.leave();
    eventually("it hears when the device has left", || !scene.asks.replies.lock().unwrap().is_empty()).await;
    scene.world.end().await;
}
