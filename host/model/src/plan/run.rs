//! Start, Stop, Resume, Reset: over names and globs, ordered by the graph.
//!
//! Invariant: Stop is refused for nothing but an unknown component, and a component it named is set in motion
//! only by a later request for it. A glob never puts into motion, nor makes ready for a later glob, a
//! component that waits for an operator to look at it: STOPPED{restarted, interlock, peer_lost}. Nothing is
//! set in motion while an end it requires is open.

use std::collections::{BTreeMap, BTreeSet};

use super::{Planner, execution, host_of};
use crate::{
    Change, Component, ComponentId, Refusal, State, StopReason, SystemGraph, Target, Verb, allowed,
    transition, validate,
};

impl Planner {
    pub(super) fn start(&mut self, targets: &[Target]) -> Result<(), Refusal> {
        self.run(Verb::Start, targets)
    }

    pub(super) fn resume(&mut self, targets: &[Target]) -> Result<(), Refusal> {
        self.run(Verb::Resume, targets)
    }

    pub(super) fn reset(&mut self, targets: &[Target]) -> Result<(), Refusal> {
        self.run(Verb::Reset, targets)
    }

    pub(super) fn stop(&mut self, targets: &[Target]) -> Result<(), Refusal> {
        let targets = self.graph.targets(Verb::Stop, targets)?;
        for (id, _) in servers_first(&self.graph, targets).into_iter().rev() {
            let Some(state) = self.graph.components.get(&id).map(|c| c.state) else { continue };
            let waits = state == State::Stopped(StopReason::Restarted) && !self.graph.is_lost(&id);
            if state != State::Active && !waits {
                let why = if state == State::Fault {
                    "it was made safe when it failed"
                } else {
                    "nothing runs there"
                };
                self.skip(&id, format!("it is {state}: {why}"));
            } else if self.graph.is_lost(&id) {
                let why = "cannot be told; what its machine still does must be stopped there";
                self.skip(&id, format!("its process is lost and {why}"));
            } else {
                self.push_run(&id, Verb::Stop, state);
            }
        }
        Ok(())
    }

    /// Start, Resume and Reset: every target is checked before the first changes anything.
    fn run(&mut self, verb: Verb, targets: &[Target]) -> Result<(), Refusal> {
        let targets = self.graph.targets(verb, targets)?;
        let mut chosen = Vec::new();
        for (id, named) in servers_first(&self.graph, targets) {
            let component = self.graph.component(&id)?;
            if self.graph.is_lost(&id) {
                if named {
                    return self.graph.attached(&id.process).map(|_| ());
                }
                self.skip(&id, "its process is lost");
                continue;
            }
            if !named && let Some(why) = spared(component.state, verb) {
                self.skip(&id, why);
                continue;
            }
            chosen.push(id);
        }
        for id in &chosen {
            self.check_run(id, verb)?;
        }
        for id in chosen {
            let state = self.graph.component(&id)?.state;
            self.push_run(&id, verb, state);
        }
        Ok(())
    }

    fn check_run(&self, id: &ComponentId, verb: Verb) -> Result<(), Refusal> {
        let component = self.graph.component(id)?;
        let state = component.state;
        let wrong =
            |why: String| Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why };
        if transition(state, verb).is_none() {
            return Err(wrong(reason(component)));
        }
        if matches!(verb, Verb::Start | Verb::Resume) {
            let ports = open_ends(&self.graph, id, component);
            if !ports.is_empty() {
                return Err(Refusal::Unconnected { id: id.clone(), verb, ports });
            }
        }
        if verb != Verb::Reset
            && let Err(why) = execution::check_thread(&self.graph, &component.execution)
        {
            return Err(wrong(why));
        }
        Ok(())
    }

    pub(super) fn push_run(&mut self, id: &ComponentId, verb: Verb, from: State) {
        if let Some(to) = transition(from, verb) {
            self.push(Change::Run { id: id.clone(), verb, from, to });
        }
    }
}

/// Returns why a glob leaves a component in `state` alone.
fn spared(state: State, verb: Verb) -> Option<String> {
    let waits = |reason: StopReason| {
        (reason != StopReason::Requested).then(|| {
            format!(
                "it is {state}: it needs {} by name",
                if verb == Verb::Reset { "Reset" } else { "Resume" }
            )
        })
    };
    match (verb, state) {
        (_, State::Stopped(reason)) => waits(reason),
        (Verb::Reset, State::Fault) => None,
        (Verb::Reset, _) => Some(format!("it is {state}: a glob resets only what is in FAULT or STOPPED")),
        (Verb::Start, State::Created) => Some("it is CREATED: its configuration is incomplete".to_owned()),
        (Verb::Start, State::Fault) => Some("it is in FAULT: Reset it first".to_owned()),
        (Verb::Start, State::Active) => Some("it is ACTIVE already".to_owned()),
        (Verb::Resume, _) => Some(format!("it is {state}: only STOPPED components are resumed")),
        _ => None,
    }
}

/// Returns the addition to "not allowed in state …".
fn reason(component: &Component) -> String {
    match component.state {
        State::Created => {
            let open = validate(&component.class.config_schema, &component.config);
            open.into_iter().map(|v| v.message).collect::<Vec<_>>().join("; ")
        }
        State::Active => "it runs already".to_owned(),
        State::Fault => component.fault.clone(),
        State::Ready | State::Stopped(_) => String::new(),
    }
}

/// Returns the names of the inputs and required interfaces of `component` that must be connected and are not.
pub fn open_ends(graph: &SystemGraph, id: &ComponentId, component: &Component) -> Vec<String> {
    let sources = graph.connections.values().map(|c| &c.client).filter(|c| c.component == *id);
    let connected: BTreeSet<&str> = sources.map(|c| c.port.as_str()).collect();
    let inputs = component.ports.inputs.iter().map(|p| (p.name.as_str(), p.optional));
    let required = component.ports.required.iter().map(|p| (p.name.as_str(), p.optional));
    let open = inputs.chain(required).filter(|(name, optional)| !optional && !connected.contains(name));
    open.map(|(name, _)| name.to_owned()).collect()
}

/// Orders servers before clients; but the owner of a thread comes after those that run in it: the head of a
/// stream sets the rest in motion, and its first sample must find them there. Circles are cut at the first
/// path.
pub(super) fn servers_first(
    graph: &SystemGraph,
    targets: Vec<(ComponentId, bool)>,
) -> Vec<(ComponentId, bool)> {
    let mut servers: BTreeMap<&ComponentId, BTreeSet<ComponentId>> = BTreeMap::new();
    let host = |id: &ComponentId| graph.components.get(id).and_then(|c| host_of(&c.execution));
    for id in graph.components.keys() {
        if let Some((lender, _)) = host(id).and_then(|h| graph.components.get_key_value(&h)) {
            servers.entry(lender).or_default().insert(id.clone());
        }
    }
    for connection in graph.connections.values() {
        let (client, server) = (&connection.client.component, &connection.server.component);
        if host(client).as_ref() != Some(server) {
            servers.entry(client).or_default().insert(server.clone());
        }
    }
    let mut wanted: BTreeMap<ComponentId, bool> = targets.into_iter().collect();
    let mut seen = BTreeSet::new();
    let mut order = Vec::with_capacity(wanted.len());
    let roots: Vec<ComponentId> = wanted.keys().cloned().collect();
    for root in roots {
        // Depth first, without recursion: (component, its servers have been visited).
        let mut stack = vec![(root, false)];
        while let Some((id, visited)) = stack.pop() {
            if visited {
                if let Some(named) = wanted.remove(&id) {
                    order.push((id, named));
                }
            } else if seen.insert(id.clone()) {
                let above: Vec<ComponentId> = servers.get(&id).into_iter().flatten().rev().cloned().collect();
                stack.push((id, true));
                stack.extend(above.into_iter().map(|server| (server, false)));
            }
        }
    }
    order
}
