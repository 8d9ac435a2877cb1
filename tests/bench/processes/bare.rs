//! What two processes charge each other without trocar: a ring in a memfd both map, and a futex.
//!
//! Invariant: the other end is this program again, told so by its first argument; it ends with its pipe or
//! after what it was to do.

use std::hint::black_box;
use std::io::{BufRead, BufReader, Lines, Write};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::baseline::{exact_timers, now_ns, sleep_until};
use crate::table::median;

/// First argument of the other end.
pub(crate) const OTHER_END: &str = "--bare";

/// Slots of the ring.
const SLOTS: usize = 4;
/// Bytes before a slot's content, its time of sending among them, and between what two processes write.
const LINE: usize = 64;
/// Larger samples are not written anew each time, as frames are not, B.
const WRITTEN: usize = 1 << 16;
/// Samples before those that count.
const WARM: usize = 200;
/// Between two round trips.
const REST: Duration = Duration::from_micros(20);

/// A latched word somebody sleeps on.
#[repr(C, align(64))]
struct Bell(AtomicU32);

const EMPTY: u32 = 0;
const RUNG: u32 = 1;
const ASLEEP: u32 = 2;

impl Bell {
    fn ring(&self) {
        if self.0.swap(RUNG, Ordering::AcqRel) == ASLEEP {
            // SAFETY: the word lives; nothing but it is touched.
            unsafe { libc::syscall(libc::SYS_futex, self.0.as_ptr(), libc::FUTEX_WAKE, 1) };
        }
    }

    fn wait(&self) {
        while self.0.swap(EMPTY, Ordering::AcqRel) != RUNG {
            if self.0.compare_exchange(EMPTY, ASLEEP, Ordering::AcqRel, Ordering::Acquire).is_ok() {
                let forever = std::ptr::null::<libc::timespec>();
                // SAFETY: as above; without a time it sleeps until it is woken.
                unsafe { libc::syscall(libc::SYS_futex, self.0.as_ptr(), libc::FUTEX_WAIT, ASLEEP, forever) };
            }
        }
    }
}

/// A position in the ring.
#[repr(C, align(64))]
struct Position(AtomicU64);

/// One direction: who takes is rung for.
#[repr(C)]
struct Lane {
    bell: Bell,
    put: Position,
    taken: Position,
}

#[repr(C)]
struct Head {
    there: Lane,
    back: Lane,
}

/// Memory of both, mapped until the end of the process that maps it.
struct Shared {
    memory: OwnedFd,
    start: *mut u8,
    /// Of one slot, content only, B.
    bytes: usize,
}

impl Shared {
    fn stride(bytes: usize) -> usize {
        LINE + bytes.next_multiple_of(LINE)
    }

    fn length(bytes: usize) -> usize {
        size_of::<Head>() + SLOTS * Shared::stride(bytes)
    }

    fn create(bytes: usize) -> Shared {
        // SAFETY: the name is a C string; no flag, so that the other end inherits it.
        let fd = unsafe { libc::memfd_create(c"bench".as_ptr(), 0) };
        assert!(fd >= 0, "no memfd: {}", std::io::Error::last_os_error());
        // SAFETY: it was just made, and nobody else has it.
        let memory = unsafe { OwnedFd::from_raw_fd(fd) };
        // SAFETY: concerns this file alone.
        let sized = unsafe { libc::ftruncate(fd, Shared::length(bytes) as i64) };
        assert!(sized == 0, "no {bytes} B in a memfd: {}", std::io::Error::last_os_error());
        Shared::map(memory, bytes)
    }

    fn map(memory: OwnedFd, bytes: usize) -> Shared {
        let (length, rights) = (Shared::length(bytes), libc::PROT_READ | libc::PROT_WRITE);
        let fd = memory.as_raw_fd();
        // SAFETY: a mapping of its own, where the kernel wants it.
        let start = unsafe { libc::mmap(std::ptr::null_mut(), length, rights, libc::MAP_SHARED, fd, 0) };
        assert!(start != libc::MAP_FAILED, "no mapping: {}", std::io::Error::last_os_error());
        Shared { memory, start: start.cast(), bytes }
    }

    fn head(&self) -> &Head {
        // SAFETY: the mapping begins with it, is never taken away, and consists of atomics.
        unsafe { &*self.start.cast::<Head>() }
    }

    fn slot(&self, position: u64) -> *mut u8 {
        let at = position as usize % SLOTS;
        // SAFETY: inside the mapping, whose length counts all slots.
        unsafe { self.start.add(size_of::<Head>() + at * Shared::stride(self.bytes)) }
    }

    /// Puts a sample into the ring and wakes who takes it; false when the ring is full.
    fn put(&self, lane: &Lane, word: u64, content: &[u8]) -> bool {
        let position = lane.put.0.load(Ordering::Relaxed);
        if position - lane.taken.0.load(Ordering::Acquire) >= SLOTS as u64 {
            return false;
        }
        let slot = self.slot(position);
        // SAFETY: the slot is this end's until the position moves; content is no longer than a slot's.
        unsafe {
            slot.cast::<u64>().write(word);
            std::ptr::copy_nonoverlapping(content.as_ptr(), slot.add(LINE), content.len().min(self.bytes));
        }
        lane.put.0.store(position + 1, Ordering::Release);
        lane.bell.ring();
        true
    }

    /// Takes the oldest sample, having looked at the first and the last byte of it.
    fn take(&self, lane: &Lane) -> Option<u64> {
        let position = lane.taken.0.load(Ordering::Relaxed);
        if position == lane.put.0.load(Ordering::Acquire) {
            return None;
        }
        let slot = self.slot(position);
        // SAFETY: the slot is this end's until the position moves.
        let word = unsafe {
            black_box(slot.add(LINE).read().wrapping_add(slot.add(LINE + self.bytes - 1).read()));
            slot.cast::<u64>().read()
        };
        lane.taken.0.store(position + 1, Ordering::Release);
        Some(word)
    }

    /// This program again, at the other end; it has said that it is ready.
    fn other_end(&self, what: &str, count: usize) -> (Child, Lines<BufReader<ChildStdout>>) {
        let me = std::env::current_exe().expect("this program has a path");
        let numbers = [self.memory.as_raw_fd().to_string(), self.bytes.to_string(), count.to_string()];
        let mut command = Command::new(me);
        command.args([OTHER_END, what]).args(numbers).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("this program starts again");
        let mut lines = BufReader::new(child.stdout.take().expect("its output is a pipe")).lines();
        let said = lines.next().expect("the other end says that it is ready").expect("it can be read");
        assert_eq!(said, "ready");
        (child, lines)
    }
}

/// p50 and p99 of the way of a sample, ns, sent each `period_ns` to a process that sleeps.
pub(crate) fn one_way(bytes: usize, count: usize, period_ns: u64) -> (f64, f64) {
    let shared = Shared::create(bytes);
    let (mut child, mut lines) = shared.other_end("take", count);
    let content = vec![1u8; if bytes <= WRITTEN { bytes } else { 0 }];
    let sender = std::thread::spawn({
        // The timers of a thread of its own, as a component's.
        let shared = Sendable(shared);
        move || {
            let shared = &shared;
            exact_timers();
            let mut due = now_ns();
            let mut left = WARM + count;
            while left > 0 {
                due += period_ns;
                sleep_until(due);
                left -= usize::from(shared.0.put(&shared.0.head().there, now_ns(), &content));
            }
        }
    });
    let line = lines.next().expect("the other end answers").expect("it can be read");
    sender.join().expect("the sending thread does not panic");
    child.wait().expect("the other end ends");
    let mut figures = line.split(' ').map(|n| n.parse().expect("a number"));
    (figures.next().expect("p50"), figures.next().expect("p99"))
}

/// There and back again, median ns, each time when the other end has gone to sleep.
pub(crate) fn ping_pong(trips: usize) -> f64 {
    let shared = Shared::create(LINE);
    let (mut child, _lines) = shared.other_end("echo", trips);
    let Head { there, back } = shared.head();
    let once = |i: u64| {
        let rested = Instant::now();
        while rested.elapsed() < REST {
            std::hint::spin_loop();
        }
        let began = Instant::now();
        shared.put(there, i, &[0; LINE]);
        while shared.take(back).is_none() {
            back.bell.wait();
        }
        began.elapsed().as_nanos() as f64
    };
    let ns = median((1..=trips as u64).map(once).collect());
    child.wait().expect("the other end ends");
    ns
}

/// kill -9 of a process that holds so many bytes, until a pipe from it ends, ns.
pub(crate) fn killed(bytes: usize) -> f64 {
    let shared = Shared::create(LINE);
    let (mut child, mut lines) = shared.other_end("hold", bytes);
    let began_ns = now_ns();
    child.kill().expect("it is a child");
    assert!(lines.next().is_none(), "it says nothing more");
    let ns = (now_ns() - began_ns) as f64;
    child.wait().expect("the other end ends");
    ns
}

struct Sendable(Shared);

// SAFETY: what is shared is atomics and slots that one end has at a time; the mapping stays.
unsafe impl Send for Sendable {}

/// `--bare WHAT FD BYTES COUNT`: takes samples and says how long they took, or sends each back; or holds
/// memory until it is killed.
pub(crate) fn run_other_end(args: &[String]) {
    let number = |at: usize| args[at].parse::<usize>().expect("a number");
    let (fd, bytes, count) = (number(1), number(2), number(3));
    // SAFETY: inherited for this process, which has nothing else of that number.
    let shared = Shared::map(unsafe { OwnedFd::from_raw_fd(fd as i32) }, bytes);
    let Head { there, back } = shared.head();
    let held = vec![1u8; if args[0] == "hold" { count } else { 0 }];
    println!("ready");
    std::io::stdout().flush().expect("its parent listens");
    while !black_box(&held).is_empty() {
        std::thread::park();
    }
    let mut ways = Vec::with_capacity(WARM + count);
    let all = if args[0] == "take" { WARM + count } else { count };
    while ways.len() < all {
        match shared.take(there) {
            None => there.bell.wait(),
            Some(when) => {
                ways.push(now_ns().saturating_sub(when));
                if args[0] == "echo" {
                    shared.put(back, when, &[0; LINE]);
                }
            }
        }
    }
    if args[0] == "take" {
        let ways = &mut ways[WARM..];
        ways.sort_unstable();
        println!("{} {}", ways[ways.len() / 2], ways[ways.len() * 99 / 100]);
    }
}
