//! Filters of a stream: samples that pass a failed one, and the counts of filters.

use std::sync::Mutex;
use std::thread;

use trocar_model::{OnFailure, Queue};
use trocar_plugin_api::abi::Tick;
use trocar_rt::executor::Cycle;

use super::super::boundary::puppet::{ArgRet, Own};
use super::super::cycle::{self, Follow, Member};
use super::super::{context, instance::Instance};
use super::*;

/// Samples written in one command: more than a cycle looks at one by one.
const BURST: u64 = 200;

/// Writes one sample in its first command, and a burst in every later one.
#[derive(Default)]
struct Source(Mutex<u64>);

impl Behaviour for Source {
    fn command(&self, _: u32, _: ArgRet, own: &Own) -> Result<(), String> {
        let mut written = self.0.lock().unwrap();
        let until = if *written == 0 { 1 } else { *written + BURST };
        for n in *written..until {
            own.write(0, &n);
        }
        *written = until;
        Ok(())
    }
}

struct Fails;

impl Behaviour for Fails {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        Err("enough".into())
    }
}

/// Takes every sample that waits.
#[derive(Default)]
struct Sink(Mutex<Vec<u64>>);

impl Behaviour for Sink {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        let mut taken = self.0.lock().unwrap();
        taken.extend(std::iter::from_fn(|| own.take(0)).map(|(value, _)| value));
        Ok(())
    }
}

struct Nothing;

impl Behaviour for Nothing {}

fn queued() -> ConnectOptions {
    let queue = Some(Queue::Fifo { depth: 1024, drop_oldest: false });
    ConnectOptions { queue, ..ConnectOptions::default() }
}

/// A component on a thread of its own that writes when it is called.
async fn create_source(world: &World) {
    let ports = Ports { provided: ctl().provided, ..plain(false, true) };
    let (class, source) = (class(ports, Safety::None), Arc::new(Source::default()));
    world.create_as("source", class, model(ExecutionModel::OnSignal), source).await;
}

/// Checks a source on a thread of its own, and on the thread of `head` a filter that fails at its first
/// sample, and a sink.
async fn all_that_comes_passes(process: &'static str, head: Execution) {
    let world = World::new(process);
    let sink = Arc::new(Sink::default());
    create_source(&world).await;
    world.create("head", head, Arc::new(Nothing)).await;
    let of_head = stream_of(&world.id("head"));
    let bypass = Execution { on_failure: Some(OnFailure::Bypass), ..of_head.clone() };
    world.create_as("filter", class(plain(true, true), Safety::None), bypass, Arc::new(Fails)).await;
    world.create_as("sink", class(plain(true, false), Safety::None), of_head, sink.clone()).await;
    world.connect(1, "filter/in", "source/out", queued()).await;
    world.connect(2, "sink/in", "filter/out", queued()).await;
    for name in ["head", "sink", "filter", "source"] {
        world.start(name).await;
    }
    world.call("source").await.unwrap();
    world.eventually("FAULT", "filter", |r| r.state == State::Fault).await;
    for burst in 1..=3 {
        world.call("source").await.unwrap();
        let all: Vec<u64> = (0..=burst * BURST).collect();
        eventually("all samples, in their order", || *sink.0.lock().unwrap() == all).await;
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn all_that_was_queued_passes_a_filter_that_failed_and_nothing_waits_for_the_next_sample() {
    let stream = model(ExecutionModel::Stream);
    let grid = |period_ns| Execution { period_ns: Some(period_ns), ..stream.clone() };
    all_that_comes_passes("f_bypass_signal", stream.clone()).await;
    all_that_comes_passes("f_bypass_fast", grid(1_000_000)).await;
    // Such a thread looks at its queues between its cycles, too.
    all_that_comes_passes("f_bypass_slow", grid(20_000_000)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_head_that_failed_lets_pass_what_comes_for_it_on_any_grid() {
    for (process, period_ns) in [("f_head_fast", 1_000_000), ("f_head_slow", 20_000_000)] {
        let world = World::new(process);
        let sink = Arc::new(Sink::default());
        create_source(&world).await;
        let head = Execution {
            period_ns: Some(period_ns),
            on_failure: Some(OnFailure::Bypass),
            ..model(ExecutionModel::Stream)
        };
        world.create_as("head", class(plain(true, true), Safety::None), head, Arc::new(Fails)).await;
        let of_head = stream_of(&world.id("head"));
        world.create_as("sink", class(plain(true, false), Safety::None), of_head, sink.clone()).await;
        world.connect(1, "head/in", "source/out", queued()).await;
        world.connect(2, "sink/in", "head/out", queued()).await;
        for name in ["sink", "head", "source"] {
            world.start(name).await;
        }
        world.eventually("FAULT", "head", |r| r.state == State::Fault).await;
        for burst in 0..=3 {
            world.call("source").await.unwrap();
            let all: Vec<u64> = (0..=burst * BURST).collect();
            eventually("all samples, in their order", || *sink.0.lock().unwrap() == all).await;
        }
        world.end().await;
    }
}

/// Cycles executed and left out, by an instance's own statistics.
pub(super) fn counted(instance: &Instance) -> (u64, u64) {
    let stats = instance.books.steps.snapshot();
    (stats.executed, stats.skipped)
}

#[tokio::test(flavor = "multi_thread")]
async fn periods_that_its_thread_left_out_are_not_charged_to_a_filter_nor_to_what_runs_inside_it() {
    let world = World::new("f_skipped");
    // Its own cycles are an hour apart: those below are the test's.
    let hour = Execution { period_ns: Some(3_600_000_000_000), ..model(ExecutionModel::Stream) };
    world.create("head", hour, Arc::new(Nothing)).await;
    let filter = class(plain(true, false), Safety::None);
    world.create_as("filter", filter, stream_of(&world.id("head")), Arc::new(Nothing)).await;
    world.create("of_head", inside(ExecutionModel::ExecIn, &world.id("head")), Arc::new(Nothing)).await;
    world.create("of_filter", inside(ExecutionModel::ExecOut, &world.id("filter")), Arc::new(Nothing)).await;
    for name in ["of_filter", "of_head", "head"] {
        world.start(name).await;
    }
    // The filter has no source, and needs none here.
    world.start("filter").await;
    let of = |name: &str| world.lcm.instance(&world.id(name)).unwrap();
    let [head, filter, of_head, of_filter] = ["head", "filter", "of_head", "of_filter"].map(of);
    let all = [head.clone(), filter.clone(), of_head.clone(), of_filter.clone()];
    let cycles = move || {
        context::set_executor(head.executor_id());
        let mut members = [
            Member::new(of_head.clone(), Follow::Member(head.number)),
            Member::new(head.clone(), Follow::Thread),
            Member::new(filter.clone(), Follow::Input),
            Member::new(of_filter.clone(), Follow::Member(filter.number)),
        ];
        let mut run = |skipped| {
            filter.signal();
            let now_ns = trocar_rt::os::now_ns();
            let cycle = Cycle { begin_ns: now_ns, deadline_ns: now_ns, period_ns: 1_000_000_000, skipped };
            cycle::all(&mut members, &cycle);
        };
        run(0);
        run(9);
        let somebody = filter.object.try_enter().unwrap();
        run(5);
        drop(somebody);
    };
    thread::spawn(cycles).join().unwrap();
    let [head, filter, of_head, of_filter] = all.map(|instance| counted(&instance));
    assert_eq!(head, (3, 14), "what is executed and what is left out are all periods of the grid");
    assert_eq!(of_head, (3, 14), "it steps with the head and is left out with it");
    assert_eq!(filter, (2, 1), "the sample it could not be entered for, and no period of the thread");
    assert_eq!(of_filter, (3, 0), "it steps with the filter");
    world.end().await;
}
