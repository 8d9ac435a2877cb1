//! Reads the machine and tries what a host would ask of it.
//!
//! Invariant: everything tried is undone: the threads end, the memory is given back, nothing is left
//! in the system.

use std::fs;
use std::io::Read;
use std::thread;

use trocar_rt::os;
use trocar_rt::pool::FramePool;

use super::limits::Limits;
use super::wake;

/// Priority a control loop would ask for.
const PRIORITY: u8 = 80;
/// Cycles of 1 ms that are watched.
const CYCLES: usize = 400;

/// Facts found. Texts of refused trials are the system's own.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    pub limits: Limits,
    /// SCHED_FIFO 80.
    pub fifo: Result<(), String>,
    /// A page was locked.
    pub lock: Result<(), String>,
    /// CAP_IPC_LOCK, so that the limit does not count.
    pub may_lock_all: bool,
    /// CPUs this process may use.
    pub cpus: usize,
    /// CPUs kept free of others (`isolcpus`), as the kernel lists them; empty = none.
    pub isolated: String,
    /// The kernel is a PREEMPT_RT one.
    pub preempt_rt: bool,
    /// Kernel release.
    pub kernel: String,
    /// Share of time real-time threads may use, µs of each second; -1 = all.
    pub rt_runtime_us: Option<i64>,
    /// CPU frequency policy of the first CPU; empty = none is told.
    pub governor: String,
    /// inotify instances and watches one user may have.
    pub inotify_instances: Option<u64>,
    pub inotify_watches: Option<u64>,
    /// A directory was watched.
    pub inotify: Result<(), String>,
    /// A pool of frames in a sealed memfd was made.
    pub shm: Result<(), String>,
    /// The kernel's source of time.
    pub clock_source: String,
    pub figures: Figures,
}

/// Measured times, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    pub clock_read_ns: f64,
    pub wake_p50_ns: u64,
    pub wake_p99_ns: u64,
    pub wake_max_ns: u64,
}

/// Looks at the machine; takes about half a second, most of it asleep.
pub fn probe() -> Facts {
    let fifo = try_fifo();
    let wakes = wake::lateness(CYCLES, 1_000_000, fifo.is_ok().then_some(PRIORITY)).unwrap_or_default();
    Facts {
        limits: Limits::read(),
        lock: try_lock(),
        may_lock_all: capability(14),
        cpus: thread::available_parallelism().map_or(1, usize::from),
        isolated: word("/sys/devices/system/cpu/isolated"),
        preempt_rt: word("/sys/kernel/realtime") == "1" || word("/proc/version").contains("PREEMPT_RT"),
        kernel: word("/proc/sys/kernel/osrelease"),
        rt_runtime_us: word("/proc/sys/kernel/sched_rt_runtime_us").parse().ok(),
        governor: word("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        inotify_instances: word("/proc/sys/fs/inotify/max_user_instances").parse().ok(),
        inotify_watches: word("/proc/sys/fs/inotify/max_user_watches").parse().ok(),
        inotify: try_inotify(),
        shm: FramePool::new(2, 64, 4096).map(drop).map_err(|e| e.to_string()),
        clock_source: word("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        figures: Figures {
            clock_read_ns: wake::clock_ns(),
            wake_p50_ns: wakes.p50_ns,
            wake_p99_ns: wakes.p99_ns,
            wake_max_ns: wakes.max_ns,
        },
        fifo,
    }
}

/// The first bytes of a small file, trimmed; empty when there is none.
fn word(path: &str) -> String {
    let mut text = String::new();
    let read = fs::File::open(path).and_then(|f| f.take(4096).read_to_string(&mut text));
    if read.is_ok() { text.trim().to_owned() } else { String::new() }
}

fn try_fifo() -> Result<(), String> {
    let tried = thread::Builder::new().spawn(|| os::set_fifo(PRIORITY).map_err(|e| refusal(&e)));
    match tried {
        Ok(thread) => thread.join().unwrap_or_else(|_| Err("the trial panicked".to_owned())),
        Err(e) => Err(e.to_string()),
    }
}

/// Returns the system's message, without a remedy: which one helps here is judged later.
fn refusal(e: &os::OsError) -> String {
    format!("{}: {}", e.asked, std::io::Error::from_raw_os_error(e.errno))
}

fn try_lock() -> Result<(), String> {
    let pool = FramePool::new(2, 64, 64 * 1024).map_err(|e| e.to_string())?;
    pool.lock_memory().map_err(|e| e.to_string())
}

fn try_inotify() -> Result<(), String> {
    use notify::Watcher;
    let mut watcher = notify::recommended_watcher(|_| {}).map_err(|e| e.to_string())?;
    watcher.watch(&std::env::temp_dir(), notify::RecursiveMode::NonRecursive).map_err(|e| e.to_string())
}

/// True when the process has this capability now.
fn capability(bit: u32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|l| l.strip_prefix("CapEff:"));
    effective.and_then(|v| u64::from_str_radix(v.trim(), 16).ok()).is_some_and(|v| v >> bit & 1 == 1)
}
