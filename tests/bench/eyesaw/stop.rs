//! `kill -9` in the middle of a scan: of the process that controls the robot, and of the one that measures.
//!
//! Invariant: when the robot holds and where it stands is told by an account in its own process, of each of
//! its cycles; the moment is read from the same clock right before the signal.

use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use super::control::Witness;
use super::plan::Plan;
use super::rig::{Rig, world};
use super::verdicts::{Unit, Verdicts, largest, smallest};
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

/// Between the signal and the look at how late the machine was: the robot holds by then.
const LOOKS: Duration = Duration::from_millis(30);

/// What followed one kill.
struct Seen {
    held_ns: f64,
    still_ns: f64,
    moved_m: f64,
    speed_m_s: f64,
    nearest_m: f64,
    /// By how much the machine was late meanwhile.
    late_ns: f64,
}

impl Seen {
    /// Further than at the speed of the moment until it must hold and its drive has followed; and what the
    /// machine adds to that.
    fn beyond_m(&self) -> (f64, f64) {
        let way_m = self.speed_m_s * (HELD_NS + LAG_NS) * 1e-9 + STEPS_M;
        ((self.moved_m - way_m).max(0.0), self.speed_m_s * self.late_ns * 1e-9)
    }
}

pub(super) fn measure(verdicts: &mut Verdicts, kills: usize) {
    let rig = Rig::up(world(), Plan::new().without_video().with_accounts());
    let mut random = fastrand::Rng::with_seed(1);
    for (process, kills, what) in [
        ("host", kills, "kill -9 of the controlling process in a scan"),
        ("oct", kills.div_ceil(OF_SOURCE), "kill -9 of the OCT's process in a scan"),
    ] {
        let seen: Vec<Seen> = (0..kills).map(|_| kill(&rig, process, &mut random)).collect();
        tell(verdicts, &format!("{what} (A6), {kills} times"), &seen);
    }
    rig.end();
}

fn kill(rig: &Rig, process: &str, random: &mut fastrand::Rng) -> Seen {
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
    thread::sleep(LOOKS);
    let late_ns = witness.late_ns();
    thread::sleep(SETTLES - LOOKS);
    let rest = rig.call("robot/rest", "ledger/since", json!(moment.to_string()));
    rig.await_back(process, pid);
    // What is not a number never came.
    let of = |key: &str| Some(as_number(&rest[key])).filter(|n| !n.is_nan()).unwrap_or(f64::INFINITY);
    Seen {
        held_ns: of("held"),
        still_ns: of("still"),
        moved_m: of("moved"),
        speed_m_s: of("speed"),
        nearest_m: of("nearest"),
        late_ns,
    }
}

fn tell(verdicts: &mut Verdicts, title: &str, seen: &[Seen]) {
    verdicts.title(title);
    let all = |of: fn(&Seen) -> f64| seen.iter().map(of).collect::<Vec<f64>>();
    let most = |of: fn(&Seen) -> f64| largest(all(of).into_iter());
    // Each beside how late the machine was at that moment; the one that is furthest beyond it decides.
    let furthest = |of: fn(&Seen) -> (f64, f64)| {
        let pairs = seen.iter().map(of);
        pairs.max_by(|a, b| (a.0 - a.1).total_cmp(&(b.0 - b.1))).unwrap_or((f64::INFINITY, 0.0))
    };
    let (held_ns, late_ns) = furthest(|seen| (seen.held_ns, seen.late_ns));
    let what = "until the robot holds: its set point stands or only leads out of the eye (the kill furthest beyond the machine's lateness)";
    verdicts.at_most(what, held_ns, HELD_NS, late_ns, Unit::Ns);
    verdicts.tell("the same, longest", most(|seen| seen.held_ns), Some(most(|seen| seen.late_ns)), Unit::Ns);
    verdicts.tell("the same, median", median(all(|seen| seen.held_ns)), None, Unit::Ns);
    let what = "until its tip stays within 2 µm of where it ends, longest";
    verdicts.tell(what, most(|seen| seen.still_ns), None, Unit::Ns);
    verdicts.tell("the same, median", median(all(|seen| seen.still_ns)), None, Unit::Ns);
    let what = "tip's speed at that moment, highest (in a second)";
    verdicts.tell(what, most(|seen| seen.speed_m_s), None, Unit::Micrometre);
    verdicts.tell(
        "way of the tip from that moment on, across or into the eye, longest",
        most(|seen| seen.moved_m),
        None,
        Unit::Micrometre,
    );
    verdicts.tell("the same, median", median(all(|seen| seen.moved_m)), None, Unit::Micrometre);
    let (beyond_m, late_m) = furthest(Seen::beyond_m);
    let what = "of it beyond 30 ms at the speed of that moment and 2 µm";
    verdicts.at_most(what, beyond_m, 0.0, late_m, Unit::Micrometre);
    let nearest_m = smallest(all(|seen| seen.nearest_m).into_iter());
    verdicts.at_least("nearest that the tip was to the surface", nearest_m, NEAREST_M, Unit::Micrometre);
}
