//! State shared by all components of one LCM: its name, its news, its log ring, the way to wake its watchdog.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::broadcast;
use trocar_lcm_api::News;
use trocar_model::Name;
use trocar_rt::wake::Waker;

use super::boundary::{AllRemains, HostContext, SharedTable, Slots};
use super::concern::{self, Concern};
use super::instance::Instance;
use super::logs::LogRing;
use super::reading::Readers;
use super::services::Desk;

/// Most news that wait for a lagging receiver before it has to ask for the inventory.
const NEWS_DEPTH: usize = 1024;

pub(super) struct Hub {
    pub(super) process: Name,
    pub(super) news: broadcast::Sender<News>,
    pub(super) logs: Arc<LogRing>,
    /// Desk where components ask for services.
    pub(super) desk: Arc<Desk>,
    /// Threads for reads from outside.
    pub(super) readers: Arc<Readers>,
    /// Makes the watchdog look now.
    pub(super) watch: Arc<Waker>,
    /// Makes the follower of changing ports look now.
    pub(super) ports: Arc<Waker>,
    /// Removed components whose code may still use what the host gave them: kept until the process ends.
    graveyard: Mutex<Vec<Arc<Instance>>>,
    /// The remains of removed components.
    pub(super) remains: AllRemains,
    /// Reports made so far.
    pub(super) reports: AtomicU64,
    /// Warnings of the process itself.
    pub(super) warnings: Mutex<BTreeMap<Concern, String>>,
}

impl Hub {
    pub(super) fn new(process: Name) -> Arc<Hub> {
        Arc::new(Hub {
            process,
            news: broadcast::channel(NEWS_DEPTH).0,
            logs: LogRing::new(),
            desk: Desk::new(),
            readers: Arc::default(),
            watch: Arc::new(Waker::new()),
            ports: Arc::new(Waker::new()),
            graveyard: Mutex::new(Vec::new()),
            remains: AllRemains::default(),
            reports: AtomicU64::new(0),
            warnings: Mutex::default(),
        })
    }

    /// Warns of the process itself from now on; `None`: ends the warning.
    pub(super) fn warn(&self, of: Concern, warning: Option<String>) {
        let mut all = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        match warning {
            Some(warning) => _ = all.insert(of, warning),
            None => _ = all.remove(&of),
        }
        // A failure is fine without listeners: the inventory has the warnings.
        let _ = self.news.send(News::Warnings(concern::told(&all)));
    }

    /// Keeps the remains of a dropped component; while a cycle may look there, the follower of ports is
    /// woken.
    pub(super) fn keep_remains(
        &self,
        host: &Arc<HostContext>,
        table: Arc<SharedTable>,
        slots: Vec<Arc<Slots>>,
    ) {
        if self.remains.take(host, table, slots) {
            self.ports.notify();
        }
    }

    /// Keeps a component for ever, on purpose, and logs it.
    pub(super) fn bury(&self, instance: Arc<Instance>, why: &str) {
        let mut graveyard = self.graveyard.lock().unwrap_or_else(PoisonError::into_inner);
        if graveyard.iter().any(|i| i.number == instance.number) {
            return;
        }
        let n = graveyard.len() + 1;
        log::warn!("{}: {why}: it is kept until the process ends, as {n} removed so far", instance.id);
        graveyard.push(instance);
    }

    /// Number of components kept for ever.
    #[cfg(test)]
    pub(super) fn buried(&self) -> usize {
        self.graveyard.lock().unwrap_or_else(PoisonError::into_inner).len()
    }
}
