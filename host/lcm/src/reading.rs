//! The reads from outside of one component that are under way.
//!
//! Invariant: they have at most [`PLACES`] threads, whatever is asked.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{Semaphore, oneshot};
use trocar_model::{MemberId, Refusal};

/// Most threads the reads of one component have at once: one may be slow, and the others are still answered.
const PLACES: usize = 2;
/// The reads of one component that are under way.
pub(super) struct Reading {
    pub(super) places: Arc<Semaphore>,
    tickets: AtomicU64,
    /// Reads that were given up and have not returned.
    late: Mutex<Vec<Late>>,
}

/// A read that was given up.
pub(super) struct Late {
    pub(super) ticket: u64,
    /// `interface/read`.
    pub(super) name: String,
    pub(super) since: Instant,
}

impl Default for Reading {
    fn default() -> Self {
        let places = Arc::new(Semaphore::new(PLACES));
        Reading { places, tickets: AtomicU64::new(1), late: Mutex::default() }
    }
}

impl Reading {
    fn late(&self) -> MutexGuard<'_, Vec<Late>> {
        self.late.lock()
    }

    /// A number for a read that begins.
    pub(super) fn ticket(&self) -> u64 {
        self.tickets.fetch_add(1, Ordering::Relaxed)
    }

    /// Refuses a read if an earlier one of it has not returned, and any read if such reads take all threads.
    pub(super) fn refuse(&self, member: &MemberId, name: &str) -> Result<(), Refusal> {
        let late = self.late();
        let full = late.len() >= PLACES;
        let Some(first) = late.iter().find(|l| full || l.name == name) else { return Ok(()) };
        let (since, of) = (first.since.elapsed().as_secs_f64(), &member.port.component);
        let text = format!(
            "it was not begun, since the read {} of {of} has not come back for {since:.1} s",
            first.name
        );
        Err(Refusal::CommandFailed { member: member.clone(), text })
    }

    /// Notes a read as late, unless its answer has come in this very moment.
    pub(super) fn give_up<T>(&self, late: Late, answer: &mut oneshot::Receiver<T>) -> Option<T> {
        let mut all = self.late();
        // The thread that answers removes its read from this list afterwards.
        let answer = answer.try_recv().ok();
        if answer.is_none() {
            all.push(late);
        }
        answer
    }

    pub(super) fn came_back(&self, ticket: u64) {
        self.late().retain(|l| l.ticket != ticket);
    }
}
