//! The owner of the system graph, and what can be seen of it.
//!
//! Invariant: every edit of the graph is one closure under the watch channel's lock, so readers see whole
//! states only; the revision grows with each accepted request that changed something, each Stop, and whatever
//! goes by itself, and never falls.

use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;
use trocar_lcm_api::Decision;
use trocar_model::{Entry, SystemGraph};

use super::answer::Answer;
use super::claims::Claims;
use super::history::History;
use super::holds::Holds;
use super::ids::Ids;
use super::isolation::Isolation;
use super::journal::Asked;
use super::lead::Lead;
use super::ledger::{Bell, Ledger};
use super::lines::Lines;
use super::past::Past;
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
    history: Arc<History>,
    pub(super) sessions: Mutex<Sessions>,
    /// Everything that changes the graph but Stop.
    pub(super) claims: Claims,
    pub(super) answers: Mutex<Answers>,
    pub(super) holds: Mutex<Holds>,
    /// The processes for isolated components.
    pub(super) isolation: watch::Sender<Isolation>,
    lines: Arc<Lines>,
    /// Revision with which it began: a process that was told a later one before has seen more.
    pub(super) began_at: u64,
    /// Everything that was decided.
    pub(super) ledger: Ledger,
    /// Held while a process is entered in the graph.
    pub(super) takes_in: tokio::sync::Mutex<()>,
}

impl Gcm {
    /// A GCM that goes on from there and hears no process yet. With a bell, its records go to a store.
    pub(super) fn new(
        ids: Ids,
        (each_change, lead): (Duration, Option<Lead>),
        past: &Past,
        bell: Option<Bell>,
    ) -> Gcm {
        let (wanted, answers) = (past.wanted.clone(), past.answers.clone());
        let (mut graph, claims) = (wanted.unseen(), Claims::default());
        graph.settle();
        claims.count_from(Decision(wanted.decision).max(Decision::before(ids.term())));
        let inner = Inner {
            each_change,
            history: Arc::new(History::beginning(graph.seen)),
            graph: watch::channel(Arc::new(graph)).0,
            sessions: Mutex::new(Sessions::after(&wanted)),
            claims,
            answers: Mutex::new(answers),
            holds: Mutex::default(),
            isolation: watch::Sender::new(Isolation::default()),
            lines: Arc::default(),
            began_at: wanted.revision,
            ledger: Ledger::new(ids.term(), wanted, bell, lead),
            takes_in: tokio::sync::Mutex::default(),
            ids,
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

    /// Changes of each state of the graph, as far as they are kept.
    pub(crate) fn history(&self) -> &Arc<History> {
        &self.inner.history
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
        self.inner.graph.send_if_modified(|graph| {
            let changed = f(graph);
            if changed {
                self.inner.history.settle(Arc::make_mut(graph));
            }
            changed
        });
    }

    pub(super) fn edit(&self, f: impl FnOnce(&mut SystemGraph)) {
        self.edit_if(|graph| {
            f(Arc::make_mut(graph));
            true
        });
    }

    /// Counts one more accepted request, and enters what it has decided. Returns the number of the record.
    pub(super) fn decide(&self, entry: impl FnOnce(u64) -> (Entry, Option<(Asked, Answer)>)) -> u64 {
        self.inner.ledger.enter(|_| entry(self.accepted()))
    }

    /// Enters something that was decided before.
    pub(super) fn enter(&self, entry: Entry) -> u64 {
        self.inner.ledger.enter(|_| (entry, None))
    }

    fn accepted(&self) -> u64 {
        let mut revision = 0;
        self.edit(|graph| {
            graph.revision += 1;
            revision = graph.revision;
        });
        revision
    }
}
