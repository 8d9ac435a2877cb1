//! The owner of the system graph, and what can be seen of it.
//!
//! Invariant: every edit of the graph is one closure under the watch channel's lock, so readers see whole
//! states only; the revision grows by one per accepted request that changed something, and by nothing else.

use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use tokio::sync::watch;
use trocar_model::{ComponentId, Refusal, State, SystemGraph};

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

    /// Waits until a component is in one of the states.
    ///
    /// # Errors
    /// ComponentNotFound, also when it is removed meanwhile; NotReached at the deadline; ComponentFault at
    /// once when it goes into FAULT and nobody waits for that.
    pub async fn wait_for(
        &self,
        id: &ComponentId,
        states: &[State],
        deadline: Instant,
    ) -> Result<Arc<SystemGraph>, Refusal> {
        let began = Instant::now();
        let mut graphs = self.watch();
        loop {
            let graph = graphs.borrow_and_update().clone();
            let Some(component) = graph.components.get(id) else {
                return Err(Refusal::ComponentNotFound {
                    id: id.clone(),
                    known: graph.components.keys().cloned().collect(),
                });
            };
            if states.contains(&component.state) {
                return Ok(graph);
            }
            if component.state == State::Fault {
                return Err(Refusal::ComponentFault { id: id.clone(), text: component.fault.clone() });
            }
            let state = component.state;
            if !matches!(tokio::time::timeout_at(deadline.into(), graphs.changed()).await, Ok(Ok(()))) {
                let after_ns = given_ns(began, deadline);
                return Err(Refusal::NotReached { id: id.clone(), state, wanted: states.to_vec(), after_ns });
            }
        }
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

/// Returns the time a caller was given, as it is told: whole ms, where there are any.
pub(crate) fn given_ns(began: Instant, deadline: Instant) -> u64 {
    let given = deadline.saturating_duration_since(began);
    let ms = (given.as_secs_f64() * 1e3).round() as u64;
    if ms > 0 { ms * 1_000_000 } else { given.subsec_nanos().into() }
}
