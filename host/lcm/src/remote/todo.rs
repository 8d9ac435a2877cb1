//! The halves of this process, and the tasks of the thread `trocar-remote` with them.
//!
//! Invariant: tasks are done in the order in which they came; whoever leaves one never waits for it.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::oneshot;
use trocar_rt::wake::Waker;

use super::super::loss::Loss;
use super::half::Half;
use super::medium::{Message, Session};

/// The halves by the number of their connection.
pub(super) type Halves = Arc<Mutex<BTreeMap<u64, Arc<Half>>>>;

pub(super) fn locked(halves: &Halves) -> MutexGuard<'_, BTreeMap<u64, Arc<Half>>> {
    halves.lock()
}

pub(super) fn all(halves: &Halves) -> Vec<Arc<Half>> {
    locked(halves).values().cloned().collect()
}

pub(super) enum Todo {
    Met(Arc<dyn Session>),
    Said(Arc<dyn Session>, Message),
    Lost(Arc<dyn Session>, String),
    /// The half is in the list, and replaced this other one there.
    Added(Arc<Half>, Option<Arc<Half>>),
    /// The half is not in the list any more.
    Removed(Arc<Half>, Loss, oneshot::Sender<()>),
    Stop,
}

/// Tasks of `trocar-remote`. Its bell is also rung by outputs that give frames of a pool the reader does not
/// know.
#[derive(Default)]
pub(super) struct Todos {
    queue: Mutex<VecDeque<Todo>>,
    pub(super) bell: Arc<Waker>,
}

impl Todos {
    fn queue(&self) -> MutexGuard<'_, VecDeque<Todo>> {
        self.queue.lock()
    }

    pub(super) fn push(&self, todo: Todo) {
        self.queue().push_back(todo);
        self.bell.notify();
    }

    pub(super) fn next(&self) -> Option<Todo> {
        self.queue().pop_front()
    }
}

/// Tells `trocar-remote` of what comes, on the threads of the sessions.
#[derive(Clone)]
pub(super) struct Teller {
    pub(super) halves: Halves,
    pub(super) todos: Arc<Todos>,
}

impl Teller {
    pub(super) fn met(&self, session: Arc<dyn Session>) {
        self.todos.push(Todo::Met(session));
    }

    pub(super) fn said(&self, session: Arc<dyn Session>, message: Message) {
        self.todos.push(Todo::Said(session, message));
    }

    pub(super) fn lost(&self, session: Arc<dyn Session>, why: String) {
        all(&self.halves).iter().for_each(|half| half.lose(&session));
        self.todos.push(Todo::Lost(session, why));
    }
}
