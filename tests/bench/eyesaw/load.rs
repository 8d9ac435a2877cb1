//! The canonical load: 2 x 1024x768 RGB at 30 Hz through rectify, overlay and picture in picture, OCT at 4
//! kHz, a robot at 1 kHz that scans meanwhile; in one process and in three.
//!
//! Invariant: what the framework costs is the mean age of frames at the sink less the time the classes spent
//! in their own steps for them, both of the same frames; and the age of frames on a way of the same shape on
//! which nothing is done.

use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use super::control::{Nominal, Witness, bare, longer};
use super::plan::{HOPS, Plan};
use super::rig::{OFFSET_M, Rig, Work, world};
use super::verdicts::{Unit, Verdicts, largest};
use crate::lab::as_number;

/// Those whose own steps lie between a frame's stamp and the sink.
const PATH: [&str; 4] = ["host/camera", "host/rectify", "host/overlay", "host/pip"];
/// Threads of 1 kHz, with all that steps in them.
const FAST: [&[&str]; 3] = [
    &["robot/robot"],
    &["oct/source", "oct/ascan", "oct/surface", "oct/edge", "oct/ledger"],
    &["host/bscan"],
];
/// Inputs of the displayed path.
const INPUTS: [&str; 5] =
    ["host/rectify/image", "host/overlay/image", "host/pip/image", "host/seen/image", "host/display/image"];
const LATEST_NS: f64 = 10e6;
const FRAMEWORK_NS: f64 = 200e3;
/// Of one A-scan.
const ASCAN_NS: f64 = 10e3;
/// Lines of a frame of spectra.
const LINES: f64 = 4.0;
/// Longest run of the bare threads, s.
const CONTROL_S: u64 = 20;
/// The scan is longer than the run by so much, s.
const SPARE_S: f64 = 5.0;
const LINE_M: f64 = 0.003;

pub(super) fn measure(verdicts: &mut Verdicts, seconds: u64) {
    for plan in [Plan::new().in_one(), Plan::new()] {
        let world = world();
        let plan = plan.with_whole_display_path().with_blank_path().with_accounts();
        let name = if plan.is_in_one() { "one process" } else { "three processes" };
        verdicts.title(&format!("Canonical load for {seconds} s, {name}"));
        run(verdicts, &Rig::up(world, plan), seconds);
    }
}

/// What all have done so far.
struct Account {
    path: Vec<Work>,
    fast: Vec<Work>,
    camera: Work,
    robot: Work,
    dropped: f64,
    /// At the display.
    gaps: f64,
    lost: f64,
}

impl Account {
    fn of(rig: &Rig) -> Account {
        let sum = |paths: &[&str]| {
            let all = paths.iter().map(|path| rig.work(path));
            all.reduce(|a, b| Work { ns: a.ns + b.ns, ..a }).unwrap_or_default()
        };
        Account {
            path: PATH.iter().map(|path| rig.work(path)).collect(),
            fast: FAST.iter().map(|paths| sum(paths)).collect(),
            camera: rig.work("host/camera"),
            robot: rig.work("robot/robot"),
            dropped: INPUTS.iter().map(|input| rig.dropped(input)).sum(),
            gaps: rig.number("host/display", "gaps"),
            lost: rig.number("oct/source", "lost")
                + rig.number("oct/ascan", "left_out")
                + rig.number("oct/ascan", "refused_frames"),
        }
    }
}

fn run(verdicts: &mut Verdicts, rig: &Rig, seconds: u64) {
    let camera = "host/camera";
    rig.await_active(camera);
    rig.scan_of(LINE_M, LINE_M / (seconds as f64 + SPARE_S), 1.0);
    let last_blank = format!("host/blank{}", HOPS - 1);
    for path in ["host/seen", &last_blank] {
        rig.call(path, "ledger/clear", Value::Null);
    }
    rig.call("oct/ledger", "ledger/clear", json!(OFFSET_M));
    let (before, witness) = (Account::of(rig), Witness::start());
    thread::sleep(Duration::from_secs(seconds));
    let machine = witness.lost();
    drop(witness);
    let after = Account::of(rig);
    let frames = rig.call("host/seen", "ledger/figures", Value::Null);
    let blank = rig.call(&last_blank, "ledger/figures", Value::Null);
    let lines = rig.call("oct/ledger", "ledger/figures", Value::Null);
    let progress = rig.progress();
    let of = |all: &Value, key: &str| as_number(&all[key]);

    // As many as the source began; the accounts around the run are some frames apart from it.
    let count = after.camera.steps - before.camera.steps;
    let spent: Vec<f64> = before.path.iter().zip(&after.path).map(|(b, a)| (a.ns - b.ns) / count).collect();
    let fast: Vec<f64> =
        before.fast.iter().zip(&after.fast).map(|(b, a)| (a.ns - b.ns) / (a.steps - b.steps)).collect();
    let nominal =
        Nominal { source: spent[0], filters: spent[1..].iter().sum(), fast: [fast[0], fast[1], fast[2]] };
    let beyond = bare(nominal, seconds.min(CONTROL_S));
    // As the source's thread, whose turns take as long as a frame of lines.
    let longer_ns = longer(1_000_000, of(&lines, "p50") * LINES, seconds.min(CONTROL_S));

    verdicts.at_least("frames at the sink", of(&frames, "frames"), 0.9 * 30.0 * seconds as f64, Unit::Count);
    let missing = largest([of(&frames, "missing"), after.dropped - before.dropped].into_iter());
    verdicts.at_most(
        "frames dropped in the display path: indices that never came, or drops of its queues",
        missing,
        0.0,
        machine.frames,
        Unit::Count,
    );
    let what = "gaps at the display behind it";
    verdicts.at_most(what, after.gaps - before.gaps, 0.0, machine.frames, Unit::Count);
    let skipped = after.camera.skipped - before.camera.skipped;
    verdicts.at_most(
        "periods of the camera that began too late to be taken",
        skipped,
        0.0,
        machine.frame_periods,
        Unit::Count,
    );
    verdicts.at_least("A-scans", of(&lines, "lines"), 0.9 * 4000.0 * seconds as f64, Unit::Count);
    verdicts.at_most(
        "A-scans lost: numbers that never came",
        of(&lines, "missing"),
        0.0,
        machine.lines,
        Unit::Count,
    );
    verdicts.at_most(
        "A-scans lost: counted by source and processor",
        after.lost - before.lost,
        0.0,
        machine.lines,
        Unit::Count,
    );
    verdicts.at_most("A-scans without a distance", of(&lines, "untold"), 0.0, 0.0, Unit::Count);
    let skipped = after.robot.skipped - before.robot.skipped;
    verdicts.tell("periods of the robot left out", skipped, Some(machine.periods), Unit::Count);
    let what = "source → display-ready, p99";
    verdicts.at_most(what, of(&frames, "p99"), LATEST_NS, beyond.p99_ns, Unit::Ns);
    verdicts.tell("source → display-ready, p50", of(&frames, "p50"), None, Unit::Ns);
    verdicts.tell("source → display-ready, longest", of(&frames, "max"), None, Unit::Ns);
    for (path, ns) in PATH.iter().zip(&spent) {
        verdicts.tell(&format!("of it in the steps of {path}, mean"), *ns, None, Unit::Ns);
    }
    let framework_ns = of(&frames, "mean") - spent.iter().sum::<f64>();
    let what = "framework's share: mean age at the sink less those steps";
    verdicts.at_most(what, framework_ns, FRAMEWORK_NS, beyond.mean_ns, Unit::Ns);
    let what = "a way of the same shape on which nothing is done, p50";
    verdicts.at_most(what, of(&blank, "p50"), FRAMEWORK_NS, beyond.p50_ns, Unit::Ns);
    verdicts.tell("the same, p99", of(&blank, "p99"), Some(beyond.p99_ns), Unit::Ns);
    let what = "time of one A-scan, spectra → distances, p99";
    verdicts.at_most(what, of(&lines, "p99"), ASCAN_NS, longer_ns / LINES, Unit::Ns);
    verdicts.tell("the same, median", of(&lines, "p50"), None, Unit::Ns);
    verdicts.tell(
        "last exposure of a frame of lines → distances, p50",
        of(&lines, "age_p50"),
        None,
        Unit::Ns,
    );
    verdicts.tell("the same, p99", of(&lines, "age_p99"), None, Unit::Ns);
    verdicts.tell("exposure → controller, mean", 1e9 * of(&progress, "delay"), None, Unit::Ns);
    verdicts.tell("scan meanwhile: truth less offset, RMS", of(&lines, "scan_rms"), None, Unit::Micrometre);
}
