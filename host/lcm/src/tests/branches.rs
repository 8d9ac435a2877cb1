//! Frames: a branch that takes none never slows the trunk, and a stream is rewired while its frames flow.
//!
//! Promise: each frame made arrives or is a counted drop, the camera never lacks a slot, and all slots come
//! back.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};

use trocar_model::{Queue, Type};
use trocar_plugin_api::abi::{EXHAUSTED, Tick};

use super::super::LinkDetail;
use super::super::boundary::puppet::Own;
use super::leaving::LongCycle;
use super::*;

/// One output `out`, or input `in`, of frames with a number; the pool of an output is the LCM's own.
pub(super) fn frames(input: bool, output: bool) -> Ports {
    let mut ports = plain(input, output);
    let inputs = ports.inputs.iter_mut().map(|port| &mut port.ty);
    for ty in inputs.chain(ports.outputs.iter_mut().map(|port| &mut port.ty)) {
        let (header, format) = (Type::Prim(Prim::U64), "image".to_owned());
        *ty = PortType::Frame { header, format, max_bytes: 64 };
    }
    ports
}

/// Makes frames 1, 2, 3, …
#[derive(Default)]
struct Camera {
    made: AtomicU64,
    exhausted: AtomicU64,
}

impl Camera {
    fn made(&self) -> u64 {
        self.made.load(Ordering::SeqCst)
    }

    async fn makes(&self, more: u64) {
        let then = self.made();
        eventually("more frames", || self.made() >= then + more).await;
    }
}

impl Behaviour for Camera {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        if own.give(0, self.made() + 1) == EXHAUSTED {
            self.exhausted.fetch_add(1, Ordering::SeqCst);
        } else {
            self.made.fetch_add(1, Ordering::SeqCst);
        }
        Ok(())
    }
}

/// Takes all frames that wait, and still holds the last one.
#[derive(Default)]
struct Screen(Mutex<Vec<u64>>);

impl Screen {
    fn seen(&self) -> Vec<u64> {
        self.0.lock().unwrap().clone()
    }

    async fn sees_more(&self, what: &str) {
        let then = self.seen().len();
        eventually(what, || self.seen().len() > then + 20).await;
    }
}

impl Behaviour for Screen {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.0.lock().unwrap().extend(std::iter::from_fn(|| own.take(0)).map(|(number, _)| number));
        Ok(())
    }
}

/// Passes frames on.
#[derive(Default)]
struct Filter(Screen);

impl Behaviour for Filter {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.0.0.lock().unwrap().extend(std::iter::from_fn(|| own.pass(0, 0)));
        Ok(())
    }
}

/// End of a branch after its first frames.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    Stopped,
    Hangs,
    Fails,
}

/// A screen that ends in one of these ways with its fifth frame, once.
struct Branch {
    screen: Screen,
    end: End,
    over: AtomicBool,
    door: Mutex<Receiver<()>>,
}

impl Behaviour for Branch {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        if self.over.load(Ordering::SeqCst) {
            return self.screen.step(tick, own);
        }
        let seen = own.take(0).map(|(number, _)| number);
        let mut all = self.screen.0.lock().unwrap();
        all.extend(seen);
        if all.len() < 5 {
            return Ok(());
        }
        drop(all);
        self.over.store(true, Ordering::SeqCst);
        match self.end {
            End::Stopped => Ok(()),
            // The test lets go, or has ended.
            End::Hangs => self.door.lock().unwrap().recv().or(Ok(())),
            End::Fails => Err("broken".into()),
        }
    }
}

impl World {
    async fn link(&self, number: u64) -> LinkDetail {
        let links = self.lcm.links().await.unwrap();
        links.into_iter().find(|link| link.connection == number).unwrap()
    }

    /// Waits until each of these frames was taken or dropped.
    async fn accounted(&self, number: u64, made: u64) -> LinkDetail {
        let mut watchdog = Watchdog::of(format!("each of {made} frames is taken or dropped"));
        loop {
            let link = self.link(number).await;
            let link = LinkDetail { dropped: link.dropped + link.skipped, ..link };
            if link.passed + link.dropped == made {
                return link;
            }
            watchdog.saw(format_args!("{link:?}"));
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn destroy(&self, name: &str, ports: Ports) {
        let component = Box::new(Component {
            ports: Arc::default(),
            class: Arc::new(class(ports, Safety::None)),
            config: serde_json::json!({}),
            execution: Execution::default(),
            state: State::Ready,
            health: Health::Ok,
            fault: String::new(),
        });
        self.apply(Change::Destroy { id: self.id(name), component }).await.unwrap();
    }

    fn wire(&self, number: u64, client: &str, server: &str, options: ConnectOptions) -> Connection {
        let port = |path: &str| PortId::parse(&format!("{}/{path}", self.process)).unwrap();
        Connection { id: ConnectionId(number), client: port(client), server: port(server), options }
    }

    async fn cut(&self, connection: Connection, replaced: bool) {
        self.apply(Change::Disconnect { connection, replaced }).await.unwrap();
    }

    /// Checks that the camera never lacked a slot, and that with its readers gone all slots are back.
    async fn all_slots_come_back(&self, camera: &Camera, readers: &[(u64, &str)]) {
        assert_eq!(camera.exhausted.load(Ordering::SeqCst), 0, "it was refused a slot");
        for &(number, name) in readers {
            let wire = self.wire(number, &format!("{name}/in"), "camera/out", ConnectOptions::default());
            self.cut(wire, false).await;
            self.destroy(name, frames(true, false)).await;
        }
        let instance = self.lcm.instance(&self.id("camera")).unwrap();
        let set = instance.described.now();
        let pool = || set.slots.output(0).pool().unwrap();
        eventually("all slots back", || pool().free == pool().slots).await;
        assert_eq!((pool().exhausted, set.slots.output(0).exhausted()), (0, 0));
    }
}

fn stream() -> Execution {
    Execution { period_ns: Some(1_000_000), ..model(ExecutionModel::Stream) }
}

/// Wires camera → screen, in one stream or `apart`, and on a thread of its own a branch with a deep queue,
/// which ends in this way.
async fn the_trunk_misses_nothing(process: &'static str, end: End, drop_oldest: bool, apart: bool) {
    let world = World::new(process);
    let (camera, screen) = (Arc::new(Camera::default()), Arc::new(Screen::default()));
    let (open, door) = channel();
    let (over, door) = (AtomicBool::new(false), Mutex::new(door));
    let branch = Arc::new(Branch { screen: Screen::default(), end, over, door });
    world.create_as("camera", class(frames(false, true), Safety::None), stream(), camera.clone()).await;
    let reads = || class(frames(true, false), Safety::None);
    let execution = if apart { model(ExecutionModel::OnSignal) } else { stream_of(&world.id("camera")) };
    world.create_as("screen", reads(), execution, screen.clone()).await;
    world.create_as("branch", reads(), periodic(1000), branch.clone()).await;
    let queue = |depth, drop_oldest| {
        let queue = Some(Queue::Fifo { depth, drop_oldest });
        ConnectOptions { queue, ..ConnectOptions::default() }
    };
    world.connect(1, "branch/in", "camera/out", queue(64, drop_oldest)).await;
    world.connect(2, "screen/in", "camera/out", queue(64, true)).await;
    for name in ["screen", "branch", "camera"] {
        world.start(name).await;
    }
    eventually("the end of the branch", || branch.over.load(Ordering::SeqCst)).await;
    match end {
        End::Stopped => drop(world.run("branch", Verb::Stop).await.unwrap()),
        End::Hangs => drop(world.eventually("a hang", "branch", |r| r.health == Health::Unresponsive).await),
        End::Fails => drop(world.eventually("FAULT", "branch", |r| r.state == State::Fault).await),
    }
    camera.makes(200).await;
    world.run("camera", Verb::Stop).await.unwrap();
    let made = camera.made();
    let (trunk, seen) = (world.accounted(2, made).await, screen.seen());
    assert!(seen.is_sorted_by(|a, b| a < b) && seen.last() == Some(&made), "{made} made: {seen:?}");
    assert_eq!((trunk.passed, trunk.dropped), (seen.len() as u64, made - seen.len() as u64), "{trunk:?}");
    let (half, most) = (trunk.latency_p50_ns, trunk.latency_p99_ns);
    assert!(0 < half && half <= most, "ages of frames: {trunk:?}");
    // A screen on a thread of its own may be late by itself.
    assert!(apart || trunk.dropped == 0, "{trunk:?}");

    // The branch takes the frames left in its queue once it goes on.
    match end {
        End::Stopped => drop(world.run("branch", Verb::Resume).await.unwrap()),
        End::Hangs => open.send(()).unwrap(),
        End::Fails => {
            world.run("branch", Verb::Reset).await.unwrap();
            world.start("branch").await;
        }
    }
    let link = world.accounted(1, made).await;
    let taken = branch.screen.seen();
    assert_eq!((link.passed, link.dropped), (taken.len() as u64, made - taken.len() as u64), "{link:?}");
    assert!(link.dropped > 100 && taken.is_sorted_by(|a, b| a < b), "{taken:?}");
    if drop_oldest {
        assert_eq!(taken.last(), Some(&made), "the newest are kept");
    }
    world.all_slots_come_back(&camera, &[(1, "branch"), (2, "screen")]).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_branch_that_is_stopped_costs_the_trunk_no_frame() {
    the_trunk_misses_nothing("b_stopped", End::Stopped, true, false).await;
    the_trunk_misses_nothing("b_stopped_newest", End::Stopped, false, false).await;
    the_trunk_misses_nothing("b_stopped_apart", End::Stopped, true, true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_branch_that_hangs_in_its_step_costs_the_trunk_no_frame() {
    the_trunk_misses_nothing("b_hangs", End::Hangs, true, false).await;
    the_trunk_misses_nothing("b_hangs_newest", End::Hangs, false, false).await;
    the_trunk_misses_nothing("b_hangs_apart", End::Hangs, true, true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_branch_in_fault_costs_the_trunk_no_frame() {
    the_trunk_misses_nothing("b_fails", End::Fails, true, false).await;
    the_trunk_misses_nothing("b_fails_newest", End::Fails, false, false).await;
    the_trunk_misses_nothing("b_fails_apart", End::Fails, true, true).await;
}

/// No later push makes room in the full branch: the slots it leaves free must be enough.
#[tokio::test(flavor = "multi_thread")]
async fn a_filter_that_stops_in_front_of_a_full_branch_costs_the_trunk_no_frame() {
    for (process, drop_oldest) in [("b_behind", true), ("b_behind_newest", false)] {
        let world = World::new(process);
        let (camera, screen) = (Arc::new(Camera::default()), Arc::new(Screen::default()));
        let filter = Arc::new(Filter::default());
        world.create_as("camera", class(frames(false, true), Safety::None), stream(), camera.clone()).await;
        let of_camera = || stream_of(&world.id("camera"));
        world.create_as("filter", class(frames(true, true), Safety::None), of_camera(), filter.clone()).await;
        let reads = || class(frames(true, false), Safety::None);
        world.create_as("screen", reads(), of_camera(), screen.clone()).await;
        world.create_as("branch", reads(), periodic(1000), Arc::new(Screen::default())).await;
        let queue = Some(Queue::Fifo { depth: 64, drop_oldest });
        let queue = ConnectOptions { queue, ..ConnectOptions::default() };
        world.connect(1, "branch/in", "filter/out", queue).await;
        world.connect(2, "filter/in", "camera/out", ConnectOptions::default()).await;
        world.connect(3, "screen/in", "camera/out", ConnectOptions::default()).await;
        for name in ["screen", "filter", "camera"] {
            world.start(name).await;
        }
        filter.0.sees_more("frames through the filter, which fill the branch").await;
        world.run("filter", Verb::Stop).await.unwrap();
        camera.makes(100).await;
        world.run("camera", Verb::Stop).await.unwrap();
        assert!(screen.seen().into_iter().eq(1..=camera.made()), "{:?}", screen.seen());
        let branch = world.wire(1, "branch/in", "filter/out", ConnectOptions::default());
        world.cut(branch, false).await;
        world.destroy("branch", frames(true, false)).await;
        world.all_slots_come_back(&camera, &[(3, "screen"), (2, "filter")]).await;
        world.end().await;
    }
}

/// Rewires `screen` again and again while frames flow: frames may be missing at the rewirings only, and
/// nothing else goes wrong.
#[tokio::test(flavor = "multi_thread")]
async fn a_filter_of_frames_comes_into_a_running_stream_and_goes_again_and_every_slot_comes_back() {
    let world = World::new("b_filter");
    let (camera, screen, filter) =
        (Arc::new(Camera::default()), Arc::new(Screen::default()), Arc::new(Filter::default()));
    world.create_as("camera", class(frames(false, true), Safety::None), stream(), camera.clone()).await;
    let of_camera = stream_of(&world.id("camera"));
    world
        .create_as("screen", class(frames(true, false), Safety::None), of_camera.clone(), screen.clone())
        .await;
    let mut wires = 0;
    let mut wire = |client: &str, server: &str| {
        wires += 1;
        world.wire(wires, client, server, ConnectOptions { replace: true, ..ConnectOptions::default() })
    };
    let connect = async |connection| world.apply(Change::Connect { connection }).await.unwrap();
    let mut straight = wire("screen/in", "camera/out");
    connect(straight.clone()).await;
    world.start("screen").await;
    world.start("camera").await;
    screen.sees_more("frames straight from the camera").await;

    for round in 0..5 {
        let info = class(frames(true, true), Safety::None);
        world.create_as("filter", info, of_camera.clone(), filter.clone()).await;
        let before = wire("filter/in", "camera/out");
        connect(before.clone()).await;
        world.start("filter").await;
        let behind = wire("screen/in", "filter/out");
        world.cut(straight, true).await;
        connect(behind.clone()).await;
        screen.sees_more(&format!("frames through the filter, round {round}")).await;
        world.cut(behind, true).await;
        straight = wire("screen/in", "camera/out");
        connect(straight.clone()).await;
        world.cut(before, false).await;
        world.destroy("filter", frames(true, true)).await;
        screen.sees_more(&format!("frames past the filter, round {round}")).await;
    }
    world.run("camera", Verb::Stop).await.unwrap();

    let (through, arrived, made) = (filter.0.seen(), screen.seen(), camera.made());
    assert!(through.is_sorted_by(|a, b| a < b), "the filter's frames: {through:?}");
    assert!(arrived.is_sorted_by(|a, b| a < b), "twice, or out of order: {arrived:?}");
    assert_eq!((arrived.first(), arrived.last()), (Some(&1), Some(&made)));
    let jumps = arrived.windows(2).filter(|w| w[1] > w[0] + 1).count();
    assert!(jumps <= 10, "frames are missing elsewhere than at the ten rewirings: {arrived:?}");
    world.all_slots_come_back(&camera, &[(straight.id.0, "screen")]).await;
    world.end().await;
}

/// A hanging cycle keeps the objects it may look at, but not the frames that wait for readers cut off
/// meanwhile.
#[tokio::test(flavor = "multi_thread")]
async fn frames_of_readers_that_are_cut_off_come_back_although_a_cycle_of_another_component_hangs() {
    let world = World::new("b_hung");
    let camera = Arc::new(Camera::default());
    world.create_as("camera", class(frames(false, true), Safety::None), stream(), camera.clone()).await;
    let screens = ["looks", "stopped", "idle"].map(|name| (name, Arc::new(Screen::default())));
    let two = Some(Queue::Fifo { depth: 2, drop_oldest: true });
    let options = ConnectOptions { queue: two, ..ConnectOptions::default() };
    for (number, (name, screen)) in (1..).zip(&screens) {
        world.create_as(name, class(frames(true, false), Safety::None), periodic(1000), screen.clone()).await;
        world.connect(number, &format!("{name}/in"), "camera/out", options.clone()).await;
    }
    world.start("looks").await;
    world.start("stopped").await;
    world.start("camera").await;
    for (_, screen) in &screens[..2] {
        screen.sees_more("frames").await;
    }
    world.run("stopped", Verb::Stop).await.unwrap();
    camera.makes(20).await;
    world.run("camera", Verb::Stop).await.unwrap();

    let cycle = LongCycle::begin();
    // The screen that looks stays, and lets go by looking.
    for (number, (name, _)) in (1..).zip(&screens) {
        world.cut(world.wire(number, &format!("{name}/in"), "camera/out", options.clone()), false).await;
    }
    for (name, _) in &screens[1..] {
        world.destroy(name, frames(true, false)).await;
    }
    let instance = world.lcm.instance(&world.id("camera")).unwrap();
    let set = instance.described.now();
    let pool = || set.slots.output(0).pool().unwrap();
    eventually("all slots back", || pool().free == pool().slots).await;
    cycle.end();
    world.end().await;
}

/// A link of shared memory carries frames of at most sixteen pools. The screen holds a frame at every cut.
#[tokio::test(flavor = "multi_thread")]
async fn shared_memory_that_has_seen_too_many_pools_is_made_anew_and_every_slot_comes_back() {
    let world = World::new("b_pools");
    let (filter, screen) = (Arc::new(Filter::default()), Arc::new(Screen::default()));
    world.create_as("filter", class(frames(true, true), Safety::None), periodic(1000), filter.clone()).await;
    world.create_as("screen", class(frames(true, false), Safety::None), periodic(1000), screen.clone()).await;
    let shared = ConnectOptions { carrier: "memfd".into(), ..ConnectOptions::default() };
    world.connect(1, "screen/in", "filter/out", shared.clone()).await;
    world.start("screen").await;
    world.start("filter").await;
    let cameras: Vec<String> = (0..20).map(|n| format!("camera{n}")).collect();
    for (number, name) in (2..).zip(&cameras) {
        let camera = Arc::new(Camera::default());
        world.create_as(name, class(frames(false, true), Safety::None), periodic(1000), camera).await;
        let wire = world.wire(number, "filter/in", &format!("{name}/out"), shared.clone());
        world.apply(Change::Connect { connection: wire.clone() }).await.unwrap();
        world.start(name).await;
        screen.sees_more(&format!("frames of {name}")).await;
        world.cut(wire, false).await;
        world.run(name, Verb::Stop).await.unwrap();
    }
    let passed = filter.0.seen().len() as u64;
    let link = world.accounted(1, passed).await;
    assert_eq!((link.carrier.as_str(), link.passed), ("memfd", screen.seen().len() as u64), "{link:?}");
    let behind = world.wire(1, "screen/in", "filter/out", shared);
    world.cut(behind, false).await;
    world.destroy("screen", frames(true, false)).await;
    world.destroy("filter", frames(true, true)).await;
    for name in &cameras {
        let instance = world.lcm.instance(&world.id(name)).unwrap();
        let set = instance.described.now();
        let pool = || set.slots.output(0).pool().unwrap();
        eventually(&format!("all slots of {name} are back"), || pool().free == pool().slots).await;
    }
    world.end().await;
}
