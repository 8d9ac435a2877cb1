//! The host's clock, and a witness of how late this machine is right now.
//!
//! Invariant: the witness does nothing but sleep until the next millisecond, so what it is late is the
//! machine's doing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rustix::thread::{CpuSet, sched_setaffinity};
use rustix::time::{ClockId, clock_gettime};

use crate::book::Timed;

/// CLOCK_MONOTONIC, ns: the clock of every stamp.
pub(crate) fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    u64::try_from(now.tv_sec).unwrap_or(0) * 1_000_000_000 + u64::try_from(now.tv_nsec).unwrap_or(0)
}

pub(crate) fn pause_ms(ms: u64) {
    thread::sleep(Duration::from_millis(ms));
}

/// A wait fails when what it observes has not changed for so long, whatever it takes in all.
const STANDSTILL: Duration = Duration::from_secs(60);

/// Watches a wait for progress: each change of what is observed is some.
pub(crate) struct Watchdog<'a> {
    what: &'a str,
    last: String,
    since: Instant,
}

impl<'a> Watchdog<'a> {
    pub(crate) fn of(what: &'a str) -> Watchdog<'a> {
        Watchdog { what, last: String::new(), since: Instant::now() }
    }

    /// The present observation, in words; an error when it has stood still for too long.
    pub(crate) fn sees(&mut self, now: String) -> Result<(), String> {
        if now != self.last {
            (self.last, self.since) = (now, Instant::now());
        } else if self.since.elapsed() > STANDSTILL {
            let s = STANDSTILL.as_secs();
            return Err(format!("{}: nothing has changed for {s} s: {}", self.what, self.last));
        }
        Ok(())
    }
}

/// Asks until the answer is there. The reason why it is not is what is observed: it names what changes on the
/// way there, and nothing else.
pub(crate) fn eventually<T>(what: &str, mut probe: impl FnMut() -> Result<T, String>) -> Result<T, String> {
    let mut watchdog = Watchdog::of(what);
    let mut pause = Duration::from_micros(200);
    loop {
        match probe() {
            Ok(value) => return Ok(value),
            Err(now) => watchdog.sees(now)?,
        }
        thread::sleep(pause);
        pause = (pause * 2).min(Duration::from_millis(5));
    }
}

const PERIOD: Duration = Duration::from_millis(1);
/// A sample goes through two threads at least, each of which may be as late.
const THREADS: f64 = 2.0;

/// Threads, one on each processor, that sleep from one millisecond to the next and note by how much they are
/// late.
pub(crate) struct Witness {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    ends: AtomicBool,
    /// Largest lateness since each was forgotten, ns.
    worst_ns: [AtomicU64; 3],
}

/// Since when a lateness counts.
#[derive(Clone, Copy)]
pub(crate) enum Since {
    /// What is timed right now began.
    Now,
    /// This moment of a row began.
    Moment,
    /// The witness is there.
    Ever,
}

impl Shared {
    fn look(&self, processor: usize) {
        let mut only = CpuSet::new();
        only.set(processor);
        // Where it is not allowed, the witness sees what it is given.
        let _ = sched_setaffinity(None, &only);
        let mut due = Instant::now() + PERIOD;
        while !self.ends.load(Ordering::Relaxed) {
            thread::sleep(due.saturating_duration_since(Instant::now()));
            let late = u64::try_from(due.elapsed().as_nanos()).unwrap_or(u64::MAX);
            for worst in &self.worst_ns {
                worst.fetch_max(late, Ordering::Relaxed);
            }
            due = (due + PERIOD).max(Instant::now());
        }
    }
}

impl Witness {
    pub(crate) fn start() -> Witness {
        let shared = Arc::new(Shared::default());
        let processors = thread::available_parallelism().map_or(1, usize::from);
        let begin = |processor| {
            let shared = shared.clone();
            thread::spawn(move || shared.look(processor))
        };
        let threads = (0..processors).map(begin).collect();
        Witness { shared, threads }
    }

    /// What is timed begins now.
    pub(crate) fn forget(&self) {
        self.begins(Since::Now);
    }

    pub(crate) fn begins(&self, what: Since) {
        self.shared.worst_ns[what as usize].store(0, Ordering::Relaxed);
    }

    /// By how much what goes through two threads may have been late since `forget`, ms.
    pub(crate) fn late_ms(&self) -> f64 {
        self.late_since(Since::Now)
    }

    pub(crate) fn late_since(&self, since: Since) -> f64 {
        THREADS * self.shared.worst_ns[since as usize].load(Ordering::Relaxed) as f64 / 1e6
    }

    /// A time between two moments, beside the lateness seen since `forget` or that of the control run,
    /// whichever is larger.
    pub(crate) fn timed(&self, from_ns: u64, to_ns: u64, control_ms: f64) -> Timed {
        Timed { ms: to_ns.saturating_sub(from_ns) as f64 / 1e6, late_ms: self.late_ms().max(control_ms) }
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
