//! Ten thousand steps of every execution model, without one allocation on the thread that steps.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_model::{Field, StructType};
use trocar_plugin_api::abi::{EXECUTED, Tick};

use super::super::boundary::counting;
use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Steps that are watched.
const STEPS: u64 = 10_000;
/// Steps before the watch, in which first uses may allocate.
const WARM: u64 = 100;

/// Watches the allocations of its thread over `STEPS` of its steps.
#[derive(Default)]
struct Watched {
    steps: AtomicU64,
    allocations: AtomicU64,
    device: Mutex<Option<Own>>,
}

impl Watched {
    fn count(&self) {
        let n = self.steps.load(Ordering::Relaxed) + 1;
        if n == WARM {
            counting::watch();
        } else if n == WARM + STEPS {
            self.allocations.store(counting::watched(), Ordering::Relaxed);
        }
        self.steps.store(n, Ordering::Release);
    }

    fn done(&self) -> bool {
        self.steps.load(Ordering::Acquire) >= WARM + STEPS
    }
}

impl Behaviour for Watched {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        self.count();
        if own.has_output() {
            own.write(0, &tick.cycle);
        }
        Ok(())
    }

    fn command(&self, _: u32, _: ArgRet, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        Ok(())
    }
}

/// Only writes its output.
struct Writes;

impl Behaviour for Writes {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        own.write(0, &tick.cycle);
        Ok(())
    }
}

async fn without_allocations(what: &str, watched: &Watched) {
    eventually(&format!("{STEPS} steps {what}"), || watched.done()).await;
    assert_eq!(watched.allocations.load(Ordering::Relaxed), 0, "allocations in {STEPS} steps {what}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_periodic_thread_with_others_inside_its_steps_allocates_nothing() {
    let world = World::new("a_periodic");
    let head = Arc::new(Watched::default());
    world.create("head", periodic(20), head.clone()).await;
    for (name, how) in [("before", ExecutionModel::ExecIn), ("after", ExecutionModel::ExecOut)] {
        world.create(name, inside(how, &world.id("head")), Arc::new(Stepping)).await;
        world.start(name).await;
    }
    world.start("head").await;
    without_allocations("of periodic, exec_in and exec_out", &head).await;
    world.end().await;
}

/// Does nothing.
struct Stepping;

impl Behaviour for Stepping {}

#[tokio::test(flavor = "multi_thread")]
async fn a_continuous_thread_and_an_on_signal_one_that_it_wakes_allocate_nothing() {
    let world = World::new("a_free");
    let (free, woken) = (Arc::new(Watched::default()), Arc::new(Watched::default()));
    let output = class(plain(false, true), Safety::None);
    world.create_as("free", output, model(ExecutionModel::Continuous), free.clone()).await;
    let input = class(plain(true, false), Safety::None);
    world.create_as("woken", input, model(ExecutionModel::OnSignal), woken.clone()).await;
    world.connect(1, "woken/in", "free/out", ConnectOptions::default()).await;
    world.start("woken").await;
    world.start("free").await;
    without_allocations("of continuous", &free).await;
    without_allocations("of on_signal", &woken).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_with_a_filter_allocates_nothing() {
    let world = World::new("a_stream");
    let filter = Arc::new(Watched::default());
    let head = Execution { period_ns: Some(20_000), ..model(ExecutionModel::Stream) };
    world.create_as("source", class(plain(false, true), Safety::None), head, Arc::new(Writes)).await;
    let execution = stream_of(&world.id("source"));
    world.create_as("filter", class(plain(true, true), Safety::None), execution, filter.clone()).await;
    world.connect(1, "filter/in", "source/out", ConnectOptions::default()).await;
    world.start("filter").await;
    world.start("source").await;
    without_allocations("of a stream", &filter).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_left_for_observers_until_the_turn_ends_allocates_nothing() {
    let world = World::new("a_observed");
    let watched = Arc::new(Watched::default());
    world.create_as("source", class(plain(false, true), Safety::None), periodic(20), watched.clone()).await;
    let mut looks_on = plain(true, false);
    looks_on.inputs[0].ty = PortType::Any;
    world
        .create_as(
            "observer",
            class(looks_on, Safety::None),
            model(ExecutionModel::OnSignal),
            Arc::new(Stepping),
        )
        .await;
    let queue = Some(trocar_model::Queue::Fifo { depth: 8, drop_oldest: true });
    let options = ConnectOptions { queue, ..ConnectOptions::default() };
    world.connect(1, "observer/in", "source/out", options).await;
    world.start("observer").await;
    world.start("source").await;
    without_allocations("that somebody observes", &watched).await;
    let links = world.lcm.links().await.unwrap();
    let given = links[0].passed + links[0].dropped + links[0].skipped;
    assert!(given + 8 >= STEPS, "it was given {given} of {STEPS} samples");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn callbacks_of_a_device_allocate_nothing() {
    let world = World::new("a_device");
    let called = Arc::new(Watched::default());
    let info = class(ctl(), Safety::None);
    world.create_as("device", info, model(ExecutionModel::OnCallback), called.clone()).await;
    world.start("device").await;
    world.call("device").await.unwrap();
    let device = called.device.lock().unwrap().unwrap();
    let callbacks = std::thread::spawn(move || {
        for _ in 0..WARM + STEPS {
            while device.enter() != EXECUTED {
                std::thread::yield_now();
            }
            called.count();
            device.leave();
        }
        called.allocations.load(Ordering::Relaxed)
    });
    assert_eq!(callbacks.join().unwrap(), 0, "allocations in {STEPS} callbacks");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_passive_component_that_is_called_from_a_step_allocates_nothing() {
    let world = World::new("a_passive");
    let caller = Arc::new(Calls(Watched::default()));
    let info = class(ctl(), Safety::None);
    world.create_as("passive", info, model(ExecutionModel::None), Arc::new(Stepping)).await;
    world.create_as("caller", class(requires_ctl(), Safety::None), periodic(20), caller.clone()).await;
    world.connect(1, "caller/peer", "passive/ctl", ConnectOptions::default()).await;
    world.start("passive").await;
    world.start("caller").await;
    without_allocations("that call a passive component and ask for its state", &caller.0).await;
    world.end().await;
}

/// Calls its function at each step.
struct Calls(Watched);

impl Behaviour for Calls {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.0.count();
        match own.send(0) {
            EXECUTED => Ok(()),
            other => Err(format!("the command came to {other}")),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn asking_for_the_state_of_a_component_from_a_step_allocates_nothing() {
    let world = World::new("a_state");
    let asker = Arc::new(Asks(Watched::default()));
    world.create("asked", periodic(1000), Arc::new(Stepping)).await;
    world.create_as("asker", class(requires_system(), Safety::None), periodic(20), asker.clone()).await;
    world.connect(1, "asker/peer", "asked/system", ConnectOptions::default()).await;
    world.start("asked").await;
    world.start("asker").await;
    without_allocations("that ask for a state", &asker.0).await;
    world.end().await;
}

/// Reads GetState at each step.
struct Asks(Watched);

impl Behaviour for Asks {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.0.count();
        let (outcome, row) = own.ask(0);
        if outcome == EXECUTED && row.windows(6).any(|w| w == b"ACTIVE") {
            Ok(())
        } else {
            Err(format!("GetState came to {outcome}"))
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_pass_a_failed_filter_allocate_nothing() {
    let world = World::new("a_bypass");
    let head = Execution { period_ns: Some(20_000), ..model(ExecutionModel::Stream) };
    let source = Arc::new(Watched::default());
    world.create_as("source", class(plain(false, true), Safety::None), head, source.clone()).await;
    let execution = Execution { on_failure: Some(OnFailure::Bypass), ..stream_of(&world.id("source")) };
    world.create_as("filter", class(plain(true, true), Safety::None), execution, Arc::new(Fails)).await;
    let sink = Arc::new(Takes::default());
    let execution = stream_of(&world.id("source"));
    world.create_as("sink", class(plain(true, false), Safety::None), execution, sink.clone()).await;
    world.connect(1, "filter/in", "source/out", ConnectOptions::default()).await;
    world.connect(2, "sink/in", "filter/out", ConnectOptions::default()).await;
    for name in ["sink", "filter", "source"] {
        world.start(name).await;
    }
    without_allocations("with a filter that is passed by", &source).await;
    assert!(sink.taken.load(Ordering::Relaxed) > STEPS / 2, "its frames came through");
    world.end().await;
}

/// Fails at its first step.
struct Fails;

impl Behaviour for Fails {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        Err("enough".into())
    }
}

/// Takes the samples of its input.
#[derive(Default)]
struct Takes {
    watched: Watched,
    taken: AtomicU64,
}

impl Behaviour for Takes {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.watched.count();
        if own.take(0).is_some() {
            self.taken.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }
}

/// A struct of these fields one after the other; all of them are made of words.
fn words(fields: &[(&str, &Type)]) -> Type {
    let mut at = 0;
    let fields: Vec<Field> = fields
        .iter()
        .map(|(name, ty)| {
            let field = Field {
                name: (*name).into(),
                at,
                unit: String::new(),
                doc: String::new(),
                frame: String::new(),
                ty: (*ty).clone(),
            };
            at += ty.size();
            field
        })
        .collect();
    let (name, doc) = ("Words".to_owned(), String::new());
    Type::Struct(Arc::new(StructType { name, doc, size: at, align: 8, fields }))
}

#[tokio::test(flavor = "multi_thread")]
async fn samples_that_are_adapted_to_another_layout_arrive_whole_and_allocate_nothing() {
    let world = World::new("a_adapt");
    let pair = |names: [&str; 2]| words(&names.map(|name| (name, &Type::Prim(Prim::U64))));
    let array = |pair: &Type| Type::Array { item: Box::new(pair.clone()), n: 2 };
    let list = |pair: &Type| Type::List { item: Box::new(pair.clone()), n: 2 };
    let (ab, ba) = (pair(["a", "b"]), pair(["b", "a"]));
    let (mut out, mut into) = (plain(false, true), plain(true, false));
    let there = words(&[("tip", &ab), ("edge", &array(&ab)), ("marks", &list(&ab))]);
    let here = words(&[("marks", &list(&ba)), ("edge", &array(&ba)), ("tip", &ba)]);
    (out.outputs[0].ty, into.inputs[0].ty) = (PortType::Plain(there), PortType::Plain(here));
    world.create_as("source", class(out, Safety::None), periodic(20), Arc::new(WritesShape)).await;
    let sink = Arc::new(TakesShape::default());
    world.create_as("sink", class(into, Safety::None), periodic(20), sink.clone()).await;
    let options = ConnectOptions { adapt: true, ..ConnectOptions::default() };
    world.connect(1, "sink/in", "source/out", options).await;
    world.start("source").await;
    world.start("sink").await;
    without_allocations("that take adapted samples", &sink.watched).await;
    assert_eq!(*sink.torn.lock().unwrap(), None, "a sample did not arrive as it was written");
    assert!(sink.taken.load(Ordering::Relaxed) > 0, "samples came");
    world.end().await;
}

/// Values of the n-th cycle: a pair, an array of two, and a list that holds one; in the layout of each end.
fn shape(n: u64) -> ([u64; 11], [u64; 11]) {
    let (a, b) = (|k| 100 * n + k, |k| 100 * n + 50 + k);
    (
        [a(0), b(0), a(1), b(1), a(2), b(2), 1, a(3), b(3), 0, 0],
        [1, b(3), a(3), 0, 0, b(1), a(1), b(2), a(2), b(0), a(0)],
    )
}

/// Writes a shape.
struct WritesShape;

impl Behaviour for WritesShape {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        own.write_words(0, &shape(tick.cycle).0);
        Ok(())
    }
}

/// Takes shapes, and keeps the first wrong one.
#[derive(Default)]
struct TakesShape {
    watched: Watched,
    taken: AtomicU64,
    torn: Mutex<Option<[u64; 11]>>,
}

impl Behaviour for TakesShape {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.watched.count();
        if let Some((came, _)) = own.take_words::<11>(0) {
            self.taken.fetch_add(1, Ordering::Relaxed);
            // The `a` of its tip tells the cycle.
            if came != shape(came[10] / 100).1 {
                self.torn.lock().unwrap().get_or_insert(came);
            }
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn slices_on_several_threads_allocate_nothing() {
    let world = World::new("a_slices");
    let sliced = Arc::new(Sliced(Watched::default()));
    let head = Execution { period_ns: Some(50_000), threads: Some(3), ..model(ExecutionModel::Stream) };
    world.create("sliced", head, sliced.clone()).await;
    world.start("sliced").await;
    without_allocations("with eight slices each", &sliced.0).await;
    world.end().await;
}

/// Runs eight slices in each step, on three threads.
struct Sliced(Watched);

impl Behaviour for Sliced {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        self.0.count();
        match own.slices() {
            3 => Ok(()),
            other => Err(format!("{other} threads")),
        }
    }
}
