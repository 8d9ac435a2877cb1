//! A-scans that the built OCT plugin makes of spectra in a second of one core, the surface included: by
//! itself and beside the stereo load, which takes of the caches and of what two processors share: gate A8
//! holds for both.
//!
//! Invariant: timed from spectra that are there to their distances, in the stream that makes them, frame by
//! frame of 64 lines.

use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use super::control::longer;
use super::plan::Plan;
use super::rig::{OFFSET_M, Rig, world};
use super::verdicts::{Unit, Verdicts};
use crate::lab::as_number;

/// Samples of a line, lines per second so that a core makes the spectra, too, and the least A-scans per
/// second and core.
const SIZES: [(u64, f64, f64); 2] = [(1024, 32_000.0, 250_000.0), (2048, 16_000.0, 120_000.0)];
/// Each second so many frames of 64 lines.
const LINES: f64 = 64.0;
const LATEST_NS: f64 = 10e3;
/// Longest run of each, s.
const LONGEST_S: u64 = 20;

pub(super) fn measure(verdicts: &mut Verdicts, seconds: u64) {
    let seconds = seconds.min(LONGEST_S);
    for size in SIZES {
        measure_one(verdicts, size, seconds, Beside::Nothing);
        measure_one(verdicts, size, seconds, Beside::Stereo);
    }
}

/// What runs on the other processors.
#[derive(Clone, Copy, PartialEq)]
enum Beside {
    /// Controller and robot, and no pictures.
    Nothing,
    /// The displayed path of the canonical load.
    Stereo,
}

fn measure_one(
    verdicts: &mut Verdicts,
    (samples, line_rate_hz, least): (u64, f64, f64),
    seconds: u64,
    beside: Beside,
) {
    let source = json!({ "samples": samples, "line_rate_hz": line_rate_hz, "exposure_s": 1e-5 });
    let (plan, words) = match beside {
        Beside::Nothing => (Plan::new().without_video(), "without the stereo load"),
        Beside::Stereo => (Plan::new().with_whole_display_path(), "beside the stereo load"),
    };
    let plan = plan
        .with_accounts()
        .configured("oct/source", source)
        .configured("oct/ascan", json!({ "samples": samples }))
        .at_rate("oct/source", line_rate_hz / LINES);
    let rig = Rig::up(world(), plan);
    rig.await_active(if beside == Beside::Stereo { "host/camera" } else { "oct/ledger" });
    verdicts.title(&format!("A-scans of {samples} samples {words}, {seconds} s"));
    thread::sleep(Duration::from_secs(1));
    rig.call("oct/ledger", "ledger/clear", json!(OFFSET_M));
    thread::sleep(Duration::from_secs(seconds));
    let lines = rig.call("oct/ledger", "ledger/figures", Value::Null);
    let of = |key: &str| as_number(&lines[key]);
    verdicts.at_least("A-scans taken", of("lines"), 0.5 * line_rate_hz * seconds as f64, Unit::Count);
    let what = "A-scans per second of one core: spectra → A-scans in dB and bytes → distances, mean";
    // A bare thread beside the same load, whose turns take as long as a frame.
    let period_ns = (1e9 * LINES / line_rate_hz) as u64;
    let control_ns = longer(period_ns, of("p50") * LINES, seconds) / LINES;
    verdicts.at_least(what, 1e9 / of("mean"), least, Unit::PerSecond);
    verdicts.at_most("time of one A-scan, p99", of("p99"), LATEST_NS, control_ns, Unit::Ns);
    verdicts.tell("A-scans per second, median", 1e9 / of("p50"), None, Unit::PerSecond);
    rig.end();
}
