//! One fault at one moment, and everything that must follow from it on the side that lives on.
//!
//! Invariant: times come from the clocks of those who were there (books, samples), not from when they were
//! asked; only what the GCM lists is timed by asking.

use std::time::Duration;

use rustix::process::Signal;
use serde_json::{Value, json};
use trocar_proto::v1::{Health, ProcessState};

use crate::book::{Book, Timed};
use crate::clock::{Since, Watchdog, Witness, eventually, now_ns, pause_ms};
use crate::json::number;
use crate::program::signal_to;
use crate::rig::{MAX_AGE, PERIOD, Rig, mark_by};
use crate::rpc::Rpc;

/// What is done to a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// `kill -9`.
    Kill,
    /// `abort` in a command.
    Abort,
    /// `exit` in a command.
    Exit,
    /// Stands still for a while, and goes on.
    Pause,
}

impl Fault {
    pub(crate) const ALL: [Fault; 4] = [Fault::Kill, Fault::Pause, Fault::Exit, Fault::Abort];
}

/// Longest until data flows again, ms.
const FLOWS: f64 = 1000.0;
/// Distance of two signs of life to the GCM, the longest anything here goes by, µs: a moment may be anywhere
/// in it.
const BEAT_US: u64 = 100_000;
/// Lines of what was printed that are shown beside a moment which took too long.
const TELLS: usize = 25;
/// Shortest and longest time a process stands still, ms.
const STANDS: (u64, u64) = (150, 800);
/// Longest until an actuator is made safe by the host when its peer stands still, ms: three heartbeats of 10
/// ms, one that has just come, and a look of the watchdog. The actuator itself sees its stale input before.
const STILL: f64 = 30.0 + 10.0 + PERIOD;

/// Longest until an actuator sees that its input is stale, ms: its next step.
const STALE: f64 = MAX_AGE as f64 + PERIOD;

/// Everything one end has of the other: what flows, who takes it, the command that has it count anew, its
/// books.
const STREAMS: [(&str, &str, &str, &str); 4] = [
    ("samples", "sink", "ctl/mark", "books"),
    ("frames", "screen", "ctl/mark", "books"),
    ("answers to calls", "caller", "run/mark", "answers"),
    ("events", "caller", "run/mark", "events"),
];

/// What was seen at all moments together.
#[derive(Default)]
pub(crate) struct Seen {
    safe: Vec<Timed>,
    /// As `safe`, of processes that stand still and close no socket.
    safe_of_still: Vec<Timed>,
    stale: Vec<Timed>,
    /// Moments in which it stepped with an input that old, and did not see it.
    never_stale: u64,
    told_ended: Vec<Timed>,
    told_stopped: Vec<Timed>,
    /// Of each stream, at both ends.
    flowing: [Vec<Timed>; STREAMS.len()],
    blocked: Vec<Timed>,
    overtime: Vec<Timed>,
    bystander: Vec<Timed>,
    /// Moments after which data came that was made before the process stood still.
    old: u64,
    /// Samples for which a bystander's queue had no room, at most.
    missed: u64,
    /// Numbers of the books that must stay 0: what, and the most of it.
    wrong: Vec<(&'static str, u64)>,
    moments: usize,
}

/// A rig under faults.
pub(crate) struct Trial<'a> {
    rig: &'a Rig,
    witness: Witness,
    /// Lateness of the run without faults, ms.
    control_ms: f64,
    seen: Seen,
}

impl<'a> Trial<'a> {
    /// Looks at the rig for a while without doing anything.
    pub(crate) fn begin(rig: &'a Rig, control_ms: u64) -> Result<Trial<'a>, String> {
        let witness = Witness::start();
        pause_ms(500);
        witness.forget();
        let sinks = ["a/sink", "b/sink", "d/sink"];
        for sink in sinks {
            rig.mark(sink)?;
        }
        pause_ms(control_ms);
        let mut late = witness.late_ms();
        for sink in sinks {
            late = late.max(rig.book(sink, "silence")? as f64 / 1e6 - PERIOD);
        }
        Ok(Trial { rig, witness, control_ms: late, seen: Seen::default() })
    }

    /// One fault; everything is as it was when this answers.
    pub(crate) fn moment(
        &mut self,
        fault: Fault,
        victim: &str,
        random: &mut fastrand::Rng,
    ) -> Result<(), String> {
        let other = if victim == "a" { "b" } else { "a" };
        let went = self.at(fault, victim, other, random);
        went.map_err(|why| format!("moment {} ({fault:?} of {victim}): {why}", self.seen.moments))?;
        self.seen.moments += 1;
        Ok(())
    }

    fn at(
        &mut self,
        fault: Fault,
        victim: &str,
        other: &str,
        random: &mut fastrand::Rng,
    ) -> Result<(), String> {
        let rig = self.rig;
        // Before anything is marked: what stands still when it is marked is silent from before.
        self.witness.begins(Since::Moment);
        let before = rig.process(victim)?;
        let pid = before.pid;
        // The port of the side that lives on answers whatever else happens.
        let alive = rig.own_port(other)?;
        let harmed = rig.own_port(victim)?;
        rig.mark("d/sink")?;
        for worst in ["source/ctl", "camera/ctl", "arm/ctl", "caller/run"] {
            alive.settle(&format!("{other}/{worst}/forget"), &Value::Null)?;
        }
        std::thread::sleep(Duration::from_micros(random.u64(0..BEAT_US)));
        self.witness.forget();
        let began = now_ns();
        self.strike(fault, victim, pid)?;
        let told = self.told(victim, pid)?;
        let told = self.witness.timed(began, told, self.control_ms);
        let safe = rig.await_safed(other, began)?;
        let safe = self.witness.timed(began, safe, self.control_ms);
        let until = if fault == Fault::Pause { &mut self.seen.safe_of_still } else { &mut self.seen.safe };
        until.push(safe);
        // Only one that was not made safe before that steps long enough to see it.
        let stale = number(&alive.row(&format!("{other}/arm"))?["stale_ns"]);
        if stale >= began {
            self.seen.stale.push(self.witness.timed(began, stale, self.control_ms));
        } else if safe.ms > STALE + safe.late_ms {
            self.seen.never_stale += 1;
        }
        if fault == Fault::Pause {
            self.seen.told_stopped.push(told);
            self.goes_on(pid, began, (other, &alive), (victim, &harmed), random)?;
        } else {
            self.seen.told_ended.push(told);
            self.flows_again((other, &alive), "first_ns", began)?;
            rig.await_back(victim, pid)?;
            self.flows_again((victim, &rig.own_port(victim)?), "first_ns", began)?;
        }
        let late_ms = self.witness.late_since(Since::Moment).max(self.control_ms);
        let ms = rig.book("d/sink", "silence")? as f64 / 1e6;
        self.seen.bystander.push(Timed { ms, late_ms });
        self.mend(fault)?;
        self.look(other, &alive)?;
        let epoch = rig.process(victim)?.epoch;
        // Whoever only stood still is the same incarnation.
        let right = if fault == Fault::Pause { epoch == before.epoch } else { epoch > before.epoch };
        if right { Ok(()) } else { Err(format!("its epoch was {} and is {epoch} (G2)", before.epoch)) }
    }

    fn strike(&self, fault: Fault, victim: &str, pid: u32) -> Result<(), String> {
        let end = |how: u64| {
            // Its answer is its end.
            let _ = self.rig.rpc.send(&format!("{victim}/server/ctl/end"), &json!(how));
            Ok(())
        };
        match fault {
            Fault::Kill => signal_to(pid, Signal::KILL),
            Fault::Pause => signal_to(pid, Signal::STOP),
            Fault::Abort => end(0),
            Fault::Exit => end(1),
        }
    }

    /// When the GCM lists it as lost.
    fn told(&self, victim: &str, pid: u32) -> Result<u64, String> {
        // Asked every millisecond: what lies between two questions is not the GCM's.
        let mut watchdog = Watchdog::of("the GCM notices");
        loop {
            let process = self.rig.process(victim)?;
            if process.state() != ProcessState::Attached || process.pid != pid {
                return Ok(now_ns());
            }
            watchdog.sees("it is attached".to_owned())?;
            pause_ms(1);
        }
    }

    /// Lets it stand a while longer; then all flows again at both ends, and the one that lived on is given
    /// nothing from before.
    fn goes_on(
        &mut self,
        pid: u32,
        stopped: u64,
        alive: (&str, &Rpc),
        harmed: (&str, &Rpc),
        random: &mut fastrand::Rng,
    ) -> Result<(), String> {
        pause_ms(random.u64(STANDS.0..STANDS.1));
        for (_, taker, mark, _) in STREAMS {
            mark_by(alive.1, &format!("{}/{taker}/{mark}", alive.0), now_ns())?;
        }
        self.witness.forget();
        let at = now_ns();
        signal_to(pid, Signal::CONT)?;
        for (_, taker, mark, _) in STREAMS {
            mark_by(harmed.1, &format!("{}/{taker}/{mark}", harmed.0), at)?;
        }
        let oldest = self.flows_again(alive, "after_mark_ns", at)?;
        // Whatever it had sent before is older than it has stood still.
        self.seen.old += u64::from(oldest >= at - stopped);
        self.flows_again(harmed, "after_mark_ns", at)?;
        Ok(())
    }

    /// Waits until one end has been given everything again after a moment, by the time its books have under
    /// that name; answers the age of the oldest it was given since it was marked, ns.
    fn flows_again(&mut self, (end, port): (&str, &Rpc), first: &str, after: u64) -> Result<u64, String> {
        let mut oldest = 0;
        for (at, (what, taker, _, key)) in STREAMS.into_iter().enumerate() {
            let books: Value = eventually(&format!("{what} at {end} again"), || {
                let books = port.row(&format!("{end}/{taker}"))?[key].take();
                if number(&books[first]) > after {
                    Ok(books)
                } else {
                    Err(format!("{first} {}", books[first]))
                }
            })?;
            oldest = oldest.max(number(&books["age"]));
            let flows = self.witness.timed(after, number(&books[first]), self.control_ms);
            if flows.ms > FLOWS + flows.late_ms {
                let moment = self.seen.moments;
                eprintln!("  moment {moment}: {what} at {end} again after {:.0} ms", flows.ms);
                let printed = self.rig.up.printed();
                let lines: Vec<&str> = printed.lines().collect();
                lines.iter().skip(lines.len().saturating_sub(TELLS)).for_each(|line| eprintln!("    {line}"));
            }
            self.seen.flowing[at].push(flows);
        }
        Ok(oldest)
    }

    /// What those who lived on say of it.
    fn look(&mut self, other: &str, alive: &Rpc) -> Result<(), String> {
        let late_ms = self.witness.late_since(Since::Moment).max(self.control_ms);
        let ms = |row: &Value, what: &str| Timed { ms: number(&row[what]) as f64 / 1e6, late_ms };
        let row = |name: &str| alive.row(&format!("{other}/{name}"));
        for writer in ["source", "camera", "arm"] {
            self.seen.blocked.push(ms(&row(writer)?, "slowest"));
        }
        let caller = row("caller")?;
        self.seen.overtime.push(ms(&caller, "overtime"));
        let bystander = self.rig.books("d/sink")?;
        self.seen.missed = self.seen.missed.max(number(&bystander["gaps"]));
        let mut wrong = vec![("answers to another call", number(&caller["wrong"]))];
        for (_, taker, _, key) in STREAMS {
            let books = row(taker)?[key].take();
            for (what, key) in [
                ("data of a former instance", "old"),
                ("data twice or too late", "disorder"),
                ("sequence numbers that are not the data's", "seq_wrong"),
                ("frames that were changed under way", "torn"),
            ] {
                wrong.push((what, number(&books[key])));
            }
        }
        let arm = row("arm")?;
        wrong.push(("frames there was no memory for", number(&row("camera")?["exhausted"])));
        wrong.push(("set points too old and not said to be (G8)", number(&arm["followed_stale"])));
        wrong.push(("set points of a former instance (G8)", number(&arm["followed_old"])));
        wrong.push(("commands carried out twice", number(&row("server")?["twice"])));
        for (what, seen) in wrong {
            match self.seen.wrong.iter_mut().find(|(known, _)| *known == what) {
                Some((_, most)) => *most = seen.max(*most),
                None => self.seen.wrong.push((what, seen)),
            }
        }
        Ok(())
    }

    /// Lets both arms go on, and waits until all is well.
    fn mend(&self, fault: Fault) -> Result<(), String> {
        // Whoever stood still learns only now that it was given up.
        let looks = if fault == Fault::Pause { 20 } else { 1 };
        for _ in 0..looks {
            for process in ["a", "b"] {
                self.rig.resume_arm(process)?;
            }
            pause_ms(5);
        }
        eventually("everything is healthy", || {
            let list = self.rig.list()?;
            let ill = list.components.iter().find(|c| !matches!(c.health(), Health::Ok | Health::Overrun));
            ill.map_or(Ok(()), |c| Err(format!("{} is {:?}", c.path, c.health())))
        })
    }

    /// All claims.
    pub(crate) fn tell(self, book: &mut Book) {
        let Seen { safe, safe_of_still, stale, told_ended, told_stopped, flowing, .. } = &self.seen;
        let Seen { blocked, overtime, bystander, .. } = &self.seen;
        let n = self.seen.moments;
        if !safe.is_empty() {
            book.times("the actuator is safe", safe, STALE);
        }
        // A process that ends is often noticed before that; one that stands still is not, so there it must
        // have been seen.
        if !stale.is_empty() || !safe_of_still.is_empty() {
            book.times("the actuator sees that its input is stale", stale, STALE);
        }
        let what = "actuators that went on with an old input and did not see it";
        book.at_most_in_time(what, n, self.seen.never_stale, 0);
        if !safe_of_still.is_empty() {
            book.times("the actuator of a process that stands still is made safe", safe_of_still, STILL);
        }
        if !told_ended.is_empty() {
            book.times("the GCM lists it as gone", told_ended, 100.0);
        }
        if !told_stopped.is_empty() {
            book.times("the GCM lists it as lost", told_stopped, 600.0);
            let what = "data from before it stood still, taken after it went on";
            book.at_most(what, told_stopped.len(), self.seen.old, 0);
        }
        for ((what, ..), flowing) in STREAMS.into_iter().zip(flowing) {
            book.times(&format!("{what} flow again at both ends"), flowing, FLOWS);
        }
        book.times("longest write of a survivor: nobody is blocked", blocked, 5.0);
        book.times("calls beyond their deadline", overtime, 50.0);
        book.times("longest silence of a bystander's 1 kHz (G4)", bystander, 5.0);
        book.at_most_in_time("samples a bystander missed (G4)", n, self.seen.missed, 0);
        for (what, seen) in &self.seen.wrong {
            book.at_most(what, n, *seen, 0);
        }
    }
}
