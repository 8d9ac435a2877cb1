//! Processes that have ended: a component that keeps its process from coming back is taken out of it, or the
//! whole process is forgotten. This is done in the graph alone, since there is no LCM to ask.
//!
//! Invariant: no change is carried out here for a process that could still do otherwise: it is FAILED, its
//! supervisor saw it end and no other incarnation is here, or the request is to forget it.

use std::sync::Arc;

use trocar_model::{Change, Name, Plan, Process, ProcessState, Refusal, Request, SystemGraph, plan_all};

use super::Gcm;
use super::fate::dismiss;
use super::observed::After;
use super::remote::awaited;
use super::sessions::Sessions;

/// Tells whether nothing of the process runs. A process that is here and gets its components back is
/// RESTARTING, too; how one ended before is no sign that this one has.
fn has_ended(sessions: &Sessions, name: &Name, process: &Process) -> bool {
    match process.state {
        _ if sessions.holder(name).is_some() => false,
        ProcessState::Failed => true,
        ProcessState::Lost | ProcessState::Restarting => sessions.is_over(name),
        ProcessState::Attached => false,
    }
}

/// The plan of requests that only take something away.
///
/// # Errors
/// Every refusal of a plan, but for the processes being away.
pub(super) fn plan_away(graph: &SystemGraph, requests: &[Request]) -> Result<Plan, Refusal> {
    let mut as_if_here = graph.clone();
    for request in requests {
        if let Request::Remove { id, .. } = request
            && let Some(process) = as_if_here.processes.get_mut(&id.process)
        {
            process.state = ProcessState::Attached;
        }
    }
    plan_all(&as_if_here, requests)
}

impl Gcm {
    /// Tells whether nothing of the process runs.
    pub(super) fn has_ended(&self, name: &Name, process: &Process) -> bool {
        has_ended(&self.inner.sessions.lock(), name, process)
    }

    /// Tells whether all requests only take something away of processes that have ended.
    pub(super) fn only_takes_away(&self, graph: &SystemGraph, requests: &[Request]) -> bool {
        let sessions = self.inner.sessions.lock();
        let ended = |name: &Name| graph.processes.get(name).is_some_and(|p| has_ended(&sessions, name, p));
        let takes = |request: &Request| match request {
            Request::Forget { .. } => true,
            Request::Remove { id, .. } => ended(&id.process),
            _ => false,
        };
        !requests.is_empty() && requests.iter().all(takes)
    }

    /// Enters such a plan.
    ///
    /// # Errors
    /// One of the processes has come back meanwhile.
    pub(super) fn take_away(&self, requests: &[Request], plan: &Plan) -> Result<(), Refusal> {
        let (mut back, mut cut, mut strays) = (None, Vec::new(), Vec::new());
        let forgotten: Vec<&Name> = requests
            .iter()
            .filter_map(|request| match request {
                Request::Forget { process } => Some(process),
                _ => None,
            })
            .collect();
        self.edit_if(|graph| {
            let mut sessions = self.inner.sessions.lock();
            back = requests.iter().find_map(|request| came_back(graph, &sessions, request));
            if back.is_some() {
                return false;
            }
            for change in &plan.changes {
                if let Change::Disconnect { connection, .. } = change
                    && !connection.is_near()
                {
                    cut.push(After::cut(connection.clone()));
                }
                Arc::make_mut(graph).carry_out(change);
            }
            for process in &forgotten {
                let pid = graph.processes.get(*process).map_or(0, |p| p.pid);
                sessions.dismiss(process, pid);
                strays.extend(awaited(&mut sessions, process));
                dismiss(graph, process, &mut cut);
            }
            true
        });
        if let Some(refusal) = back {
            return Err(refusal);
        }
        for change in &plan.changes {
            if let Change::Destroy { id, .. } = change {
                self.inner.holds.lock().removed(id);
            }
        }
        for process in &forgotten {
            self.left(process, 0);
        }
        self.not_wanted(&forgotten.into_iter().cloned().collect());
        // Their other halves.
        self.cut_off(cut);
        self.cut_strays(strays);
        Ok(())
    }
}

fn came_back(graph: &SystemGraph, sessions: &Sessions, request: &Request) -> Option<Refusal> {
    let (process, forgets) = match request {
        Request::Forget { process } => (process, true),
        Request::Remove { id, .. } => (&id.process, false),
        _ => return None,
    };
    let there = graph.processes.get(process)?;
    let may_go = match there.state {
        ProcessState::Lost | ProcessState::Failed if forgets => true,
        _ => !forgets && has_ended(sessions, process, there),
    };
    let runs = || Refusal::ProcessRuns { process: process.clone(), state: there.state, pid: there.pid };
    (!may_go).then(runs)
}
