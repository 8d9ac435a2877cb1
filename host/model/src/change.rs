//! A plan: the ordered changes that carry out one request, and their inverse.
//!
//! Invariant: a change holds everything needed to undo it; `SystemGraph::apply(plan)` then
//! `apply(inverse(plan))` is the identity on everything but the revision and the number of the next
//! connection.

use serde_json::Value;

use crate::{Component, ComponentId, Connection, State, SystemGraph, Verb};

/// One step an LCM can do.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Makes the instance; `component.state` is CREATED. Config follows as `Configure`.
    Create {
        id: ComponentId,
        component: Box<Component>,
    },
    /// Destroys it; `component` is what it was.
    Destroy {
        id: ComponentId,
        component: Box<Component>,
    },
    /// Whole configurations before and after; the state goes `from_state` → `to_state`.
    Configure {
        id: ComponentId,
        from: Value,
        to: Value,
        from_state: State,
        to_state: State,
    },
    /// Start, Stop, Resume or Reset.
    Run {
        id: ComponentId,
        verb: Verb,
        from: State,
        to: State,
    },
    Connect {
        connection: Connection,
    },
    Disconnect {
        connection: Connection,
        /// The next change connects the same client end to another source: its component is only rewired.
        replaced: bool,
    },
}

/// A component a glob matched but the verb leaves alone, with the reason.
#[derive(Clone, Debug, PartialEq)]
pub struct Skipped {
    pub id: ComponentId,
    pub why: String,
}

/// Changes of an accepted request, in order. Empty `changes` = nothing to do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    pub changes: Vec<Change>,
    pub skipped: Vec<Skipped>,
}

impl SystemGraph {
    /// Applies an accepted plan to the graph, without doing any of it. Health and fault texts are left alone:
    /// the LCMs report them.
    pub fn apply(&mut self, plan: &Plan) {
        for change in &plan.changes {
            self.carry_out(change);
        }
        if !plan.changes.is_empty() {
            self.revision += 1;
        }
    }

    /// Carries out one change. A change to something that has gone meanwhile has no effect.
    pub fn carry_out(&mut self, change: &Change) {
        match change {
            Change::Create { id, component } => {
                self.components.insert(id.clone(), (**component).clone());
            }
            Change::Destroy { id, .. } => {
                self.components.remove(id);
            }
            Change::Configure { id, to, to_state, .. } => {
                if let Some(component) = self.components.get_mut(id) {
                    component.config = to.clone();
                    component.state = *to_state;
                }
            }
            Change::Run { id, to, .. } => {
                if let Some(component) = self.components.get_mut(id) {
                    component.state = *to;
                }
            }
            Change::Connect { connection } => {
                self.next_connection = self.next_connection.max(connection.id.0 + 1);
                self.connections.insert(connection.id, connection.clone());
            }
            Change::Disconnect { connection, .. } => {
                self.connections.remove(&connection.id);
            }
        }
    }
}

/// Returns the plan that undoes `plan`.
pub fn inverse(plan: &Plan) -> Plan {
    let before = |at: usize| at.checked_sub(1).map(|at| &plan.changes[at]);
    let undone = plan.changes.iter().enumerate().rev().flat_map(|(at, change)| {
        let mut back = vec![undo(change, before(at))];
        back.extend(configured_again(change));
        back
    });
    Plan { changes: undone.collect(), skipped: Vec::new() }
}

/// Returns the change that follows when a destroyed component is made again: the made one is CREATED, without
/// a configuration.
fn configured_again(change: &Change) -> Option<Change> {
    let Change::Destroy { id, component } = change else { return None };
    let (from_state, to_state) = (State::Created, component.state);
    let config = component.config.clone();
    let again = Change::Configure { id: id.clone(), from: config.clone(), to: config, from_state, to_state };
    (to_state != from_state).then_some(again)
}

/// Returns the inverse of one change. `before`: the change it came after.
fn undo(change: &Change, before: Option<&Change>) -> Change {
    match change.clone() {
        Change::Create { id, component } => Change::Destroy { id, component },
        Change::Destroy { id, mut component } => {
            component.state = State::Created;
            Change::Create { id, component }
        }
        Change::Configure { id, from, to, from_state, to_state } => {
            Change::Configure { id, from: to, to: from, from_state: to_state, to_state: from_state }
        }
        Change::Run { id, from, to, .. } => Change::Run { id, verb: way_back(to, from), from: to, to: from },
        Change::Connect { connection } => {
            // A replacement that is taken back is one again.
            let replaced = before.is_some_and(
                |b| matches!(b, Change::Disconnect { connection: old, replaced: true } if old.client == connection.client),
            );
            Change::Disconnect { connection, replaced }
        }
        Change::Disconnect { connection, .. } => Change::Connect { connection },
    }
}

/// Returns the verb that leads an LCM from `from` to `to`, or as near to it as is safe: nothing is ever put
/// into motion that did not move before, and no fault is made again.
fn way_back(from: State, to: State) -> Verb {
    match (from, to) {
        (State::Stopped(_), State::Active) => Verb::Resume,
        (_, State::Active) => Verb::Start,
        (_, State::Ready) => Verb::Reset,
        (_, State::Created | State::Stopped(_) | State::Fault) => Verb::Stop,
    }
}
