//! Samples and frames over a line, one way, beside bare TCP.

use serde_json::{Value, json};
use trocar::model::ExecutionModel;

use super::bare;
use super::site::Site;
use crate::lab::model;
use crate::processes::{periodic, round};
use crate::table::{Goal, Table, median};

/// Rounds of each in turn; the median counts.
const ROUNDS: usize = 7;
/// Samples before those that count.
const WARM: usize = 20;
/// A way of samples, which the design allows so much more for being encrypted, ns.
const ENCRYPTED_NS: f64 = 10_000.0;

/// Something that is sent again and again.
struct Load {
    name: &'static str,
    bytes: usize,
    /// The sender's port, and its settings.
    port: &'static str,
    config: Value,
    period_ns: u64,
    /// Samples per round.
    count: usize,
}

fn loads() -> [Load; 3] {
    [
        Load { name: "64 B", bytes: 64, port: "small", config: json!({}), period_ns: 1_000_000, count: 1000 },
        Load {
            name: "8 KiB",
            bytes: 8192,
            port: "large",
            config: json!({ "large": true }),
            period_ns: 1_000_000,
            count: 1000,
        },
        Load {
            name: "a frame of 6.2 MB",
            bytes: 6_220_800,
            port: "frame",
            config: json!({ "frame_bytes": 6_220_800 }),
            period_ns: 33_000_000,
            count: 60,
        },
    ]
}

pub(super) fn measure(table: &mut Table) {
    let site = Site::new(&[]);
    table.title("A sample over an encrypted line to a process that sleeps, one way");
    for load in loads() {
        let (mut ours, mut bares) = (Vec::new(), Vec::new());
        let lab = &site.lab;
        lab.create_with("far/sender", "sender", load.config.clone(), periodic(load.period_ns));
        lab.create("near/sink", "sink", model(ExecutionModel::OnSignal));
        site.connect(&format!("near/sink/{}", load.port), &format!("far/sender/{}", load.port));
        lab.start_only("near/sink");
        for _ in 0..ROUNDS {
            ours.push(round(lab, WARM, load.count));
            bares.push(bare::one_way(load.bytes, load.count, load.period_ns));
        }
        lab.remove("far/sender");
        lab.remove("near/sink");
        let of = |all: &[(f64, f64)], part: fn(&(f64, f64)) -> f64| median(all.iter().map(part).collect());
        let (p50, p99) = (of(&ours, |p| p.0), of(&ours, |p| p.1));
        let (bare_p50, bare_p99) = (of(&bares, |p| p.0), of(&bares, |p| p.1));
        let name = load.name;
        let goal = match load.bytes {
            64 => Goal::Ns(1.2 * bare_p50 + ENCRYPTED_NS),
            _ => Goal::Times(1.2),
        };
        table.row(name, p50, goal, "bare TCP, not encrypted", bare_p50);
        table.row(&format!("{name}, p99"), p99, Goal::None, "the same of the bare one", bare_p99);
        if load.bytes == 64 {
            table.row(&format!("{name}, p99"), p99, Goal::Times(1.4), "its own p50", p50);
        }
    }
}
