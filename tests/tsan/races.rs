//! Races the thread sanitizer must report, and edges it must not: the check of the tool itself, before the
//! suite is believed.
//!
//! Invariant: one case per process, named by the argument; without one all are listed, each with `race` or
//! `order` before it. The races are there on purpose, beside edges that must not be mistaken for the missing
//! one.
#![allow(clippy::unwrap_used)]

use std::cell::UnsafeCell;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering, fence};
use std::sync::{Arc, Condvar, LazyLock, Mutex, OnceLock, RwLock, mpsc};
use std::{env, process, thread};

/// A number that anybody may touch at any time.
struct Bare(UnsafeCell<u64>);

// SAFETY: not safe by itself: the cases order what they do with it, or are there to be caught.
unsafe impl Sync for Bare {}

static BARE: Bare = Bare::new();

impl Bare {
    const fn new() -> Self {
        Self(UnsafeCell::new(0))
    }

    fn add(&self) -> u64 {
        // SAFETY: in the cases of order nobody else is here; in the others that is the very thing the
        // sanitizer must deny.
        unsafe {
            *self.0.get() += 1;
            *self.0.get()
        }
    }

    fn get(&self) -> u64 {
        // SAFETY: as in `add`.
        unsafe { *self.0.get() }
    }
}

const ROUNDS: u32 = 2_000;

/// Both at the same time, in threads that know nothing of each other.
fn both(one: impl FnOnce() + Send, other: impl FnOnce() + Send) {
    thread::scope(|scope| {
        let threads = [scope.spawn(one), scope.spawn(other)];
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    });
}

fn until(flag: &AtomicBool) {
    while !flag.load(Ordering::Relaxed) {
        thread::yield_now();
    }
}

/// Long enough inside for the other to wait: what is to be seen is the contended lock.
fn inside() {
    BARE.add();
    thread::yield_now();
}

fn nothing_between() {
    let adds = || _ = BARE.add();
    both(adds, adds);
}

/// The flag says that it is there, and orders nothing.
fn a_relaxed_flag() {
    static READY: AtomicBool = AtomicBool::new(false);
    both(
        || {
            BARE.add();
            READY.store(true, Ordering::Relaxed);
        },
        || {
            until(&READY);
            BARE.add();
        },
    );
}

fn another_mutex_each() {
    static MUTEXES: [Mutex<()>; 2] = [Mutex::new(()), Mutex::new(())];
    // Each is contended, by two threads that take nothing but it.
    let locks = |mutex: &'static Mutex<()>| move || (0..ROUNDS).for_each(|_| drop(mutex.lock().unwrap()));
    let adds = |mutex: &'static Mutex<()>| {
        move || {
            for _ in 0..ROUNDS {
                let _held = mutex.lock().unwrap();
                inside();
            }
        }
    };
    let [one, other] = &MUTEXES;
    both(|| both(adds(one), locks(one)), || both(adds(other), locks(other)));
}

/// Adds when the last share of it is dropped.
struct Last;

impl Drop for Last {
    fn drop(&mut self) {
        BARE.add();
    }
}

/// Who gave up its share still adds; the last one has not waited for that.
fn after_its_share_of_an_arc() {
    static GIVEN_UP: AtomicBool = AtomicBool::new(false);
    let mine = Arc::new(Last);
    let theirs = Arc::clone(&mine);
    both(
        move || {
            drop(theirs);
            BARE.add();
            GIVEN_UP.store(true, Ordering::Relaxed);
        },
        move || {
            until(&GIVEN_UP);
            drop(mine);
        },
    );
}

/// Counted down without a release: the fence of the last has nothing to acquire.
fn a_relaxed_count() {
    static NUMBERS: [Bare; 2] = [Bare::new(), Bare::new()];
    static COUNT: AtomicUsize = AtomicUsize::new(2);
    let gives_up = |own: usize| {
        move || {
            NUMBERS[own].add();
            if COUNT.fetch_sub(1, Ordering::Relaxed) == 1 {
                fence(Ordering::Acquire);
                NUMBERS[1 - own].add();
            }
        }
    };
    both(gives_up(0), gives_up(1));
}

fn one_mutex() {
    static MUTEX: Mutex<()> = Mutex::new(());
    let adds = || {
        for _ in 0..ROUNDS {
            let _held = MUTEX.lock().unwrap();
            inside();
        }
    };
    both(adds, adds);
}

fn one_lock_of_readers_and_writers() {
    static LOCK: RwLock<()> = RwLock::new(());
    both(
        || {
            for _ in 0..ROUNDS {
                let _held = LOCK.write().unwrap();
                inside();
            }
        },
        || {
            for _ in 0..ROUNDS {
                let _held = LOCK.read().unwrap();
                assert!(BARE.get() <= u64::from(ROUNDS));
                thread::yield_now();
            }
        },
    );
}

fn turns_by_a_condvar() {
    static TURN: (Mutex<u32>, Condvar) = (Mutex::new(0), Condvar::new());
    let takes = |own: u32| {
        move || {
            for _ in 0..ROUNDS {
                let mut turn = TURN.0.lock().unwrap();
                while *turn % 2 != own {
                    turn = TURN.1.wait(turn).unwrap();
                }
                BARE.add();
                *turn += 1;
                TURN.1.notify_one();
            }
        }
    };
    both(takes(0), takes(1));
}

fn made_once() {
    static MADE: LazyLock<u64> = LazyLock::new(|| BARE.add());
    static SET: OnceLock<Box<u64>> = OnceLock::new();
    let uses = || assert_eq!(**SET.get_or_init(|| Box::new(*MADE)), BARE.get());
    both(uses, uses);
}

/// One number for each of two owners; what drops it looks at both.
struct Shares([Bare; 2]);

impl Drop for Shares {
    fn drop(&mut self) {
        assert_eq!(self.0.each_ref().map(Bare::get), [1, 1]);
    }
}

/// Whoever is the last sees what the other one did.
fn the_last_share_of_an_arc() {
    let owns = |shares: Arc<Shares>, own: usize| move || _ = shares.0[own].add();
    for _ in 0..ROUNDS / 10 {
        let shares = Arc::new(Shares([Bare::new(), Bare::new()]));
        let other = Arc::clone(&shares);
        both(owns(shares, 0), owns(other, 1));
    }
}

fn handed_over_by_a_channel() {
    let (give, take) = mpsc::channel();
    both(
        move || (0..ROUNDS).for_each(|_| give.send(Box::new(1)).unwrap()),
        move || assert_eq!(take.iter().map(|one| *one).sum::<u32>(), ROUNDS),
    );
}

const RACES: [(&str, fn()); 5] = [
    ("nothing_between", nothing_between),
    ("a_relaxed_flag", a_relaxed_flag),
    ("another_mutex_each", another_mutex_each),
    ("after_its_share_of_an_arc", after_its_share_of_an_arc),
    ("a_relaxed_count", a_relaxed_count),
];

const ORDERS: [(&str, fn()); 6] = [
    ("one_mutex", one_mutex),
    ("one_lock_of_readers_and_writers", one_lock_of_readers_and_writers),
    ("turns_by_a_condvar", turns_by_a_condvar),
    ("made_once", made_once),
    ("the_last_share_of_an_arc", the_last_share_of_an_arc),
    ("handed_over_by_a_channel", handed_over_by_a_channel),
];

fn main() {
    let Some(wanted) = env::args().nth(1) else {
        RACES.iter().for_each(|(name, _)| println!("race {name}"));
        ORDERS.iter().for_each(|(name, _)| println!("order {name}"));
        return;
    };
    match RACES.iter().chain(&ORDERS).find(|(name, _)| *name == wanted) {
        Some((_, case)) => case(),
        None => {
            eprintln!("there is no case '{wanted}'; without an argument they are listed");
            process::exit(2);
        }
    }
}
