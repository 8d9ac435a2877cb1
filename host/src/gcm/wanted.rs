//! Wanted states of components whose process is away, or gets them back: the graph has the states seen last.
//!
//! Invariant: a component that was stopped while its process was away is kept in mind until it stands still,
//! whatever becomes of the process meanwhile; a decision made before the Stop does not set it in motion.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_lcm_api::Report;
use trocar_model::{
    Change, ComponentId, Health, Name, ProcessState, Refusal, Request, State, StopReason, SystemGraph, Target,
};

use super::Gcm;
use super::execute::id_of;
use super::manager::lock;
use super::stop::names;

/// Time to stop the components that were stopped while their process was away.
const WITHIN: Duration = Duration::from_secs(5);

#[derive(Default)]
pub(super) struct Wanted {
    states: BTreeMap<ComponentId, State>,
    /// Processes that were started again and have not got all back yet.
    unfinished: BTreeSet<Name>,
}

impl Wanted {
    /// Notes that a process gets back the components it was to have.
    pub(super) fn begin(&mut self, process: &Name) {
        self.unfinished.insert(process.clone());
    }

    pub(super) fn is_unfinished(&self, process: &Name) -> bool {
        self.unfinished.contains(process)
    }

    /// Returns the wanted states of the components of a process. They are kept from the first call on, since
    /// making the components changes the states seen.
    pub(super) fn of(&mut self, graph: &SystemGraph, process: &Name) -> BTreeMap<ComponentId, State> {
        let mine = graph.components.iter().filter(|(id, _)| id.process == *process);
        mine.map(|(id, c)| (id.clone(), *self.states.entry(id.clone()).or_insert(c.state))).collect()
    }

    /// Notes that a component seen in state `seen` is to stand still when it comes back. True: that is new.
    fn stop(&mut self, id: &ComponentId, seen: State) -> bool {
        let state = self.states.get(id).copied().unwrap_or(seen);
        let moves_again = matches!(state, State::Active | State::Fault | RESTARTED);
        if moves_again {
            self.states.insert(id.clone(), REQUESTED);
        }
        moves_again
    }

    /// Notes a Stop while the process is here, which may be about to be started again.
    fn stop_again(&mut self, id: &ComponentId) {
        if let Some(state) = self.states.get_mut(id) {
            *state = REQUESTED;
        }
    }

    /// Notes that the process was to be started again and was not; stopped components are kept in mind.
    pub(super) fn stays(&mut self, process: &Name) {
        self.states.retain(|id, state| id.process != *process || *state == REQUESTED);
    }

    /// Returns the components that were to be stopped and are seen otherwise.
    pub(super) fn owed(&self, graph: &SystemGraph, process: &Name) -> Vec<(ComponentId, State)> {
        let stopped = self.states.iter().filter(|(id, to)| id.process == *process && **to == REQUESTED);
        let owed = stopped.filter_map(|(id, _)| {
            let component = graph.components.get(id).filter(|c| c.health != Health::Lost)?;
            matches!(component.state, State::Active | RESTARTED).then(|| (id.clone(), component.state))
        });
        owed.collect()
    }

    /// Notes that the process is here; only `owed` is kept in mind of it.
    pub(super) fn here(&mut self, process: &Name, owed: &[(ComponentId, State)]) {
        self.unfinished.remove(process);
        self.states.retain(|id, _| id.process != *process || owed.iter().any(|(other, _)| other == id));
    }
}

const RESTARTED: State = State::Stopped(StopReason::Restarted);
const REQUESTED: State = State::Stopped(StopReason::Requested);

impl Gcm {
    /// Notes components that are stopped and cannot be told, because their process is away. True: a component
    /// that might have been set in motion by itself is now to stand still, and the revision is a new one, so
    /// that no earlier decision sets it in motion.
    pub(super) fn keep_stopped(&self, targets: &[Target]) -> bool {
        let mut noted = false;
        self.edit_if(|graph| {
            let mut sessions = lock(&self.inner.sessions);
            let stopped =
                graph.components.iter().filter(|(id, _)| targets.iter().any(|target| names(target, id)));
            for (id, component) in stopped {
                let there = |state: ProcessState| state == ProcessState::Attached;
                noted |= match graph.processes.get(&id.process) {
                    Some(process) if there(process.state) => {
                        sessions.wanted.stop_again(id);
                        component.state == RESTARTED
                    }
                    _ => sessions.wanted.stop(id, component.state),
                };
            }
            if noted {
                Arc::make_mut(graph).revision += 1;
            }
            noted
        });
        noted
    }

    /// Stops a component. If its process goes away meanwhile, it is stopped when that process comes back.
    pub(super) async fn stop_one(&self, stop: &Change, deadline: Instant) -> Result<Report, Refusal> {
        let id = id_of(stop);
        let asked = lock(&self.inner.sessions).holder(&id.process);
        let lost = match self.one(stop, deadline).await {
            Err(lost @ Refusal::ProcessLost { .. }) => lost,
            done => return done,
        };
        let mut is_back = false;
        self.edit_if(|graph| {
            let mut sessions = lock(&self.inner.sessions);
            let holder = sessions.holder(&id.process);
            is_back = holder.is_some() && holder != asked;
            if let Some(component) = graph.components.get(id).filter(|_| !is_back) {
                sessions.wanted.stop(id, component.state);
            }
            false
        });
        if is_back { self.one(stop, deadline).await } else { Err(lost) }
    }

    /// Stops the components that were stopped while their process was away, which has come back as it was.
    pub(super) fn stop_owed(&self, session: u64, owed: Vec<(ComponentId, State)>) {
        for (id, _) in owed {
            let gcm = self.clone();
            tokio::spawn(async move {
                log::warn!("{id} was stopped while its process was away, and runs: it is stopped now");
                let request = [Request::Stop { targets: vec![Target::One(id.clone())] }];
                match gcm.stop(&request, false, Instant::now() + WITHIN).await {
                    // The component is stopped when the process is back again.
                    Err(Refusal::ProcessLost { .. }) => return,
                    Err(refusal) => log::error!("{id} cannot be stopped: {refusal}"),
                    Ok(_) => {}
                }
                let mut sessions = lock(&gcm.inner.sessions);
                if sessions.holder(&id.process) == Some(session) {
                    sessions.wanted.states.remove(&id);
                }
            });
        }
    }
}
