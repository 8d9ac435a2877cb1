//! Samples and frames from one process to the other: one way, beside a bare ring in a memfd, and beside
//! iceoryx2.

use serde_json::{Value, json};
use trocar::model::{ConnectOptions, Execution, ExecutionModel};

use super::site::{Site, periodic, round};
use super::{bare, peers};
use crate::baseline;
use crate::lab::model;
use crate::table::{Goal, Table, median};

/// Between two samples.
const PERIOD_NS: u64 = 250_000;
/// Samples per round, and rounds of each way in turn; the median counts.
const COUNT: usize = 2000;
/// Samples before them.
const WARM: usize = 200;
const ROUNDS: usize = 7;

/// What is sent: its name, its size in B, the sender's port and settings.
fn sizes() -> [(&'static str, usize, &'static str, Value); 4] {
    [
        ("64 B", 64, "small", json!({})),
        ("8 KiB", 8192, "large", json!({ "large": true })),
        ("a frame of 6.2 MB", 6_220_800, "frame", json!({ "frame_bytes": 6_220_800 })),
        ("a frame of 40 MB", 40_000_000, "frame", json!({ "frame_bytes": 40_000_000 })),
    ]
}

pub(super) fn measure(table: &mut Table) {
    let site = Site::new();
    table.title("A sample to a process that sleeps, one way, one each 250 µs");
    let mut flat = Vec::new();
    let mut moved = (0.0, 0.0);
    for (name, bytes, port, config) in sizes() {
        let (mut ours, mut bares) = (Vec::new(), Vec::new());
        let (mut peer, mut p99s) = (Vec::new(), Vec::new());
        let lab = &site.lab;
        lab.create_with("far/sender", "sender", config, periodic(PERIOD_NS));
        lab.create("near/sink", "sink", model(ExecutionModel::OnSignal));
        lab.connect(&format!("near/sink/{port}"), &format!("far/sender/{port}"));
        lab.start_only("near/sink");
        for _ in 0..ROUNDS {
            let (p50, p99) = round(lab, WARM, COUNT);
            ours.push(p50);
            let (bare_p50, bare_p99) = bare::one_way(bytes, COUNT, PERIOD_NS);
            bares.push(bare_p50);
            p99s.push((p99, bare_p99));
            peer.extend(peers::one_way(bytes, COUNT));
        }
        moved = (moved.0 + lab.number("near/sink", "moved"), moved.1 + lab.number("near/sink", "got"));
        lab.remove("far/sender");
        lab.remove("near/sink");
        let (ns, bare) = (median(ours), median(bares));
        flat.push(ns);
        table.row(name, ns, Goal::Times(1.2), "bare ring in a memfd + futex", bare);
        let p99 = |of: fn(&(f64, f64)) -> f64| median(p99s.iter().map(of).collect());
        table.row(
            &format!("{name}, p99"),
            p99(|p| p.0),
            Goal::None,
            "the same of the bare one",
            p99(|p| p.1),
        );
        match peer.is_empty() {
            true => table.missing(name, "≤ 1 ×", peers::MISSING),
            false => table.row(name, ns, Goal::Times(1.0), "iceoryx2, publisher + event", median(peer)),
        }
    }
    let (least, most) =
        (flat.iter().copied().fold(f64::MAX, f64::min), flat.iter().copied().fold(0.0, f64::max));
    table.row("longest of the four", most, Goal::Times(1.2), "shortest of the four", least);
    table.count(
        "frames whose bytes lie in another file, or elsewhere in it, than their sender put them",
        &format!("{}", moved.0),
        "0",
        moved.0 == 0.0,
        &format!("{} frames and samples", moved.1),
    );
    push(table, &site);
}

/// Writes per run and runs.
const WRITES: u64 = 20_000;
const RUNS: u64 = 15;

/// What one write costs its step, however the reader is told.
fn push(table: &mut Table, site: &Site) {
    let lab = &site.lab;
    lab.create("near/gauge", "gauge", Execution::default());
    lab.create("far/asleep", "target", model(ExecutionModel::OnSignal));
    lab.create("far/polls", "target", periodic(1_000_000));
    lab.start();
    table.title("What a write of 16 B costs the step of a component whose reader is in another process");
    let call = baseline::call();
    let empty = lab.measure("near/gauge", "nothing", WRITES, RUNS);
    let nobody = lab.measure("near/gauge", "output", WRITES, RUNS) - empty;
    let beside = "a call through a pointer";
    table.row("nobody reads", nobody, Goal::None, beside, call);
    for (reader, what) in [
        ("asleep", "a reader that sleeps; it is woken once, after the step"),
        ("polls", "a reader that looks by itself, each ms"),
    ] {
        let replace = ConnectOptions { replace: true, ..ConnectOptions::default() };
        lab.connect_with(&format!("far/{reader}/sample"), "near/gauge/sample", replace);
        let push = lab.measure("near/gauge", "output", WRITES, RUNS) - empty;
        table.row(what, push, Goal::Ns(50.0), beside, call);
        lab.remove(&format!("far/{reader}"));
    }
}
