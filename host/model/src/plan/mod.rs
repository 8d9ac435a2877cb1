//! The planner: `(&SystemGraph, Request) → Plan | Refusal`.
//!
//! Invariant: pure, and every check happens here, before anything runs. Checks are made in the order of the
//! error table (path, process, class, component, interface, direction, connected, types, cycle, tags, state,
//! configuration, arguments), so that the same mistake always gets the same answer.

mod carrier;
mod circle;
mod configure;
mod create;
mod execution;
mod lookup;
mod remove;
mod restore;
mod run;
mod tags;
mod wire;

use std::collections::BTreeMap;

pub(crate) use circle::is_stream;
pub use execution::{class_fault, least_execution, period_fault};
pub use restore::{Here, restore};
pub use run::open_ends;
pub(crate) use tags::forbidden;
pub use wire::{default_max_age, made_of};

use crate::{Change, ComponentId, Execution, Plan, Refusal, Request, Skipped, SystemGraph, inverse};

/// Returns what `request` would do to `graph`.
///
/// # Errors
/// The first check that fails; nothing is changed by asking.
pub fn plan(graph: &SystemGraph, request: &Request) -> Result<Plan, Refusal> {
    plan_all(graph, std::slice::from_ref(request))
}

/// Returns one plan for several requests, all or nothing. Later requests see the effects of earlier ones; a
/// component that runs in another's stream or step may be listed before that one.
///
/// # Errors
/// The first check that fails.
pub fn plan_all(graph: &SystemGraph, requests: &[Request]) -> Result<Plan, Refusal> {
    let mut planner = Planner { graph: graph.clone(), plan: Plan::default() };
    for index in in_order(graph, requests)? {
        planner.request(&requests[index])?;
    }
    Ok(planner.plan)
}

/// Requests planned one after another, each on the result of those before it. A refused request changes
/// nothing, and hides no other.
pub struct Planning(Planner);

impl Planning {
    pub fn of(graph: &SystemGraph) -> Planning {
        Planning(Planner { graph: graph.clone(), plan: Plan::default() })
    }

    /// # Errors
    /// The first check that fails.
    pub fn add(&mut self, request: &Request) -> Result<(), Refusal> {
        let (changes, skipped) = (self.0.plan.changes.len(), self.0.plan.skipped.len());
        let number = self.0.graph.next_connection;
        in_order(&self.0.graph, std::slice::from_ref(request))?;
        self.0.request(request).inspect_err(|_| {
            let changes = self.0.plan.changes.split_off(changes);
            self.0.plan.skipped.truncate(skipped);
            let undone = inverse(&Plan { changes, skipped: Vec::new() });
            undone.changes.iter().for_each(|change| self.0.graph.carry_out(change));
            self.0.graph.next_connection = number;
        })
    }

    /// The graph as it will be.
    pub fn graph(&self) -> &SystemGraph {
        &self.0.graph
    }

    /// Returns the plan of all that was not refused.
    pub fn plan(self) -> Plan {
        self.0.plan
    }
}

/// The graph as it will be, and the changes that lead there.
struct Planner {
    graph: SystemGraph,
    plan: Plan,
}

impl Planner {
    fn request(&mut self, request: &Request) -> Result<(), Refusal> {
        match request {
            Request::Create { id, class, config, execution } => {
                self.create(id, class, config.as_ref(), execution)
            }
            Request::CreateIsolated { id, home, class, config, execution } => {
                self.create_isolated(id, home, class, config.as_ref(), execution)
            }
            Request::Remove { id, force } => self.remove(id, *force),
            Request::Forget { process } => self.forget(process),
            Request::Configure { id, patch, execution } => self.configure(id, patch, execution.as_ref()),
            Request::Start { targets } => self.start(targets),
            Request::Stop { targets } => self.stop(targets),
            Request::Resume { targets } => self.resume(targets),
            Request::Reset { targets } => self.reset(targets),
            Request::Connect { client, server, options } => self.connect(client, server, options),
            Request::Disconnect { which } => self.disconnect(which),
        }
    }

    fn push(&mut self, change: Change) {
        self.graph.carry_out(&change);
        self.plan.changes.push(change);
    }

    fn skip(&mut self, id: &ComponentId, why: impl Into<String>) {
        self.plan.skipped.push(Skipped { id: id.clone(), why: why.into() });
    }
}

/// Returns the indices of `requests`, each Create after the one it names in `stream_of` or `inside`;
/// otherwise as given.
fn in_order(graph: &SystemGraph, requests: &[Request]) -> Result<Vec<usize>, Refusal> {
    let mut creates = BTreeMap::new();
    for (i, request) in requests.iter().enumerate() {
        if let Request::Create { id, execution, .. } = request {
            creates.entry(id.clone()).or_insert((i, host_of(execution)));
        }
    }
    let mut order = Vec::with_capacity(requests.len());
    let mut done = vec![false; requests.len()];
    for (i, request) in requests.iter().enumerate() {
        // The chain of hosts above this one that are still to be created, outermost last.
        let mut chain = vec![i];
        let mut path = Vec::new();
        let mut next = match request {
            Request::Create { id, execution, .. } if !done[i] => {
                path.push(id.clone());
                host_of(execution)
            }
            _ => None,
        };
        while let Some(host) = next.filter(|h| !graph.components.contains_key(h)) {
            let Some((at, above)) = creates.get(&host).filter(|(at, _)| !done[*at]) else { break };
            if let Some(start) = path.iter().position(|id| *id == host) {
                let mut path = path.split_off(start);
                path.push(host);
                return Err(Refusal::SyncCycle { path });
            }
            path.push(host);
            chain.push(*at);
            next = above.clone();
        }
        for at in chain.into_iter().rev() {
            if !std::mem::replace(&mut done[at], true) {
                order.push(at);
            }
        }
    }
    Ok(order)
}

/// Returns the component in whose thread this execution runs, if it names one that can be read.
pub fn host_of(execution: &Execution) -> Option<ComponentId> {
    let named = execution.stream_of.as_deref().or(execution.inside.as_deref())?;
    ComponentId::parse(named).ok()
}
