//! Calls that stay open until something happens: how many of each kind a port serves at a time.
//!
//! Invariant: a call has its place before its first cost, and gives it back however it ends.

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::Status;
use trocar_links::Seldom;
use trocar_rt::os::now_ns;

/// Most calls of one kind that a port serves at a time. Each has a task and messages of its own for every
/// change, or every line, so without a bound one program that opens them without end takes the memory of all.
pub(crate) const STANDING: usize = 256;

/// The places of each kind.
#[derive(Debug)]
pub(crate) struct Standing {
    pub(super) watches: Places,
    /// Lists that name an etag and wait for another one.
    pub(super) lists: Places,
    /// Logs that follow.
    pub(super) logs: Places,
    pub(super) waits: Places,
    /// Components that end with their callers.
    pub(super) holds: Places,
}

impl Default for Standing {
    fn default() -> Standing {
        let of = |calls, instead| Places {
            calls,
            instead,
            free: Arc::new(Semaphore::new(STANDING)),
            refused: Mutex::default(),
        };
        Standing {
            watches: of("Watches", ", or ask List with unless_etag, which answers at the next change"),
            lists: of(
                "Lists that wait for a change",
                ", or ask List without unless_etag, which answers at once",
            ),
            logs: of("Logs that follow", ", or ask Logs without `follow`, which answers what is kept"),
            waits: of("WaitFors", ", or ask Watch, one of which tells of all components"),
            holds: of("Holds", ", or take the component away yourself (Remove), without a Hold"),
        }
    }
}

/// The places of one kind of call.
#[derive(Debug)]
pub(super) struct Places {
    calls: &'static str,
    instead: &'static str,
    free: Arc<Semaphore>,
    refused: Mutex<Seldom>,
}

impl Places {
    /// A place, free again when it is dropped.
    ///
    /// # Errors
    /// RESOURCE_EXHAUSTED, with the limit and what to do; the log says how often.
    pub(super) fn take(&self) -> Result<OwnedSemaphorePermit, Status> {
        self.free.clone().try_acquire_owned().map_err(|_| {
            let Places { calls, instead, .. } = self;
            let said =
                format!("{STANDING} {calls} are open at this port, which is the most: end some of those calls{instead}");
            let mut refused = self.refused.lock();
            refused.warn(now_ns(), &format!("a call was refused: {said}"));
            Status::resource_exhausted(said)
        })
    }
}
