//! What the supervisors of processes tell, entered in the graph.
//!
//! Invariant: what is told of one incarnation never changes how a later one stands; telling the same again changes nothing.

use std::sync::Arc;

use trocar_model::{Name, Process, ProcessState, SystemGraph};

use super::Gcm;
use super::manager::lock;

/// What became of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    Running,
    /// It ended and is being started again.
    Restarting,
    /// It ended too often.
    Failed,
    /// It ended and stays away.
    Ended,
    /// It was taken down: the system is without it and its components from now on.
    Dismissed,
}

/// A process as its supervisor knows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    pub process: Name,
    pub fate: Fate,
    /// Of the incarnation that runs, or ended last; 0 = none.
    pub pid: u32,
    /// How it ended last; "" when it never did.
    pub last_exit: String,
    pub restarts: u32,
}

impl Gcm {
    /// Enters what a supervisor tells. A process it has seen end is lost at once, whatever its stream still pretends.
    pub fn told(&self, told: &Told) {
        if told.fate != Fate::Running {
            let held = lock(&self.inner.sessions).holder(&told.process);
            let graph = self.graph();
            let is_it = |p: &Process| p.pid == told.pid;
            if let (Some(session), Some(_)) = (held, graph.processes.get(&told.process).filter(|p| is_it(p)))
            {
                self.lost(&told.process, session);
            }
        }
        self.edit_if(|graph| {
            // Another incarnation has come since, or it is somebody else's.
            let other = |p: &Process| p.state == ProcessState::Attached && p.pid != told.pid;
            if graph.processes.get(&told.process).is_some_and(other) {
                return false;
            }
            if told.fate == Fate::Dismissed {
                return dismiss(graph, &told.process);
            }
            let mut now = match graph.processes.get(&told.process) {
                Some(process) => process.clone(),
                // It registers by itself.
                None if told.fate == Fate::Running => return false,
                None => never_seen(told.pid),
            };
            now.last_exit.clone_from(&told.last_exit);
            now.restarts = told.restarts;
            now.state = match told.fate {
                Fate::Running | Fate::Dismissed => now.state,
                Fate::Restarting => ProcessState::Restarting,
                Fate::Failed => ProcessState::Failed,
                Fate::Ended => ProcessState::Lost,
            };
            if graph.processes.get(&told.process) == Some(&now) {
                return false;
            }
            Arc::make_mut(graph).processes.insert(told.process.clone(), now);
            true
        });
    }
}

/// One that ended before it could register.
fn never_seen(pid: u32) -> Process {
    Process {
        epoch: 0,
        state: ProcessState::Lost,
        endpoint: String::new(),
        pid,
        classes: Vec::new(),
        last_exit: String::new(),
        restarts: 0,
    }
}

fn dismiss(graph: &mut Arc<SystemGraph>, process: &Name) -> bool {
    if !graph.processes.contains_key(process) {
        return false;
    }
    let graph = Arc::make_mut(graph);
    graph.processes.remove(process);
    let before = graph.components.len();
    graph
        .connections
        .retain(|_, c| c.client.component.process != *process && c.server.component.process != *process);
    graph.components.retain(|id, _| id.process != *process);
    if graph.components.len() != before {
        graph.revision += 1;
    }
    true
}
