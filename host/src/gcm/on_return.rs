//! Wanted states of components whose process is away, or gets them back: the graph has the states seen last.
//!
//! Invariant: a component that was stopped while its process was away is kept in mind until it stands still,
//! whatever becomes of the process meanwhile; a decision made before the Stop does not set it in motion.

use std::collections::{BTreeMap, BTreeSet};

use trocar_model::{ComponentId, Health, Name, State, StopReason, SystemGraph};

#[derive(Default)]
pub(super) struct OnReturn {
    states: BTreeMap<ComponentId, State>,
    /// Processes that were started again and have not got all back yet.
    unfinished: BTreeSet<Name>,
}

impl OnReturn {
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

    /// Keeps the wanted states of the components of a process before its reports are entered. Requests under
    /// way have the last word of theirs.
    pub(super) fn keep(&mut self, graph: &SystemGraph, process: &Name, under_way: &BTreeSet<ComponentId>) {
        let mine = graph.components.iter().filter(|(id, _)| id.process == *process);
        for (id, component) in mine.filter(|(id, _)| !under_way.contains(id)) {
            self.states.entry(id.clone()).or_insert(component.state);
        }
    }

    /// Notes that a component seen in state `seen` is to stand still when it comes back. True: that is new.
    pub(super) fn stop(&mut self, id: &ComponentId, seen: State) -> bool {
        let state = self.states.get(id).copied().unwrap_or(seen);
        let moves_again = matches!(state, State::Active | State::Fault | RESTARTED);
        if moves_again {
            self.states.insert(id.clone(), REQUESTED);
        }
        moves_again
    }

    /// Notes a Stop while the process is here, which may be about to be started again.
    pub(super) fn stop_again(&mut self, id: &ComponentId) {
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

    /// Notes that a component that was to be stopped stands still.
    pub(super) fn stands(&mut self, id: &ComponentId) {
        self.states.remove(id);
    }

    /// Notes that the process is here; only `owed` is kept in mind of it.
    pub(super) fn here(&mut self, process: &Name, owed: &[(ComponentId, State)]) {
        self.unfinished.remove(process);
        self.states.retain(|id, _| id.process != *process || owed.iter().any(|(other, _)| other == id));
    }
}

pub(super) const RESTARTED: State = State::Stopped(StopReason::Restarted);
const REQUESTED: State = State::Stopped(StopReason::Requested);
