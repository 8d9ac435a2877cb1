//! Whole steps: statistics, publication, hops of a chain.

use trocar::model::{ConnectOptions, Execution, ExecutionModel, Queue};

use crate::baseline;
use crate::lab::{Lab, after, as_number, model};
use crate::table::{Goal, Table, median};

/// Components under test between head and tail.
const MANY: usize = 8;
/// Cycles whose times are taken.
const CYCLES: f64 = 4000.0;
/// Repetitions; the median counts.
const ROUNDS: usize = 5;

pub(crate) fn measure(table: &mut Table) {
    table.title("Steps, on one thread");
    let clock = baseline::clock();
    let bare = each("row0");
    let beside = "a look at the clock";
    table.row("step with statistics, nothing to publish", bare, Goal::None, beside, clock);
    table.row("step with statistics and a row of 1 f64", each("row1"), Goal::Ns(150.0), beside, clock);
    let hop = median((0..ROUNDS).map(|_| (hops(MANY) - hops(0)) / MANY as f64).collect());
    table.row("step of a filter that hands a sample on", hop, Goal::Ns(150.0), beside, clock);
    for (class, numbers) in [("row1", 1), ("row10", 10), ("row100", 100), ("row1000", 1000)] {
        let publish = each(class) - bare;
        let what = format!("publication of {numbers} f64");
        let goal = Goal::Ns(60.0 + 0.8 * f64::from(numbers));
        table.row(&what, publish, goal, "a copy of it", baseline::copy(8 * numbers as usize));
    }
    for (what, class, port) in [
        ("sample of an output, 16 bytes", "teller", "value"),
        ("row of 1 f64", "row1", "tap_rows"),
        ("row of 100 f64", "row100", "tap_rows"),
        ("event", "speaker", "tap_events"),
        ("command with 8 bytes", "relay", "tap_commands"),
    ] {
        let what = format!("{what}, told to who looks on from another thread");
        let [step, turn] = tapped(class, port);
        table.row(&format!("{what}: a step longer by"), step, Goal::None, beside, clock);
        table.row(&format!("{what}: its thread's turn longer by"), turn, Goal::Ns(60.0), beside, clock);
    }
}

/// What a tap with a listener adds to one step of a class, and to its thread's turn; ns.
fn tapped(class: &str, port: &str) -> [f64; 2] {
    let once = || {
        let (with, without) = (with_taps(class, Some(port)), with_taps(class, None));
        [0, 1].map(|at| (with[at] - without[at]) / MANY as f64)
    };
    let all: Vec<[f64; 2]> = (0..ROUNDS).map(|_| once()).collect();
    [0, 1].map(|at| median(all.iter().map(|figures| figures[at]).collect()))
}

/// As [`between`], and a whole turn, with a listener for each on a thread that looks each millisecond,
/// connected to this tap.
fn with_taps(class: &str, port: Option<&str>) -> [f64; 2] {
    let lab = Lab::new();
    lab.create("head", "head", model(ExecutionModel::Continuous));
    for i in 0..MANY {
        lab.create(&format!("one{i}"), class, after("head"));
        if class == "relay" {
            lab.create(&format!("asker{i}"), "asker", after("head"));
            lab.connect(&format!("asker{i}/next"), &format!("one{i}/ctl"));
        }
        let execution = if i == 0 { Execution::default() } else { after("ear0") };
        lab.create(&format!("ear{i}"), "listener", execution);
        if let Some(port) = port {
            let queue = Some(Queue::Fifo { depth: 4096, drop_oldest: true });
            let options = ConnectOptions { queue, ..ConnectOptions::default() };
            lab.connect_with(&format!("ear{i}/any"), &format!("one{i}/{port}"), options);
        }
    }
    let taken = cycle(&lab);
    if port.is_some() {
        lab.wait("ear7", "taken", 1.0);
    }
    [taken, as_number(&lab.invoke("head/turn/median", serde_json::Value::Null))]
}

/// What one step of a class takes, its publication included, ns.
fn each(class: &str) -> f64 {
    let once = || (between(class, MANY) - between(class, 0)) / MANY as f64;
    median((0..ROUNDS).map(|_| once()).collect())
}

/// From the end of the head's step to the begin of the tail's, with `many` of a class in between; ns.
fn between(class: &str, many: usize) -> f64 {
    let lab = Lab::new();
    lab.create("head", "head", model(ExecutionModel::Continuous));
    for i in 0..many {
        lab.create(&format!("one{i}"), class, after("head"));
    }
    cycle(&lab)
}

/// The same with a chain in which each hands a sample on.
fn hops(many: usize) -> f64 {
    let lab = Lab::new();
    lab.create("head", "head", model(ExecutionModel::Continuous));
    let mut from = "head/value".to_owned();
    for i in 0..many {
        lab.create(&format!("hop{i}"), "hop", after("head"));
        lab.connect(&format!("hop{i}/value"), &from);
        from = format!("hop{i}/value_out");
    }
    cycle(&lab)
}

fn cycle(lab: &Lab) -> f64 {
    lab.create("tail", "tail", after("head"));
    lab.start();
    lab.wait("tail", "cycles", CYCLES);
    as_number(&lab.invoke("tail/time/median", serde_json::Value::Null))
}
