//! Rows about the GCM: killed and stopped while data flows between processes, started late.
//!
//! Invariant: what flows is asked of the processes' own ports, so a GCM that is away hides nothing.

use std::collections::BTreeMap;

use rustix::process::Signal;
use serde_json::Value;
use trocar_proto::v1::ProcessState;

use crate::book::{Book, Timed};
use crate::clock::{Since, Witness, eventually, now_ns, pause_ms};
use crate::invariants::{Desired, Holdings, agree, nothing_is_left};
use crate::json::number;
use crate::procfs;
use crate::program::{Program, host_args, signal_to};
use crate::rig::{Load, Rig, mark_at};
use crate::rpc::Rpc;
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[
    Row { name: "5", fault: "the GCM is killed under traffic", when: When::Gate, run: killed },
    Row { name: "7", fault: "the GCM stands still and goes on", when: When::Gate, run: stopped },
    Row { name: "9", fault: "the GCM comes last, and is away", when: When::Gate, run: late },
];

const LOAD: Load = Load { rate_hz: 1000, frames_hz: 60, holds_ms: 0, fast_hz: 4000, bystanders: false };
/// How often each sink is given something, Hz.
const SINKS: [(&str, f64); 3] = [("sink", 1000.0), ("fast_sink", 4000.0), ("screen", 60.0)];
/// Beyond the control run a sample may be so late, ms: the witness wakes once a millisecond and overlooks as
/// much of any stall.
const BEYOND_MS: f64 = 1.0;

/// What flowed in a while.
#[derive(Default)]
struct Flow {
    taken: u64,
    /// What a queue had no room for, which a machine that is wanted by others does, too.
    missed: u64,
    /// Faults that nothing excuses: twice, torn, of somebody else.
    wrong: u64,
    /// For each sink the age of the oldest sample, or the longest time without one beyond its period, ms.
    late_ms: BTreeMap<&'static str, f64>,
}

/// What came of calls in a while: answered, of each caller; of both, those that were late, and those that
/// ended in another way.
#[derive(Default)]
struct Calls {
    answered: [u64; 2],
    late: u64,
    failed: u64,
}

/// The counts of a caller: calls that were answered, and calls that were not within their deadline.
const ANSWERED: usize = 0;
const LATE: usize = 2;

/// Both ends by their own ports.
struct Ends {
    ports: [(&'static str, Rpc); 2],
}

impl Ends {
    fn of(rig: &Rig) -> Result<Ends, String> {
        Ok(Ends { ports: [("a", rig.own_port("a")?), ("b", rig.own_port("b")?)] })
    }

    fn books(&self) -> Result<Vec<(&'static str, f64, Value)>, String> {
        let mut all = Vec::new();
        for (process, port) in &self.ports {
            for (sink, rate_hz) in SINKS {
                let books = port.row(&format!("{process}/{sink}"))?["books"].take();
                all.push((sink, 1000.0 / rate_hz, books));
            }
        }
        Ok(all)
    }

    /// What flows while something is done.
    fn flow(&self, during: impl FnOnce() -> Result<(), String>) -> Result<Flow, String> {
        for (process, port) in &self.ports {
            for (sink, _) in SINKS {
                mark_at(port, &format!("{process}/{sink}"), now_ns())?;
            }
        }
        let before = self.books()?;
        during()?;
        let mut flow = Flow::default();
        for ((sink, period_ms, after), (_, _, before)) in self.books()?.into_iter().zip(before) {
            let more = |key: &str| number(&after[key]).saturating_sub(number(&before[key]));
            flow.taken += more("taken");
            flow.missed += more("gaps");
            flow.wrong += more("disorder") + more("old") + more("instances") + more("torn");
            let ms = |key: &str| number(&after[key]) as f64 / 1e6;
            let worst = flow.late_ms.entry(sink).or_default();
            *worst = worst.max(ms("age")).max(ms("silence") - period_ms);
        }
        Ok(flow)
    }

    /// What came of calls since some moment.
    fn calls(&self, since: &Calls) -> Result<Calls, String> {
        let mut calls = Calls::default();
        for (at, (process, port)) in self.ports.iter().enumerate() {
            let row = port.row(&format!("{process}/caller"))?;
            let outcomes = row["outcomes"].as_array().cloned().unwrap_or_default();
            let of = |place: usize| outcomes.get(place).map_or(0, number);
            calls.answered[at] = of(ANSWERED) - since.answered[at];
            calls.late += of(LATE);
            let all = outcomes.iter().map(number).sum::<u64>();
            calls.failed += all - of(ANSWERED) - of(LATE) + number(&row["wrong"]);
        }
        (calls.late, calls.failed) = (calls.late - since.late, calls.failed - since.failed);
        Ok(calls)
    }
}

/// Waits until every process is attached to a GCM, other than this one if it is named, and answers when.
fn await_all(rig: &Rig, not: Option<u32>) -> Result<u64, String> {
    eventually("a GCM has everybody", || {
        let list = rig.list()?;
        let attached = list.processes.iter().filter(|p| p.state() == ProcessState::Attached).count();
        if attached == 2 && Some(rig.gcm_pid()?) != not {
            Ok(now_ns())
        } else {
            Err(format!("{:?}", list.processes))
        }
    })
}

fn killed(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let rounds: Vec<u64> = (0..run.times(3, 20)).map(|_| random.u64(0..400)).collect();
    let mut back = Vec::new();
    away(run, book, &rounds, |rig, after_ms, witness| {
        pause_ms(after_ms);
        let gcm = rig.gcm_pid()?;
        witness.forget();
        let began = now_ns();
        signal_to(gcm, Signal::KILL)?;
        back.push(witness.timed(began, await_all(rig, Some(gcm))?, 0.0));
        pause_ms(300);
        Ok(())
    })?;
    book.times("everybody is attached again", &back, 1000.0);
    Ok(())
}

fn stopped(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut back = Vec::new();
    away(run, book, &[run.times(2_000, 10_000)], |rig, still_ms, witness| {
        let gcm = rig.gcm_pid()?;
        signal_to(gcm, Signal::STOP)?;
        pause_ms(still_ms);
        witness.forget();
        let began = now_ns();
        signal_to(gcm, Signal::CONT)?;
        // It may take everybody for attached until it looks; that they are is looked at again in the end.
        back.push(witness.timed(began, await_all(rig, None)?, 0.0));
        pause_ms(500);
        Ok(())
    })?;
    book.times("it answers with everybody attached", &back, 1000.0);
    Ok(())
}

/// Harms the GCM in several rounds while data flows, and holds what flowed against a run without harm.
fn away(
    run: &Run,
    book: &mut Book,
    rounds: &[u64],
    mut harm: impl FnMut(&Rig, u64, &Witness) -> Result<(), String>,
) -> Result<(), String> {
    let mut rig = Rig::up(LOAD)?;
    let (ends, witness) = (Ends::of(&rig)?, Witness::start());
    pause_ms(500);
    let desired = Desired::now(&rig.rpc)?;
    let before = (rig.process("a")?, rig.process("b")?);
    let control = ends.flow(|| {
        pause_ms(run.times(2_000, 20_000));
        Ok(())
    })?;
    let calls_before = ends.calls(&Calls::default())?;
    // Now this program's own connections are among what they hold.
    let held = Holdings::of(&[("a", before.0.pid), ("b", before.1.pid), ("up", rig.up.pid())]);
    let (mut missed, mut wrong, mut taken, mut went) = (0, 0, 0, Ok(()));
    // Answered in the round, by the caller, with the fewest.
    let mut answered = u64::MAX;
    let mut late: BTreeMap<&'static str, Vec<Timed>> = BTreeMap::new();
    for round in rounds {
        witness.begins(Since::Moment);
        let calls = ends.calls(&Calls::default())?;
        match ends.flow(|| harm(&rig, *round, &witness)) {
            Ok(flow) => {
                (missed, wrong, taken) = (missed + flow.missed, wrong + flow.wrong, taken + flow.taken);
                answered = ends.calls(&calls)?.answered.into_iter().fold(answered, u64::min);
                for (sink, _) in SINKS {
                    // Lateness of the machine itself in these very seconds, or all of it in the control run.
                    let late_ms = control.late_ms[sink].max(witness.late_since(Since::Moment));
                    late.entry(sink).or_default().push(Timed { ms: flow.late_ms[sink], late_ms });
                }
            }
            Err(why) => {
                went = Err(why);
                break;
            }
        }
    }
    let n = rounds.len();
    let went_well = went.is_ok();
    book.check("the system goes on", n, went);
    book.at_most_in_time(&format!("of {taken} samples and frames: missed"), n, missed, 0);
    book.at_most(&format!("of {taken} samples and frames: twice, torn or of somebody else"), n, wrong, 0);
    for (sink, rate_hz) in SINKS {
        let seen = late.get(sink).map_or(&[][..], Vec::as_slice);
        book.times(&format!("latest sample at {rate_hz} Hz"), seen, BEYOND_MS);
    }
    let calls = ends.calls(&calls_before)?;
    let all = calls.answered.iter().sum::<u64>() + calls.late + calls.failed;
    book.at_most_in_time(&format!("of {all} calls: not answered within their deadline"), n, calls.late, 0);
    book.at_most(&format!("of {all} calls: refused, or with a wrong answer"), n, calls.failed, 0);
    if went_well {
        book.at_least(
            "calls with their answer, in the round and of the caller with the fewest",
            n,
            answered,
            1,
        );
    }
    book.check("desired, observed and actual agree (G3)", 1, agree(&rig.rpc, &desired));
    let after = (rig.process("a")?, rig.process("b")?);
    let other = [(&before.0, &after.0), (&before.1, &after.1)].into_iter().find(|(before, after)| {
        before.pid != after.pid || before.epoch != after.epoch || after.restarts != 0
    });
    let same = other.map_or(Ok(()), |(before, after)| Err(format!("{before:?} became {after:?}")));
    book.check("nothing was restarted, epochs are as they were (G2)", n, same);
    book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// A host waits for a GCM that is not there yet; later the GCM is away, and it can be stopped all the same,
/// which the next GCM learns.
fn late(run: &Run, book: &mut Book) -> Result<(), String> {
    let world = World::new(&["fixture_torture"])?;
    // A port that is free now and will most likely be a moment later.
    let mut first = Program::gcm(&world)?;
    let address = first.address.clone();
    first.terminate()?;
    let mut args = host_args(&world, "b", "b", Some(&address));
    args.push("--tied".into());
    let mut host = Program::begin(&world, "b", &args, true)?;
    let late_ms = run.times(2_000, 60_000);
    let busy = procfs::cpu_ms(host.pid());
    pause_ms(late_ms);
    if let Some(status) = host.ended() {
        return Err(format!("it did not wait: {status}: {}", host.printed()));
    }
    let spent = (procfs::cpu_ms(host.pid()) - busy) as f64 / late_ms as f64 * 100.0;
    book.beside("processor time while it waits", 1, spent, 0.0, 20.0, "%");
    let mut gcm = Program::gcm_at(&world, &address)?;
    let mut times = vec![await_attached(&gcm)?];
    host.await_address()?;
    let rpc = Rpc::at(&gcm.address);
    eventually("its classes are offered", || {
        Ok(rpc.create("b/source", "fixture-torture/source", Value::Null)?)
    })?;
    rpc.start("b/source")?;
    gcm.kill();
    let own = Rpc::at(&host.address);
    let steps = || Ok::<u64, String>(number(&own.row("b/source")?["sent"]));
    let before = steps()?;
    let moved = eventually("it steps", || match steps()? {
        now if now > before => Ok(()),
        now => Err(format!("{now} steps")),
    });
    book.check("it goes on without a GCM", 1, moved);
    let mut stop = Program::begin(&world, "stop", &["stop".to_owned(), "--all".to_owned()], false)?;
    let stopped = stop.await_end().and_then(|status| {
        if !status.success() {
            return Err(format!("{status}: {}", stop.printed()));
        }
        let before = steps()?;
        pause_ms(100);
        if steps()? == before { Ok(()) } else { Err("it still steps".into()) }
    });
    book.check("`trocar stop --all` works without a GCM", 1, stopped);
    let mut gcm = Program::gcm_at(&world, &address)?;
    times.push(await_attached(&gcm)?);
    let state = eventually("b/source is STOPPED", || match rpc.state("b/source")? {
        state if state == "STOPPED" => Ok(()),
        state => Err(state),
    });
    book.check("the next GCM knows that it is stopped", 1, state);
    book.times("attached after the GCM is there", &times, 1500.0);
    host.untie();
    host.await_end()?;
    gcm.terminate()?;
    nothing_is_left(book, &world);
    Ok(())
}

/// How long after a GCM answers its one host is attached.
fn await_attached(gcm: &Program) -> Result<Timed, String> {
    let (rpc, began) = (Rpc::at(&gcm.address), now_ns());
    let at = eventually("the host is attached", || {
        let list = rpc.brief()?;
        let there = list.processes.iter().any(|p| p.name == "b" && p.state() == ProcessState::Attached);
        if there { Ok(now_ns()) } else { Err("it is not listed".into()) }
    })?;
    Ok(Timed { ms: at.saturating_sub(began) as f64 / 1e6, late_ms: 0.0 })
}
