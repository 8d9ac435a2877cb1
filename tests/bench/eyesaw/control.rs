//! Control: the machine itself meanwhile, by threads without trocar that have the same periods and the same
//! work.
//!
//! Invariant: nothing of trocar is called here, so whatever is late or lost here is the machine's doing.

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::{self, JoinHandle};

use super::plan::{FAST_PRIORITIES, VIDEO_PRIORITY};
use crate::baseline::{exact_timers, now_ns, sleep_until};

const MS: u64 = 1_000_000;
/// Of the canonical load, ns.
pub(super) const FRAME_NS: u64 = 1_000_000_000 / 30;
/// Lines of a millisecond, and the most that a source fetches at once: what is late by more loses lines.
const LINES_PER_MS: u64 = 4;
const MOST_LINES: u64 = 64;
/// Frames that may wait.
const FRAMES: u64 = 2;

/// Threads that sleep from one ms to the next, one on each processor.
pub(super) struct Witness {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    ends: AtomicBool,
    /// The longest since it was forgotten, ns.
    worst_ns: AtomicU64,
    /// What sources and queues of the same size would have lost.
    lines: AtomicU64,
    frames: AtomicU64,
    periods: AtomicU64,
    frame_periods: AtomicU64,
}

impl Shared {
    fn look(&self, processor: usize) {
        pin(processor);
        exact_timers();
        let mut due = now_ns() + MS;
        while !self.ends.load(Ordering::Relaxed) {
            sleep_until(due);
            let late_ns = now_ns().saturating_sub(due);
            self.worst_ns.fetch_max(late_ns, Ordering::Relaxed);
            let waiting = (late_ns + MS) * LINES_PER_MS / MS;
            self.lines.fetch_add(waiting.saturating_sub(MOST_LINES), Ordering::Relaxed);
            self.frames.fetch_add((late_ns / FRAME_NS).saturating_sub(FRAMES), Ordering::Relaxed);
            self.periods.fetch_add(late_ns / MS, Ordering::Relaxed);
            self.frame_periods.fetch_add(late_ns / FRAME_NS, Ordering::Relaxed);
            due += MS * (1 + late_ns / MS);
        }
    }
}

/// What was lost without trocar, on all processors together: a thread of trocar's may be on any of them.
#[derive(Clone, Copy)]
pub(super) struct Lost {
    pub(super) lines: f64,
    pub(super) frames: f64,
    /// Of a ms, and of a frame.
    pub(super) periods: f64,
    pub(super) frame_periods: f64,
}

impl Witness {
    pub(super) fn start() -> Witness {
        let shared = Arc::new(Shared::default());
        let processors = thread::available_parallelism().map_or(1, usize::from);
        let begin = |processor| {
            let shared = shared.clone();
            thread::spawn(move || shared.look(processor))
        };
        let threads = (0..processors).map(begin).collect();
        Witness { shared, threads }
    }

    pub(super) fn forget(&self) {
        self.shared.worst_ns.store(0, Ordering::Relaxed);
    }

    /// By how much two threads one after the other may have been late, ns.
    pub(super) fn late_ns(&self) -> f64 {
        2.0 * self.shared.worst_ns.load(Ordering::Relaxed) as f64
    }

    pub(super) fn lost(&self) -> Lost {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed) as f64;
        let Shared { lines, frames, periods, frame_periods, .. } = &*self.shared;
        Lost { lines: of(lines), frames: of(frames), periods: of(periods), frame_periods: of(frame_periods) }
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // It only sleeps.
            let _ = thread.join();
        }
    }
}

/// As the plan asks for it; where it is refused to trocar, it is refused here.
fn be_urgent(priority: i32) {
    let priority = libc::sched_param { sched_priority: priority };
    // SAFETY: the parameter lives for the call, which is for the calling thread.
    unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &priority) };
}

fn pin(processor: usize) {
    // SAFETY: an empty set of processors is all zeros.
    let mut only: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: the set lives for both calls; where it is refused, the thread sees what it is given.
    unsafe {
        libc::CPU_SET(processor, &mut only);
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &only);
    }
}

/// The work of the canonical load: what its threads do in each of their periods, ns.
#[derive(Clone, Copy)]
pub(super) struct Nominal {
    pub(super) source: f64,
    /// All behind it.
    pub(super) filters: f64,
    /// Of the 1 kHz threads.
    pub(super) fast: [f64; 3],
}

/// What bare threads with this work needed from a frame's begin to its end beyond the work itself.
#[derive(Clone, Copy)]
pub(super) struct Beyond {
    pub(super) mean_ns: f64,
    pub(super) p50_ns: f64,
    pub(super) p99_ns: f64,
}

/// Runs the same periods and the same work on bare threads.
pub(super) fn bare(work: Nominal, seconds: u64) -> Beyond {
    let spin = Spin::calibrated();
    let end = now_ns() + seconds * 1000 * MS;
    let mut priorities = FAST_PRIORITIES.into_iter();
    let fast = work.fast.map(|ns| {
        let priority = priorities.next();
        thread::spawn(move || {
            priority.into_iter().for_each(be_urgent);
            exact_timers();
            let mut due = now_ns();
            while due < end {
                due += MS;
                sleep_until(due);
                spin.work(ns);
                due += now_ns().saturating_sub(due) / MS * MS;
            }
        })
    });
    let (hand_on, taken) = sync_channel::<u64>(FRAMES as usize);
    let filters = thread::spawn(move || {
        be_urgent(VIDEO_PRIORITY);
        let mut ages = Vec::new();
        while let Ok(begun_ns) = taken.recv() {
            spin.work(work.filters);
            ages.push((now_ns() - begun_ns) as f64);
        }
        ages
    });
    let source = thread::spawn(move || {
        be_urgent(VIDEO_PRIORITY);
        exact_timers();
        let mut due = now_ns();
        while due < end {
            due += FRAME_NS;
            sleep_until(due);
            let begun_ns = now_ns();
            spin.work(work.source);
            // A full queue loses the frame.
            let _ = hand_on.try_send(begun_ns);
            due += now_ns().saturating_sub(due) / FRAME_NS * FRAME_NS;
        }
    });
    source.join().expect("a thread that spins does not panic");
    for thread in fast {
        thread.join().expect("a thread that spins does not panic");
    }
    let mut ages = filters.join().expect("a thread that spins does not panic");
    ages.sort_by(f64::total_cmp);
    let nominal_ns = work.source + work.filters;
    let beyond = |ns: f64| (ns - nominal_ns).max(0.0);
    let mean_ns = ages.iter().sum::<f64>() / ages.len() as f64;
    let of = |percent: usize| beyond(ages[ages.len() * percent / 100]);
    Beyond { mean_ns: beyond(mean_ns), p50_ns: of(50), p99_ns: of(99) }
}

/// By how much 99 of 100 turns of a bare thread with this period took longer at most than their work takes,
/// ns.
pub(super) fn longer(period_ns: u64, work_ns: f64, seconds: u64) -> f64 {
    let spin = Spin::calibrated();
    let end = now_ns() + seconds * 1000 * MS;
    let turns = thread::spawn(move || {
        be_urgent(FAST_PRIORITIES[1]);
        exact_timers();
        let (mut took, mut due) = (Vec::new(), now_ns());
        while due < end {
            due += period_ns;
            sleep_until(due);
            let began_ns = now_ns();
            spin.work(work_ns);
            took.push((now_ns() - began_ns) as f64);
            due += now_ns().saturating_sub(due) / period_ns * period_ns;
        }
        took
    });
    let mut took = turns.join().expect("a thread that spins does not panic");
    took.sort_by(f64::total_cmp);
    (took[took.len() * 99 / 100] - work_ns).max(0.0)
}

/// Work of a known length that is no longer when the thread is set aside.
#[derive(Clone, Copy)]
struct Spin {
    turns_per_ns: f64,
}

impl Spin {
    fn calibrated() -> Spin {
        const TURNS: u64 = 1_000_000;
        let once = || {
            let began = now_ns();
            turn(TURNS);
            (now_ns() - began) as f64
        };
        let least_ns = (0..50).map(|_| once()).fold(f64::MAX, f64::min);
        Spin { turns_per_ns: TURNS as f64 / least_ns }
    }

    fn work(self, ns: f64) {
        turn((ns * self.turns_per_ns) as u64);
    }
}

fn turn(times: u64) {
    let mut x = 1u64;
    for i in 0..times {
        x = black_box(x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(i));
    }
    black_box(x);
}

/// Time that the host of this machine has taken from all its processors so far, s; 0 on one that is no guest.
pub(super) fn stolen_s() -> f64 {
    let all = std::fs::read_to_string("/proc/stat").unwrap_or_default();
    // Of the first line, user, nice, system, idle, iowait, irq, softirq, steal.
    let ticks = all.split_whitespace().nth(8).and_then(|ticks| ticks.parse::<f64>().ok()).unwrap_or(0.0);
    ticks / rustix::param::clock_ticks_per_second() as f64
}
