//! Promises of the bench to an author, tried on one component that uses everything.
#![allow(clippy::unwrap_used)]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;
use trocar_sdk::testing::{Bench, Life};
use trocar_sdk::{ServiceReply, serde_json::json};

trocar_sdk::testing::count_allocations!();

#[derive(Config)]
struct Cfg {
    /// Factor of the output
    #[config(live, min = 0, max = 10, default = 2.0)]
    gain: f64,
    /// Size of the table
    #[config(default = 4)]
    table: usize,
    /// Names of further inputs
    #[config(live, default = [])]
    more: Vec<String>,
}

/// Scales a signal and asks a robot to hold.
#[derive(Component)]
#[component(rate_hz = 1000, safety = "actuator", provides("ctl"), requires("robot"))]
struct Worker {
    #[input(fifo = 4)]
    x: In<Scalar>,
    #[input]
    more: Many<In<f64>>,
    #[output]
    y: Out<f64>,
    #[required(interface = "robot")]
    hold: Function<f64, f64>,
    #[event("ctl")]
    done: Event<f64>,
    #[state]
    gaps: u64,
    #[state]
    last_seq: u64,
    #[state]
    stamp: Stamp,
    #[state]
    elapsed_s: f64,
    #[state]
    cycle: u64,
    #[state]
    lateness_s: f64,
    #[state]
    full: u64,
    #[state]
    stopped: u64,
    #[config]
    cfg: Cfg,
    #[host]
    host: Host,
    outcome: Option<Outcome>,
    greedy: bool,
    table: Vec<f64>,
    answers: Vec<ServiceReply>,
}

#[provides("ctl")]
impl Worker {
    /// From now on a step allocates.
    #[command]
    fn be_greedy(&mut self) {
        self.greedy = true;
    }
    /// Asks for another component.
    #[command]
    fn build(&mut self) {
        let _ = self.host.services().create("host/other", "low_pass", json!(null));
    }
    /// Sums 0 to 99 on all threads.
    #[command]
    fn sum(&mut self) -> u64 {
        let sum = AtomicU64::new(0);
        let done = self.host.parallel(100, |slice| {
            sum.fetch_add(u64::from(slice), Ordering::Relaxed);
        });
        if done.is_ok() { sum.into_inner() } else { 0 }
    }
    /// Allocates once in each of ten slices.
    #[command]
    fn greedy_slices(&mut self) {
        let _ = self.host.parallel(10, |_| drop(std::hint::black_box(Box::new(1u64))));
    }
    /// Outcome of the last call.
    #[command]
    fn outcome(&mut self) -> Text<32> {
        Text::new(&format!("{:?}", self.outcome))
    }
    /// Answers of the system so far.
    #[command]
    fn answered(&mut self) -> u64 {
        self.answers.iter().filter(|a| a.ok).count() as u64
    }
}

impl Component for Worker {
    fn configure(&mut self) -> Result {
        self.table = vec![0.0; self.cfg.table];
        self.more.set(&self.cfg.more)
    }
    fn stop(&mut self) -> Result {
        self.stopped += 1;
        Ok(())
    }
    fn step(&mut self, tick: &Tick) -> Result {
        (self.elapsed_s, self.cycle) = (tick.elapsed_s(), tick.cycle());
        self.lateness_s = tick.now().seconds_since(tick.deadline());
        if self.greedy {
            std::hint::black_box((vec![1u8; 100], &self.table));
        }
        while let Some(x) = self.x.next_sample() {
            if self.last_seq > 0 {
                self.gaps += x.seq - self.last_seq - 1;
            }
            (self.last_seq, self.stamp) = (x.seq, x.stamp);
            if x.value.value.is_nan() {
                return Err("the signal is no number".into());
            }
            self.y.write(&(self.cfg.gain * x.value.value));
            self.outcome = Some(match self.hold.call(x.value.value) {
                Ok(_) => Outcome::Executed,
                Err(e) => {
                    assert_eq!(e.may_still_run, e.outcome == Outcome::Deadline);
                    e.outcome
                }
            });
            if self.done.emit(x.value.value) == Outcome::QueueFull {
                self.full += 1;
            }
        }
        for more in self.more.ports_mut() {
            if let Some(x) = more.fresh() {
                self.y.write(&x);
            }
        }
        Ok(())
    }
    fn answered(&mut self, reply: ServiceReply) -> Result {
        self.answers.push(reply);
        Ok(())
    }
}

fn x(value: f64) -> Scalar {
    Scalar { stamp: Stamp::INVALID, value }
}

fn bench() -> Bench<Worker> {
    let mut bench = Bench::<Worker>::new("{}");
    bench.answer("hold", |x: f64| Ok(x));
    bench
}

/// The text of the failure that `f` ends in.
fn failure(f: impl FnOnce()) -> String {
    let payload = catch_unwind(AssertUnwindSafe(f)).expect_err("the expectation should have failed");
    payload.downcast_ref::<String>().cloned().unwrap_or_default()
}

fn outcome(bench: &mut Bench<Worker>) -> String {
    bench.command::<(), Text<32>>("outcome", ()).unwrap().to_string()
}

#[test]
fn a_late_step_is_late_and_the_grid_stays() {
    let mut bench = bench();
    bench.step(1);
    let begin = bench.now();
    bench.late_step(300_000).unwrap();
    assert!(
        (bench.state().lateness_s - 0.3e-3).abs() < 1e-12 && (bench.state().elapsed_s - 1.3e-3).abs() < 1e-12
    );
    bench.step(1);
    assert!(bench.state().lateness_s == 0.0 && (bench.state().elapsed_s - 0.7e-3).abs() < 1e-12);
    assert!((bench.now().seconds_since(begin) - 2e-3).abs() < 1e-12);
}

#[test]
fn skipped_cycles_are_counted_and_take_their_time() {
    let mut bench = bench();
    bench.step(2);
    bench.skip(3);
    bench.step(1);
    assert_eq!(bench.state().cycle, 5);
    assert!((bench.state().elapsed_s - 4e-3).abs() < 1e-12);
}

#[test]
fn lost_samples_leave_a_gap_in_the_sequence() {
    let mut bench = bench();
    bench.push("x", x(1.0));
    bench.lose("x", 2);
    bench.push("x", x(2.0));
    bench.step(1);
    assert_eq!(bench.state().gaps, 2);
}

#[test]
fn a_sample_carries_the_stamp_it_was_pushed_with() {
    let mut bench = bench();
    bench.push_at("x", x(1.0), Stamp::from_ns(5));
    bench.step(1);
    assert_eq!(bench.state().stamp.ns(), 5);
    bench.push("x", x(1.0));
    let pushed = bench.now();
    bench.step(1);
    assert_eq!(bench.state().stamp, pushed);
}

#[test]
fn each_way_a_call_can_fail_is_seen_by_the_component_and_made_well_again() {
    let mut bench = bench();
    for (fault, seen) in [
        (Outcome::QueueFull, "Some(QueueFull)"),
        (Outcome::Deadline, "Some(Deadline)"),
        (Outcome::PeerLost, "Some(PeerLost)"),
        (Outcome::Unbound, "Some(Unbound)"),
        (Outcome::WouldBlock, "Some(WouldBlock)"),
    ] {
        bench.fail("robot/hold", fault);
        bench.push("x", x(1.0));
        bench.step(1);
        assert_eq!(outcome(&mut bench), seen);
    }
    bench.answer("hold", |x: f64| Ok(x));
    bench.push("x", x(1.0));
    bench.step(1);
    assert_eq!(outcome(&mut bench), "Some(Executed)");
}

#[test]
fn an_observer_without_room_is_told_to_the_component_and_the_event_is_still_seen_here() {
    let mut bench = bench();
    bench.overflow("ctl/done", true);
    bench.push("x", x(1.0));
    bench.step(1);
    bench.overflow("ctl/done", false);
    bench.push("x", x(2.0));
    bench.step(1);
    assert_eq!(bench.state().full, 1);
    bench.expect_events("done", &[1.0, 2.0]);
}

#[test]
fn an_actuator_is_made_safe_when_it_loses_its_peer_and_when_it_is_stopped() {
    let mut bench = bench();
    bench.lose_peer("robot").unwrap();
    assert_eq!((bench.made_safe(), bench.state().stopped), (1, 0));
    bench.resume().unwrap();
    bench.push("x", x(1.0));
    bench.step(1);
    assert_eq!(outcome(&mut bench), "Some(Unbound)");
    bench.stop().unwrap();
    assert_eq!((bench.made_safe(), bench.state().stopped), (2, 1));
    let missing = failure(|| drop(bench.lose_peer("robto")));
    assert!(missing.contains("there are robot"), "{missing}");
}

#[test]
fn a_step_that_fails_makes_the_component_safe() {
    let mut bench = bench();
    bench.push("x", x(f64::NAN));
    let failed = bench.try_step().unwrap_err();
    assert_eq!((failed.reason.as_str(), bench.made_safe()), ("the signal is no number", 1));
}

/// Breaks wherever it is entered and told to.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"), requires("robot"))]
struct Brittle {
    #[state]
    count: u64,
}

#[provides("ctl")]
impl Brittle {
    #[command]
    fn explode(&mut self) {
        panic!("a fuse is blown");
    }
    #[command]
    fn refuse(&mut self) -> Result {
        Err("not today".into())
    }
    #[command]
    fn count(&mut self) {
        self.count += 1;
    }
    #[read]
    fn counted(s: &BrittleState) -> u64 {
        s.count
    }
}

#[handles("robot")]
impl Brittle {
    #[on]
    fn fell(&mut self, from: f64) {
        assert!(from < 1.0, "it fell from {from} m");
    }
}

impl Component for Brittle {
    fn step(&mut self, _: &Tick) -> Result {
        self.count += 1;
        Ok(())
    }
}

#[test]
fn after_a_panic_in_a_command_it_is_safe_and_in_fault_and_nothing_but_reset_leads_on() {
    let mut bench = Bench::<Brittle>::new("{}");
    bench.step(1);
    assert_eq!(bench.command::<(), ()>("refuse", ()).unwrap_err().reason, "not today");
    assert_eq!((bench.life(), bench.made_safe()), (Life::Active, 0), "a refusal is no failure");
    assert!(bench.command::<(), ()>("ctl/explode", ()).unwrap_err().panicked());
    assert_eq!((bench.life(), bench.made_safe()), (Life::Fault, 1));

    let refused = bench.command::<(), ()>("count", ()).unwrap_err();
    assert!(!refused.panicked());
    assert!(
        refused.reason.starts_with("NOT_ACTIVE: ctl/count: it is in FAULT (command ctl/explode: panicked"),
        "{refused}"
    );
    let now = bench.now();
    for refused in [
        bench.try_step(),
        bench.start(),
        bench.resume(),
        bench.configure("{}"),
        bench.emit("fell", 0.5),
        bench.reply(1, "{}"),
    ] {
        assert!(refused.unwrap_err().reason.contains("in FAULT"));
    }
    bench.stop().unwrap();
    assert_eq!((bench.life(), bench.made_safe(), bench.now()), (Life::Fault, 1, now));
    assert_eq!(bench.read::<(), u64>("counted", ()), Ok(1), "its last row stands");

    bench.reset().unwrap();
    assert_eq!(bench.life(), Life::Ready);
    bench.start().unwrap();
    bench.command::<(), ()>("count", ()).unwrap();
    assert!(bench.emit("fell", 2.0).unwrap_err().panicked());
    assert_eq!(bench.life(), Life::Fault, "and a handler's panic is no better");
}

#[test]
fn what_does_not_run_takes_no_commands_and_makes_no_steps() {
    let mut bench = Bench::<Brittle>::created();
    assert!(bench.start().unwrap_err().reason.contains("it is CREATED, and has to be READY or STOPPED"));
    bench.configure("{}").unwrap();
    assert_eq!(bench.life(), Life::Ready);
    for refused in [bench.command::<(), ()>("count", ()), bench.try_step(), bench.emit("fell", 0.5)] {
        let reason = refused.unwrap_err().reason;
        assert!(
            reason.starts_with("NOT_ACTIVE: ") && reason.ends_with("it is READY, and has to be ACTIVE"),
            "{reason}"
        );
    }
    assert!(bench.resume().is_err(), "it never ran");
    bench.start().unwrap();
    assert!(bench.start().is_err(), "it runs");
    bench.command::<(), ()>("count", ()).unwrap();
    bench.stop().unwrap();
    bench.stop().unwrap();
    assert_eq!((bench.life(), bench.made_safe(), bench.state().count), (Life::Stopped, 1, 1));
}

#[test]
fn a_running_component_takes_live_settings_only_as_from_a_host() {
    let mut bench = bench();
    bench.configure(r#"{"gain": 3}"#).unwrap();
    let refused = bench.configure(r#"{"gain": 3, "table": 8}"#).unwrap_err().reason;
    assert_eq!(
        refused,
        "table: is not live, so it cannot change while the component runs; live are gain, more"
    );
    let refused = bench.configure(r#"{"gain": 11}"#).unwrap_err().reason;
    assert!(refused.contains("gain: 11 is above 10"), "{refused}");
    bench.push("x", x(1.0));
    bench.step(1);
    bench.expect_outputs("y", &[3.0]);
    bench.stop().unwrap();
    bench.configure(r#"{"table": 8}"#).unwrap();
}

#[test]
fn reset_gives_a_fresh_instance_with_the_former_configuration() {
    let mut bench = bench();
    bench.configure(r#"{"gain": 5}"#).unwrap();
    bench.command::<(), ()>("be_greedy", ()).unwrap();
    bench.step(3);
    bench.reset().unwrap();
    assert_eq!(bench.state().cycle, 0);
    bench.start().unwrap();
    bench.push("x", x(1.0));
    bench.assert_no_alloc(|bench| bench.step(1));
    bench.expect_outputs("y", &[5.0]);
}

#[test]
fn ports_that_come_with_the_configuration_can_be_pushed_and_go_again() {
    let mut bench = bench();
    bench.push("x", x(1.0));
    bench.configure(r#"{"more": ["a", "b"]}"#).unwrap();
    bench.push("b", 7.0);
    bench.step(1);
    bench.expect_outputs("y", &[2.0, 7.0]);
    bench.push("b", 8.0);
    bench.configure(r#"{"more": ["b"]}"#).unwrap();
    bench.step(1);
    bench.expect_outputs("y", &[8.0]);
    let gone = failure(|| bench.push("a", 1.0));
    assert_eq!(gone, "no input `a`; there are x, b");
}

#[test]
fn a_step_without_allocation_passes_and_one_with_is_said_with_its_size() {
    let mut bench = bench();
    bench.push("x", x(1.0));
    bench.assert_no_alloc(|bench| bench.step(1000));
    bench.command::<(), ()>("be_greedy", ()).unwrap();
    let told = failure(|| bench.assert_no_alloc(|bench| bench.step(2)));
    assert!(told.contains("allocated 2 times, first 100 B") && told.contains("step"), "{told}");
    bench.threads(3);
    let told =
        failure(|| bench.assert_no_alloc(|bench| bench.command::<(), ()>("greedy_slices", ()).unwrap()));
    assert!(told.contains("allocated 10 times, first 8 B"), "{told}");
}

#[test]
fn slices_run_on_as_many_threads_as_the_test_says() {
    let mut bench = bench();
    for threads in [1, 2, 4] {
        bench.threads(threads);
        let sum = bench.command::<(), u64>("sum", ()).unwrap();
        assert_eq!(sum, 4950, "on {threads} threads");
    }
}

#[test]
fn a_fake_system_answers_services_between_entries() {
    let mut bench = bench();
    bench.command::<(), ()>("build", ()).unwrap();
    assert_eq!(bench.services().len(), 1, "without a fake system the test sees what was asked");
    bench.answer_service("Create", |request| {
        if request["class"] == "low_pass" { Ok(json!({})) } else { Err("no such class".to_string()) }
    });
    bench.command::<(), ()>("build", ()).unwrap();
    assert_eq!(bench.command::<(), u64>("answered", ()).unwrap(), 1);
    assert!(bench.services().is_empty());
}

#[test]
fn an_expectation_that_fails_says_what_came_and_what_happened_last() {
    let mut bench = bench();
    bench.push("x", x(1.5));
    bench.step(1);
    let told = failure(|| bench.expect_outputs("y", &[4.0]));
    assert!(told.contains("output `y`: expected 1 values, 1 came; value 0 is 3.0 instead of 4.0"), "{told}");
    for line in [
        "into x {stamp: 0, value: 1.5}",
        "step 1",
        "out of y 3",
        "call of robot/hold 1.5",
        "event ctl/done 1.5",
    ] {
        assert!(told.contains(line), "`{line}` is not in:{told}");
    }
    bench.push("x", x(1.0));
    bench.step(1);
    let told = failure(|| bench.expect_calls::<f64>("hold", &[1.5, 1.0, 2.0]));
    assert!(told.contains("expected 3 values, 2 came; 2.0 and what follows did not come"), "{told}");
    let told = failure(|| bench.expect(false, "the robot holds"));
    assert!(told.starts_with("the robot holds\nwhat happened last:"), "{told}");
}

#[test]
fn a_wrong_type_is_said_with_both_sides() {
    let mut bench = bench();
    for _ in 0..2 {
        let told = failure(|| bench.push("x", 1.0f64));
        assert_eq!(told, "input `x` has type Scalar, the test uses f64");
        // A right one in between makes no wrong one right.
        bench.push("x", x(1.0));
    }
    let told = failure(|| drop(bench.outputs::<f64>("z")));
    assert_eq!(told, "no output `z`; there is y");
}

#[test]
fn a_wrong_name_is_blamed_on_the_line_of_the_test_with_the_nearest_name() {
    let mut bench = bench();
    let told = failure(|| drop(bench.calls::<f64>("robot/hodl")));
    assert_eq!(told, "no function `robot/hodl`, did you mean `robot/hold`?; there is robot/hold");
    let told = failure(|| drop(bench.events::<f64>("dne")));
    assert!(told.starts_with("no event `dne`, did you mean `ctl/done`?; there"), "{told}");
    let (me, (send, place)) = (std::thread::current().id(), std::sync::mpsc::channel());
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if std::thread::current().id() == me {
            let _ = send.send(info.location().map(|at| at.file().to_string()));
        }
        before(info);
    }));
    let _told = failure(|| bench.push("z", 1.0));
    let _told = failure(|| drop(bench.outputs::<f64>("z")));
    for _ in 0..2 {
        assert_eq!(place.recv().unwrap().as_deref(), Some(file!()));
    }
}
