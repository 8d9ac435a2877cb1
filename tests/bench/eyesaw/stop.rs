//! `kill -9` in the middle of a scan: of the process that controls the robot, and of the one that measures.
//!
//! Invariant: when the robot holds and where it stands is told by an account in its own process, of each of its cycles; the moment is
//! read from the same clock right before the signal.

use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use super::control::Witness;
use super::plan::Plan;
use super::rig::{Rig, world};
use super::verdicts::{Unit, Verdicts};
use crate::baseline::now_ns;
use crate::lab::as_number;
use crate::table::median;

/// The robot holds.
const HELD_NS: f64 = 20e6;
/// Behind its set point the tip is late by the lag of the drive, 8 ms, and two periods.
const LAG_NS: f64 = 10e6;
/// What the tip may go beside that: steps of the encoders.
const STEPS_M: f64 = 2e-6;
const NEAREST_M: f64 = 150e-6;
const LINE_M: f64 = 0.002;
const SPEED_M_S: f64 = 0.0005;
/// From the signal until all is looked at.
const SETTLES: Duration = Duration::from_millis(400);
/// The process that measures is killed once for so many times the one that controls is.
const OF_SOURCE: usize = 5;

#[derive(Default)]
struct Seen {
    held_ns: Vec<f64>,
    still_ns: Vec<f64>,
    moved_m: Vec<f64>,
    speed_m_s: Vec<f64>,
    nearest_m: Vec<f64>,
    /// Furthest beyond the way at the speed of the moment, and what the machine's lateness adds to that way.
    beyond_m: f64,
    late_m: f64,
    late_ns: f64,
}

pub(super) fn measure(verdicts: &mut Verdicts, kills: usize) {
    let rig = Rig::up(world(), Plan::new().without_video().with_accounts());
    let mut random = fastrand::Rng::with_seed(1);
    for (process, kills, what) in [
        ("host", kills, "kill -9 of the controlling process in a scan"),
        ("oct", kills.div_ceil(OF_SOURCE), "kill -9 of the OCT's process in a scan"),
    ] {
        let mut seen = Seen::default();
        for _ in 0..kills {
            kill(&rig, process, &mut random, &mut seen);
        }
        tell(verdicts, &format!("{what} (A6), {kills} times"), seen);
    }
    rig.end();
}

fn kill(rig: &Rig, process: &str, random: &mut fastrand::Rng, seen: &mut Seen) {
    rig.scan_of(LINE_M, SPEED_M_S, 5.0);
    let witness = Witness::start();
    thread::sleep(Duration::from_micros(random.u64(0..500_000)));
    rig.call("robot/rest", "ledger/mark", Value::Null);
    let pid = rig.pid(process);
    assert!(pid > 0, "{process} is not there");
    witness.forget();
    let moment = now_ns();
    // SAFETY: a signal to a process that this benchmark's own child started and waits for.
    assert!(unsafe { libc::kill(pid, libc::SIGKILL) } == 0, "{process} could not be killed");
    thread::sleep(SETTLES);
    let late_ns = witness.late_ns();
    seen.late_ns = seen.late_ns.max(late_ns);
    drop(witness);
    let rest = rig.call("robot/rest", "ledger/since", json!(moment.to_string()));
    let of = |key: &str| as_number(&rest[key]);
    seen.held_ns.push(of("held"));
    seen.still_ns.push(of("still"));
    seen.moved_m.push(of("moved"));
    seen.speed_m_s.push(of("speed"));
    seen.nearest_m.push(of("nearest"));
    let way_m = of("speed") * (HELD_NS + LAG_NS) * 1e-9 + STEPS_M;
    seen.beyond_m = seen.beyond_m.max(of("moved") - way_m);
    seen.late_m = seen.late_m.max(of("speed") * late_ns * 1e-9);
    rig.await_back(process, pid);
}

fn tell(verdicts: &mut Verdicts, title: &str, seen: Seen) {
    verdicts.title(title);
    // What is not a number is no maximum: it must not be left out.
    let worst = |all: &[f64]| {
        all.iter().fold(0.0, |most: f64, one| if one.is_nan() { f64::INFINITY } else { most.max(*one) })
    };
    let Seen { held_ns, still_ns, moved_m, speed_m_s, nearest_m, beyond_m, late_m, late_ns } = seen;
    verdicts.at_most(
        "until the robot holds: its set point stands",
        worst(&held_ns),
        HELD_NS,
        late_ns,
        Unit::Ns,
    );
    verdicts.tell("the same, median", median(held_ns), None, Unit::Ns);
    let what = "until its tip stays within 2 µm of where it ends";
    verdicts.tell(what, worst(&still_ns), Some(late_ns), Unit::Ns);
    verdicts.tell("the same, median", median(still_ns), None, Unit::Ns);
    verdicts.tell(
        "tip's speed at that moment, highest (in a second)",
        worst(&speed_m_s),
        None,
        Unit::Micrometre,
    );
    verdicts.tell("way of the tip from that moment on, longest", worst(&moved_m), None, Unit::Micrometre);
    verdicts.tell("the same, median", median(moved_m), None, Unit::Micrometre);
    let what = "of it beyond 30 ms at the speed of that moment and 2 µm";
    verdicts.at_most(what, beyond_m, 0.0, late_m, Unit::Micrometre);
    let nearest_m = nearest_m.into_iter().fold(f64::INFINITY, f64::min);
    verdicts.at_least("nearest that the tip was to the surface", nearest_m, NEAREST_M, Unit::Micrometre);
}
