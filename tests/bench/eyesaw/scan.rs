//! Robot-Assisted B-Scans in real time, held against the truth: robot, OCT and tracker in three processes,
//! beside one process.
//!
//! Invariant: the deviation is that of the true distance while columns were taken, at each line; the control
//! is the same scan in one process on the same machine just before.

use serde_json::{Value, json};

use super::control::Witness;
use super::plan::Plan;
use super::rig::{OFFSET_M, Rig, world};
use super::verdicts::{Unit, Verdicts, largest};
use crate::lab::as_number;

const SCANS: usize = 3;
const LINE_M: f64 = 0.003;
const SPEED_M_S: f64 = 0.0005;
const RMS_M: f64 = 5.5e-6;
const MAX_M: f64 = 30e-6;
const NEAREST_M: f64 = 150e-6;
const DELAY_NS: f64 = 2e6;
/// Columns that a whole scan may lack.
const FEW: f64 = 5.0;
/// Scans that are given up while the machine stands still, for each whole one.
const TRIES: f64 = 5.0;
/// Two threads late by as much together: a column's time.
const STALL_NS: f64 = 12e6;
/// What it may cost to be apart.
const APART: f64 = 1.1;

/// One scan.
struct Seen {
    rms_m: f64,
    max_m: f64,
    tracker_m: f64,
    delay_ns: f64,
    empty: f64,
    untold: f64,
    given_up: f64,
    late_ns: f64,
}

pub(super) fn measure(verdicts: &mut Verdicts) {
    let plan = || Plan::new().without_video().with_accounts().with_tracker_apart();
    let (one, _) = scans(plan().in_one());
    let (three, nearest_m) = scans(plan());
    verdicts.title(
        "B-scan in three processes, in real time, against the truth (A4); control: the same in one process",
    );
    let worst = |all: &[Seen], of: fn(&Seen) -> f64| largest(all.iter().map(of));
    let mean = |all: &[Seen]| all.iter().map(|seen| seen.rms_m).sum::<f64>() / all.len() as f64;
    verdicts.at_most(
        "truth less offset, RMS, worst scan",
        worst(&three, |s| s.rms_m),
        RMS_M,
        0.0,
        Unit::Micrometre,
    );
    verdicts.at_most("truth less offset, largest", worst(&three, |s| s.max_m), MAX_M, 0.0, Unit::Micrometre);
    // Each scan meets the eye at another moment of its motion.
    let spread_m = worst(&one, |s| s.rms_m) - mean(&one);
    let what = "RMS of all scans beside that in one process and a tenth more";
    verdicts.at_most(what, mean(&three), APART * mean(&one), spread_m, Unit::Micrometre);
    verdicts.tell("RMS in one process", mean(&one), None, Unit::Micrometre);
    verdicts.tell(
        "tracker less truth, RMS",
        worst(&three, |s| s.tracker_m),
        Some(worst(&one, |s| s.tracker_m)),
        Unit::Micrometre,
    );
    let delay_ns = worst(&three, |s| s.delay_ns);
    verdicts.at_most("exposure → controller, mean", delay_ns, DELAY_NS, 0.0, Unit::Ns);
    verdicts.tell("the same in one process", worst(&one, |s| s.delay_ns), None, Unit::Ns);
    // What stands still for a column's time takes nothing in it; a robot silent for 20 ms ends a scan.
    let stood_still = worst(&three, |s| s.late_ns) > STALL_NS;
    let allowed = if stood_still { TRIES } else { 0.0 };
    let empty = worst(&three, |s| s.empty);
    verdicts.at_most("columns without an A-scan", empty, 0.0, allowed, Unit::Count);
    verdicts.at_most("columns never told", worst(&three, |s| s.untold), 0.0, allowed, Unit::Count);
    verdicts.at_most("scans given up", worst(&three, |s| s.given_up), 0.0, allowed, Unit::Count);
    verdicts.at_least("nearest that the tip was to the surface", nearest_m, NEAREST_M, Unit::Micrometre);
}

/// Some scans, and how near the tip was to the surface in all of them.
fn scans(plan: Plan) -> (Vec<Seen>, f64) {
    let rig = Rig::up(world(), plan);
    rig.call("robot/rest", "ledger/mark", Value::Null);
    let all = (0..SCANS).map(|_| scan(&rig)).collect();
    let nearest_m = rig.number("robot/rest", "nearest");
    rig.end();
    (all, nearest_m)
}

/// One whole scan, and how many were given up before it.
fn scan(rig: &Rig) -> Seen {
    let (mut given_up, witness) = (0.0, Witness::start());
    loop {
        rig.call("oct/ledger", "ledger/clear", json!(OFFSET_M));
        given_up += rig.scan_of(LINE_M, SPEED_M_S, 100.0) as f64;
        let delay_ns = 1e9 * as_number(&rig.progress()["delay"]);
        let end = rig.await_idle();
        let lines = rig.call("oct/ledger", "ledger/figures", Value::Null);
        let of = |key: &str| as_number(&lines[key]);
        let empty = as_number(&end["of"]) - as_number(&end["columns"]);
        // One that was given up has far fewer.
        if empty > FEW && given_up < TRIES {
            given_up += 1.0;
            continue;
        }
        let (rms_m, max_m, tracker_m) = (of("scan_rms"), of("scan_max"), of("tracker_rms"));
        let (untold, late_ns) = (of("columns_missing"), witness.late_ns());
        return Seen { rms_m, max_m, tracker_m, delay_ns, empty, untold, given_up, late_ns };
    }
}
