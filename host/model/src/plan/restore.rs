//! Plan for a process that was started again: the components it was to have, made anew, with their
//! connections.
//!
//! Invariant: nothing that moves something is put in motion, and nothing that stood still for a reason loses
//! that reason. A component that cannot be made again is named with the reason, and keeps no other from
//! coming back.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::run::{open_ends, servers_first};
use super::tags::forbidden;
use super::{Plan, host_of};
use crate::{
    Change, ClassInfo, Component, ComponentId, ConnectionId, Health, Name, Safety, Skipped, State,
    StopReason, SystemGraph, Verb,
};

/// Components and connections a process has already: none, unless it was interrupted while it got them back.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Here {
    /// Each with its state.
    pub components: BTreeMap<ComponentId, State>,
    pub connections: BTreeSet<ConnectionId>,
}

/// Returns the changes that make anew what `process` was to have and has not; `skipped` is what cannot be
/// made, or not be started. `wanted` has the states components should have where they differ from the last
/// seen ones.
pub fn restore(
    graph: &SystemGraph,
    process: &Name,
    wanted: &BTreeMap<ComponentId, State>,
    here: &Here,
) -> Plan {
    let mine: BTreeMap<&ComponentId, &Component> =
        graph.components.iter().filter(|(id, _)| id.process == *process).collect();
    let (plan, whole) = (Plan::default(), graph.clone());
    let (made, running) = (BTreeSet::new(), Vec::new());
    let mut restored = Restored { graph, process, here, plan, whole, made, running };
    for id in owners_first(&mine) {
        let old = mine[&id];
        let was = wanted.get(&id).copied().unwrap_or(old.state);
        match restored.class(&id, old) {
            Ok(class) => restored.make(id, old, class, was),
            Err(why) => restored.plan.skipped.push(Skipped { id, why }),
        }
    }
    restored.connect();
    restored.start();
    restored.plan
}

/// A process on the way back.
struct Restored<'a> {
    /// As it was last seen.
    graph: &'a SystemGraph,
    process: &'a Name,
    here: &'a Here,
    plan: Plan,
    /// The graph with what was made again, and without what cannot be.
    whole: SystemGraph,
    made: BTreeSet<ComponentId>,
    /// Components to be started, none of which was named in a request.
    running: Vec<(ComponentId, bool)>,
}

impl Restored<'_> {
    /// Returns the class a component is made of; or the reason why it cannot be made.
    fn class(&self, id: &ComponentId, old: &Component) -> Result<Arc<ClassInfo>, String> {
        let stands_already = self.here.components.contains_key(id);
        let offered = self.graph.class(self.process, &old.class.full_name());
        let class = match offered.and_then(|class| class.is_let_into(self.process).map(|()| class)) {
            Err(_) if stands_already => old.class.clone(),
            offered => offered.map_err(|refusal| refusal.to_string())?,
        };
        let is_missing = |owner: &ComponentId| {
            owner.process == *self.process
                && self.graph.components.contains_key(owner)
                && !self.made.contains(owner)
        };
        match host_of(&old.execution).filter(is_missing) {
            Some(owner) if !stands_already => {
                Err(format!("it runs in the thread of {owner}, which could not be made again"))
            }
            _ => Ok(class),
        }
    }

    /// Makes and configures a component, as far as it does not stand already, and notes whether it is to run.
    fn make(&mut self, id: ComponentId, old: &Component, class: Arc<ClassInfo>, was: State) {
        let stands_already = self.here.components.get(&id);
        // The class may be another one by now, with the same name.
        let to = stands(was, [old.class.safety, class.safety].contains(&Safety::Actuator));
        let is_idle = stands_already.is_none_or(|now| matches!(now, State::Created | State::Ready));
        if was == State::Active && to == State::Ready && is_idle {
            self.running.push((id.clone(), false));
        }
        if stands_already.is_none() {
            let component = Component {
                ports: Arc::new(class.ports.clone()),
                class,
                state: State::Created,
                health: Health::Ok,
                fault: String::new(),
                ..old.clone()
            };
            self.whole.components.insert(id.clone(), component.clone());
            self.plan.changes.push(Change::Create { id: id.clone(), component: Box::new(component) });
        }
        if to != State::Created && stands_already.is_none_or(|now| *now == State::Created) {
            let config = old.config.clone();
            let (from_state, to_state) = (State::Created, to);
            let change =
                Change::Configure { id: id.clone(), from: config.clone(), to: config, from_state, to_state };
            self.plan.changes.push(change);
        }
        self.made.insert(id);
    }

    /// Makes the connections whose ends are there again and may still be connected.
    fn connect(&mut self) {
        let Restored { process, here, plan, whole, made, .. } = self;
        whole.components.retain(|id, _| id.process != **process || made.contains(id));
        let known = |id: &ComponentId| whole.components.contains_key(id);
        whole.connections.retain(|_, c| known(&c.client.component) && known(&c.server.component));
        // Its classes may be others by now, with other tags.
        for (number, why) in forbidden(whole) {
            if let Some(connection) = whole.connections.remove(&number) {
                let id = connection.client.component.clone();
                let why = format!("{} is not connected again: {why}", connection.client.port);
                plan.skipped.push(Skipped { id, why });
            }
        }
        let missing = whole.connections.values().filter(|c| !here.connections.contains(&c.id));
        for connection in missing.filter(|c| c.ends_in(process)) {
            plan.changes.push(Change::Connect { connection: connection.clone() });
        }
    }

    /// Starts what ran, servers first, where everything it needs is connected.
    fn start(&mut self) {
        for (id, _) in servers_first(&self.whole, std::mem::take(&mut self.running)) {
            let open = open_ends(&self.whole, &id, &self.whole.components[&id]);
            if open.is_empty() {
                let (from, to) = (State::Ready, State::Active);
                self.plan.changes.push(Change::Run { id, verb: Verb::Start, from, to });
            } else {
                let why = format!("it is not started: nothing gives it {}", open.join(", "));
                self.plan.skipped.push(Skipped { id, why });
            }
        }
    }
}

/// Returns the state of a component once it is made again and before anything is started. A new instance of a
/// failed component is ready, but its failure has not been looked into.
fn stands(was: State, moves: bool) -> State {
    match was {
        State::Created => State::Created,
        State::Ready => State::Ready,
        State::Stopped(reason) => State::Stopped(reason),
        State::Active | State::Fault if moves => State::Stopped(StopReason::Restarted),
        State::Active | State::Fault => State::Ready,
    }
}

/// Orders each owner of a thread before the components that run in it; a circle is cut at its first path.
fn owners_first(components: &BTreeMap<&ComponentId, &Component>) -> Vec<ComponentId> {
    let mut order: Vec<ComponentId> = Vec::with_capacity(components.len());
    let mut left: Vec<(&ComponentId, Option<ComponentId>)> =
        components.iter().map(|(id, c)| (*id, host_of(&c.execution))).collect();
    while !left.is_empty() {
        let waits: BTreeSet<ComponentId> = left.iter().map(|(id, _)| (*id).clone()).collect();
        let (later, now): (Vec<_>, Vec<_>) = left
            .iter()
            .cloned()
            .partition(|(id, owner)| owner.as_ref().is_some_and(|o| o != *id && waits.contains(o)));
        if now.is_empty() {
            order.extend(later.into_iter().map(|(id, _)| id.clone()));
            break;
        }
        order.extend(now.into_iter().map(|(id, _)| id.clone()));
        left = later;
    }
    order
}
