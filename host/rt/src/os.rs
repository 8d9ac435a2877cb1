//! The Linux calls of the real-time core: clock, futex, sleep, and the settings of a real-time thread.
//!
//! Time is ns of CLOCK_MONOTONIC everywhere; a deadline is absolute on that clock.

mod descriptors;
mod environment;
mod forked;
mod household;
mod manners;
mod sockets;

use std::fmt;
use std::sync::atomic::AtomicU32;

pub use crate::sync::Scope;
pub use descriptors::{Descriptor, Lasting, replace};
pub use environment::Environment;
pub use forked::{Unshared, unshared};
pub use household::{Household, keep_streams, standard_error};
pub use manners::{Hygiene, reset_rounding, rounding, set_sigmask, thread_hygiene};
pub use sockets::{set_most_rate, set_most_unsent, set_priority};

/// Ns of CLOCK_MONOTONIC. Any thread, about 25 ns, no system call.
pub fn now_ns() -> u64 {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `t` is a valid place for the answer; CLOCK_MONOTONIC exists on every Linux.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut t) };
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Ends the process with this code, and runs nothing on the way: no handler of `atexit`, no destructor.
pub fn end_at_once(code: i32) -> ! {
    // SAFETY: it ends every thread of the process and comes back to none.
    unsafe { libc::_exit(code) }
}

/// Ticks since boot, as the kernel writes when a thread began: 10 ms each on every Linux.
pub fn boot_ticks() -> u64 {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `t` is a valid place for the answer; CLOCK_BOOTTIME exists since Linux 2.6.39.
    unsafe { libc::clock_gettime(libc::CLOCK_BOOTTIME, &mut t) };
    t.tv_sec as u64 * 100 + t.tv_nsec as u64 / 10_000_000
}

/// Returns the kernel id of the calling thread, as /proc lists it; 0 where that does not tell.
pub fn thread_id() -> i32 {
    let link = std::fs::read_link("/proc/thread-self").unwrap_or_default();
    link.file_name().and_then(|n| n.to_str()).and_then(|n| n.parse().ok()).unwrap_or(0)
}

/// Returns the computing time of a thread of this process so far, ns, exact also while it runs; `None` when
/// it is gone.
pub fn thread_ran_ns(tid: i32) -> Option<u64> {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // The kernel's number of the clock that counts what one thread runs: 6 is "a thread's, in ns".
    let clock = (!tid << 3) | 6;
    // SAFETY: `t` is a valid place for the answer; a clock of a thread that is gone is answered with an
    // error.
    let rc = unsafe { libc::clock_gettime(clock, &mut t) };
    (rc == 0).then(|| t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64)
}

/// Tells whether a thread of this process runs or waits for a processor; false for one that sleeps or is
/// gone.
pub fn is_ready(tid: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/self/task/{tid}/stat")).unwrap_or_default();
    // "17 (a name) with) anything) R …": the name may hold all but its own end.
    stat.rsplit_once(')').is_some_and(|(_, rest)| rest.trim_start().starts_with('R'))
}

fn timespec(ns: u64) -> libc::timespec {
    libc::timespec { tv_sec: (ns / 1_000_000_000) as libc::time_t, tv_nsec: (ns % 1_000_000_000) as _ }
}

/// Why a futex wait came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WaitResult {
    /// Woken, or for no reason: look at the word again.
    Woken,
    /// The word did not hold the expected value.
    Changed,
    /// The deadline passed.
    TimedOut,
}

/// Returns the futex flag: a word of one process costs the kernel less to find.
fn flag(scope: Scope) -> i32 {
    match scope {
        Scope::Process => libc::FUTEX_PRIVATE_FLAG,
        Scope::Machine => 0,
    }
}

/// Sleeps while `word` holds `expected`, until a wake or the absolute monotonic deadline in ns.
pub fn futex_wait(word: &AtomicU32, expected: u32, deadline_ns: Option<u64>, scope: Scope) -> WaitResult {
    let until = deadline_ns.map(timespec);
    let until = until.as_ref().map_or(std::ptr::null(), std::ptr::from_ref);
    let op = libc::FUTEX_WAIT_BITSET | flag(scope);
    // SAFETY: the word and the time outlive the call; BITSET makes the time absolute on the monotonic clock.
    let rc = unsafe {
        libc::syscall(
            libc::SYS_futex,
            word.as_ptr(),
            op,
            expected,
            until,
            std::ptr::null::<u32>(),
            libc::FUTEX_BITSET_MATCH_ANY,
        )
    };
    if rc == 0 {
        return WaitResult::Woken;
    }
    match errno() {
        libc::ETIMEDOUT => WaitResult::TimedOut,
        libc::EAGAIN => WaitResult::Changed,
        _ => WaitResult::Woken,
    }
}

/// Wakes up to `n` sleepers on `word`. One system call; never waits.
pub fn futex_wake(word: &AtomicU32, n: u32, scope: Scope) {
    let n = i32::try_from(n).unwrap_or(i32::MAX);
    let op = libc::FUTEX_WAKE | flag(scope);
    // SAFETY: the kernel uses the word's address only as a key.
    unsafe { libc::syscall(libc::SYS_futex, word.as_ptr(), op, n) };
}

/// The kernel cannot sleep on several words at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAtOnce;

/// Words one thread can sleep on at once.
pub const MOST_WORDS: usize = 128;

/// Sleeps while every word holds `expected`, until a wake on one of them or the absolute monotonic deadline
/// in ns. At most [`MOST_WORDS`]; no allocation.
///
/// # Errors
/// The kernel has no futex_waitv (before Linux 5.16), or a sandbox keeps it away.
pub fn futex_wait_any<'a>(
    words: impl Iterator<Item = (&'a AtomicU32, Scope)>,
    expected: u32,
    deadline_ns: Option<u64>,
) -> Result<WaitResult, NotAtOnce> {
    match waitv(words.map(|(word, scope)| (word, expected, scope)), deadline_ns) {
        Err(libc::ETIMEDOUT) => Ok(WaitResult::TimedOut),
        Err(libc::EAGAIN) => Ok(WaitResult::Changed),
        // Sandboxes that do not know the call answer EPERM.
        Err(libc::ENOSYS | libc::EPERM) => Err(NotAtOnce),
        _ => Ok(WaitResult::Woken),
    }
}

/// As above, while each word holds its own expected value. Returns the index of the word whose sleeper was
/// woken, `None` when a word holds something else, or for no reason.
///
/// # Errors
/// As above, or the machine has no memory for it.
pub fn futex_wait_each<'a>(
    words: impl Iterator<Item = (&'a AtomicU32, u32, Scope)>,
) -> Result<Option<usize>, NotAtOnce> {
    match waitv(words, None) {
        Ok(woken) => Ok(Some(woken)),
        Err(libc::EAGAIN | libc::EINTR) => Ok(None),
        Err(_) => Err(NotAtOnce),
    }
}

/// Calls futex_waitv(2) for words, the values they hold, and the scope of their wakers; returns the index of
/// a word that was woken, or the errno.
#[inline]
fn waitv<'a>(
    words: impl Iterator<Item = (&'a AtomicU32, u32, Scope)>,
    deadline_ns: Option<u64>,
) -> Result<usize, i32> {
    const U32: u32 = 2;
    let mut all: [std::mem::MaybeUninit<libc::futex_waitv>; MOST_WORDS] =
        [const { std::mem::MaybeUninit::uninit() }; MOST_WORDS];
    let mut n = 0;
    for ((word, expected, scope), place) in words.zip(&mut all) {
        // SAFETY: a zeroed futex_waitv is one; it has reserved parts that must be 0.
        let mut one: libc::futex_waitv = unsafe { std::mem::zeroed() };
        one.val = u64::from(expected);
        one.uaddr = word.as_ptr().addr() as u64;
        one.flags = U32 | flag(scope) as u32;
        place.write(one);
        n += 1;
    }
    let until = deadline_ns.map(timespec);
    let until = until.as_ref().map_or(std::ptr::null(), std::ptr::from_ref);
    // SAFETY: the first `n` places were written; words and time outlive the call.
    let rc =
        unsafe { libc::syscall(libc::SYS_futex_waitv, all.as_ptr(), n, 0, until, libc::CLOCK_MONOTONIC) };
    usize::try_from(rc).map_err(|_| errno())
}

/// Sleeps until the absolute monotonic time; returns at once when it has passed.
pub fn sleep_until(deadline_ns: u64) {
    let until = timespec(deadline_ns);
    // SAFETY: `until` outlives the call; with an absolute time the remainder is not written.
    while unsafe {
        libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &until, std::ptr::null_mut())
    } == libc::EINTR
    {}
}

/// A refusal of the operating system: what was asked, its reason, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OsError {
    /// The request, with its values.
    pub asked: String,
    /// The errno of the answer, 0 when the call was not made because it could not have worked.
    pub errno: i32,
    /// Advice.
    pub help: &'static str,
}

impl OsError {
    fn last(asked: String, help: &'static str) -> Self {
        Self { asked, errno: errno(), help }
    }
}

impl fmt::Display for OsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.asked)?;
        if self.errno != 0 {
            write!(f, "{}; ", std::io::Error::from_raw_os_error(self.errno))?;
        }
        f.write_str(self.help)
    }
}

impl std::error::Error for OsError {}

/// Sets how late, in ns, the kernel may fire this thread's timers to save power (default 50 000 ns). A
/// `SCHED_FIFO` thread has no slack whatever is set.
pub fn set_timer_slack_ns(slack_ns: u64) -> Result<(), OsError> {
    // SAFETY: PR_SET_TIMERSLACK takes a number and touches this thread only.
    if unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, slack_ns) } == 0 {
        return Ok(());
    }
    Err(OsError::last(format!("set the timer slack to {slack_ns} ns"), "timers may fire up to 50 us late"))
}

/// Names the calling thread as tools show it; the kernel keeps the first 15 bytes.
pub fn set_thread_name(name: &str) {
    let mut text = [0u8; 16];
    for (to, from) in text[..15].iter_mut().zip(name.bytes().take_while(|&b| b != 0)) {
        *to = from;
    }
    // SAFETY: 16 bytes, the last of them 0, as PR_SET_NAME wants.
    unsafe { libc::prctl(libc::PR_SET_NAME, text.as_ptr()) };
}

/// Puts the calling thread under `SCHED_FIFO` at `priority` (1 lowest … 99).
pub fn set_fifo(priority: u8) -> Result<(), OsError> {
    schedule(libc::SCHED_FIFO, priority).map_err(|errno| {
        let help = match errno {
            libc::EINVAL => "use a priority from 1 to 99",
            _ => "give the process CAP_SYS_NICE or raise `ulimit -r` to the priority (`trocar doctor` tells how)",
        };
        OsError { asked: format!("run at SCHED_FIFO priority {priority}"), errno, help }
    })
}

/// Has the calling thread scheduled as threads without a real-time priority are.
pub fn set_normal() -> Result<(), OsError> {
    let refused = |errno| OsError { asked: "run without a real-time priority".into(), errno, help: "" };
    schedule(libc::SCHED_OTHER, 0).map_err(refused)
}

fn schedule(policy: libc::c_int, priority: u8) -> Result<(), i32> {
    let param = libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: the thread is the caller itself and the parameter outlives the call.
    match unsafe { libc::pthread_setschedparam(libc::pthread_self(), policy, &param) } {
        0 => Ok(()),
        errno => Err(errno),
    }
}

/// Binds the calling thread to these CPUs (numbers as in /proc/cpuinfo).
pub fn set_affinity(cpus: &[usize]) -> Result<(), OsError> {
    let asked = || format!("run on CPUs {cpus:?}");
    let help = "name at least one CPU that exists and that this process may use (see `nproc`, `taskset -p`)";
    if cpus.is_empty() || cpus.iter().any(|&c| c >= libc::CPU_SETSIZE as usize) {
        return Err(OsError { asked: asked(), errno: libc::EINVAL, help });
    }
    // SAFETY: a zeroed cpu_set_t is the empty set, and every CPU number was checked to lie inside it.
    let rc = unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        cpus.iter().for_each(|&c| libc::CPU_SET(c, &mut set));
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &set)
    };
    if rc == 0 { Ok(()) } else { Err(OsError::last(asked(), help)) }
}

/// Locks all memory of the process, present and future, where that cannot turn against it.
///
/// # Errors
/// With a finite `RLIMIT_MEMLOCK` and no CAP_IPC_LOCK it is not even tried: the call would succeed, and later
/// threads and mappings would fail. Lock single regions with [`lock_region`] then.
pub fn lock_memory() -> Result<(), OsError> {
    let asked = || "lock all memory of the process".to_owned();
    if !memlock_is_unlimited() && !has_ipc_lock() {
        return Err(OsError {
            asked: asked(),
            errno: 0,
            help: "the locked-memory limit is finite: set `ulimit -l unlimited` or give the process CAP_IPC_LOCK",
        });
    }
    // SAFETY: mlockall takes flags only.
    if unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) } == 0 {
        return Ok(());
    }
    Err(OsError::last(asked(), "free memory, or run without locking and expect page faults"))
}

/// Locks one region (a pool, a stack) into memory; counts against `RLIMIT_MEMLOCK`.
pub fn lock_region(start: *const u8, bytes: usize) -> Result<(), OsError> {
    // SAFETY: mlock changes no content, and answers an error for an address that is not mapped.
    if unsafe { libc::mlock(start.cast(), bytes) } == 0 {
        return Ok(());
    }
    Err(OsError::last(
        format!("lock {bytes} bytes into memory"),
        "raise `ulimit -l`, or give the process CAP_IPC_LOCK",
    ))
}

fn memlock_is_unlimited() -> bool {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: `limit` is a valid place for the answer.
    let rc = unsafe { libc::getrlimit(libc::RLIMIT_MEMLOCK, &mut limit) };
    rc == 0 && limit.rlim_cur == libc::RLIM_INFINITY
}

fn has_ipc_lock() -> bool {
    const CAP_IPC_LOCK: u64 = 1 << 14;
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap_or_default();
    let effective = status.lines().find_map(|l| l.strip_prefix("CapEff:"));
    effective.and_then(|v| u64::from_str_radix(v.trim(), 16).ok()).is_some_and(|v| v & CAP_IPC_LOCK != 0)
}

fn errno() -> i32 {
    std::io::Error::last_os_error().raw_os_error().unwrap_or(0)
}
