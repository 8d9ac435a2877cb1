//! Threads beside the step: ordinary ones, however real-time the thread is that makes them.
//!
//! Invariant: a new thread has the scheduling class that programs have by default in this process, not that
//! of the component's thread that made it; else encoding a picture would hold up control loops. Nor has it
//! that thread's processors, which are often those of the control loops, unless it says so: what is kept away
//! from them by its own `execution.cpus` keeps its threads away, too.

use std::io;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

use rustix::thread::{sched_getaffinity, sched_setaffinity};
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id, thread_schedule_policy,
};
use trocar_sdk::Result;
use trocar_sdk::prelude::Host;

use crate::waits::Stop;

/// Niceness 0 on the crate's scale of 0 to 99.
const NOT_NICE: u8 = 47;

/// A thread of a component that ends with its owner.
pub struct Side {
    stop: Arc<Stop>,
    thread: Option<JoinHandle<()>>,
    what: &'static str,
}

impl Side {
    /// Starts a thread that tools call after the component and `name`. `what` says in errors which one it is:
    /// "that reads lines".
    ///
    /// # Errors
    /// The system has no thread or no descriptor for it.
    pub fn begin(
        host: &Host,
        name: &str,
        what: &'static str,
        run: impl FnOnce(&Stop) + Send + 'static,
    ) -> Result<Side> {
        let name = format!("{} {name}", host.instance_name().rsplit('/').next().unwrap_or_default());
        let stop = Arc::new(Stop::new()?);
        let heard = stop.clone();
        let thread = spawn(&name, move || run(&heard)).map_err(|why| format!("no thread {what}: {why}"))?;
        Ok(Side { stop, thread: Some(thread), what })
    }

    #[must_use]
    pub fn stop(&self) -> &Stop {
        &self.stop
    }

    /// Whether nobody has ended it yet.
    #[must_use]
    pub fn is_owned(&self) -> bool {
        self.thread.is_some()
    }

    /// Whether it has nothing left to do.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Tells the thread to end, and does not wait for it.
    pub fn halt(&self) {
        self.stop.set();
    }

    /// Ends the thread.
    ///
    /// # Errors
    /// The thread panicked.
    pub fn end(&mut self) -> Result {
        self.halt();
        let Some(thread) = self.thread.take() else { return Ok(()) };
        thread.join().map_err(|_| format!("the thread {} panicked", self.what).into())
    }
}

impl Drop for Side {
    fn drop(&mut self) {
        let _ = self.end();
    }
}

/// Starts a thread; tools show the first 15 bytes of its name, which says the component first.
///
/// # Errors
/// The system has no thread for it.
pub fn spawn<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    builder(name).spawn(move || {
        be_ordinary();
        run_anywhere();
        run()
    })
}

/// As [`spawn`], on the processors of the thread that makes it.
///
/// # Errors
/// As of [`spawn`].
pub fn spawn_on_same<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    builder(name).spawn(move || {
        be_ordinary();
        run()
    })
}

fn builder(name: &str) -> Builder {
    // A name with a zero in it would be a panic.
    Builder::new().name(name.replace('\0', ""))
}

/// Takes the calling thread out of the class it inherited. Less is always allowed; where it is not, the
/// thread works as it is.
fn be_ordinary() {
    // One that is ordinary already keeps how nice whoever started the process wants it.
    if let (Ok(ThreadSchedulePolicy::Realtime(_)), Ok(not_nice)) =
        (thread_schedule_policy(), NOT_NICE.try_into())
    {
        let ordinary = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
        let _ = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Crossplatform(not_nice),
            ordinary,
        );
    }
}

/// On whatever processors the process has; where that is refused, the thread works as it is.
fn run_anywhere() {
    // The process's first thread has what whoever started it gave: no component runs on it.
    if let Ok(all) = sched_getaffinity(Some(rustix::process::getpid())) {
        let _ = sched_setaffinity(None, &all);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::thread::CpuSet;
    use thread_priority::RealtimeThreadSchedulePolicy;

    /// Scheduling class of the calling thread as the kernel numbers it, and its real-time priority.
    fn class() -> [i32; 2] {
        let stat = std::fs::read_to_string("/proc/thread-self/stat").expect("Linux");
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
        // Fields 41 and 40 of proc(5); the first two are before the bracket.
        [38, 37].map(|n| fields[n].parse().expect("a number"))
    }

    #[test]
    fn a_thread_made_by_a_real_time_thread_on_one_processor_is_ordinary_and_there_only_if_asked() {
        let all = sched_getaffinity(Some(rustix::process::getpid())).expect("Linux");
        let first = (0..CpuSet::MAX_CPU).find(|cpu| all.is_set(*cpu)).expect("there is one");
        let seen = std::thread::spawn(move || {
            let mut one = CpuSet::new();
            one.set(first);
            sched_setaffinity(None, &one).expect("its own");
            let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
            let priority = ThreadPriority::Crossplatform(10u8.try_into().expect("10"));
            let granted = set_thread_priority_and_policy(thread_native_id(), priority, fifo).is_ok();
            assert_eq!(class()[0] == 1, granted, "1 is SCHED_FIFO");
            let seen = || {
                (
                    class(),
                    sched_getaffinity(None).expect("Linux"),
                    std::thread::current().name().map(str::to_owned),
                )
            };
            let threads = [spawn("camera draw\0", seen), spawn_on_same("camera draw\0", seen)];
            (one, threads.map(|thread| thread.expect("a thread").join().expect("no panic")))
        });
        let (one, threads) = seen.join().expect("no panic");
        for ((class, cpus, name), processors) in threads.into_iter().zip([all, one]) {
            assert_eq!(class, [0, 0]);
            assert!(cpus == processors);
            assert_eq!(name.as_deref(), Some("camera draw"));
        }
    }
}
