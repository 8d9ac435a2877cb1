//! How often Watch tells of one component that it overruns.
//!
//! Invariant: every message counts that says so, whatever changed in it; but for one that follows
//! UNRESPONSIVE: the component is back in the overrun that was told before.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::task::JoinHandle;
use trocar_proto::v1::watch_response::News;
use trocar_proto::v1::{Health, WatchRequest};

use crate::clock::now_ns;
use crate::rpc::{Refused, Rpc, done, runtime};

pub(crate) struct Overruns {
    told: Arc<AtomicU64>,
    task: JoinHandle<()>,
    began_ns: u64,
}

impl Overruns {
    /// From now on, of the component at this path.
    pub(crate) fn of(rpc: &Rpc, path: &str) -> Result<Overruns, Refused> {
        let mut news = done(async { rpc.gcm().watch(WatchRequest::default()).await })?;
        let (told, path) = (Arc::new(AtomicU64::new(0)), path.to_owned());
        let count = told.clone();
        let task = runtime().spawn(async move {
            let mut before = Health::Unspecified;
            while let Ok(Some(one)) = news.message().await {
                let Some(News::Delta(delta)) = one.news else { continue };
                let Some(now) = delta.components.iter().find(|c| c.path == path) else { continue };
                let told = now.health() == Health::Overrun && before != Health::Unresponsive;
                count.fetch_add(u64::from(told), Ordering::Relaxed);
                before = now.health();
            }
        });
        Ok(Overruns { told, task, began_ns: now_ns() })
    }

    /// How often it was told, and how many seconds were watched.
    pub(crate) fn told(&self) -> (u64, f64) {
        (self.told.load(Ordering::Relaxed), now_ns().saturating_sub(self.began_ns) as f64 / 1e9)
    }
}

impl Drop for Overruns {
    fn drop(&mut self) {
        self.task.abort();
    }
}
