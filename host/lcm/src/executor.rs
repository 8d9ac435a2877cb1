//! The thread a component runs on, or several components share: cycles, jobs, wakes.
//!
//! Invariant: component code runs only here (passive components and device callbacks excepted). A cycle takes
//! no lock, allocates nothing and calls nothing of the OS but its own sleep and the wakes after the step;
//! jobs run between cycles.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use trocar_model::{Execution, ExecutionModel, State};
use trocar_rt::executor::{Bells, Clock, Pacer};
use trocar_rt::wake::{MOST_BELLS, Waker};
use trocar_rt::{house, os};

use super::boundary::deferred;
use super::context::{self, ExecutorId};
use super::core::Core;
use super::cycle::{self, Member};
use super::instance::Instance;
use super::realtime::{self, Memory, Settings};
use super::thread::Thread;

pub(super) use trocar_rt::executor::Pace;

/// The pace an execution asks for.
pub(super) fn pace_of(execution: &Execution) -> Pace {
    let grid = execution.period_ns.map(|period_ns| Pace::Grid {
        period_ns,
        phase_ns: execution.phase_ns.unwrap_or(0),
        catch_up: execution.catch_up.unwrap_or(0),
    });
    match execution.model {
        Some(ExecutionModel::Periodic | ExecutionModel::Stream) => grid.unwrap_or(Pace::Signal),
        Some(ExecutionModel::Continuous) => Pace::Free,
        Some(ExecutionModel::None) => Pace::Never,
        _ => Pace::Signal,
    }
}

/// The members of a thread, in the order of their steps, and its pacer.
pub(super) struct Crew {
    pub(super) members: Vec<Member>,
    pub(super) bells: Rung,
    pacer: Pacer,
}

/// Bells that other processes ring for members of a thread.
#[derive(Default)]
pub(super) struct Rung {
    bells: Vec<Arc<Waker>>,
    /// The member of each bell.
    members: Vec<Arc<Core>>,
}

impl Rung {
    pub(super) fn add(&mut self, bell: Arc<Waker>, member: Arc<Core>) {
        self.bells.push(bell);
        self.members.push(member);
    }

    pub(super) fn remove(&mut self, bell: &Arc<Waker>) {
        if let Some(at) = self.bells.iter().position(|b| Arc::ptr_eq(b, bell)) {
            self.bells.swap_remove(at);
            self.members.swap_remove(at);
        }
    }

    /// Signals the members whose bells were rung. Real-time.
    fn hear(&self) {
        for (bell, member) in self.bells.iter().zip(&self.members) {
            if bell.take_if_set() {
                member.signal();
            }
        }
    }
}

type Job = Box<dyn FnOnce(&mut Crew) + Send>;

/// Called with a member of a thread that broke down by a fault of the host, and the reason.
pub(super) type Broken = fn(&Instance, String);

pub(super) struct Executor {
    pub(super) id: ExecutorId,
    pub(super) waker: Arc<Waker>,
    /// Way the thread finds its cycles.
    pub(super) pace: Pace,
    /// True when the thread looks at its queues in the cycle only and is not woken in between.
    polls: bool,
    /// Told of a member when the thread broke down, and why.
    broken: Broken,
    jobs: Mutex<VecDeque<Job>>,
    has_jobs: AtomicBool,
    stop: AtomicBool,
    /// Changed and read under the lock of `jobs`.
    ended: AtomicBool,
    pub(super) settings: Arc<Settings>,
    /// Name as the kernel shows it; also the name of threads that code on it starts without a name of their
    /// own.
    pub(super) name: String,
    /// Kernel id of the thread; 0 until it runs.
    tid: AtomicI32,
    /// Number of bells the thread sleeps on, or is about to.
    bells: AtomicUsize,
    /// Phase of its grid, ns; a job sets it in its pacer.
    phase_ns: AtomicU64,
}

static NEXT: AtomicU64 = AtomicU64::new(1);
/// Names of all executors' threads, by kernel id, whichever LCM they belong to: a program may have several
/// LCMs, with components of one name.
static NAMES: Mutex<BTreeMap<i32, String>> = Mutex::new(BTreeMap::new());

fn all_names() -> MutexGuard<'static, BTreeMap<i32, String>> {
    NAMES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Names of the threads of this process's executors; threads that code on them starts without a name of their
/// own have these names, too.
pub(super) fn names() -> BTreeSet<String> {
    all_names().values().cloned().collect()
}

/// One thread in the list of names, until it ends.
struct Named(i32);

impl Named {
    fn here(name: String) -> Named {
        let tid = os::thread_id();
        all_names().insert(tid, name);
        Named(tid)
    }
}

impl Drop for Named {
    fn drop(&mut self) {
        all_names().remove(&self.0);
    }
}

impl Executor {
    /// Starts the thread; it has no members yet.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub(super) fn spawn(
        name: &str,
        execution: &Execution,
        memory: &Memory,
        broken: Broken,
    ) -> std::io::Result<Arc<Executor>> {
        let settings = Arc::new(Settings::default());
        let team = realtime::team(name, execution, memory, settings.clone())?;
        let pace = pace_of(execution);
        let executor = Arc::new(Executor {
            id: NEXT.fetch_add(1, Ordering::Relaxed),
            waker: Arc::new(Waker::new()),
            pace,
            polls: execution.polls(),
            broken,
            jobs: Mutex::new(VecDeque::new()),
            has_jobs: AtomicBool::new(false),
            stop: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            settings,
            name: name[..name.floor_char_boundary(realtime::NAME_BYTES)].to_owned(),
            tid: AtomicI32::new(0),
            bells: AtomicUsize::new(0),
            phase_ns: AtomicU64::new(match pace {
                Pace::Grid { phase_ns, .. } => phase_ns,
                _ => 0,
            }),
        });
        let (mine, name, execution) = (executor.clone(), name.to_owned(), execution.clone());
        let memory = memory.clone();
        let thread = thread::Builder::new().name(name.clone()).stack_size(realtime::STACK_BYTES);
        house::spawn(thread, move || {
            context::set_executor(mine.id);
            deferred::prepare();
            context::set_team(team);
            let named = Named::here(mine.name.clone());
            mine.tid.store(named.0, Ordering::Release);
            mine.settings.settle(&name, &execution);
            mine.settings.lock(&memory);
            let mut crew = Crew { members: Vec::new(), bells: Rung::default(), pacer: Pacer::new(pace) };
            if let Some(panic) = house::breakdown(|| mine.run(&mut crew)) {
                mine.abandon(&crew.members, &panic);
            }
        })?;
        Ok(executor)
    }

    /// The part of it that its members know.
    pub(super) fn thread(&self) -> Thread {
        let Executor { id, pace, polls, .. } = *self;
        Thread { id, waker: self.waker.clone(), pace, polls }
    }

    pub(super) fn tid(&self) -> i32 {
        self.tid.load(Ordering::Acquire)
    }

    /// Runs `job` on the thread, between cycles. After the end of the thread the job is dropped, so that a
    /// caller that waits for it is told.
    pub(super) fn submit(&self, job: impl FnOnce(&mut Crew) + Send + 'static) {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        if self.ended.load(Ordering::Relaxed) {
            return;
        }
        jobs.push_back(Box::new(job));
        drop(jobs);
        self.has_jobs.store(true, Ordering::Release);
        self.waker.notify();
    }

    /// Phase of its grid, ns; `None` without a grid.
    pub(super) fn phase_ns(&self) -> Option<u64> {
        matches!(self.pace, Pace::Grid { .. }).then(|| self.phase_ns.load(Ordering::Relaxed))
    }

    /// Moves its grid to this phase without leaving out a cycle.
    pub(super) fn set_phase(&self, phase_ns: u64) {
        if self.phase_ns.swap(phase_ns, Ordering::Relaxed) != phase_ns {
            self.submit(move |crew| crew.pacer.set_phase(phase_ns));
        }
    }

    /// Lets another process wake the thread for this member with this bell from now on.
    ///
    /// # Errors
    /// The thread sleeps on as many bells as the kernel allows.
    pub(super) fn add_bell(&self, bell: Arc<Waker>, member: Arc<Core>) -> Result<(), String> {
        if self.bells.fetch_add(1, Ordering::Relaxed) >= MOST_BELLS {
            self.bells.fetch_sub(1, Ordering::Relaxed);
            return Err(format!(
                "{}'s thread is woken by {MOST_BELLS} connections to other processes already, and can be by no more",
                member.id
            ));
        }
        self.submit(move |crew| crew.bells.add(bell, member));
        Ok(())
    }

    pub(super) fn remove_bell(&self, bell: Arc<Waker>) {
        self.bells.fetch_sub(1, Ordering::Relaxed);
        self.submit(move |crew| crew.bells.remove(&bell));
    }

    /// Number of jobs not begun yet.
    #[cfg(test)]
    pub(super) fn waiting(&self) -> usize {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// Ends the thread after the jobs that are queued already.
    pub(super) fn close(&self) {
        self.stop.store(true, Ordering::Release);
        self.waker.notify();
    }

    fn run(&self, crew: &mut Crew) {
        loop {
            self.run_jobs(crew);
            if self.stop.load(Ordering::Acquire) && self.ends() {
                // Threads of the team end before this one.
                context::set_team(None);
                return;
            }
            let Crew { members, bells, pacer } = &mut *crew;
            bells.hear();
            let clock = Bells { own: &self.waker, bells: &bells.bells };
            // A polling thread is not woken by other processes either.
            let looks = self.polls;
            if !looks {
                cycle::serve(members, pacer.pace());
            }
            if !members.iter().any(|m| m.instance.is_active()) {
                cycle::refuse(members);
                pacer.rest(&clock);
                continue;
            }
            // The thread that leaves a callback runs the queued calls, or wakes this thread again.
            let asks = |m: &Member| m.instance.has_signal() && !m.instance.is_called_back();
            let signalled = || members.iter().any(asks);
            let due = if looks { pacer.next(&*self.waker, signalled) } else { pacer.next(&clock, signalled) };
            let Some(due) = due else { continue };
            let stepped = match pacer.pace() {
                Pace::Signal => cycle::signalled(members, &due),
                _ => cycle::all(members, &due),
            };
            if pacer.pace() == Pace::Free {
                if stepped || members.iter().any(asks) {
                    thread::yield_now();
                } else {
                    // The head is not ACTIVE: there is nothing to run freely for.
                    clock.wait(None);
                }
            }
        }
    }

    /// Makes the members safe and ends them, after the thread broke down outside of its members, by a fault
    /// of the host.
    fn abandon(&self, members: &[Member], panic: &str) {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        self.ended.store(true, Ordering::Relaxed);
        let left = std::mem::take(&mut *jobs);
        drop(jobs);
        let why = format!("the thread {} of the host broke down: {panic}", self.name);
        context::set_stepping(false);
        for Member { instance, .. } in members {
            instance.object.let_go();
            if instance.set_state_from(State::Active, State::Fault, &why) {
                instance.watch.owe_safe();
            }
            if let Some(mut entered) = instance.object.try_enter() {
                instance.pay_safe(&mut entered);
            }
        }
        // A caller that waits for a job is told that it will not run.
        drop(left);
        if let Some(member) = members.first() {
            (self.broken)(&member.instance, why);
        }
    }

    /// Tells whether no job is left, and accepts no more in that case.
    fn ends(&self) -> bool {
        let jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        let ends = jobs.is_empty();
        self.ended.store(ends, Ordering::Relaxed);
        ends
    }

    fn run_jobs(&self, crew: &mut Crew) {
        while self.has_jobs.swap(false, Ordering::AcqRel) {
            loop {
                let job = self.jobs.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
                match job {
                    Some(job) => job(crew),
                    None => break,
                }
            }
        }
    }
}
