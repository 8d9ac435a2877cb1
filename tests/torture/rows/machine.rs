//! Rows about a machine that is wanted by others: processors, memory and disk are taken away while components
//! keep their time.

use std::fs::File;
use std::hint::black_box;
use std::io::{Seek, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

use serde_json::{Value, json};
use trocar_proto::v1::Execution;

use crate::book::Book;
use crate::bystander::{PRIORITY, start_late};
use crate::clock::pause_ms;
use crate::invariants::{Holdings, nothing_is_left};
use crate::json::number;
use crate::program::Program;
use crate::rpc::{PATIENCE, Rpc};
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] =
    &[Row { name: "45", fault: "hogs of processors, memory and disk", when: When::Times, run: hogs }];

/// Lateness of the host's steps that is allowed beyond 1.5 times a bare thread's, µs: the work of a step
/// before it looks at its clock.
const BEYOND_US: f64 = 50.0;
/// Of memory that is free, a hog takes a quarter, at most so much, MiB.
const MOST_MIB: u64 = 512;
/// What a hog of the disk writes again and again, MiB.
const FILE_MIB: usize = 32;

/// Threads that take what there is, until dropped.
struct Hogs {
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Hogs {
    fn begin(world: &World) -> Result<Hogs, String> {
        let mut hogs = Hogs { ends: Arc::default(), threads: Vec::new() };
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            hogs.add(|| {
                for n in 0..10_000_u64 {
                    black_box(n);
                }
            });
        }
        let free = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
        let free_kib: u64 = free
            .lines()
            .find_map(|line| line.strip_prefix("MemAvailable:")?.split_whitespace().next()?.parse().ok())
            .unwrap_or(0);
        let mut taken = vec![0_u8; ((free_kib / 4).min(MOST_MIB << 10) << 10) as usize];
        let mut turn = 0_u8;
        hogs.add(move || {
            turn = turn.wrapping_add(1);
            taken.iter_mut().step_by(4096).for_each(|byte| *byte = turn);
            black_box(&taken);
        });
        let mut file = File::create(world.path("hog")).map_err(|e| format!("hog: {e}"))?;
        let block = vec![0xa5_u8; 1 << 20];
        hogs.add(move || {
            // A disk that is full is as busy as one that is not.
            let _ = file.rewind();
            for _ in 0..FILE_MIB {
                let _ = file.write_all(&block);
            }
            let _ = file.sync_data();
        });
        Ok(hogs)
    }

    fn add(&mut self, mut bite: impl FnMut() + Send + 'static) {
        let ends = self.ends.clone();
        self.threads.push(thread::spawn(move || {
            while !ends.load(Ordering::Relaxed) {
                bite();
            }
        }));
    }
}

impl Drop for Hogs {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // It ends after a bite.
            let _ = thread.join();
        }
    }
}

/// Lateness of a thread since it was asked last, µs.
struct Lateness {
    count: u64,
    p50: f64,
    p99: f64,
    max: f64,
    granted: bool,
}

impl Lateness {
    fn of(rpc: &Rpc, path: &str) -> Result<Lateness, String> {
        let figures: Value = rpc.invoke(&format!("{path}/ctl/figures"), &Value::Null, PATIENCE)?;
        let us = |key: &str| number(&figures[key]) as f64 / 1e3;
        let granted = number(&figures["granted"]) == 1;
        Ok(Lateness {
            count: number(&figures["count"]),
            p50: us("p50"),
            p99: us("p99"),
            max: us("max"),
            granted,
        })
    }

    fn of_all(rpc: &Rpc, paths: &[String]) -> Result<Vec<Lateness>, String> {
        paths.iter().map(|path| Lateness::of(rpc, path)).collect()
    }

    fn say(&self, who: &str) {
        eprintln!(
            "  {who}: {} periods, late by p50 {:.0}, p99 {:.0}, at most {:.0} µs",
            self.count, self.p50, self.p99, self.max
        );
    }
}

fn hogs(run: &Run, book: &mut Book) -> Result<(), String> {
    let world = World::new(&["fixture_chaos", "fixture_torture"])?;
    let mut host = Program::host(&world, "a", None)?;
    let rpc = Rpc::at(&host.address);
    let periodic = Execution {
        model: "periodic".into(),
        rate_hz: Some(1000.0),
        priority: Some(PRIORITY),
        ..Execution::default()
    };
    start_late(&rpc, "a/late", json!({}), periodic)?;
    // Its thread is its own; the host only starts and stops it. One on each processor, since what is taken
    // away of one (by the machine below this one, too) is not taken of the other, and a step may be on
    // either.
    let passive = Execution { rate_hz: Some(1.0), ..Execution::default() };
    let processors = thread::available_parallelism().map_or(1, usize::from);
    let bare: Vec<String> = (0..processors).map(|cpu| format!("a/bare-{cpu}")).collect();
    for (cpu, path) in bare.iter().enumerate() {
        let config = json!({ "bare_priority": PRIORITY, "bare_cpu": cpu });
        start_late(&rpc, path, config, passive.clone())?;
    }
    // Whatever the first requests cost is over.
    Lateness::of(&rpc, "a/late")?;
    Lateness::of_all(&rpc, &bare)?;
    let held = Holdings::of(&[("a", host.pid())]);
    let ms = run.times(3_000, 60_000);
    pause_ms(ms / 2);
    Lateness::of(&rpc, "a/late")?.say("without hogs");
    Lateness::of_all(&rpc, &bare)?.iter().for_each(|one| one.say("without hogs, a bare thread"));
    let before = rpc.stats("a/late")?;
    {
        let _hogs = Hogs::begin(&world)?;
        pause_ms(ms);
        let answered = rpc.brief();
        book.check("the host answers meanwhile", 1, answered.map(drop).map_err(|e| e.to_string()));
        let (ours, bare) = (Lateness::of(&rpc, "a/late")?, Lateness::of_all(&rpc, &bare)?);
        ours.say("with hogs");
        bare.iter().for_each(|one| one.say("with hogs, a bare thread"));
        let after = rpc.stats("a/late")?;
        if !after.realtime || !bare.iter().all(|one| one.granted) {
            book.leaves_out(
                "real-time priorities, which this machine does not grant: all threads are ordinary",
            );
        }
        let what = "1 kHz beside hogs: 99th percentile of the lateness, beside 1.5 × a bare thread";
        let latest = bare.iter().map(|one| one.p99).fold(0.0, f64::max);
        book.beside(what, ours.count as usize, ours.p99, 1.5 * latest, BEYOND_US, "µs");
        let elapsed = (after.executed + after.skipped).saturating_sub(before.executed + before.skipped);
        let part = |periods: u64| periods as f64 * 100.0 / elapsed.max(1) as f64;
        // A bare thread notes a period each time it wakes: what is missing it slept through.
        let missed = bare.iter().map(|one| elapsed.saturating_sub(one.count)).sum();
        let skipped = part(after.skipped - before.skipped);
        book.beside("periods missed", elapsed as usize, skipped, part(missed), 0.5, "%");
    }
    book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    host.terminate()?;
    nothing_is_left(book, &world);
    Ok(())
}
