//! Threads of one LCM that run reads from outside: started when needed, and few are kept.
//!
//! Invariant: they belong to no runtime: none of them is waited for when a runtime or a process ends.

use std::sync::{Arc, mpsc};
use std::thread;

use parking_lot::{Mutex, MutexGuard};
use trocar_rt::house;

use super::realtime::STACK_BYTES;

/// Idle threads that are kept for the next reads of any component.
const IDLE: usize = 2;

type Job = Box<dyn FnOnce() + Send>;

/// Threads of one LCM that run reads.
#[derive(Default)]
pub(super) struct Readers {
    idle: Mutex<Vec<mpsc::Sender<Job>>>,
}

impl Readers {
    fn idle(&self) -> MutexGuard<'_, Vec<mpsc::Sender<Job>>> {
        self.idle.lock()
    }

    /// Runs `job` on an idle thread, or on a new one.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub(super) fn run(self: &Arc<Self>, mut job: Job) -> std::io::Result<()> {
        loop {
            let Some(thread) = self.idle().pop() else { break };
            match thread.send(job) {
                Ok(()) => return Ok(()),
                Err(back) => job = back.0,
            }
        }
        let readers = Arc::downgrade(self);
        let work = move || {
            loop {
                job();
                let Some(readers) = readers.upgrade() else { return };
                let (give, given) = mpsc::channel();
                let mut idle = readers.idle();
                if idle.len() >= IDLE {
                    return;
                }
                idle.push(give);
                drop(idle);
                drop(readers);
                // Without the LCM there is no next job.
                match given.recv() {
                    Ok(next) => job = next,
                    Err(_) => return,
                }
            }
        };
        house::spawn(thread::Builder::new().name("trocar-read".into()).stack_size(STACK_BYTES), work)
            .map(drop)
    }
}
