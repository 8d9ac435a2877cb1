//! Calls, events and samples from one component to another.

use serde_json::json;
use trocar::model::{ConnectOptions, Execution, ExecutionModel};

use crate::baseline;
use crate::lab::{Lab, after, model};
use crate::table::{Goal, Table, median};

/// Calls per run and runs: about 1 ms each, so that the median is of undisturbed ones.
const CALLS: u64 = 20_000;
const RUNS: u64 = 15;
/// Depth of the queues, and events per burst, which must fit in.
const DEPTH: usize = 256;
/// Round trips per run, commands per flood.
const TRIPS: u64 = 5_000;
const FLOOD: u64 = 500_000;

/// On the thread of the caller.
pub(crate) fn inline(table: &mut Table) {
    let lab = Lab::new();
    lab.create("gauge", "gauge", Execution::default());
    lab.create("target", "target", after("gauge"));
    lab.connect("gauge/peer", "target/ctl");
    lab.start();
    let call = baseline::call();
    let beside = "a call through a pointer";
    let time = |what: &str| lab.measure("gauge", what, CALLS, RUNS);
    table.title("Calls from one component to another, on one thread, from a step");
    let empty = time("nothing");
    let void = time("void") - empty;
    table.row("inline void", void, Goal::Ns(5.0), beside, call);
    table.row("inline write", time("write") - empty, Goal::Ns(8.0), beside, call);
    table.row("inline write-return", time("write_return") - empty, Goal::None, beside, call);
    table.row("read of the published state", time("read") - empty, Goal::Ns(12.0), beside, call);
    table.row("write to an output nobody reads", time("output") - empty, Goal::None, beside, call);
    lab.connect("target/sample", "gauge/sample");
    let hop = time("hop") - empty - void;
    table.row("inline hop: a sample written and taken", hop, Goal::Ns(25.0), beside, call);
    table.row("event to nobody", time("unheard") - empty, Goal::None, beside, call);
    for (handlers, goal) in [(1, 15.0), (8, 60.0)] {
        for i in listeners(handlers) {
            lab.create(&format!("direct{i}"), "direct", after("gauge"));
            lab.connect(&format!("direct{i}/source"), "gauge/ctl");
        }
        lab.start();
        let what = format!("event to {handlers} handlers inside `emit`");
        table.row(&what, time("event") - empty, Goal::Ns(goal), beside, call);
    }
}

/// The listeners that are added for so many.
fn listeners(handlers: usize) -> std::ops::Range<usize> {
    if handlers == 1 { 0..1 } else { 1..handlers }
}

/// Components a chain goes through.
const HOPS: u64 = 9;
/// Passages of a chain per run: as long as [`CALLS`] of one hop.
const CHAINS: u64 = CALLS / HOPS;

/// A sample, then a command, handed on through nine components.
pub(crate) fn chain(table: &mut Table) {
    let beside = format!("{HOPS} calls through a pointer");
    let bare = HOPS as f64 * baseline::call();
    let what = format!("{HOPS} hops: a sample written and taken, each time on a command");
    table.row(&what, samples_handed_on(), Goal::Ns(230.0), &beside, bare);
    let what = format!("{HOPS} hops: a command handed on");
    table.row(&what, commands_handed_on(), Goal::None, &beside, bare);
}

/// Each takes its sample, writes it and has the next one take it; ns for all. Nobody of them has a row to
/// publish but the last.
fn samples_handed_on() -> f64 {
    let lab = Lab::new();
    lab.create("gauge", "gauge", Execution::default());
    let (mut client, mut output) = ("gauge/peer".to_owned(), "gauge/sample".to_owned());
    for i in 1..HOPS {
        lab.create(&format!("hand{i}"), "hand", after("gauge"));
        lab.connect(&client, &format!("hand{i}/ctl"));
        lab.connect(&format!("hand{i}/sample"), &output);
        (client, output) = (format!("hand{i}/next"), format!("hand{i}/sample_out"));
    }
    lab.create("end", "target", after("gauge"));
    lab.connect(&client, "end/ctl");
    lab.connect("end/sample", &output);
    lab.start();
    let chain = lab.measure("gauge", "hop", CHAINS, RUNS);
    // What did not get through would cost nothing.
    lab.wait_until("end", "looks", (CHAINS * RUNS) as f64);
    chain - lab.measure("gauge", "nothing", CHAINS, RUNS)
}

/// The same for a command with a number, ns.
fn commands_handed_on() -> f64 {
    let lab = Lab::new();
    lab.create("gauge", "gauge", Execution::default());
    let mut client = "gauge/relay".to_owned();
    for i in 1..=HOPS {
        lab.create(&format!("relay{i}"), "relay", after("gauge"));
        lab.connect(&client, &format!("relay{i}/ctl"));
        client = format!("relay{i}/next");
    }
    lab.start();
    lab.measure("gauge", "relay", CHAINS, RUNS) - lab.measure("gauge", "nothing", CHAINS, RUNS)
}

/// To another thread.
pub(crate) fn queued(table: &mut Table) {
    let lab = Lab::new();
    lab.create("target", "target", model(ExecutionModel::OnSignal));
    lab.create("gauge", "gauge", Execution::default());
    lab.create("caller", "gauge", model(ExecutionModel::None));
    let deep = ConnectOptions { mailbox: Some(DEPTH), ..ConnectOptions::default() };
    lab.connect_with("caller/peer", "target/ctl", deep.clone());
    lab.start();
    table.title("To a component on another thread");
    let (mut trips, mut bare) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        trips.push(lab.invoke("caller/time/trip", json!(TRIPS)).as_f64().unwrap_or(f64::NAN));
        bare.push(baseline::ping_pong(TRIPS));
    }
    let beside = "bare ring + futex, there and back";
    table.row(
        "blocking round trip to a sleeping component",
        median(trips),
        Goal::Times(1.1),
        beside,
        median(bare),
    );
    let flood = median(
        (0..7).map(|_| lab.invoke("caller/time/flood", json!(FLOOD)).as_f64().unwrap_or(f64::NAN)).collect(),
    );
    let ring = median((0..7).map(|_| baseline::ring(FLOOD)).collect());
    let what = "command queued and executed, flooding (10 M/s = 100 ns)";
    table.row(what, flood, Goal::Ns(100.0), "a word through a bare ring", ring);
    for (handlers, goal) in [(1, 15.0), (8, 60.0)] {
        for i in listeners(handlers) {
            // One thread for all.
            let place = if i == 0 { model(ExecutionModel::OnSignal) } else { after("queued0") };
            lab.create(&format!("queued{i}"), "queued", place);
            lab.connect_with(&format!("queued{i}/source"), "gauge/ctl", deep.clone());
        }
        lab.start();
        // A burst fits into the queues, which are empty again before the next: all of it was heard.
        let burst = DEPTH as u64 / 2;
        let once = |what: &str| {
            let before: Vec<f64> =
                listeners(handlers).map(|i| lab.number(&format!("queued{i}"), "heard")).collect();
            let ns = lab.measure("gauge", what, burst, 1);
            for (i, before) in listeners(handlers).zip(before).filter(|_| what == "event") {
                lab.wait_until(&format!("queued{i}"), "heard", before + burst as f64);
            }
            ns
        };
        let time = |what: &str| median((0..41).map(|_| once(what)).collect());
        let (event, empty) = (time("event"), time("nothing"));
        let what = format!("event queued for {handlers} handlers");
        table.row(&what, event - empty, Goal::Ns(goal), "a word through a bare ring", ring);
    }
}
