//! Rows about components that take their whole process along, or eat its memory.

use std::thread;
use std::time::Duration;

use rustix::process::Signal;
use serde_json::{Value, json};
use trocar_proto::v1::{Process, ProcessState};

use crate::book::{Book, Timed};
use crate::clock::{Since, Witness, eventually, now_ns, pause_ms};
use crate::invariants::{Desired, Holdings, agree, nothing_is_left};
use crate::json::number;
use crate::procfs;
use crate::program::{Program, signal_to};
use crate::rig::{Rig, pair};
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[
    Row { name: "24", fault: "a component takes more and more memory", when: When::Gate, run: leaks },
    Row { name: "25", fault: "SEGV, stack overflow, exit, abort in a plugin", when: When::Gate, run: fatal },
    Row { name: "27", fault: "a process dies 10 ms after each start", when: When::Full, run: storm },
];

/// What `doom` does on `strike`, and how its process is said to have ended.
const WAYS: [(u64, &str, &[&str]); 4] = [
    (1, "SIGSEGV", &["SIGSEGV"]),
    // Whoever finds the end of the stack may abort instead of dying of it.
    (2, "stack overflow", &["SIGSEGV", "SIGABRT"]),
    (3, "exit", &["code 3"]),
    (4, "abort", &["SIGABRT"]),
];
const LEAK: u64 = 5;

/// What `b` takes of memory, MiB/s, and its bounds, MiB.
struct Leak {
    mib_s: u64,
    warn_mib: u64,
    limit_mib: u64,
}

/// Nothing is taken, and there is room for anything.
const NO_LEAK: Leak = Leak { mib_s: 1, warn_mib: 1 << 20, limit_mib: 1 << 20 };

/// A pair whose `b` has what ends it.
fn rig(restart: Value, doom: Option<&Leak>) -> Result<Rig, String> {
    let mut system = pair(restart);
    if let Some(leak) = doom {
        let config = json!({ "leak_mib_s": leak.mib_s });
        system["components"]["b/doom"] = json!({ "class": "fixture-chaos/doom", "config": config });
        system["processes"]["b"]["memory"] =
            json!({ "warn_mib": leak.warn_mib, "limit_mib": leak.limit_mib });
    }
    Rig::of(World::new(&["fixture_torture", "fixture_chaos"])?, &system)
}

fn always() -> Value {
    json!({ "max": 1000, "backoff_ms": 50, "most_backoff_ms": 50 })
}

/// What those who live on saw of one end.
#[derive(Default)]
struct Seen {
    told: Vec<Timed>,
    flows: Vec<Timed>,
    near: Vec<Timed>,
}

impl Seen {
    fn tell(&self, book: &mut Book) {
        book.times("the GCM lists it as gone", &self.told, 100.0);
        book.times("samples flow again", &self.flows, 1000.0);
        book.times("longest silence of a bystander's 1 kHz (G4)", &self.near, 5.0);
    }
}

/// One end of `b` from the inside; all is well again when this answers.
fn end(rig: &Rig, witness: &Witness, way: u64, seen: &mut Seen) -> Result<String, String> {
    let (before, own) = (rig.process("b")?, rig.own_port("a")?);
    let instance = number(&own.row("a/sink")?["books"]["instance"]);
    witness.begins(Since::Moment);
    rig.mark("a/near")?;
    witness.forget();
    // It may end before it has said that the command is queued.
    if let Err(refused) = rig.rpc.send("b/doom/ctl/strike", &json!(way))
        && refused.reason != "PEER_LOST"
    {
        return Err(refused.to_string());
    }
    ended(rig, witness, seen, &Before { b: before, instance, killed_ns: None })
}

/// An incarnation of `b` that ends.
struct Before {
    b: Process,
    /// As `a/sink` has it.
    instance: u64,
    /// When it was told to end, ns; `None`: it does so by itself.
    killed_ns: Option<u64>,
}

/// What follows its end.
fn ended(rig: &Rig, witness: &Witness, seen: &mut Seen, before: &Before) -> Result<String, String> {
    let own = rig.own_port("a")?;
    let Before { b: before, instance, killed_ns } = before;
    // Its step comes within a period of 10 ms, and what it does then takes a while.
    let ended = eventually("its process ends", || {
        let runs = || format!("it runs, with {} KiB", procfs::rss_kib(before.pid));
        if procfs::gone(before.pid) { Ok(now_ns()) } else { Err(runs()) }
    })?;
    let ended = killed_ns.unwrap_or(ended);
    let told = eventually("the GCM notices", || {
        let now = rig.process("b")?;
        let noticed = now.state() != ProcessState::Attached || now.pid != before.pid;
        if noticed { Ok(now_ns()) } else { Err("it is attached".into()) }
    })?;
    seen.told.push(witness.timed(ended, told, 0.0));
    let first = eventually("samples of the next incarnation", || {
        let books = own.row("a/sink")?["books"].take();
        let now = number(&books["instance"]);
        if now > *instance { Ok(number(&books["first_ns"])) } else { Err(format!("of {now}")) }
    })?;
    seen.flows.push(witness.timed(ended, first, 0.0));
    let after = rig.await_back("b", before.pid)?;
    let silence_ms = rig.book("a/near", "silence")? as f64 / 1e6;
    let late_ms = witness.late_since(Since::Moment);
    seen.near.push(Timed { ms: silence_ms, late_ms });
    if after.epoch > before.epoch {
        Ok(after.last_exit)
    } else {
        Err(format!("its epoch was {} and is {} (G2)", before.epoch, after.epoch))
    }
}

fn fatal(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let mut rig = rig(always(), Some(&NO_LEAK))?;
    let (desired, witness, mut seen) = (Desired::now(&rig.rpc)?, Witness::start(), Seen::default());
    let (mut held, rounds) = (None, run.times(1, 25));
    for _ in 0..rounds {
        for (way, name, expected) in WAYS {
            pause_ms(random.u64(0..50));
            let exit = end(&rig, &witness, way, &mut seen).map_err(|why| format!("{name}: {why}"))?;
            let right = expected.iter().any(|word| exit.contains(word));
            book.check(
                "how it ended is told",
                1,
                if right { Ok(()) } else { Err(format!("{name}: {exit}")) },
            );
            // What comes with the first loss of a peer stays.
            if held.is_none() {
                agree(&rig.rpc, &desired)?;
                held = Some(Holdings::of(&[("a", rig.process("a")?.pid), ("up", rig.up.pid())]));
            }
        }
    }
    seen.tell(book);
    book.check("desired, observed and actual agree (G3)", 4 * rounds as usize, agree(&rig.rpc, &desired));
    if let Some(held) = held {
        book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    }
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// Kills of a process that has 1 GiB to give back, which takes the kernel a while.
pub(super) fn heavy(book: &mut Book, rounds: u64) -> Result<(), String> {
    let mut rig = rig(always(), Some(&Leak { mib_s: 1024, ..NO_LEAK }))?;
    let (desired, witness, mut seen) = (Desired::now(&rig.rpc)?, Witness::start(), Seen::default());
    for _ in 0..rounds {
        let before = rig.process("b")?;
        let instance = number(&rig.own_port("a")?.row("a/sink")?["books"]["instance"]);
        rig.rpc.send("b/doom/ctl/strike", &json!(LEAK))?;
        eventually("it has 1 GiB", || match procfs::rss_kib(before.pid) {
            kib if kib >> 20 == 0 => Err(format!("{kib} KiB")),
            _ => Ok(()),
        })?;
        witness.begins(Since::Moment);
        rig.mark("a/near")?;
        witness.forget();
        let (killed_ns, pid) = (Some(now_ns()), before.pid);
        signal_to(pid, Signal::KILL)?;
        ended(&rig, &witness, &mut seen, &Before { b: before, instance, killed_ns })?;
    }
    book.times("the GCM lists a process of 1 GiB as gone", &seen.told, 170.0);
    book.times("samples of it flow again", &seen.flows, 1000.0);
    book.times("longest silence of a bystander's 1 kHz meanwhile (G4)", &seen.near, 5.0);
    book.check("desired, observed and actual agree after 1 GiB (G3)", 1, agree(&rig.rpc, &desired));
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// The bound of `b` is RLIMIT_DATA, which every user may set; nothing of it needs a control group.
fn leaks(run: &Run, book: &mut Book) -> Result<(), String> {
    let leak = if run.full {
        Leak { mib_s: 1, warn_mib: 64, limit_mib: 96 }
    } else {
        Leak { mib_s: 64, warn_mib: 96, limit_mib: 256 }
    };
    let mut rig = rig(always(), Some(&leak))?;
    let (desired, witness, mut seen) = (Desired::now(&rig.rpc)?, Witness::start(), Seen::default());
    let (rounds, mut warned) = (run.times(1, 3), Vec::new());
    for _ in 0..rounds {
        let pid = rig.process("b")?.pid;
        let quiet = rig.process("b")?.warnings;
        book.check(
            "it is not warned of before",
            1,
            if quiet.is_empty() { Ok(()) } else { Err(quiet.join("; ")) },
        );
        thread::scope(|scope| {
            let watched = scope.spawn(|| first_warning(&rig, pid, leak.warn_mib, &witness));
            let exit = end(&rig, &witness, LEAK, &mut seen)?;
            let right = if exit.contains("SIGABRT") { Ok(()) } else { Err(exit) };
            book.check("it ends where its memory ends, and that is told", 1, right);
            warned.push(watched.join().map_err(|_| "the look at its warnings panicked")??);
            Ok::<(), String>(())
        })?;
    }
    book.times("it is warned of at its soft limit", &warned, 1000.0);
    seen.tell(book);
    book.check("desired, observed and actual agree (G3)", rounds as usize, agree(&rig.rpc, &desired));
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// How long after a process has so much in use it is listed with a warning of it.
fn first_warning(rig: &Rig, pid: u32, warn_mib: u64, witness: &Witness) -> Result<Timed, String> {
    let has = || match procfs::rss_kib(pid) {
        kib if kib > warn_mib * 1024 => Ok(now_ns()),
        kib => Err(format!("{kib} KiB")),
    };
    let beyond = eventually("it has so much in use", has)?;
    let told = eventually("it is listed with a warning", || {
        let warnings = rig.process("b")?.warnings;
        let says = |w: &String| w.contains(&format!("to be warned of {warn_mib} MiB"));
        if warnings.iter().any(says) { Ok(now_ns()) } else { Err(format!("{warnings:?}")) }
    })?;
    Ok(witness.timed(beyond, told, 0.0))
}

fn storm(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut rig = rig(json!("on_failure"), None)?;
    let witness = Witness::start();
    pause_ms(200);
    rig.mark("a/near")?;
    witness.begins(Since::Moment);
    rig.rpc.create("b/doom", "fixture-chaos/doom", json!({ "how": "segv", "after_ms": 10 }))?;
    // It may be gone before it answers.
    let _ = rig.rpc.start("b/doom");
    let failed = eventually("it is given up", || match rig.process("b")? {
        b if b.state() == ProcessState::Failed => Ok(b),
        b => Err(format!("{:?} after {} restarts", b.state(), b.restarts)),
    })?;
    book.at_most("restarts in 10 s", 1, u64::from(failed.restarts), 3);
    let told = if failed.last_exit.contains("SIGSEGV") { Ok(()) } else { Err(failed.last_exit) };
    book.check("how it ended last is told", 1, told);
    let silence_ms = rig.book("a/near", "silence")? as f64 / 1e6;
    let late_ms = witness.late_since(Since::Moment);
    let near = [Timed { ms: silence_ms, late_ms }];
    book.times("longest silence of a bystander's 1 kHz (G4)", &near, 5.0);
    let (up, gcm) = (rig.up.pid(), rig.gcm_pid()?);
    let spent = || procfs::cpu_ms(up) + procfs::cpu_ms(gcm);
    let (before, ms) = (spent(), run.times(1_000, 10_000));
    thread::sleep(Duration::from_millis(ms));
    let busy = (spent() - before) as f64 / ms as f64 * 100.0;
    book.beside("processor time of `up` and the GCM afterwards", 1, busy, 0.0, 5.0, "%");
    rig.up.terminate()?;
    // What one that was given up has left is taken away by the next of its name.
    rig.up = Program::up(&rig.world, &pair(json!("on_failure")).to_string())?;
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}
