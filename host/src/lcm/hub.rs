//! What all components of one LCM share: its name, its news, its log ring.

use std::sync::Arc;

use tokio::sync::broadcast;
use trocar_model::Name;

use super::api::News;
use super::logs::LogRing;

/// News a lagging receiver may miss before it has to ask for the inventory.
const NEWS_DEPTH: usize = 1024;

pub(super) struct Hub {
    pub(super) process: Name,
    pub(super) news: broadcast::Sender<News>,
    pub(super) logs: Arc<LogRing>,
}

impl Hub {
    pub(super) fn new(process: Name) -> Arc<Hub> {
        Arc::new(Hub { process, news: broadcast::channel(NEWS_DEPTH).0, logs: LogRing::new() })
    }
}
