//! Threads of this process that the host did not start, and the components whose code did.
//!
//! Invariant: a thread is identified by its number in the kernel and its begin, never by its name alone. A
//! look costs by the number of threads; a look that finds no thread started since the last one costs nothing
//! more.

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use trocar_rt::house;
use trocar_rt::threads;

use super::super::executor;
use super::household::is_own_process;
use super::moment::Moment;
use super::roster::Guarded;

/// One such thread.
#[derive(Debug)]
pub(super) struct Stranger {
    pub(super) tid: i32,
    pub(super) name: String,
    /// Ticks since boot.
    began: u64,
}

/// All such threads at one moment.
pub(crate) struct Strangers {
    threads: Vec<Stranger>,
    executors: BTreeSet<String>,
}

impl Strangers {
    /// Lists the threads. Not real-time.
    pub(crate) fn look() -> Strangers {
        #[cfg(test)]
        LISTS.with(|lists| lists.set(lists.get() + 1));
        let mut own = house::threads();
        let listed = threads::list();
        // A thread that came or went meanwhile is on one of both lists.
        own.extend(house::threads());
        let unknown = listed.into_iter().filter(|tid| !own.contains(tid));
        let threads = unknown.map(|tid| Stranger { tid, name: name(tid), began: began(tid) });
        let threads = threads.filter(|thread| !thread.name.is_empty() && !is_of_program(&thread.name));
        Strangers { threads: threads.collect(), executors: executor::names() }
    }

    /// All threads that came after a moment.
    pub(super) fn since(&self, moment: Moment) -> impl Iterator<Item = &Stranger> {
        self.threads.iter().filter(move |thread| moment.is_before(thread.tid, thread.began))
    }

    /// Names of threads that the component's own code started: they have the name of its thread, as new
    /// threads do, or appeared during one of its entries. A thread from before the component was made is not
    /// its own: it may be of a removed component with the same name.
    pub(crate) fn left_behind(&self, guarded: &Guarded) -> Vec<String> {
        self.of(guarded).map(|thread| thread.name.clone()).collect()
    }

    /// Tells whether a thread that `stop` should have ended still runs, as far as known: threads started by
    /// `create` or `configure` may be for `destroy` to end.
    pub(crate) fn outlast_stop(&self, guarded: &Guarded) -> bool {
        self.of(guarded).any(|thread| !guarded.instance.threads.lasts(thread.tid))
    }

    fn of(&self, guarded: &Guarded) -> impl Iterator<Item = &Stranger> {
        let (own, executor) = (guarded.executor.name.as_str(), guarded.executor.tid());
        let (noted, made) = (guarded.instance.threads.noted(), guarded.instance.threads.made());
        let is_own = move |thread: &Stranger| {
            // A thread without a name of its own belongs to the component whose name it has.
            let born = noted.get(&thread.tid) == Some(&thread.name) && !self.executors.contains(&thread.name);
            thread.name == own || born
        };
        let came_after = move |t: &Stranger| made.is_none_or(|made| made.is_before(t.tid, t.began));
        // An executor that ends leaves its list a moment before its thread is gone.
        self.threads.iter().filter(move |t| t.tid != executor && came_after(t) && is_own(t))
    }
}

/// A program that embeds a host has threads of its own runtime, with default names.
fn is_of_program(name: &str) -> bool {
    // Tests run beside each other: a thread of another test, named by its path, belongs to no component here.
    #[cfg(test)]
    if name.contains("::") {
        return true;
    }
    !is_own_process() && name.starts_with("tokio")
}

/// Times this thread has read the kernel's last number.
#[cfg(test)]
fn looks() -> u64 {
    LOOKS.with(std::cell::Cell::get)
}

/// Times this thread has listed all threads.
#[cfg(test)]
pub(super) fn lists() -> u64 {
    LISTS.with(std::cell::Cell::get)
}

#[cfg(test)]
thread_local! {
    static LOOKS: std::cell::Cell<u64> = const { std::cell::Cell::new(0) };
    static LISTS: std::cell::Cell<u64> = const { std::cell::Cell::new(0) };
}

fn began(tid: i32) -> u64 {
    #[cfg(test)]
    LOOKS.with(|looks| looks.set(looks.get() + 1));
    threads::began(tid)
}

fn name(tid: i32) -> String {
    #[cfg(test)]
    LOOKS.with(|looks| looks.set(looks.get() + 1));
    threads::name(tid)
}
