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

/// A word put into a ring for a thread that takes it out, both busy; ns per word.
pub(crate) fn ring(words: u64) -> f64 {
    const SLOTS: u64 = 256;
    let ring: Arc<Vec<AtomicU64>> = Arc::new((0..SLOTS).map(|_| AtomicU64::new(0)).collect());
    let taker = {
        let ring = ring.clone();
        thread::spawn(move || {
            for i in 1..=words {
                let slot = &ring[(i % SLOTS) as usize];
                while slot.load(Ordering::Acquire) != i {
                    std::hint::spin_loop();
                }
                slot.store(0, Ordering::Release);
            }
        })
    };
    let began = Instant::now();
    for i in 1..=words {
        let slot = &ring[(i % SLOTS) as usize];
        while slot.load(Ordering::Acquire) != 0 {
            std::hint::spin_loop();
        }
        slot.store(i, Ordering::Release);
    }
    taker.join().expect("the taking thread does not panic");
    began.elapsed().as_nanos() as f64 / words as f64
}

/// A word handed to a sleeping thread through a futex and back, median ns for both ways: what any queued call has to pay.
pub(crate) fn ping_pong(trips: u64) -> f64 {
    let (there, back) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let stop = Arc::new(AtomicBool::new(false));
    let caller = thread::current();
    let server = {
        let (there, back, stop) = (there.clone(), back.clone(), stop.clone());
        thread::spawn(move || {
            let mut seen = 0;
            while !stop.load(Ordering::Acquire) {
                let now = there.load(Ordering::Acquire);
                if now == seen {
                    thread::park();
                    continue;
                }
                seen = now;
                back.store(now, Ordering::Release);
                caller.unpark();
            }
        })
    };
    let trip = |i: u64| {
        // Each time when the other one has gone to sleep, as for a component.
        let rested = Instant::now();
        while rested.elapsed() < REST {
            std::hint::spin_loop();
        }
        let began = Instant::now();
        there.store(i, Ordering::Release);
        server.thread().unpark();
        while back.load(Ordering::Acquire) != i {
            thread::park();
        }
        began.elapsed().as_nanos() as f64
    };
    let ns = median((1..=trips).map(trip).collect());
    stop.store(true, Ordering::Release);
    server.thread().unpark();
    server.join().expect("the echoing thread does not panic");
    ns
}

/// How late a bare loop of sleeps until absolute times begins its turns, ns; ended by `stop`.
pub(crate) fn sleeper(period_ns: u64, stop: Arc<AtomicBool>) -> thread::JoinHandle<Vec<f64>> {
    thread::spawn(move || {
        // As exact as the kernel can, like a component's thread.
        // SAFETY: concerns this thread alone.
        unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
        let mut late = Vec::with_capacity(1 << 22);
        let mut due = now_ns() + period_ns;
        while !stop.load(Ordering::Acquire) {
            let (tv_sec, tv_nsec) = ((due / 1_000_000_000) as i64, (due % 1_000_000_000) as i64);
            let until = libc::timespec { tv_sec, tv_nsec };
            // SAFETY: the time lives for the call; nobody asks for the rest.
            unsafe {
                libc::clock_nanosleep(
                    libc::CLOCK_MONOTONIC,
                    libc::TIMER_ABSTIME,
                    &until,
                    std::ptr::null_mut(),
                )
            };
            let late_ns = now_ns().saturating_sub(due);
            late.push(late_ns as f64);
            due += period_ns * (1 + late_ns / period_ns);
        }
        late
    })
}

/// The monotonic clock, ns.
fn now_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: room for one time.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
