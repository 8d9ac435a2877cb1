//! Rows about data: takers that are slow, stand still or die, floods, and a machine that is wanted by others.

use std::thread;

use serde_json::{Value, json};
use trocar_proto::v1::Connection;

use rustix::process::Signal;

use crate::book::{Book, Timed};
use crate::clock::{Witness, eventually, now_ns, pause_ms};
use crate::invariants::{Desired, agree, nothing_is_left};
use crate::json::number;
use crate::procfs;
use crate::program::signal_to;
use crate::rig::Rig;
use crate::rpc::PATIENCE;
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[
    Row {
        name: "42",
        fault: "takers of 900 Mbit/s and 1.13 Gbit/s that are slow, stopped, dead",
        when: When::Gate,
        run: takers,
    },
    Row { name: "43", fault: "a flood of samples and of commands", when: When::Gate, run: floods },
];

/// Frames of a camera, Hz.
const FRAMES_HZ: f64 = 60.0;
/// Sizes of a frame, B: 900 Mbit/s and 1.13 Gbit/s at 60 Hz.
const SIZES: [u64; 2] = [1_875_000, 2_360_000];
/// What a frame may cost its producer, of what it costs without harm.
const MORE: f64 = 1.1;
/// And beyond that, µs: while nobody takes them all slots go round, so the one that is written has left the
/// caches, and what was not taken is taken back. Two to four µs here, of a period of 16 667.
const COLD_US: f64 = 5.0;
/// Frames of which a 99th percentile says nothing.
const FEW: usize = 400;
/// How long one stretch of frames takes, ms, and how long it is waited after the camera has begun anew.
const STRETCH: u64 = 1_000;
const SETTLED: u64 = 300;
/// What memory in use may grow by, KiB.
const MOST_KIB: u64 = 1024;

fn connection(rig: &Rig, client: &str) -> Result<Connection, String> {
    let all = rig.rpc.list()?.connections;
    let found = all.into_iter().find(|c| c.client == client);
    // A client that takes the newest only misses those, too.
    let missed = found.map(|c| Connection { dropped: c.dropped + c.skipped, ..c });
    missed.ok_or_else(|| format!("{client} is not connected"))
}

/// What stretches of one kind cost the producer, by its own clock.
#[derive(Default)]
struct Stretches {
    /// Of each frame, ns, stretch by stretch.
    costs: Vec<Vec<u64>>,
    /// The slowest frame of each stretch.
    slowest: Vec<Timed>,
    exhausted: u64,
}

impl Stretches {
    /// One more stretch, `during` which frames are made.
    fn add(&mut self, rig: &Rig, during: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
        let costs = || rig.rpc.invoke("a/camera/ctl/costs", &Value::Null, PATIENCE);
        let exhausted = || Ok::<_, String>(number(&rig.rpc.row("a/camera")?["exhausted"]));
        let (witness, before) = (Witness::start(), exhausted()?);
        // Forgets what was before.
        costs()?;
        during()?;
        // Of all of them, also where there are more than are told one by one.
        let slowest_ns = number(&rig.rpc.row("a/camera")?["slowest"]);
        self.slowest.push(Timed { ms: slowest_ns as f64 / 1e6, late_ms: witness.late_ms() });
        let ns: Vec<u64> = costs()?.as_array().into_iter().flatten().map(number).collect();
        if ns.is_empty() {
            return Err("no frame was made".to_owned());
        }
        self.costs.push(ns);
        self.exhausted += exhausted()? - before;
        Ok(())
    }

    fn frames(&self) -> usize {
        self.costs.iter().map(Vec::len).sum()
    }

    /// What so many of a hundred frames of these stretches cost at most, µs.
    fn percentile_us<'a>(stretches: impl Iterator<Item = &'a Vec<u64>>, hundredths: usize) -> f64 {
        let mut all: Vec<u64> = stretches.flatten().copied().collect();
        all.sort_unstable();
        all.get(all.len() * hundredths / 100).map_or(0.0, |ns| *ns as f64 / 1e3)
    }

    fn us(&self, hundredths: usize) -> f64 {
        Self::percentile_us(self.costs.iter(), hundredths)
    }

    /// By how much this figure differs between every other stretch and those in between: what the machine
    /// alone makes of it, µs.
    fn differs_by_us(&self, hundredths: usize) -> f64 {
        let half = |skip| Self::percentile_us(self.costs.iter().skip(skip).step_by(2), hundredths);
        (half(0) - half(1)).abs()
    }
}

fn takers(run: &Run, book: &mut Book) -> Result<(), String> {
    let sizes = if run.full { &SIZES[..] } else { &SIZES[1..] };
    for &bytes in sizes {
        let rounds = run.times(4, 20);
        let name = format!("{:.2} Gbit/s", bytes as f64 * 8.0 * FRAMES_HZ / 1e9);
        let process = json!({
            "plugins": ["plugins"], "restart": { "max": 1000, "backoff_ms": 50, "most_backoff_ms": 50, "unheard_s": "never" },
        });
        // Who wakes whom across processors is the same all the time, where there is more than one.
        let others: Vec<usize> = (1..thread::available_parallelism().map_or(1, usize::from)).collect();
        let taker = json!({ "class": "fixture-torture/screen", "execution": { "cpus": others } });
        let system = json!({
            "version": 1, "processes": { "a": process, "b": process },
            "components": {
                "a/camera": {
                    "class": "fixture-torture/camera", "config": { "bytes": bytes, "slots": 4 },
                    "execution": { "rate_hz": FRAMES_HZ, "cpus": [0] },
                },
                "a/near": taker, "b/screen": taker,
            },
            "connections": [
                { "client": "a/near/frame", "server": "a/camera/frame" },
                { "client": "b/screen/frame", "server": "a/camera/frame" },
            ],
        });
        let mut rig = Rig::of(World::new(&["fixture_torture"])?, &system)?;
        let desired = Desired::now(&rig.rpc)?;
        pause_ms(500);
        one_size(&rig, book, &name, rounds)?;
        book.check("desired, observed and actual agree (G3)", 1, agree(&rig.rpc, &desired));
        rig.up.terminate()?;
        nothing_is_left(book, &rig.world);
    }
    Ok(())
}

/// Harms take turns with stretches without any, so that what the machine does meanwhile falls on all of them.
fn one_size(rig: &Rig, book: &mut Book, name: &str, rounds: u64) -> Result<(), String> {
    let a = rig.process("a")?.pid;
    let (rss, gaps, witness) = (procfs::rss_kib(a), rig.book("a/near", "gaps")?, Witness::start());
    let [mut quiet, mut slow, mut stopped, mut dead] = [(); 4].map(|()| Stretches::default());
    let goes_on = || {
        pause_ms(STRETCH);
        Ok(())
    };
    for _ in 0..rounds {
        pause_ms(SETTLED);
        quiet.add(rig, goes_on)?;
        // Slow: six periods with each frame in hand.
        let before = (connection(rig, "b/screen/frame")?.dropped, rig.book("b/screen", "gaps")?);
        rig.rpc.configure("b/screen", json!({ "slow_step_ms": 100 }))?;
        slow.add(rig, goes_on)?;
        rig.rpc.configure("b/screen", json!({ "slow_step_ms": 0 }))?;
        exact(rig, book, &format!("{name}, a slow taker"), before)?;
        let b = rig.process("b")?.pid;
        let before = (connection(rig, "b/screen/frame")?.dropped, rig.book("b/screen", "gaps")?);
        stopped.add(rig, || {
            signal_to(b, Signal::STOP)?;
            pause_ms(STRETCH);
            signal_to(b, Signal::CONT)
        })?;
        flows(rig)?;
        exact(rig, book, &format!("{name}, a stopped taker"), before)?;
        // Dead, and there again. Its taker begins anew and cannot miss what its former self would have: the
        // connection must.
        let before = at_rest(rig)?;
        pause_ms(SETTLED);
        dead.add(rig, || {
            signal_to(b, Signal::KILL)?;
            pause_ms(STRETCH);
            rig.await_back("b", b).map(drop)
        })?;
        flows(rig)?;
        all_accounted(book, name, before, at_rest(rig)?);
    }
    for (how, seen) in [("a slow taker", &slow), ("a stopped taker", &stopped), ("a dead taker", &dead)] {
        costs_no_more(book, &format!("{name}, {how}"), seen, &quiet);
    }
    let grown = procfs::rss_kib(a).saturating_sub(rss);
    let harms = 3 * rounds as usize;
    book.at_most(&format!("{name}: KiB more in use at the producer"), harms, grown, MOST_KIB);
    let books = rig.books("a/near")?;
    let missed = (number(&books["gaps"]) - gaps) as f64;
    // Three times what the machine was late itself at worst, in frames.
    let late = (3.0 * witness.late_ms() / 1000.0 * FRAMES_HZ).floor();
    book.beside(&format!("{name}: frames a taker beside it missed (G4)"), harms, missed, late, 0.0, "frames");
    for taker in ["a/near", "b/screen"] {
        let books = rig.books(taker)?;
        let wrong = ["torn", "disorder", "old", "seq_wrong"].iter().map(|key| number(&books[*key])).sum();
        let what = format!("{name}, {taker}: frames torn, twice, old, with a wrong number");
        book.at_most(&what, harms, wrong, 0);
    }
    Ok(())
}

/// What was passed to the dead one went with it; it had taken one perhaps, and as many waited as may.
fn all_accounted(book: &mut Book, name: &str, before: (u64, u64, u64), after: (u64, u64, u64)) {
    let passed = if after.1 < before.1 { after.1 } else { after.1 - before.1 };
    let (sent, dropped) = (after.0 - before.0, after.2.saturating_sub(before.2));
    let all = match sent.checked_sub(passed + dropped) {
        Some(0..=3) => Ok(()),
        _ => Err(format!("{sent} sent, {passed} passed, {dropped} dropped: {before:?}, {after:?}")),
    };
    let what = format!("{name}, a dead taker: each frame was passed or dropped, but for those it took along");
    book.check(&what, sent as usize, all);
}

/// A frame costs its producer what it costs in the stretches without harm, which differ among themselves.
fn costs_no_more(book: &mut Book, name: &str, seen: &Stretches, control: &Stretches) {
    // Of few frames the 99th percentile would be nearly their largest.
    let high = if seen.frames() < FEW { 90 } else { 99 };
    for which in [50, high] {
        let what = format!(
            "{name}: p{which} of what a frame costs its producer, beside 1.1 × control and {COLD_US} µs"
        );
        let allowed = (control.differs_by_us(which) * 10.0).ceil() / 10.0 + COLD_US;
        book.beside(&what, seen.frames(), seen.us(which), MORE * control.us(which), allowed, "µs");
    }
    book.times(&format!("{name}: slowest frame"), &seen.slowest, 5.0);
    book.at_most(&format!("{name}: frames there was no memory for"), seen.frames(), seen.exhausted, 0);
}

/// Frames sent, passed to `b` and dropped, when nothing is under way; then the camera goes on.
fn at_rest(rig: &Rig) -> Result<(u64, u64, u64), String> {
    rig.rpc.stop("a/camera")?;
    let mut last = (0, 0, 0);
    let rest = eventually("nothing is under way", || {
        let c = connection(rig, "b/screen/frame")?;
        let now = (number(&rig.rpc.row("a/camera")?["sent"]), c.passed, c.dropped);
        pause_ms(100);
        if std::mem::replace(&mut last, now) == now { Ok(now) } else { Err(format!("{now:?}")) }
    })?;
    rig.rpc.start("a/camera")?;
    Ok(rest)
}

/// Waits for frames made from now on.
fn flows(rig: &Rig) -> Result<(), String> {
    eventually("frames flow", || {
        rig.mark("b/screen")?;
        pause_ms(100);
        match rig.books("b/screen")? {
            books if number(&books["after_mark_ns"]) > 0 => Ok(()),
            books => Err(format!("{} taken", number(&books["taken"]))),
        }
    })
}

/// The connection counted as dropped what its taker misses, since some moment; there was some, or nothing is
/// shown.
fn exact(rig: &Rig, book: &mut Book, name: &str, before: (u64, u64)) -> Result<(), String> {
    let mut gaps = 0;
    let same = eventually("they are the same", || {
        gaps = rig.book("b/screen", "gaps")?.saturating_sub(before.1);
        let dropped = connection(rig, "b/screen/frame")?.dropped.saturating_sub(before.0);
        let right = dropped == gaps && gaps > 0;
        if right { Ok(()) } else { Err(format!("{dropped} dropped, {gaps} missing")) }
    });
    book.check(&format!("{name}: dropped is what is missing, exactly"), gaps as usize, same);
    Ok(())
}

fn floods(run: &Run, book: &mut Book) -> Result<(), String> {
    let process = json!({ "plugins": ["plugins"] });
    let chaos = |flood: u32| json!({ "class": "fixture-chaos/chaos", "config": { "flood": flood } });
    let system = json!({
        "version": 1, "processes": { "a": process, "b": process },
        "components": {
            "a/source": { "class": "fixture-torture/source" },
            "a/sink": { "class": "fixture-torture/sink" },
            "a/near": { "class": "fixture-chaos/chaos" },
            "a/tap": { "class": "fixture-torture/sink" },
            "b/far": { "class": "fixture-chaos/chaos" },
            "b/flood": { "class": "fixture-torture/source", "execution": { "rate_hz": 10_000 } },
            "b/drain": { "class": "fixture-torture/sink" },
            "b/nearby": chaos(0),
        },
        "connections": [
            { "client": "a/sink/value", "server": "a/source/value" },
            { "client": "b/drain/value", "server": "b/flood/value" },
            { "client": "a/tap/value", "server": "b/flood/value" },
        ],
    });
    let mut rig = Rig::of(World::new(&["fixture_torture", "fixture_chaos"])?, &system)?;
    let ms = run.times(1_500, 30_000);
    let witness = Witness::start();
    pause_ms(300);
    rig.mark("a/sink")?;
    let began = now_ns();
    samples(&rig, book, ms)?;
    for (sender, receiver) in [("b/nearby", "b/far"), ("b/nearby", "a/near")] {
        commands(&rig, book, sender, receiver, ms)?;
    }
    let silence_ms = rig.book("a/sink", "silence")? as f64 / 1e6;
    let late = Timed { ms: silence_ms, late_ms: witness.late_ms() };
    let periods = (now_ns() - began) / 1_000_000;
    book.times(&format!("longest silence of a bystander's 1 kHz in {periods} ms (G4)"), &[late], 5.0);
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// Ten thousand a second for takers that are busy half a second at a time, beside them and in another
/// process.
fn samples(rig: &Rig, book: &mut Book, ms: u64) -> Result<(), String> {
    for sink in ["b/drain", "a/tap"] {
        let client = format!("{sink}/value");
        let before = (connection(rig, &client)?.dropped, rig.book(sink, "gaps")?);
        rig.rpc.configure(sink, json!({ "slow_step_ms": 500 }))?;
        pause_ms(ms);
        rig.rpc.configure(sink, json!({ "slow_step_ms": 0 }))?;
        let mut gaps = 0;
        let same = eventually("they are the same", || {
            gaps = rig.book(sink, "gaps")? - before.1;
            let dropped = connection(rig, &client)?.dropped - before.0;
            if dropped == gaps && gaps > 0 {
                Ok(())
            } else {
                Err(format!("{dropped} dropped, {gaps} missing"))
            }
        });
        let what = format!("10 kHz for {sink}, which is busy: dropped is what is missing, exactly");
        book.check(&what, gaps as usize, same);
        let books = rig.books(sink)?;
        let wrong = number(&books["disorder"]) + number(&books["seq_wrong"]);
        book.at_most(&format!("samples twice, too late or with a wrong number at {sink}"), 1, wrong, 0);
    }
    let slowest = Timed { ms: number(&rig.rpc.row("b/flood")?["slowest"]) as f64 / 1e6, late_ms: 0.0 };
    let late_ms = number(&rig.rpc.row("a/source")?["slowest"]) as f64 / 1e6;
    // The same write without a flood, on the same machine at the same time.
    book.times("longest write of the flood", &[Timed { late_ms, ..slowest }], 5.0);
    Ok(())
}

/// Each command was carried out or turned away at once, and its sender knows which.
fn commands(rig: &Rig, book: &mut Book, sender: &str, receiver: &str, ms: u64) -> Result<(), String> {
    const FLOOD: u64 = 1_000;
    let client = format!("{sender}/peer");
    rig.rpc.connect(&client, &format!("{receiver}/ctl"), trocar_proto::v1::ConnectOptions::default())?;
    rig.rpc.stop(sender)?;
    let of = |key: &str| -> Result<u64, String> { Ok(number(&rig.rpc.row(sender)?[key])) };
    let done = || -> Result<u64, String> { Ok(rig.rpc.stats(receiver)?.commands) };
    let (steps, turned_away, carried_out) = (of("steps")?, of("turned_away")?, done()?);
    rig.rpc.configure(sender, json!({ "flood": FLOOD }))?;
    rig.rpc.start(sender)?;
    pause_ms(ms);
    rig.rpc.stop(sender)?;
    let sent = (of("steps")? - steps) * FLOOD;
    let turned_away = of("turned_away")? - turned_away;
    let mut carried = 0;
    let all = eventually("all are accounted for", || {
        carried = done()? - carried_out;
        let told = || format!("{sent} sent, {turned_away} turned away, {carried} carried out");
        if carried + turned_away == sent && carried > 0 { Ok(()) } else { Err(told()) }
    });
    book.check(&format!("{sender} to {receiver}: no command is lost silently"), sent as usize, all);
    let counted = connection(rig, &client)?;
    let right = counted.rejected == turned_away;
    let told = format!("{} rejected, {turned_away} turned away", counted.rejected);
    let what = format!("{sender} to {receiver}: what the queue did not take is counted");
    book.check(&what, turned_away as usize, if right { Ok(()) } else { Err(told) });
    let health = rig.rpc.state(receiver)?;
    let well = if health == "ACTIVE" { Ok(()) } else { Err(health) };
    book.check(&format!("{receiver} goes on"), 1, well);
    rig.rpc.disconnect(&client, &format!("{receiver}/ctl"))?;
    rig.rpc.configure(sender, json!({ "flood": 0 }))?;
    rig.rpc.start(sender)?;
    Ok(())
}
