//! Rows about components that fail, hang and have bad manners inside a process that goes on.

use std::time::Duration;

use serde_json::{Value, json};
use trocar_proto::v1::{Component, ConnectOptions, Execution, Health};

use crate::book::{Book, Timed};
use crate::bystander::Bystander;
use crate::churn::Churn;
use crate::clock::{Watchdog, Witness, eventually, now_ns};
use crate::invariants::{Holdings, nothing_runs};
use crate::json::number;
use crate::procfs;
use crate::program::Program;
use crate::rpc::{NO_ANSWER, PATIENCE, Rpc, state_name};
use crate::run::{Row, Run, When};
use crate::watching::Overruns;
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[
    Row { name: "19", fault: "a component panics in any of its entries", when: When::Gate, run: panics },
    Row {
        name: "20",
        fault: "a panic with a frame in hand, and during Connect",
        when: When::Gate,
        run: in_hand,
    },
    Row { name: "21", fault: "an error from Configure and Start", when: When::Gate, run: errors },
    Row { name: "22", fault: "steps of 1.5 and of 10 periods", when: When::Gate, run: overruns },
    Row { name: "23", fault: "a deadlock and an endless loop in a component", when: When::Gate, run: hangs },
    Row {
        name: "26",
        fault: "a component leaves threads, mask, rounding, directory",
        when: When::Gate,
        run: rude,
    },
];

const C: &str = "a/c";
const CHAOS: &str = "fixture-chaos/chaos";

/// A process with a bystander at 1 kHz.
struct Scene {
    world: World,
    host: Program,
    rpc: Rpc,
    bystander: Bystander,
    witness: Witness,
}

impl Scene {
    fn new() -> Result<Scene, String> {
        let world = World::new(&["fixture_chaos", "fixture_pace"])?;
        let host = Program::host(&world, "a", None)?;
        let rpc = Rpc::at(&host.address);
        let bystander = Bystander::start(&world, &rpc, "a/late")?;
        Ok(Scene { world, host, rpc, bystander, witness: Witness::start() })
    }

    /// Waits for something at a component, and answers when it was seen.
    fn seen(
        &self,
        path: &str,
        what: &str,
        is: impl Fn(&Component) -> bool,
    ) -> Result<(u64, Component), String> {
        let what = format!("{path} is {what}");
        let mut watchdog = Watchdog::of(&what);
        loop {
            let component = self.rpc.component(path)?;
            let now = now_ns();
            if is(&component) {
                return Ok((now, component));
            }
            let Component { fault, .. } = &component;
            let warnings = component.stats.as_ref().map(|stats| &stats.warnings);
            watchdog.sees(format!(
                "{:?}, {:?}, {fault:?}, {warnings:?}",
                component.state(),
                component.health()
            ))?;
            std::thread::sleep(Duration::from_micros(300));
        }
    }

    /// Until it is in FAULT with these words.
    fn fault(&self, path: &str, words: &str) -> Result<u64, String> {
        let (at, component) = self.seen(path, "in FAULT", |c| state_name(c.state()) == "FAULT")?;
        if component.fault.contains(words) {
            Ok(at)
        } else {
            Err(format!("not `{words}`: {}", component.fault))
        }
    }

    fn timed(&self, began: u64, at: u64) -> Timed {
        self.witness.timed(began, at, 0.0)
    }

    /// Nobody else was harmed, and nothing stays; whoever panicked said that it was chaos.
    fn end(self, book: &mut Book, tried: usize) -> Result<(), String> {
        let Scene { world, mut host, bystander, .. } = self;
        bystander.tell(book)?;
        host.terminate()?;
        nothing_runs(book, &world);
        let strange = |line: &&str| line.contains("panicked at") && !line.contains("chaos");
        let printed = host.printed();
        let stray = printed.lines().find(strange).map_or(Ok(()), |line| Err(line.to_owned()));
        book.check("nobody panicked who was not told to (G7)", tried, stray);
        Ok(())
    }
}

/// A refusal that must be there and have these words.
fn refused<T>(answer: Result<T, crate::rpc::Refused>, words: &str) -> Result<(), String> {
    match answer {
        Err(refused) if refused.message.contains(words) => Ok(()),
        Err(refused) => Err(format!("not `{words}`: {refused}")),
        Ok(_) => Err(format!("it was not refused: {words}")),
    }
}

fn is_gone(rpc: &Rpc, path: &str) -> Result<(), String> {
    match rpc.component(path) {
        Err(refused) if refused.reason == "COMPONENT_NOT_FOUND" => Ok(()),
        other => Err(format!("{path}: {other:?}")),
    }
}

fn panics(run: &Run, book: &mut Book) -> Result<(), String> {
    let scene = Scene::new()?;
    let (rpc, rounds) = (&scene.rpc, run.times(1, 20));
    let (mut at_once, mut in_step) = (Vec::new(), Vec::new());
    let held = Holdings::of(&[("a", scene.host.pid())]);
    for _ in 0..rounds {
        for entry in ["step", "command", "start", "stop", "resume", "make_safe"] {
            rpc.create(C, CHAOS, json!({ "panic_in": entry }))?;
            scene.witness.forget();
            let mut began = now_ns();
            let started = rpc.start(C);
            if !matches!(entry, "step" | "start") {
                started?;
                began = now_ns();
            }
            match entry {
                "command" => rpc.send("a/c/ctl/poke", &Value::Null)?,
                "stop" | "make_safe" => drop(rpc.stop(C)),
                "resume" => {
                    rpc.stop(C)?;
                    began = now_ns();
                    drop(rpc.resume(C));
                }
                _ => {}
            }
            let timed = scene.timed(began, scene.fault(C, &format!("chaos in {entry}"))?);
            if matches!(entry, "step" | "command") {
                in_step.push(timed)
            } else {
                at_once.push(timed)
            }
            rpc.remove(C, true)?;
        }
        refused(rpc.create(C, "fixture-chaos/panics_in_create", json!({})), "chaos in create")?;
        is_gone(rpc, C)?;
        refused(rpc.create(C, CHAOS, json!({ "panic_in": "configure" })), "chaos in configure")?;
        is_gone(rpc, C)?;
        rpc.create(C, CHAOS, json!({ "panic_in": "drop" }))?;
        rpc.start(C)?;
        rpc.remove(C, true)?;
        is_gone(rpc, C)?;
    }
    let said = scene.host.printed().matches("chaos in drop").count();
    let told = if said >= rounds as usize { Ok(()) } else { Err(format!("{said} of {rounds}")) };
    book.check("a panic while it is destroyed is in the log", rounds as usize, told);
    book.check("panics while it is made are refused with their words", 2 * rounds as usize, Ok(()));
    book.times("FAULT with its own words", &at_once, 10.0);
    // One period of 10 ms until it steps.
    book.times("FAULT with its own words, in its next step", &in_step, 20.0);
    book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    scene.end(book, 9 * rounds as usize)
}

fn in_hand(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let scene = Scene::new()?;
    let rpc = &scene.rpc;
    let rounds = run.times(12, 300);
    rpc.create("a/spills", "fixture-chaos/spills", json!({}))?;
    for path in ["a/grasps", "a/other"] {
        rpc.create(path, "fixture-chaos/grasps", json!({}))?;
        rpc.start(path)?;
    }
    rpc.connect("a/grasps/frame", "a/spills/frame", ConnectOptions::default())?;
    rpc.start("a/spills")?;
    let churn = Churn::begin(rpc, &[("a/other/frame", "a/spills/frame")]);
    let mut back = Vec::new();
    for round in 0..rounds {
        let (path, words) = match round % 2 {
            0 => ("a/spills", "chaos with a frame half written"),
            _ => ("a/grasps", "chaos with a frame in hand"),
        };
        for (one, at) in
            [(path, random.u64(1..10)), (if round % 2 == 0 { "a/grasps" } else { "a/spills" }, 0)]
        {
            rpc.configure(one, json!({ "panics_at": at }))?;
        }
        // It may have struck already.
        let _ = rpc.stop(path);
        let _ = rpc.start(path);
        scene.fault(path, words)?;
        scene.witness.forget();
        let began = now_ns();
        rpc.reset(path)?;
        rpc.configure(path, json!({ "panics_at": 0 }))?;
        let before = number(&rpc.row("a/grasps")?["taken"]);
        rpc.start(path)?;
        eventually("frames flow again", || match rpc.row("a/grasps")? {
            row if number(&row["taken"]) != before && number(&row["taken"]) > 0 => Ok(()),
            row => Err(format!("{} taken", number(&row["taken"]))),
        })
        .map_err(|why| format!("round {round}: {why}: {:?}", rpc.row("a/spills")))?;
        back.push(scene.timed(began, now_ns()));
    }
    let churned = churn.end()?;
    book.times("frames flow after Reset and Start", &back, 50.0);
    let waited =
        Timed { ms: churned.longest_ms, late_ms: scene.witness.late_since(crate::clock::Since::Ever) };
    let what =
        format!("Connect and Disconnect meanwhile ({} done, {} refused)", churned.made, churned.refused);
    book.times(&what, &[waited], 1_000.0);
    book.at_least("Connect and Disconnect that were done meanwhile", rounds as usize, churned.made as u64, 1);
    let (spills, grasps) = (rpc.row("a/spills")?, rpc.row("a/grasps")?);
    book.at_most("frames there was no memory for", rounds as usize, number(&spills["exhausted"]), 0);
    book.at_most("frames that were not whole", rounds as usize, number(&grasps["torn"]), 0);
    let list = rpc.list()?;
    let one = matches!(&list.connections[..], [c] if c.client == "a/grasps/frame" && c.carrier == "heap");
    let only = if one { Ok(()) } else { Err(format!("{:?}", list.connections)) };
    book.check("the connections are those that were made (G3)", 1, only);
    scene.end(book, rounds as usize)
}

fn errors(run: &Run, book: &mut Book) -> Result<(), String> {
    let scene = Scene::new()?;
    let (rpc, rounds) = (&scene.rpc, run.times(3, 50));
    let held = Holdings::of(&[("a", scene.host.pid())]);
    let mut went = Ok(());
    let mut answers = Vec::new();
    for _ in 0..rounds {
        scene.witness.forget();
        let began = now_ns();
        went = (|| {
            refused(rpc.create(C, CHAOS, json!({ "error_in": "configure" })), "chaos in configure")?;
            is_gone(rpc, C)?;
            rpc.create(C, CHAOS, json!({}))?;
            let before = rpc.component(C)?;
            refused(rpc.configure(C, json!({ "error_in": "configure" })), "chaos in configure")?;
            let after = rpc.component(C)?;
            if (after.state(), &after.config) != (before.state(), &before.config) {
                return Err(format!("{before:?} became {after:?}"));
            }
            rpc.configure(C, json!({ "error_in": "start" }))?;
            refused(rpc.start(C), "chaos in start")?;
            scene.fault(C, "chaos in start")?;
            rpc.reset(C)?;
            rpc.configure(C, json!({ "error_in": null }))?;
            rpc.start(C)?;
            match rpc.state(C)? {
                state if state == "ACTIVE" => {}
                state => return Err(format!("after Reset and Start it is {state}")),
            }
            rpc.remove(C, true)?;
            Ok(())
        })();
        answers.push(scene.timed(began, now_ns()));
        if went.is_err() {
            break;
        }
    }
    book.check("refused with its own words, nothing half made, well after Reset", answers.len(), went);
    book.times("all of it together", &answers, 1_000.0);
    book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    scene.end(book, rounds as usize)
}

fn overruns(run: &Run, book: &mut Book) -> Result<(), String> {
    let scene = Scene::new()?;
    let (rpc, times) = (&scene.rpc, run.times(3, 100));
    for (slow_periods, rate_hz, tenths) in [(1.5, 20.0, 15), (10.0, 100.0, 100)] {
        let path = format!("a/pace-{tenths}");
        let execution = Execution { rate_hz: Some(rate_hz), ..Execution::default() };
        rpc.create_with(&path, "fixture-pace/pace", json!({ "slow_periods": slow_periods }), execution)?;
        rpc.start(&path)?;
        let watched = Overruns::of(rpc, &path)?;
        for n in 1..=times {
            let period = Duration::from_secs_f64(1.0 / rate_hz);
            rpc.invoke(&format!("{path}/ctl/slow"), &json!(1), PATIENCE)?;
            eventually("the slow step is over", || match number(&rpc.row(&path)?["late"]) {
                late if late >= n => Ok(()),
                late => Err(format!("{late} of {n}")),
            })?;
            std::thread::sleep(2 * period);
        }
        // Watch tells it in its own time.
        eventually("an overrun is told", || match watched.told().0 {
            0 => Err("none".to_owned()),
            _ => Ok(()),
        })?;
        let (told, seconds) = watched.told();
        let at_most = seconds.ceil() as u64;
        let often = format!("told {told} times in {seconds:.1} s");
        let seldom = if (1..=at_most).contains(&told) { Ok(()) } else { Err(often) };
        book.check("overruns are told, at most once a second", times as usize, seldom);
        rpc.stop(&path)?;
        let (row, stats) = (rpc.row(&path)?, rpc.stats(&path)?);
        // What it noted itself, and what it noted but for the moment between its clock and the host's.
        let (least, most) = (number(&row["late"]), number(&row["perhaps_late"]));
        let exact = (least..=most).contains(&stats.overruns);
        let told = format!("{} counted, {least} to {most} by its own clock", stats.overruns);
        let what = format!("steps of {slow_periods} periods: overruns are counted exactly");
        book.check(&what, times as usize, if exact { Ok(()) } else { Err(told) });
        let elapsed = number(&row["cycle"]) + 1;
        let accounted = stats.executed + stats.skipped;
        // Whole periods after its last step may have passed until it was stopped.
        let exact =
            accounted >= elapsed && accounted <= elapsed + 3 && stats.executed == number(&row["steps"]);
        let told = format!("{} steps, {} skipped, its last cycle {row}", stats.executed, stats.skipped);
        let what = format!("steps of {slow_periods} periods: every period is accounted for");
        book.check(&what, times as usize, if exact { Ok(()) } else { Err(told) });
        rpc.remove(&path, true)?;
    }
    scene.end(book, 2 * times as usize)
}

fn hangs(run: &Run, book: &mut Book) -> Result<(), String> {
    let scene = Scene::new()?;
    let (rpc, rounds) = (&scene.rpc, run.times(3, 30));
    let (mut locked, mut looping) = (Vec::new(), Vec::new());
    let (mut answers, mut quiet, mut stops) = (Vec::new(), Vec::new(), Vec::new());
    let ask = |n: usize, into: &mut Vec<Timed>| -> Result<(), String> {
        for _ in 0..n {
            scene.witness.forget();
            let began = now_ns();
            rpc.brief()?;
            into.push(scene.timed(began, now_ns()));
        }
        Ok(())
    };
    ask(100, &mut quiet)?;
    let mut hang = |how: &str, path: &str, class: &str, config: Value| -> Result<(), String> {
        rpc.create(path, class, config)?;
        scene.witness.forget();
        let mut began = now_ns();
        let started = rpc.start(path);
        if how == "loop" {
            started?;
            began = now_ns();
            rpc.send(&format!("{path}/ctl/strike"), &json!(SPIN))?;
        }
        let (at, _) = scene.seen(path, "UNRESPONSIVE", |c| c.health() == Health::Unresponsive)?;
        let mut timed = scene.timed(began, at);
        // Time in which it was ready and got no processor does not count as its own.
        let name = path.rsplit('/').next().unwrap_or_default();
        timed.late_ms += procfs::kept_waiting_ms(scene.host.pid(), name);
        if how == "loop" {
            looping.push(timed)
        } else {
            locked.push(timed)
        }
        ask(50, &mut answers)?;
        // Answered, whatever comes of it; then it is taken away without waiting for it.
        scene.witness.forget();
        let asked = now_ns();
        let stopped = rpc.stop(path);
        stops.push(scene.timed(asked, now_ns()));
        if stopped.is_err_and(|refused| refused.message.starts_with(NO_ANSWER)) {
            return Err("Stop of one that hangs was not answered".to_owned());
        }
        rpc.remove(path, true)?;
        is_gone(rpc, path)
    };
    for round in 0..rounds {
        hang("deadlock", &format!("a/locked-{round}"), CHAOS, json!({ "hang_in": "step" }))?;
    }
    // Only one, since it keeps a processor for good.
    hang("loop", "a/loops", "fixture-chaos/doom", json!({}))?;
    let tried = rounds as usize + 1;
    // Until it enters its next step, one period of 10 ms.
    book.times("a deadlock is UNRESPONSIVE", &locked, 60.0 + 10.0);
    book.times("an endless loop is UNRESPONSIVE", &looping, 60.0 + 10.0);
    let p99 = |all: &[Timed]| {
        let mut ms: Vec<f64> = all.iter().map(|t| (t.ms - t.late_ms).max(0.0)).collect();
        ms.sort_by(f64::total_cmp);
        ms.get(ms.len() * 99 / 100).copied().unwrap_or(f64::NAN)
    };
    let what = "99th percentile of an answer of the LCM meanwhile, beyond the machine's lateness";
    book.beside(what, answers.len(), p99(&answers), p99(&quiet), 20.0, "ms");
    book.check("Stop is answered, and Remove takes it away", tried, Ok(()));
    book.times("Stop is answered", &stops, 9_000.0);
    scene.end(book, tried)
}

/// What `doom` does on `strike`.
const SPIN: u64 = 6;

fn rude(run: &Run, book: &mut Book) -> Result<(), String> {
    book.leaves_out("a changed locale: the C library cannot tell it safely beside a thread that changes it");
    let scene = Scene::new()?;
    let (rpc, rounds) = (&scene.rpc, run.times(1, 20));
    let pid = scene.host.pid();
    let directory = || std::fs::read_link(format!("/proc/{pid}/cwd")).map_err(|e| e.to_string());
    let (before, threads) = (directory()?, procfs::threads(pid));
    let cases = [
        ("rounding", "start", "changed the rounding mode of its thread"),
        ("rounding", "step", "changed the rounding mode of its thread"),
        ("sigmask", "start", "changed the signal mask of its thread"),
        ("sigmask", "step", "the signal mask of its thread was changed"),
        ("cwd", "start", "changed the working directory of the process"),
        ("cwd", "step", "the working directory of the process was changed"),
    ];
    let mut named = Vec::new();
    for round in 0..rounds {
        for (mode, entry, words) in cases {
            scene.witness.forget();
            rpc.create(C, CHAOS, json!({ "rude": mode, "rude_in": entry }))?;
            let began = now_ns();
            rpc.start(C)?;
            let says = |c: &Component| {
                c.stats.as_ref().is_some_and(|s| s.warnings.iter().any(|w| w.contains(words)))
            };
            let (at, component) = scene.seen(C, words, says)?;
            named.push(scene.timed(began, at));
            if state_name(component.state()) != "ACTIVE" {
                return Err(format!("{mode} in {entry} ended it: {component:?}"));
            }
            rpc.remove(C, true)?;
        }
        let path = format!("a/brood-{round}");
        rpc.create(&path, CHAOS, json!({ "rude": "threads", "rude_in": "step" }))?;
        rpc.start(&path)?;
        eventually("it has stepped", || match number(&rpc.row(&path)?["steps"]) {
            0 | 1 => Err("not yet".into()),
            _ => Ok(()),
        })?;
        scene.witness.forget();
        let began = now_ns();
        rpc.stop(&path)?;
        let words = "1 of its own threads still run after it was stopped";
        let says =
            |c: &Component| c.stats.as_ref().is_some_and(|s| s.warnings.iter().any(|w| w.contains(words)));
        let (at, _) = scene.seen(&path, words, says)?;
        named.push(scene.timed(began, at));
        rpc.remove(&path, true)?;
    }
    book.times("each is named at whoever did it", &named, 2_000.0);
    let now = directory()?;
    let same = if now == before { Ok(()) } else { Err(format!("{now:?}, before {before:?}")) };
    book.check("the working directory is what it was", rounds as usize, same);
    let left = eventually("only the threads that were left are there", || {
        let now = procfs::threads(pid);
        if now <= threads + rounds as usize { Ok(()) } else { Err(format!("{now}, before {threads}")) }
    });
    book.check("no thread but those that were left", rounds as usize, left);
    let quiet = rpc.stats("a/late")?.warnings;
    // A directory is the whole process's: then all are named who stepped meanwhile.
    let strange = ["mask", "rounding", "threads"];
    let innocent = quiet.iter().all(|w| strange.iter().all(|word| !w.contains(word)));
    book.check(
        "nobody else is named",
        rounds as usize,
        if innocent { Ok(()) } else { Err(quiet.join("; ")) },
    );
    scene.end(book, 7 * rounds as usize)
}
