//! The owner of the system graph, and what can be seen of it.
//!
//! Invariant: every edit of the graph is one closure under the watch channel's lock, so readers see whole
//! states only; the revision grows by one per accepted request that changed something, and by nothing else.

use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;
use trocar_model::SystemGraph;

use super::claims::Claims;
use super::holds::Holds;
use super::ids::Ids;
use super::isolation::Isolation;
use super::lines::Lines;
use super::requests::Answers;
use super::sessions::Sessions;

/// A handle; clones share one GCM.
#[derive(Clone)]
pub struct Gcm {
    pub(super) inner: Arc<Inner>,
}

pub(super) struct Inner {
    pub(super) ids: Ids,
    pub(super) each_change: Duration,
    graph: watch::Sender<Arc<SystemGraph>>,
    pub(super) sessions: Mutex<Sessions>,
    /// Everything that changes the graph but Stop.
    pub(super) claims: Claims,
    pub(super) answers: Mutex<Answers>,
    pub(super) holds: Mutex<Holds>,
    /// The processes for isolated components.
    pub(super) isolation: watch::Sender<Isolation>,
    lines: Arc<Lines>,
}

impl Gcm {
    /// A GCM without processes.
    pub(super) fn new(ids: Ids, each_change: Duration) -> Gcm {
        let graph = SystemGraph { next_connection: 1, ..SystemGraph::default() };
        let inner = Inner {
            ids,
            each_change,
            graph: watch::channel(Arc::new(graph)).0,
            sessions: Mutex::default(),
            claims: Claims::default(),
            answers: Mutex::default(),
            holds: Mutex::default(),
            isolation: watch::Sender::new(Isolation::default()),
            lines: Arc::default(),
        };
        Gcm { inner: Arc::new(inner) }
    }

    /// The graph as it is now.
    pub fn graph(&self) -> Arc<SystemGraph> {
        self.inner.graph.borrow().clone()
    }

    /// Every later state of the graph; a slow reader sees the newest and misses those between.
    pub fn watch(&self) -> watch::Receiver<Arc<SystemGraph>> {
        self.inner.graph.subscribe()
    }

    /// The term of this GCM: one per incarnation.
    pub fn term(&self) -> u64 {
        self.inner.ids.term()
    }

    /// Returns the log lines of the components of all processes.
    pub fn lines(&self) -> &Arc<Lines> {
        &self.inner.lines
    }

    /// Edits the graph; `f` tells whether anything changed, and only then the followers are woken.
    pub(super) fn edit_if(&self, f: impl FnOnce(&mut Arc<SystemGraph>) -> bool) {
        self.inner.graph.send_if_modified(f);
    }

    pub(super) fn edit(&self, f: impl FnOnce(&mut SystemGraph)) {
        self.inner.graph.send_modify(|graph| f(Arc::make_mut(graph)));
    }

    /// Counts one more accepted request.
    pub(super) fn accepted(&self) -> u64 {
        let mut revision = 0;
        self.edit(|graph| {
            graph.revision += 1;
            revision = graph.revision;
        });
        revision
    }
}
