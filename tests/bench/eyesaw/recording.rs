//! The canonical load while it is recorded: video, 4000 A-scans a second, a robot of 1 kHz that scans, all events and commands.
//!
//! Invariant: what a recorder costs whom it records is the time of their steps with it beside that in two runs without, of the same
//! length, one before and one after; what these differ among themselves is the machine's doing.

use std::thread;
use std::time::Duration;

use serde_json::{Value, json};
use trocar_tests::eventually;

use super::plan::{Plan, RECORDER};
use super::rig::{OFFSET_M, Rig, world};
use super::verdicts::{Unit, Verdicts};
use crate::lab::as_number;

/// Those whose steps are timed, beside the stream of A-scans.
const TIMED: [&str; 3] = ["host/camera", "robot/robot", "host/bscan"];
/// What is recorded, how many may wait, and how many come in a second at least; events and commands come as they do.
const OUTPUTS: [(&str, usize, f64); 8] = [
    ("host/camera/image", 64, 30.0),
    ("oct/source/spectra", 64, 1000.0),
    ("oct/ascan/ascan", 64, 1000.0),
    ("oct/surface/distance", 4096, 4000.0),
    ("robot/robot/tap_rows", 512, 1000.0),
    ("robot/robot/tap_commands", 512, 0.0),
    ("robot/robot/tap_events", 512, 0.0),
    ("host/bscan/tap_events", 512, 0.0),
];
/// Its step's thread and its writer's.
const THREADS: &str = "rec";
const SLOWER: f64 = 0.05;
const OF_A_CORE: f64 = 0.35;
/// Of what is to come, what comes at least: the file begins and ends some cycles beside the run.
const AT_LEAST: f64 = 0.9;
const BITS_PER_S: f64 = 1e9;
/// The scan is longer than the run by so much, s.
const SPARE_S: f64 = 5.0;
const LINE_M: f64 = 0.003;

/// Times of steps, ns, in the order of [`TIMED`] and then that of one A-scan: percentile 99 and median.
struct Times {
    p99: Vec<f64>,
    p50: Vec<f64>,
}

pub(super) fn measure(verdicts: &mut Verdicts, seconds: u64) {
    let plan = || Plan::new().with_accounts().with_steps_timed(&TIMED);
    let control = |rig: Rig| {
        let times = stretch(&rig, seconds);
        rig.end();
        times
    };
    let before = control(Rig::up(world(), plan()));
    let world = world();
    let outputs = OUTPUTS.map(|(output, fifo, _)| (output, fifo));
    let plan_recorded = plan().recorded(&outputs, &world.path(""));
    verdicts.title(&format!("Canonical load recorded for {seconds} s, three processes"));
    let with = recorded(verdicts, &Rig::up(world, plan_recorded), seconds);
    let after = control(Rig::up(self::world(), plan()));
    for (at, name) in
        TIMED.iter().map(|path| format!("step of {path}")).chain(["time of one A-scan".into()]).enumerate()
    {
        for (what, of) in [("p99", 0), ("p50", 1)] {
            let pick = |times: &Times| if of == 0 { times.p99[at] } else { times.p50[at] };
            let (a, b) = (pick(&before), pick(&after));
            let base = 0.5 * (a + b);
            let seen = pick(&with) / base - 1.0;
            let control = (a - b).abs() / base;
            if of == 0 {
                verdicts.at_most(&format!("{name}, {what}, longer by"), seen, SLOWER, control, Unit::Share);
            } else {
                verdicts.tell(&format!("{name}, {what}, longer by"), seen, Some(control), Unit::Share);
            }
            verdicts.tell(
                &format!("{name}, {what}, recorded; beside it not recorded"),
                pick(&with),
                Some(base),
                Unit::Ns,
            );
        }
    }
}

/// One run's times.
fn stretch(rig: &Rig, seconds: u64) -> Times {
    begin(rig, seconds);
    thread::sleep(Duration::from_secs(seconds));
    times(rig)
}

/// Lets it scan, and all accounts begin.
fn begin(rig: &Rig, seconds: u64) {
    rig.await_active("host/camera");
    rig.scan_of(LINE_M, LINE_M / (seconds as f64 + SPARE_S), 1.0);
    for path in TIMED {
        rig.call(&format!("{path}-ends"), "ledger/clear", Value::Null);
    }
    rig.call("oct/ledger", "ledger/clear", json!(OFFSET_M));
}

fn times(rig: &Rig) -> Times {
    let ledgers = TIMED.iter().map(|path| format!("{path}-ends")).chain(["oct/ledger".to_owned()]);
    let figures: Vec<Value> = ledgers.map(|path| rig.call(&path, "ledger/figures", Value::Null)).collect();
    let all = |key: &str| figures.iter().map(|figures| as_number(&figures[key])).collect();
    Times { p99: all("p99"), p50: all("p50") }
}

fn recorded(verdicts: &mut Verdicts, rig: &Rig, seconds: u64) -> Times {
    begin(rig, seconds);
    let ctl = |member: &str, arg: Value| rig.call(RECORDER, &format!("ctl/{member}"), arg);
    ctl("start", json!({ "path": "load.mcap", "delay": 0, "duration": 0 }));
    eventually("it records", || {
        let status = ctl("status", Value::Null);
        if as_number(&status["messages"]) > 0.0 { Ok(()) } else { Err(status.to_string()) }
    });
    let drops = |at: usize| rig.dropped(&format!("{RECORDER}/in_{}", at + 1));
    // What came between the connection and Start found nobody, and is no loss of a recording.
    let before: Vec<f64> = (0..OUTPUTS.len()).map(drops).collect();
    let spent_s = rig.processor_s("host", THREADS);
    let begun = (std::time::Instant::now(), as_number(&ctl("status", Value::Null)["bytes"]));
    thread::sleep(Duration::from_secs(seconds));
    let took_s = begun.0.elapsed().as_secs_f64();
    let spent_s = rig.processor_s("host", THREADS) - spent_s;
    let bytes = as_number(&ctl("status", Value::Null)["bytes"]) - begun.1;
    let times = times(rig);
    ctl("stop", Value::Null);
    let last = eventually("its file is closed", || {
        let last = ctl("last", Value::Null);
        if last["reason"].as_str().is_some_and(|why| !why.is_empty()) {
            Ok(last)
        } else {
            Err(last.to_string())
        }
    });
    let mut dropped = 0.0;
    for (at, (output, _, rate)) in OUTPUTS.iter().enumerate() {
        dropped += drops(at) - before[at];
        let kept = as_number(&ctl("topic", json!(at))["kept"]);
        match *rate > 0.0 {
            true => verdicts.at_least(
                &format!("{output} in the file"),
                kept,
                AT_LEAST * rate * seconds as f64,
                Unit::Count,
            ),
            false => verdicts.tell(&format!("{output} in the file"), kept, None, Unit::Count),
        }
    }
    verdicts.at_most("samples lost, as the recorder counts", as_number(&last["lost"]), 0.0, 0.0, Unit::Count);
    verdicts.at_most("samples its full queues dropped", dropped, 0.0, 0.0, Unit::Count);
    let whole = if last["whole"] == true { 1.0 } else { 0.0 };
    verdicts.at_least("its file is whole", whole, 1.0, Unit::Count);
    let what = "processor of the recorder's threads, of a core";
    verdicts.at_most(what, spent_s / took_s, OF_A_CORE, 0.0, Unit::Share);
    verdicts.at_least("bits written", 8.0 * bytes / took_s, BITS_PER_S, Unit::PerSecond);
    times
}
