//! Execution models: each one steps as it says, in the order it says.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, mpsc};
use std::thread;

use trocar_plugin_api::abi::{EXECUTED, NOT_ACTIVE, Tick, WOULD_BLOCK};

use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Counts its steps and writes its name into a log.
struct Named {
    name: &'static str,
    log: Arc<Mutex<Vec<&'static str>>>,
    steps: AtomicU64,
    fail_at: u64,
}

impl Named {
    fn new(name: &'static str, log: &Arc<Mutex<Vec<&'static str>>>) -> Arc<Named> {
        Arc::new(Named { name, log: log.clone(), steps: AtomicU64::new(0), fail_at: 0 })
    }

    fn steps(&self) -> u64 {
        self.steps.load(Ordering::SeqCst)
    }
}

impl Behaviour for Named {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        let n = self.steps.fetch_add(1, Ordering::SeqCst) + 1;
        self.log.lock().unwrap().push(self.name);
        if self.name == "source" {
            own.write(0, &n);
        }
        if n == self.fail_at { Err("enough".into()) } else { Ok(()) }
    }
}

fn log() -> Arc<Mutex<Vec<&'static str>>> {
    Arc::new(Mutex::new(Vec::new()))
}

#[tokio::test(flavor = "multi_thread")]
async fn what_runs_inside_another_steps_right_before_or_after_it_in_every_cycle() {
    let (world, log) = (World::new("x_inside"), log());
    let names = ["head", "before", "after", "deep"];
    let [head, before, after, deep] = names.map(|n| Named::new(n, &log));
    world.create("head", periodic(1000), head.clone()).await;
    let id = |n: &str| world.id(n);
    world.create("before", inside(ExecutionModel::ExecIn, &id("head")), before).await;
    world.create("after", inside(ExecutionModel::ExecOut, &id("head")), after).await;
    world.create("deep", inside(ExecutionModel::ExecOut, &id("before")), deep.clone()).await;
    for name in ["deep", "before", "after"] {
        world.start(name).await;
    }
    assert_eq!(deep.steps(), 0, "its parent's parent is not ACTIVE yet");
    log.lock().unwrap().clear();
    world.start("head").await;
    eventually("50 steps of the head", || head.steps() >= 50).await;
    world.run("head", Verb::Stop).await.unwrap();
    let log = log.lock().unwrap().clone();
    for cycle in log.chunks_exact(4) {
        assert_eq!(cycle, ["before", "deep", "head", "after"]);
    }
    let detail = world.detail("after").await;
    assert!(
        detail.thread.contains("x_inside/head") && detail.thread.contains("not ACTIVE"),
        "{}",
        detail.thread
    );
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_inside_another_that_fails_leaves_the_other_running() {
    let (world, log) = (World::new("x_child_fails"), log());
    let head = Named::new("head", &log);
    let child = Arc::new(Named { name: "child", log: log.clone(), steps: AtomicU64::new(0), fail_at: 3 });
    world.create("head", periodic(1000), head.clone()).await;
    world.create("child", inside(ExecutionModel::ExecIn, &world.id("head")), child.clone()).await;
    world.start("child").await;
    world.start("head").await;
    let report = world.eventually("FAULT", "child", |r| r.state == State::Fault).await;
    assert_eq!(report.fault, "step: enough");
    let then = head.steps();
    eventually("the head goes on", || head.steps() > then + 20).await;
    assert_eq!(child.steps(), 3);
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_of_a_component_are_served_while_the_one_around_it_stands_still() {
    let (world, log) = (World::new("x_served"), log());
    world.create("head", periodic(1000), Named::new("head", &log)).await;
    let execution = inside(ExecutionModel::ExecIn, &world.id("head"));
    world.create_as("child", class(ctl(), Safety::None), execution, Named::new("child", &log)).await;
    world.start("child").await;
    world.call("child").await.unwrap();
    assert!(log.lock().unwrap().is_empty(), "nobody may step");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_to_a_slow_grid_does_not_wait_for_its_next_cycle() {
    let (world, log) = (World::new("x_slow"), log());
    world
        .create_as("slow", class(ctl(), Safety::None), periodic(3_600_000_000), Named::new("slow", &log))
        .await;
    world.start("slow").await;
    world.call("slow").await.unwrap();
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_elapsed_period_is_executed_or_counted_as_skipped_and_figures_begin_anew_at_start() {
    let (world, log) = (World::new("x_exact"), log());
    let head = Named::new("head", &log);
    world.create("head", periodic(500), head.clone()).await;
    world.start("head").await;
    eventually("200 steps", || head.steps() >= 200).await;
    world.run("head", Verb::Stop).await.unwrap();
    let first = world.detail("head").await;
    assert_eq!(first.executed, head.steps());
    let begun = head.steps();
    world.start("head").await;
    eventually("20 more steps", || head.steps() >= begun + 20).await;
    world.run("head", Verb::Stop).await.unwrap();
    let second = world.detail("head").await;
    assert_eq!(second.executed, head.steps() - begun, "counted since Start only");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn filters_of_a_stream_step_in_its_cycle_along_their_connections() {
    let (world, log) = (World::new("x_stream"), log());
    let source = Named::new("source", &log);
    let head = Execution { period_ns: Some(1_000_000), threads: Some(2), ..model(ExecutionModel::Stream) };
    world.create_as("source", class(plain(false, true), Safety::None), head, source.clone()).await;
    let filter = stream_of(&world.id("source"));
    for name in ["second", "first"] {
        let ports = class(plain(true, true), Safety::None);
        world.create_as(name, ports, filter.clone(), Arc::new(Filter(Named::new(name, &log)))).await;
        world.start(name).await;
    }
    world.connect(1, "first/in", "source/out", ConnectOptions::default()).await;
    world.connect(2, "second/in", "first/out", ConnectOptions::default()).await;
    world.start("source").await;
    eventually("30 frames", || source.steps() >= 30).await;
    world.run("source", Verb::Stop).await.unwrap();
    for cycle in log.lock().unwrap().chunks_exact(3) {
        assert_eq!(cycle, ["source", "first", "second"]);
    }
    world.end().await;
}

/// Writes a sample to its output at each step.
struct Filter(Arc<Named>);

impl Behaviour for Filter {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        own.write(0, &tick.cycle);
        self.0.step(tick, own)
    }
}

/// Hands its device out to the test.
#[derive(Default)]
struct Called {
    device: Mutex<Option<Own>>,
    commands: AtomicU64,
}

impl Behaviour for Called {
    fn command(&self, _: u32, _: ArgRet, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        self.commands.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_calls_in_one_thread_at_a_time_and_commands_run_when_it_leaves_or_when_nobody_is_inside() {
    let world = World::new("x_callback");
    let called = Arc::new(Called::default());
    let execution = model(ExecutionModel::OnCallback);
    world.create_as("device", class(ctl(), Safety::None), execution, called.clone()).await;
    world.start("device").await;
    // No callback comes: its own thread serves.
    world.call("device").await.unwrap();
    let device = called.device.lock().unwrap().unwrap();

    let (inside, entered) = std::sync::mpsc::channel();
    let (go, leave) = std::sync::mpsc::channel::<()>();
    let first = thread::spawn(move || {
        inside.send(device.enter()).unwrap();
        leave.recv().unwrap();
        device.leave();
    });
    assert_eq!(entered.recv().unwrap(), EXECUTED);
    assert_eq!(device.enter(), WOULD_BLOCK, "somebody is inside");
    // A leave without an enter of this thread's own opens nothing.
    device.leave();
    assert_eq!(device.enter(), WOULD_BLOCK);
    let call = world.call("device");
    let calls = async {
        // The call is queued behind the callback; leaving runs it.
        tokio::task::yield_now().await;
        go.send(()).unwrap();
    };
    let (done, ()) = tokio::join!(call, calls);
    done.unwrap();
    first.join().unwrap();
    assert_eq!(called.commands.load(Ordering::SeqCst), 2);
    let detail = world.detail("device").await;
    assert_eq!(detail.executed, 1, "each callback is a cycle");
    let named = |r: &Report| r.warnings.iter().any(|w| w.contains("turned away"));
    world.eventually("telling that calls overlapped", "device", named).await;
    world.run("device", Verb::Stop).await.unwrap();
    assert_eq!(device.enter(), NOT_ACTIVE);
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_continuous_component_steps_without_pause_and_an_on_signal_one_only_for_a_reason() {
    let (world, log) = (World::new("x_free"), log());
    let (free, sleepy) = (Named::new("free", &log), Named::new("sleepy", &log));
    world.create("free", model(ExecutionModel::Continuous), free.clone()).await;
    world
        .create_as("sleepy", class(ctl(), Safety::None), model(ExecutionModel::OnSignal), sleepy.clone())
        .await;
    world.start("sleepy").await;
    world.start("free").await;
    eventually("1000 free steps", || free.steps() > 1000).await;
    assert_eq!(sleepy.steps(), 0);
    world.call("sleepy").await.unwrap();
    eventually("a step after the command", || sleepy.steps() == 1).await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn late_periods_are_made_up_for_back_to_back_when_the_execution_says_so() {
    let world = World::new("x_catch_up");
    let slow = Arc::new(SlowOnce(AtomicU64::new(0)));
    world.create("slow", Execution { catch_up: Some(1000), ..periodic(2000) }, slow.clone()).await;
    world.start("slow").await;
    eventually("40 steps", || slow.0.load(Ordering::SeqCst) >= 40).await;
    world.run("slow", Verb::Stop).await.unwrap();
    let detail = world.detail("slow").await;
    assert_eq!(detail.skipped, 0);
    assert!(detail.overruns >= 10, "those made up for were late: {}", detail.overruns);
    world.end().await;
}

/// Takes ten periods for its tenth step.
struct SlowOnce(AtomicU64);

impl Behaviour for SlowOnce {
    fn step(&self, tick: &Tick, _: &Own) -> Result<(), String> {
        if self.0.fetch_add(1, Ordering::SeqCst) == 10 {
            while trocar_rt::os::now_ns() < tick.now_ns + 10 * tick.period_ns {
                std::hint::spin_loop();
            }
        }
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_pass_a_filter_that_failed_when_it_says_so_and_stop_there_otherwise() {
    let (world, log) = (World::new("x_bypass"), log());
    let source = Named::new("source", &log);
    let head = Execution { period_ns: Some(1_000_000), ..model(ExecutionModel::Stream) };
    world.create_as("source", class(plain(false, true), Safety::None), head, source).await;
    let mut sinks = Vec::new();
    for (n, (name, on_failure)) in
        [("passes", OnFailure::Bypass), ("stops", OnFailure::StopBranch)].into_iter().enumerate()
    {
        let fails =
            Arc::new(Named { name: "filter", log: log.clone(), steps: AtomicU64::new(0), fail_at: 5 });
        let execution = Execution { on_failure: Some(on_failure), ..stream_of(&world.id("source")) };
        world
            .create_as(name, class(plain(true, true), Safety::None), execution, Arc::new(Filter(fails)))
            .await;
        let (end, sink) = (format!("end_{name}"), Named::new("sink", &log));
        let ports = class(plain(true, false), Safety::None);
        world.create_as(&end, ports, stream_of(&world.id("source")), sink.clone()).await;
        let number = 2 * n as u64;
        world.connect(number + 1, &format!("{name}/in"), "source/out", ConnectOptions::default()).await;
        world
            .connect(number + 2, &format!("{end}/in"), &format!("{name}/out"), ConnectOptions::default())
            .await;
        world.start(&end).await;
        world.start(name).await;
        sinks.push(sink);
    }
    world.start("source").await;
    for name in ["passes", "stops"] {
        world.eventually("FAULT", name, |r| r.state == State::Fault).await;
    }
    // The cycle in which it failed is over: the samples from before that were taken.
    let then = sinks[0].steps();
    eventually("two more cycles", || sinks[0].steps() > then + 1).await;
    let stopped = sinks[1].steps();
    eventually("frames pass the filter that failed", || sinks[0].steps() > 30).await;
    assert_eq!(sinks[1].steps(), stopped, "the other branch gets nothing more");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_setting_the_machine_refuses_is_a_warning_with_the_state_and_the_component_runs() {
    let (world, log) = (World::new("x_refused"), log());
    let head = Named::new("head", &log);
    world.create("head", Execution { cpus: vec![1023], ..periodic(1000) }, head.clone()).await;
    world.start("head").await;
    eventually("steps all the same", || head.steps() > 10).await;
    let report = world.report("head").await;
    assert!(
        report.warnings.iter().any(|w| w.contains("processors [1023] were refused")),
        "{:?}",
        report.warnings
    );
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_runs_inside_a_component_whose_steps_are_calls_of_its_device() {
    let (world, log) = (World::new("x_nowhere"), log());
    world.create("device", model(ExecutionModel::OnCallback), Named::new("device", &log)).await;
    let id = world.id("child");
    behave("x_nowhere/child", Named::new("child", &log));
    let info = class(Ports::default(), Safety::None);
    let component = Box::new(Component {
        ports: Arc::new(info.ports.clone()),
        class: Arc::new(info),
        config: serde_json::json!({}),
        execution: inside(ExecutionModel::ExecIn, &world.id("device")),
        state: State::Created,
        health: Health::Ok,
        fault: String::new(),
    });
    let refused = world.apply(Change::Create { id, component }).await.unwrap_err();
    assert!(refused.to_string().contains("no step to run in"), "{refused}");
    world.end().await;
}

/// Tells when it is inside its command, and stays there until the test lets go.
struct Held {
    named: Arc<Named>,
    gate: Mutex<(mpsc::Sender<()>, mpsc::Receiver<()>)>,
}

impl Held {
    /// Returns the component, the receiver of its messages, and the sender that lets it go.
    fn new(named: Arc<Named>) -> (Arc<Held>, mpsc::Receiver<()>, mpsc::Sender<()>) {
        let ((tell, told), (go, gone)) = (mpsc::channel(), mpsc::channel());
        (Arc::new(Held { named, gate: Mutex::new((tell, gone)) }), told, go)
    }
}

impl Behaviour for Held {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        self.named.step(tick, own)
    }
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        let gate = self.gate.lock().unwrap();
        gate.0.send(()).unwrap();
        gate.1.recv().map_err(|e| e.to_string())
    }
}

/// `inner` runs inside `host`, which is the head itself or a filter of it. While a command of `inner` runs in
/// a cycle that has asked `host` already, a command for `host` comes. In rare rounds the thread is not asleep
/// yet, and runs `inner` between two cycles.
async fn commands_in_the_middle_of_cycles(process: &'static str, head: Execution, host: &str) {
    let (world, log) = (World::new(process), log());
    let ports = || class(ctl(), Safety::None);
    let named = ["head", "filter", "inner"].map(|n| Named::new(n, &log));
    let around = if host == "head" { named[0].clone() } else { named[1].clone() };
    world.create_as("head", ports(), head, named[0].clone()).await;
    if host == "filter" {
        world.create_as("filter", ports(), stream_of(&world.id("head")), named[1].clone()).await;
    }
    let (inner, inside_it, goes_on) = Held::new(named[2].clone());
    world.create_as("inner", ports(), inside(ExecutionModel::ExecIn, &world.id(host)), inner).await;
    for name in BTreeSet::from(["head", "inner", host]) {
        world.start(name).await;
    }
    for round in 1..=20 {
        world.send("inner").await;
        inside_it.recv().unwrap();
        world.send(host).await;
        goes_on.send(()).unwrap();
        eventually("a step of both", || around.steps() == round && named[2].steps() == round).await;
    }
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_after_a_head_was_asked_in_a_cycle_is_stepped_for_in_the_next_one() {
    let head = model(ExecutionModel::OnSignal);
    commands_in_the_middle_of_cycles("x_late_head", head, "head").await;
    let stream = Execution { threads: Some(2), ..model(ExecutionModel::Stream) };
    commands_in_the_middle_of_cycles("x_late_stream", stream, "head").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_after_a_filter_was_asked_in_a_cycle_is_stepped_for_in_the_next_one() {
    let head = Execution { period_ns: Some(1_000_000), ..model(ExecutionModel::Stream) };
    commands_in_the_middle_of_cycles("x_late_filter", head, "filter").await;
}
