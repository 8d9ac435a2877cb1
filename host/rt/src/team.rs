//! A team of threads that share the slices of one piece of work: fork and join inside a step.
//!
//! A thread takes a slice off `open`, and only a thread with a slice reads the job's content: so the content
//! stays while a thread is inside, and a helper that comes late takes nothing and touches nothing.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::sync::{AtomicBool, AtomicU32, JoinHandle, Ordering, Padded, Shared, pause_while, spawn};
use crate::wake::Waker;

/// Result of [`Team::run`] for a slice that panicked: the plugin interface's STATUS_PANICKED.
pub const PANICKED: i32 = -2;

/// The most threads a team has.
pub const MAX_THREADS: usize = 256;

/// Time an idle thread looks for work, or for the end of it, before it sleeps.
const SPIN_NS: u64 = 4_000;

type Body<'a> = dyn Fn(u32) -> i32 + Sync + 'a;

/// Threads that work together, the caller of [`Team::run`] included. Dropping it ends and joins them.
pub struct Team {
    state: Arc<TeamState>,
    helpers: Vec<JoinHandle<()>>,
}

/// State the threads of a team share.
struct TeamState {
    /// Slices of the current job that nobody has taken.
    open: Padded<AtomicU32>,
    /// Slices of the current job that are not done.
    pending: Padded<AtomicU32>,
    /// The first failure's status as bits, 0 without one.
    failed: AtomicU32,
    job: Shared<Option<Job>>,
    /// Notified once by the helper that does a job's last slice, and consumed once by the owner.
    done: Waker,
    /// One for each helper.
    calls: Box<[Waker]>,
    /// Whether a job is at work; a second one at the same time runs in its caller's thread alone.
    busy: AtomicBool,
    closed: AtomicBool,
}

#[derive(Clone, Copy)]
struct Job {
    slices: u32,
    /// Borrowed by `run`, which does not return while a thread may call it.
    body: *const Body<'static>,
}

// SAFETY: `job` is written by the owner while no slice is open or pending, and read by holders of a slice,
// whose taking follows the owner's opening; the body behind it may be called from any thread.
unsafe impl Send for TeamState {}
// SAFETY: as above.
unsafe impl Sync for TeamState {}

impl Team {
    /// Starts `threads - 1` helpers (0 counts as 1: no helper, everything runs in the caller's thread). Each
    /// calls `setup` with its number, from 1, before its first slice: name, priority, processors.
    ///
    /// # Errors
    /// With more than [`MAX_THREADS`], or when the machine gives no more threads; then none is left over.
    pub fn new(threads: usize, setup: impl Fn(usize) + Send + Sync + 'static) -> io::Result<Self> {
        if threads > MAX_THREADS {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("a team of {threads} threads was asked for; use at most {MAX_THREADS}"),
            ));
        }
        let helpers = threads.saturating_sub(1);
        let state = Arc::new(TeamState {
            open: Padded(AtomicU32::new(0)),
            pending: Padded(AtomicU32::new(0)),
            failed: AtomicU32::new(0),
            job: Shared::new(None),
            done: Waker::new(),
            calls: (0..helpers).map(|_| Waker::new()).collect(),
            busy: AtomicBool::new(false),
            closed: AtomicBool::new(false),
        });
        let mut team = Self { state, helpers: Vec::with_capacity(helpers) };
        let setup = Arc::new(setup);
        for helper in 0..helpers {
            let (state, setup) = (Arc::clone(&team.state), Arc::clone(&setup));
            team.helpers.push(spawn(move || {
                setup(helper + 1);
                state.help(helper);
            })?);
        }
        Ok(team)
    }

    /// Returns the number of threads that work together, the caller's included.
    pub fn threads(&self) -> usize {
        self.helpers.len() + 1
    }

    /// Runs `body` once for each number below `slices`, on any of the threads, and returns when all are done:
    /// the negative status that came first, else 0. A slice that panics counts as [`PANICKED`], and the
    /// others run all the same. No allocation, no lock; a futex wake for each helper that sleeps, and a sleep
    /// when the helpers are not done yet. Called again from inside `body`, or by another thread at the same
    /// time, it runs all slices in the calling thread.
    pub fn run(&self, slices: u32, body: &Body<'_>) -> i32 {
        if slices == 0 {
            return 0;
        }
        if self.helpers.is_empty() || slices == 1 || self.state.busy.swap(true, Ordering::Acquire) {
            return alone(slices, body);
        }
        let status = self.state.share(slices, body);
        self.state.busy.store(false, Ordering::Release);
        status
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        self.state.closed.store(true, Ordering::Release);
        self.state.calls.iter().for_each(|call| {
            call.notify();
        });
        for helper in self.helpers.drain(..) {
            // A helper that panicked (in `setup`) has nothing more to tell here.
            let _ = helper.join();
        }
    }
}

impl TeamState {
    /// Leads the owner through one job.
    fn share(&self, slices: u32, body: &Body<'_>) -> i32 {
        // SAFETY: only the lifetime changes; nobody calls the body once nothing is pending, which this
        // function waits for and nothing in it can unwind past.
        let body: *const Body<'static> = unsafe { std::mem::transmute(std::ptr::from_ref(body)) };
        // SAFETY: nothing is open or pending, and `busy` keeps every other owner out.
        unsafe { *self.job.exclusive() = Some(Job { slices, body }) };
        self.failed.store(0, Ordering::Relaxed);
        self.pending.0.store(slices, Ordering::Relaxed);
        // Release: a thread that takes a slice sees the job.
        self.open.0.store(slices, Ordering::Release);
        self.calls.iter().take(slices as usize - 1).for_each(|call| {
            call.notify();
        });
        if !self.work() {
            pause_while(SPIN_NS, || self.pending.0.load(Ordering::Relaxed) != 0);
            self.done.wait(None);
        }
        self.failed.load(Ordering::Relaxed).cast_signed()
    }

    fn help(&self, helper: usize) {
        let call = &self.calls[helper];
        while !self.closed.load(Ordering::Acquire) {
            if self.work() {
                self.done.notify();
            }
            pause_while(SPIN_NS, || self.open.0.load(Ordering::Relaxed) == 0);
            if self.open.0.load(Ordering::Relaxed) == 0 {
                call.wait(None);
            }
        }
    }

    /// Takes and runs slices until none is open; returns whether this thread did the job's last one.
    fn work(&self) -> bool {
        let mut last = false;
        while let Some(open) = self.take() {
            // SAFETY: this thread holds a slice, so the job is there and stays.
            let job = unsafe { *self.job.readable() };
            let Some(Job { slices, body }) = job else { unreachable!("a slice was open") };
            // SAFETY: `run` borrows the body until nothing is pending any more.
            let status = run_one(unsafe { &*body }, slices - open);
            if status < 0 {
                let bits = status.cast_unsigned();
                let _ = self.failed.compare_exchange(0, bits, Ordering::Relaxed, Ordering::Relaxed);
            }
            // Release and Acquire: what was done in all slices happens before the owner goes on.
            last = self.pending.0.fetch_sub(1, Ordering::AcqRel) == 1;
        }
        last
    }

    /// Takes a slice; returns how many were open. Each turn that fails means that another thread took one.
    fn take(&self) -> Option<u32> {
        let mut open = self.open.0.load(Ordering::Relaxed);
        while open != 0 {
            match self.open.0.compare_exchange_weak(open, open - 1, Ordering::Acquire, Ordering::Relaxed) {
                Ok(_) => return Some(open),
                Err(now) => open = now,
            }
        }
        None
    }
}

fn run_one(body: &Body<'_>, slice: u32) -> i32 {
    catch_unwind(AssertUnwindSafe(|| body(slice))).unwrap_or(PANICKED)
}

fn alone(slices: u32, body: &Body<'_>) -> i32 {
    (0..slices).fold(0, |first, slice| {
        let status = run_one(body, slice);
        if first < 0 { first } else { status.min(0) }
    })
}
