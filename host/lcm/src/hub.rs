//! State shared by all components of one LCM: its name, its news, its log ring, the way to wake its watchdog.

use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use parking_lot::Mutex;
use tokio::sync::broadcast;
use trocar_lcm_api::News;
use trocar_model::{ComponentId, Name};
use trocar_rt::wake::Waker;

use super::concern::{self, Concern};
use super::latches::Latches;
use super::logs::LogRing;
use super::readers::Readers;
use super::request_queue::RequestQueue;

/// Most news that wait for a lagging receiver before it has to ask for the inventory.
const NEWS_DEPTH: usize = 1024;

pub(super) struct Hub {
    pub(super) process: Name,
    pub(super) news: broadcast::Sender<News>,
    pub(super) logs: Arc<LogRing>,
    /// Queue of the services that components ask for.
    pub(super) request_queue: Arc<RequestQueue>,
    /// Threads for reads from outside.
    pub(super) readers: Arc<Readers>,
    /// Makes the watchdog look now.
    pub(super) watch: Arc<Waker>,
    /// Makes the follower of changing ports look now.
    pub(super) ports: Arc<Waker>,
    /// Removed components whose code may still use what the host gave them: kept until the process ends.
    retired: Mutex<BTreeMap<u32, Arc<dyn Any + Send + Sync>>>,
    /// Reports made so far.
    pub(super) reports: AtomicU64,
    /// Warnings of the process itself.
    pub(super) warnings: Mutex<BTreeMap<Concern, String>>,
    /// The Stops that were ordered.
    pub(super) latches: Latches,
}

impl Hub {
    pub(super) fn new(process: Name) -> Arc<Hub> {
        Arc::new(Hub {
            process,
            news: broadcast::channel(NEWS_DEPTH).0,
            logs: LogRing::new(),
            request_queue: RequestQueue::new(),
            readers: Arc::default(),
            watch: Arc::new(Waker::new()),
            ports: Arc::new(Waker::new()),
            retired: Mutex::default(),
            reports: AtomicU64::new(0),
            warnings: Mutex::default(),
            latches: Latches::default(),
        })
    }

    /// Warns of the process itself from now on; `None`: ends the warning.
    pub(super) fn warn(&self, of: Concern, warning: Option<String>) {
        let mut all = self.warnings.lock();
        match warning {
            Some(warning) => _ = all.insert(of, warning),
            None => _ = all.remove(&of),
        }
        // A failure is fine without listeners: the inventory has the warnings.
        let _ = self.news.send(News::Warnings(concern::told(&all)));
    }

    /// Keeps a component for ever, on purpose, and logs it.
    pub(super) fn retire(
        &self,
        number: u32,
        id: &ComponentId,
        component: Arc<dyn Any + Send + Sync>,
        why: &str,
    ) {
        let mut retired = self.retired.lock();
        if retired.contains_key(&number) {
            return;
        }
        let n = retired.len() + 1;
        log::warn!("{id}: {why}: it is kept until the process ends, as {n} removed so far");
        retired.insert(number, component);
    }

    /// Number of components kept for ever.
    #[cfg(test)]
    pub(super) fn retired(&self) -> usize {
        self.retired.lock().len()
    }
}
