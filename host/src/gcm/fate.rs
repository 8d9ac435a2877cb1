//! Enters in the graph what the supervisors of processes tell.
//!
//! Invariant: news of one incarnation never changes how a later one stands; telling the same again changes
//! nothing.

use std::sync::Arc;

use trocar_model::{Entry, Name, Process, ProcessState, SystemGraph, Warnings};

use super::Gcm;
use super::heard::said_lost;
use super::observed::Loose;
use super::remote::awaited;

/// State of a process, as its supervisor tells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    Running,
    /// The process ended and is being started again.
    Restarting,
    /// The process ended too often.
    Failed,
    /// The process ended and stays away.
    Ended,
    /// The process was taken down: the system is without it and its components from now on.
    Dismissed,
}

/// A process as its supervisor knows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    pub process: Name,
    pub fate: Fate,
    /// Pid of the incarnation that runs, or ended last; 0 = none.
    pub pid: u32,
    /// Last exit of the process; "" when it never ended.
    pub last_exit: String,
    pub restarts: u32,
}

impl Gcm {
    /// Enters what a supervisor tells. A process that the supervisor has seen end is lost at once, whatever
    /// its stream still pretends.
    pub fn told(&self, told: &Told) {
        let (mut cut, mut strays, mut lost, mut dismissed) = (Vec::<Loose>::new(), Vec::new(), None, false);
        self.edit_if(|graph| {
            let mut sessions = self.inner.sessions.lock();
            // Another incarnation or a foreign process is here; or the process was taken down after this was
            // told.
            if sessions.pid(&told.process).is_some_and(|pid| pid != told.pid)
                || sessions.was_dismissed(&told.process, told.pid)
            {
                return false;
            }
            sessions.has_ended(&told.process, told.fate != Fate::Running);
            let held = sessions.holder(&told.process).filter(|_| told.fate != Fate::Running);
            if let Some(session) = held {
                lost = sessions.lose(Arc::make_mut(graph), &told.process, session);
            }
            if told.fate == Fate::Dismissed {
                dismissed = true;
                sessions.dismiss(&told.process, told.pid);
                strays = awaited(&mut sessions, &told.process);
                return dismiss(graph, &told.process, &mut cut);
            }
            let mut now = match graph.processes.get(&told.process) {
                Some(process) => process.clone(),
                // A process that runs registers by itself.
                None if told.fate == Fate::Running => return false,
                None => never_seen(told.pid),
            };
            now.last_exit.clone_from(&told.last_exit);
            now.restarts = told.restarts;
            now.state = match told.fate {
                // The process was given up, and an operator wanted it back.
                Fate::Running if now.state == ProcessState::Failed => ProcessState::Restarting,
                Fate::Running | Fate::Dismissed => now.state,
                Fate::Restarting => ProcessState::Restarting,
                Fate::Failed => ProcessState::Failed,
                Fate::Ended => ProcessState::Lost,
            };
            if graph.processes.get(&told.process) == Some(&now) {
                return held.is_some();
            }
            Arc::make_mut(graph).processes.insert(told.process.clone(), now);
            true
        });
        said_lost(&told.process, lost);
        if dismissed {
            self.left(&told.process);
            self.not_wanted(&[told.process.clone()].into());
        }
        // Their other halves.
        self.cut_off(cut);
        self.cut_strays(strays);
    }
}

/// Entry of a process that ended before it could register.
fn never_seen(pid: u32) -> Process {
    Process {
        epoch: 0,
        state: ProcessState::Lost,
        endpoint: String::new(),
        pid,
        classes: Vec::new(),
        last_exit: String::new(),
        restarts: 0,
        warnings: Warnings::default(),
        guest: String::new(),
    }
}

impl Gcm {
    /// Puts on record that a process was taken out of the system, with all it had.
    pub(crate) fn left(&self, process: &Name) {
        self.enter(Entry::Gone { revision: self.graph().revision, process: process.clone(), epoch: 0 });
    }
}

pub(super) fn dismiss(graph: &mut Arc<SystemGraph>, process: &Name, cut: &mut Vec<Loose>) -> bool {
    if !graph.processes.contains_key(process) {
        return false;
    }
    let graph = Arc::make_mut(graph);
    graph.processes.remove(process);
    let before = graph.components.len();
    let halves = graph.connections.values().filter(|c| !c.is_near() && c.ends_in(process)).cloned();
    cut.extend(halves.map(Loose::cut));
    graph.connections.retain(|_, c| !c.ends_in(process));
    graph.components.retain(|id, _| id.process != *process);
    if graph.components.len() != before {
        graph.revision += 1;
    }
    true
}
