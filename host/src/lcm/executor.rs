//! The thread a component runs on, or several components share: cycles, jobs, wakes.
//!
//! Invariant: component code runs only here (passive components excepted). A cycle takes no lock, allocates nothing and
//! calls nothing of the OS but its own sleep and the wakes after the step; jobs (Start, Stop, …) run between cycles.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use trocar_model::{Execution, ExecutionModel};
use trocar_plugin_api::abi::Tick;
use trocar_rt::os;
use trocar_rt::timing::Grid;
use trocar_rt::wake::Waker;

use super::context::{self, ExecutorId};
use super::instance::Instance;

/// How a thread finds its next cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pace {
    /// Absolute deadlines.
    Grid { period_ns: u64, phase_ns: u64 },
    /// Without pause.
    Free,
    /// When something is there.
    Signal,
    /// Never: passive components, whose commands run in their callers' threads.
    Never,
}

impl Pace {
    pub(super) fn of(execution: &Execution) -> Pace {
        let grid = execution
            .period_ns
            .map(|period_ns| Pace::Grid { period_ns, phase_ns: execution.phase_ns.unwrap_or(0) });
        match execution.model {
            Some(ExecutionModel::Periodic | ExecutionModel::Stream) => grid.unwrap_or(Pace::Signal),
            Some(ExecutionModel::Continuous) => Pace::Free,
            Some(ExecutionModel::OnSignal | ExecutionModel::OnCallback | ExecutionModel::ExecIn | ExecutionModel::ExecOut) | None => Pace::Signal,
            Some(ExecutionModel::None) => Pace::Never,
        }
    }
}

/// One component on a thread, and how it follows the head.
#[derive(Clone)]
pub(super) struct Member {
    pub(super) instance: Arc<Instance>,
    /// Steps only when something new is there (a filter of a stream); false: steps in every cycle.
    pub(super) on_input: bool,
}

type Job = Box<dyn FnOnce(&mut Vec<Member>) + Send>;

pub(super) struct Executor {
    pub(super) id: ExecutorId,
    pub(super) pace: Pace,
    pub(super) waker: Arc<Waker>,
    jobs: Mutex<VecDeque<Job>>,
    has_jobs: AtomicBool,
    stop: AtomicBool,
    pub(super) warnings: Mutex<Vec<String>>,
    pub(super) realtime: AtomicBool,
}

static NEXT: AtomicU64 = AtomicU64::new(1);

impl Executor {
    /// Starts the thread; it has no members yet.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub(super) fn spawn(name: &str, pace: Pace, execution: &Execution) -> std::io::Result<Arc<Executor>> {
        let executor = Arc::new(Executor {
            id: NEXT.fetch_add(1, Ordering::Relaxed),
            pace,
            waker: Arc::new(Waker::new()),
            jobs: Mutex::new(VecDeque::new()),
            has_jobs: AtomicBool::new(false),
            stop: AtomicBool::new(false),
            warnings: Mutex::new(Vec::new()),
            realtime: AtomicBool::new(false),
        });
        let (mine, name, execution) = (executor.clone(), name.to_owned(), execution.clone());
        thread::Builder::new().name(name.clone()).stack_size(1 << 20).spawn(move || {
            context::set_executor(mine.id);
            mine.settle(&name, &execution);
            mine.run();
        })?;
        Ok(executor)
    }

    /// Runs `job` on the thread, between cycles.
    pub(super) fn submit(&self, job: impl FnOnce(&mut Vec<Member>) + Send + 'static) {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).push_back(Box::new(job));
        self.has_jobs.store(true, Ordering::Release);
        self.waker.notify();
    }

    /// Ends the thread after the jobs already there.
    pub(super) fn close(&self) {
        self.stop.store(true, Ordering::Release);
        self.waker.notify();
    }

    /// Real-time settings; what the machine refuses is noted, and the component runs all the same.
    fn settle(&self, name: &str, execution: &Execution) {
        os::set_thread_name(name);
        let mut warnings = Vec::new();
        if let Err(e) = os::set_timer_slack_ns(1) {
            warnings.push(format!(
                "timer slack stays at the system's default ({e}): cycles begin up to 50 µs later"
            ));
        }
        if let Some(priority) = execution.priority {
            match os::set_fifo(priority) {
                Ok(()) => self.realtime.store(true, Ordering::Relaxed),
                Err(e) => warnings.push(format!(
                    "real-time priority {priority} was refused ({e}): runs with normal scheduling; allow it with \
                     `ulimit -r {priority}` or CAP_SYS_NICE"
                )),
            }
        }
        if !execution.cpus.is_empty()
            && let Err(e) = os::set_affinity(&execution.cpus)
        {
            warnings.push(format!("cpus {:?} were refused ({e}): runs on any", execution.cpus));
        }
        *self.warnings.lock().unwrap_or_else(PoisonError::into_inner) = warnings;
    }

    fn run(&self) {
        let mut members: Vec<Member> = Vec::new();
        let mut grid: Option<Grid> = None;
        loop {
            self.run_jobs(&mut members);
            if self.stop.load(Ordering::Acquire) && !self.has_jobs.load(Ordering::Acquire) {
                return;
            }
            let active = members.iter().any(|m| m.instance.is_active());
            match self.pace {
                _ if !active => {
                    grid = None;
                    self.waker.wait(None);
                }
                Pace::Grid { period_ns, phase_ns } => {
                    let grid = grid.get_or_insert_with(|| Grid::new(os::now_ns(), period_ns, phase_ns));
                    // A wake before the deadline is for jobs only; the cycle stays on its grid.
                    if !self.waker.wait(Some(grid.deadline())) || os::now_ns() >= grid.deadline() {
                        let begin_ns = os::now_ns();
                        let deadline_ns = grid.deadline();
                        let skipped = grid.advance(begin_ns);
                        cycle(&members, begin_ns, deadline_ns, period_ns, skipped);
                    }
                }
                Pace::Free => {
                    let now = os::now_ns();
                    cycle(&members, now, now, 0, 0);
                    thread::yield_now();
                }
                Pace::Signal => {
                    if !members.iter().any(|m| m.instance.has_signal()) {
                        self.waker.wait(None);
                    }
                    let now = os::now_ns();
                    signalled(&members, now);
                }
                Pace::Never => {
                    self.waker.wait(None);
                }
            }
        }
    }

    fn run_jobs(&self, members: &mut Vec<Member>) {
        while self.has_jobs.swap(false, Ordering::AcqRel) {
            loop {
                let job = self.jobs.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
                match job {
                    Some(job) => job(members),
                    None => break,
                }
            }
        }
    }
}

/// One cycle of a thread with a pace of its own. Real-time.
fn cycle(members: &[Member], begin_ns: u64, deadline_ns: u64, period_ns: u64, skipped: u64) {
    context::set_stepping(true);
    for member in members {
        let signalled = member.instance.take_signal();
        if !member.instance.is_active() || (member.on_input && !signalled) {
            continue;
        }
        let (begin_ns, deadline_ns, period_ns) =
            if member.on_input { (os::now_ns(), 0, 0) } else { (begin_ns, deadline_ns, period_ns) };
        step(&member.instance, begin_ns, deadline_ns, period_ns, skipped);
    }
    context::set_stepping(false);
    context::flush_wakes();
}

/// Steps every member something is there for. Real-time.
fn signalled(members: &[Member], now_ns: u64) {
    context::set_stepping(true);
    for member in members {
        if member.instance.take_signal() && member.instance.is_active() {
            step(&member.instance, now_ns, now_ns, 0, 0);
        }
    }
    context::set_stepping(false);
    context::flush_wakes();
}

fn step(instance: &Instance, begin_ns: u64, deadline_ns: u64, period_ns: u64, skipped: u64) {
    // Somebody inside means a control entry still runs; this cycle is left out and counted.
    let Some(mut entered) = instance.object.try_enter() else {
        instance.stats.record_skipped(1 + skipped);
        return;
    };
    let inner = entered.inner();
    inner.cycle += 1 + skipped;
    let elapsed_ns = if inner.last_begin_ns == 0 { period_ns } else { begin_ns - inner.last_begin_ns };
    inner.last_begin_ns = begin_ns;
    let tick = Tick {
        struct_size: size_of::<Tick>() as u32,
        flags: 0,
        cycle: inner.cycle - 1,
        now_ns: begin_ns,
        deadline_ns: if deadline_ns == 0 { begin_ns } else { deadline_ns },
        period_ns,
        elapsed_ns,
    };
    instance.step(&mut entered, &tick);
    drop(entered);
    let end_ns = os::now_ns();
    let lateness_ns = begin_ns.saturating_sub(tick.deadline_ns);
    instance.stats.record(begin_ns, end_ns, lateness_ns);
    if skipped > 0 {
        instance.stats.record_skipped(skipped);
    }
    if period_ns > 0 {
        instance.set_overrun(end_ns - begin_ns > period_ns);
    }
}
