//! What the machine charges without trocar: a call, a clock, a copy, a wake, a sleep.

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::table::median;

/// Calls per run of a cheap loop, and runs.
const CHEAP: u32 = 20_000;
const RUNS: usize = 31;

/// Between two round trips.
const REST: Duration = Duration::from_micros(20);

/// One call through a function pointer the compiler cannot see through, ns.
pub(crate) fn call() -> f64 {
    fn add(x: u64) -> u64 {
        black_box(x).wrapping_add(1)
    }
    let run = || {
        let f: fn(u64) -> u64 = black_box(add);
        let began = Instant::now();
        for i in 0..u64::from(CHEAP) {
            black_box(f(black_box(i)));
        }
        began.elapsed().as_nanos() as f64 / f64::from(CHEAP)
    };
    median((0..RUNS).map(|_| run()).collect())
}

/// One look at the monotonic clock, ns.
pub(crate) fn clock() -> f64 {
    let run = || {
        let began = Instant::now();
        for _ in 0..CHEAP {
            black_box(Instant::now());
        }
        began.elapsed().as_nanos() as f64 / f64::from(CHEAP)
    };
    median((0..RUNS).map(|_| run()).collect())
}

/// A copy of so many bytes that lie in the cache, ns.
pub(crate) fn copy(bytes: usize) -> f64 {
    let (from, mut to) = (vec![1u8; bytes], vec![0u8; bytes]);
    let times = (20_000_000 / bytes).clamp(1, CHEAP as usize);
    let mut run = || {
        let began = Instant::now();
        for _ in 0..times {
            black_box(&mut to).copy_from_slice(black_box(&from));
        }
        began.elapsed().as_nanos() as f64 / times as f64
    };
    median((0..RUNS).map(|_| run()).collect())
}

/// Words a bare ring holds.
const SLOTS: usize = 256;

/// One end of a bare ring of words, none of which is 0; each word passes with one store and one load.
struct End {
    ring: Arc<[AtomicU64; SLOTS]>,
    at: usize,
}

impl End {
    /// The end that puts and the end that takes.
    fn pair() -> (End, End) {
        let ring = Arc::new([const { AtomicU64::new(0) }; SLOTS]);
        (End { ring: ring.clone(), at: 0 }, End { ring, at: 0 })
    }

    /// False when the ring is full.
    fn put(&mut self, word: u64) -> bool {
        let slot = &self.ring[self.at % SLOTS];
        let room = slot.load(Ordering::Acquire) == 0;
        if room {
            slot.store(word, Ordering::Release);
            self.at += 1;
        }
        room
    }

    fn take(&mut self) -> Option<u64> {
        let slot = &self.ring[self.at % SLOTS];
        let word = slot.load(Ordering::Acquire);
        if word == 0 {
            return None;
        }
        slot.store(0, Ordering::Release);
        self.at += 1;
        Some(word)
    }
}

/// A word put into a ring for a thread that takes it out, both busy; ns per word.
pub(crate) fn ring(words: u64) -> f64 {
    let (mut put, mut take) = End::pair();
    let taker = thread::spawn(move || {
        for _ in 0..words {
            while take.take().is_none() {
                std::hint::spin_loop();
            }
        }
    });
    let began = Instant::now();
    for i in 1..=words {
        while !put.put(i) {
            std::hint::spin_loop();
        }
    }
    taker.join().expect("the taking thread does not panic");
    began.elapsed().as_nanos() as f64 / words as f64
}

/// A word put into a ring for a thread that sleeps on a futex, and back through another ring, median ns for
/// both ways: what any queued call has to pay.
pub(crate) fn ping_pong(trips: u64) -> f64 {
    let ((mut ask, mut asked), (mut answer, mut answered)) = (End::pair(), End::pair());
    let caller = thread::current();
    let server = thread::spawn(move || {
        let mut left = trips;
        while left > 0 {
            let Some(word) = asked.take() else {
                thread::park();
                continue;
            };
            // There is never more than one on its way.
            answer.put(word);
            caller.unpark();
            left -= 1;
        }
    });
    let mut trip = |i: u64| {
        // Each time when the other one has gone to sleep, as for a component.
        let rested = Instant::now();
        while rested.elapsed() < REST {
            std::hint::spin_loop();
        }
        let began = Instant::now();
        ask.put(i);
        server.thread().unpark();
        while answered.take() != Some(i) {
            thread::park();
        }
        began.elapsed().as_nanos() as f64
    };
    let ns = median((1..=trips).map(&mut trip).collect());
    server.join().expect("the echoing thread does not panic");
    ns
}

/// How late a bare loop of sleeps until absolute times begins its turns, ns; ended by `stop`.
pub(crate) fn sleeper(period_ns: u64, stop: Arc<AtomicBool>) -> thread::JoinHandle<Vec<f64>> {
    thread::spawn(move || {
        exact_timers();
        let mut late = Vec::with_capacity(1 << 22);
        let mut due = now_ns() + period_ns;
        while !stop.load(Ordering::Acquire) {
            sleep_until(due);
            let late_ns = now_ns().saturating_sub(due);
            late.push(late_ns as f64);
            due += period_ns * (1 + late_ns / period_ns);
        }
        late
    })
}

/// As exact as the kernel can, like a component's thread.
pub(crate) fn exact_timers() {
    // SAFETY: concerns this thread alone.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
}

/// Sleeps until a time of the monotonic clock.
pub(crate) fn sleep_until(due_ns: u64) {
    let (tv_sec, tv_nsec) = ((due_ns / 1_000_000_000) as i64, (due_ns % 1_000_000_000) as i64);
    let until = libc::timespec { tv_sec, tv_nsec };
    let absolute = libc::TIMER_ABSTIME;
    // SAFETY: the time lives for the call; nobody asks for the rest.
    unsafe { libc::clock_nanosleep(libc::CLOCK_MONOTONIC, absolute, &until, std::ptr::null_mut()) };
}

/// The monotonic clock, ns.
pub(crate) fn now_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: room for one time.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
