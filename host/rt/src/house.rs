//! This program's own threads, by kernel id: any other thread was started by foreign code, whatever its name
//! is.
//!
//! Invariant: a thread is on the list before it runs anything of this program's, and until that is over.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::{io, thread};

use crate::os;

static OWN: Mutex<BTreeSet<i32>> = Mutex::new(BTreeSet::new());

fn list() -> MutexGuard<'static, BTreeSet<i32>> {
    OWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes the calling thread one of this program's own, until [`end`]. For runtimes that start threads by
/// themselves.
pub fn begin() {
    list().insert(os::thread_id());
}

/// Takes the calling thread off the list, since it ends.
pub fn end() {
    list().remove(&os::thread_id());
}

/// Own threads at this moment.
pub fn threads() -> BTreeSet<i32> {
    list().clone()
}

/// Number of own threads that the machine has not given.
static REFUSED: AtomicU64 = AtomicU64::new(0);

/// Returns the number of own threads that could not be started so far.
pub fn refused() -> u64 {
    REFUSED.load(Ordering::Relaxed)
}

/// Starts an own thread.
///
/// # Errors
/// The machine gives no more threads.
pub fn spawn<T: Send + 'static>(
    thread: thread::Builder,
    run: impl FnOnce() -> T + Send + 'static,
) -> io::Result<thread::JoinHandle<T>> {
    let started = thread.spawn(move || {
        let _listed = Listed::here();
        run()
    });
    if started.is_err() {
        REFUSED.fetch_add(1, Ordering::Relaxed);
    }
    started
}

/// Runs a thread's work; returns the words of its panic, if it broke down.
pub fn breakdown(run: impl FnOnce()) -> Option<String> {
    let panic = catch_unwind(AssertUnwindSafe(run)).err()?;
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    Some(text.unwrap_or_else(|| "a panic without words".to_owned()))
}

/// On the list as long as this lives, a panic of the thread included.
struct Listed(i32);

impl Listed {
    fn here() -> Listed {
        let tid = os::thread_id();
        list().insert(tid);
        Listed(tid)
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        list().remove(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::{os, refused, spawn, thread, threads};

    #[test]
    fn a_thread_is_on_the_list_while_it_runs_and_not_after_a_panic() -> Result<(), Box<dyn std::error::Error>>
    {
        let (tell, told) = channel();
        let (go, wait) = channel::<()>();
        let own = spawn(thread::Builder::new(), move || {
            let _ = tell.send(os::thread_id());
            let _ = wait.recv();
            std::panic::resume_unwind(Box::new(()));
        })?;
        let tid = told.recv()?;
        assert!(threads().contains(&tid));
        assert!(!threads().contains(&os::thread_id()), "nobody named the thread of this test");
        drop(go);
        assert!(own.join().is_err());
        assert!(!threads().contains(&tid));
        Ok(())
    }

    #[test]
    fn a_thread_that_the_machine_does_not_give_is_counted() {
        let before = refused();
        // No machine has the memory for its stack.
        assert!(spawn(thread::Builder::new().stack_size(1 << 60), || ()).is_err());
        assert!(refused() > before);
    }

    #[test]
    fn a_thread_knows_its_kernel_id_which_no_other_has() {
        let other = thread::spawn(os::thread_id).join().ok();
        assert!(os::thread_id() > 0 && other != Some(os::thread_id()));
    }
}
