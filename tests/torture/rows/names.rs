//! Rows about one name and several processes: a second one of it, one that was replaced while it stood still,
//! one that is killed while it starts.
//!
//! Invariant: which process a sample comes from is told by the sample, not by who is listed.

use std::time::Duration;

use rustix::process::Signal;
use serde_json::json;
use trocar_proto::v1::{ConnectOptions, ProcessState};

use crate::book::{Book, Timed};
use crate::clock::{Witness, eventually, now_ns, pause_ms};
use crate::invariants::{Desired, agree, nothing_is_left};
use crate::json::number;
use crate::procfs;
use crate::program::{Program, host_args, signal_to};
use crate::rig::{Rig, pair};
use crate::rpc::Rpc;
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[
    Row { name: "2", fault: "a host is killed at any moment of its start", when: When::Gate, run: starting },
    Row { name: "4", fault: "a process goes on after it was replaced", when: When::Gate, run: zombie },
    Row { name: "10", fault: "a process name that is taken", when: When::Gate, run: taken },
];

/// The process of this name below `up` that runs now, attached or not.
fn running(rig: &Rig, name: &str) -> Option<u32> {
    let is_it = |pid: &u32| procfs::command_line(*pid).windows(2).any(|two| two == ["--name", name]);
    procfs::children(rig.up.pid()).into_iter().find(is_it)
}

fn starting(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let world = World::new(&["fixture_torture"])?;
    let always = json!({ "max": 1000, "backoff_ms": 1, "most_backoff_ms": 1 });
    let mut rig = Rig::of(world, &pair(always))?;
    let (desired, witness) = (Desired::now(&rig.rpc)?, Witness::start());
    let own = rig.own_port("a")?;
    let (times, mut last, mut began) = (run.times(20, 200), 0, 0);
    for round in 0..times {
        last = eventually(&format!("round {round}: b runs"), || match running(&rig, "b") {
            Some(pid) if pid != last => Ok(pid),
            other => Err(format!("{other:?}")),
        })?;
        // From its first instruction to long after it has all it had.
        std::thread::sleep(Duration::from_micros(1 << random.u32(0..19)));
        began = now_ns();
        signal_to(last, Signal::KILL)?;
    }
    witness.forget();
    let first = eventually("samples of the last incarnation", || {
        let books = own.row("a/sink")?["books"].take();
        let instance = number(&books["instance"]);
        if instance > began { Ok(number(&books["first_ns"])) } else { Err(format!("of {instance}")) }
    });
    let what = "samples flow after the last kill";
    match first {
        Ok(first) => book.times(what, &[witness.timed(began, first, 0.0)], 1000.0),
        Err(why) => book.check(what, 1, Err(why)),
    }
    book.check("desired, observed and actual agree (G3)", times as usize, agree(&rig.rpc, &desired));
    for sink in ["sink", "near"] {
        let books = own.row(&format!("a/{sink}"))?["books"].take();
        let wrong = number(&books["old"]) + number(&books["disorder"]) + number(&books["seq_wrong"]);
        book.at_most(&format!("data of a former instance, or twice, at a/{sink}"), times as usize, wrong, 0);
    }
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    given_up(book)
}

/// With the policy that holds when none is set: three restarts in ten seconds.
fn given_up(book: &mut Book) -> Result<(), String> {
    let world = World::new(&["fixture_torture"])?;
    let mut rig = Rig::of(world, &pair(json!("on_failure")))?;
    let mut last = 0;
    let failed = eventually("it is given up", || {
        let b = rig.process("b")?;
        if b.state() == ProcessState::Failed {
            return Ok(b);
        }
        if let Some(pid) = running(&rig, "b").filter(|pid| *pid != last) {
            last = pid;
            signal_to(pid, Signal::KILL)?;
        }
        Err(format!("{:?} after {} restarts", b.state(), b.restarts))
    })?;
    book.at_most("restarts of one that is killed again and again", 1, u64::from(failed.restarts), 3);
    let flows = rig.book("a/near", "taken")?;
    let goes_on = eventually("samples flow", || match rig.book("a/near", "taken")? {
        now if now > flows => Ok(()),
        now => Err(format!("{now} samples")),
    });
    book.check("the others go on", 1, goes_on);
    let busy = procfs::cpu_ms(rig.up.pid());
    pause_ms(1000);
    let spent = (procfs::cpu_ms(rig.up.pid()) - busy) as f64 / 10.0;
    book.beside("processor time of `up` afterwards", 1, spent, 0.0, 5.0, "%");
    rig.up.terminate()?;
    // What a killed process has left is taken away by the next of its name.
    rig.up = Program::up(&rig.world, &pair(json!("on_failure")).to_string())?;
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// STOP, another one takes the name, CONT: what the old one says counts nowhere, and it ends.
fn zombie(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let times = run.times(2, 20);
    let (mut fenced, mut old) = (Vec::new(), 0);
    for round in 0..times {
        let world = World::new(&["fixture_torture"])?;
        let mut gcm = Program::gcm(&world)?;
        let mut a = Program::host(&world, "a", Some(&gcm.address))?;
        let mut b = Program::host_as(&world, "b", "b", Some(&gcm.address))?;
        let (rpc, own, witness) = (Rpc::at(&gcm.address), Rpc::at(&a.address), Witness::start());
        make_pair(&rpc)?;
        let before = flowing(&own, 0)?;
        pause_ms(random.u64(0..50));
        b.signal(Signal::STOP)?;
        eventually("b is lost", || {
            let list = rpc.brief()?;
            let lost = list.processes.iter().any(|p| p.name == "b" && p.state() == ProcessState::Lost);
            if lost { Ok(()) } else { Err(format!("{:?}", list.processes)) }
        })?;
        let mut next = Program::host_as(&world, "b", "b-next", Some(&gcm.address))?;
        let after =
            flowing(&own, before).map_err(|why| format!("round {round}: {why}: {:?}", rpc.brief()))?;
        witness.forget();
        let began = now_ns();
        b.signal(Signal::CONT)?;
        let ended = b.await_end()?;
        fenced.push(witness.timed(began, now_ns(), 0.0));
        let said = b.printed();
        // 75: replaced, and nothing else.
        let told = ended.code() == Some(75) && said.contains("the name `b` is taken");
        book.check("and says why", 1, if told { Ok(()) } else { Err(format!("{ended}: {said}")) });
        pause_ms(300);
        let books = own.row("a/sink")?["books"].take();
        old += number(&books["old"]) + number(&books["disorder"]);
        old += u64::from(number(&books["instance"]) != after);
        let list = rpc.brief()?.processes;
        let is_next = list.iter().any(|p| p.pid == next.pid() && p.state() == ProcessState::Attached);
        let undisturbed = if is_next { Ok(()) } else { Err(format!("{list:?}")) };
        book.check("its replacement is undisturbed", 1, undisturbed);
        next.terminate()?;
        a.terminate()?;
        gcm.terminate()?;
        nothing_is_left(book, &world);
    }
    book.at_most("its samples that were taken", times as usize, old, 0);
    book.times("it ends after it went on", &fenced, 200.0);
    Ok(())
}

/// A sink in `a` of a source in `b`.
fn make_pair(rpc: &Rpc) -> Result<(), String> {
    for (path, class) in [("a/sink", "fixture-torture/sink"), ("b/source", "fixture-torture/source")] {
        eventually(&format!("{class} is offered"), || Ok(rpc.create(path, class, json!({}))?))?;
    }
    rpc.connect("a/sink/value", "b/source/value", ConnectOptions::default())?;
    for path in ["b/source", "a/sink"] {
        rpc.start(path)?;
    }
    Ok(())
}

/// Waits for samples of an instance after this one, and answers which.
fn flowing(own: &Rpc, before: u64) -> Result<u64, String> {
    eventually("samples flow", || {
        let books = own.row("a/sink")?["books"].take();
        let instance = number(&books["instance"]);
        if instance > before { Ok(instance) } else { Err(format!("of {instance}")) }
    })
}

fn taken(run: &Run, book: &mut Book) -> Result<(), String> {
    let world = World::new(&["fixture_torture"])?;
    let mut gcm = Program::gcm(&world)?;
    let mut a = Program::host(&world, "a", Some(&gcm.address))?;
    let mut b = Program::host(&world, "b", Some(&gcm.address))?;
    let (rpc, own) = (Rpc::at(&gcm.address), Rpc::at(&a.address));
    make_pair(&rpc)?;
    flowing(&own, 0)?;
    let before = rpc.brief()?.processes;
    // How long one takes to start and to be told, where its name is free.
    let began = now_ns();
    let mut free = Program::host(&world, "c", Some(&gcm.address))?;
    let control_ms = now_ns().saturating_sub(began) as f64 / 1e6;
    free.terminate()?;
    let marked = own.row("a/sink")?["books"].take();
    let (mut refused, mut accepted, mut said) = (Vec::new(), 0, Ok(()));
    for round in 0..run.times(3, 50) {
        let name = format!("second-{round}");
        let args = host_args(&world, "b", &name, Some(&gcm.address));
        let began = now_ns();
        let mut second = Program::begin(&world, &name, &args, false)?;
        let status = second.await_end()?;
        let ms = now_ns().saturating_sub(began) as f64 / 1e6;
        refused.push(Timed { ms, late_ms: control_ms });
        accepted += u64::from(status.success());
        if !second.printed().contains("the name `b` is taken") {
            said = Err(second.printed());
        }
    }
    let tried = refused.len();
    book.times("the second one is refused and ends", &refused, 300.0);
    book.at_most("second ones that ended as if all were well", tried, accepted, 0);
    book.check("it is said why", tried, said);
    let after: Vec<_> = rpc.brief()?.processes.into_iter().filter(|p| p.name != "c").collect();
    let is = |p: &trocar_proto::v1::Process| (p.name.clone(), p.pid, p.epoch, p.state);
    let same = after.iter().map(is).eq(before.iter().map(is));
    book.check("the first one is as it was", tried, if same { Ok(()) } else { Err(format!("{after:?}")) });
    let books = own.row("a/sink")?["books"].take();
    let more = |key: &str| number(&books[key]).saturating_sub(number(&marked[key]));
    book.at_most_in_time("samples its reader missed", tried, more("gaps"), 0);
    book.at_most("samples of another instance", tried, more("instances"), 0);
    b.terminate()?;
    a.terminate()?;
    gcm.terminate()?;
    nothing_is_left(book, &world);
    Ok(())
}
