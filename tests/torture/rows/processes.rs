//! Rows about processes: killed, stopped, ended at any moment.
//!
//! Invariant: after its faults a row looks at what is held and what is left, as it was before them.

use std::collections::BTreeMap;

use crate::book::{Book, Timed};
use crate::bystander::Bystander;
use crate::churn::{Churn, Churned};
use crate::clock::eventually;
use crate::invariants::{Desired, agree, nothing_is_left};
use crate::moments::{Fault, Trial};
use crate::procfs::{self, Held};
use crate::rig::{Load, Rig};
use crate::run::{Row, Run, When};

use super::crashes::heavy;

pub(crate) const ROWS: &[Row] = &[
    Row { name: "1", fault: "a host is killed", when: When::Full, run: killed },
    Row { name: "3", fault: "a host stands still and goes on", when: When::Full, run: stopped },
    Row {
        name: "moments",
        fault: "either end killed, stopped, exited, aborted",
        when: When::Gate,
        run: moments,
    },
];

const LOAD: Load = Load { rate_hz: 1000, frames_hz: 60, holds_ms: 5, fast_hz: 0, bystanders: true };

fn killed(run: &Run, book: &mut Book) -> Result<(), String> {
    faults(run, book, run.times(5, 200), &[Fault::Kill], &["b"])?;
    heavy(book, run.times(1, 10))
}

fn stopped(run: &Run, book: &mut Book) -> Result<(), String> {
    faults(run, book, run.times(5, 50), &[Fault::Pause], &["b"])
}

fn moments(run: &Run, book: &mut Book) -> Result<(), String> {
    faults(run, book, run.times(20, 300), &Fault::ALL, &["a", "b"])
}

/// So many moments, the faults in turn, the ends in turn; then nothing has grown, and nothing is left.
fn faults(run: &Run, book: &mut Book, times: u64, faults: &[Fault], victims: &[&str]) -> Result<(), String> {
    let mut random = run.random(book);
    let mut rig = Rig::up(LOAD)?;
    let bystander = Bystander::start(&rig.world, &rig.rpc, "d/late")?;
    let desired = Desired::now(&rig.rpc)?;
    let mut trial = Trial::begin(&rig, run.times(1_000, 10_000))?;
    // While all that goes on, somebody connects and disconnects both ends.
    let spare = [("a/spare/value", "b/source/value"), ("b/spare/value", "a/source/value")];
    // Threads and files that come with the first loss of a peer stay.
    let first = if times as usize > faults.len() * victims.len() { faults.len() * victims.len() } else { 1 };
    let (mut held, mut churned, mut went) = (None, Churned::default(), Ok(()));
    for moments in [0..first, first..times as usize] {
        let churn = Churn::begin(&rig.rpc, &spare);
        for moment in moments {
            let fault = faults[moment % faults.len()];
            let victim = victims[moment / faults.len() % victims.len()];
            went = trial.moment(fault, victim, &mut random);
            if went.is_err() {
                break;
            }
        }
        let clean = churn.end().map(|more| churned.add(more));
        if clean.is_err() {
            book.check("connections made meanwhile are taken away", 1, clean);
            went = went.and(Err("connections stayed that were made meanwhile".into()));
        }
        if went.is_err() {
            break;
        }
        if held.is_none() {
            agree(&rig.rpc, &desired)?;
            held = Some(holdings(&rig)?);
        }
    }
    trial.tell(book);
    bystander.tell(book)?;
    let slowest = Timed { ms: churned.longest_ms, late_ms: 0.0 };
    let counts = format!("({} done, {} refused)", churned.made, churned.refused);
    book.times(&format!("Connect and Disconnect meanwhile {counts}"), &[slowest], 5_000.0);
    book.at_least("Connect and Disconnect that were done meanwhile", times as usize, churned.made as u64, 1);
    book.check("everything comes back", times as usize, went);
    book.check("desired, observed and actual agree (G3)", 1, agree(&rig.rpc, &desired));
    if let Some(held) = held {
        let grown = eventually("nothing more is held", || not_more(&held, &holdings(&rig)?));
        book.check("no file, thread, socket, segment more (G5)", 1, grown);
    }
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// What each process of the rig holds now, whichever incarnation.
fn holdings(rig: &Rig) -> Result<BTreeMap<String, Held>, String> {
    let mut all = rig.pids()?;
    all.insert("up".into(), rig.up.pid());
    Ok(all.into_iter().map(|(name, pid)| (name, procfs::held(pid))).collect())
}

fn not_more(before: &BTreeMap<String, Held>, now: &BTreeMap<String, Held>) -> Result<(), String> {
    for (name, now) in now {
        let before = before.get(name).ok_or_else(|| format!("{name} is new"))?;
        if let Some(more) = now.beyond(before) {
            return Err(format!("{name} holds {more}"));
        }
    }
    Ok(())
}
