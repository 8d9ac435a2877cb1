//! Makes a process that came back have what is wanted of it, and nothing else: what a request had begun there
//! that was never decided is taken away again.
//!
//! Invariant: nothing is set in motion; what requests under way have done is left to them until they end.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use trocar_lcm_api::{Inventory, Lcm, Order, Report};
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, Connection, Execution, ExecutionLimits, Health, Name, Plan,
    Ports, Programs, Refusal, Request, Safety, State, StopReason, SystemGraph, Target, Verb,
};

use super::claims::Planned;
use super::sessions::{Registration, Slice};
use super::{Gcm, text};

/// Tells whether a process may have something else than is wanted of it.
pub(super) fn differs(graph: &SystemGraph, who: &Registration, inventory: &Inventory) -> bool {
    !amends(graph, graph, &who.process, &who.slice, &inventory.components).is_empty()
}

/// Returns the changes that take away what a process has and should not, and put back what it has otherwise.
/// `slice`: everything it was told to have when the graph was as `then`; `has`: its components now.
fn amends(
    graph: &SystemGraph,
    then: &SystemGraph,
    process: &Name,
    slice: &Slice,
    has: &[Report],
) -> Vec<Change> {
    let told: BTreeMap<&ComponentId, &Component> = slice.components.iter().map(|(id, c)| (id, c)).collect();
    let is_wanted = |id: &ComponentId| graph.components.contains_key(id);
    let (mut stops, mut rest, mut goes) = (Vec::new(), Vec::new(), Vec::new());
    for report in has.iter().filter(|report| report.id.process == *process && !is_wanted(&report.id)) {
        let (id, to) = (report.id.clone(), State::Stopped(StopReason::Requested));
        if report.state == State::Active {
            stops.push(Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to });
        }
        let component = told.get(&id).map_or_else(|| nameless(report.state), |known| (*known).clone());
        goes.push(Change::Destroy { id, component: Box::new(component) });
    }
    let is_same = |a: &Connection, b: &Connection| a.client == b.client && a.server == b.server;
    let mine = |c: &&Connection| c.is_near() && c.ends_in(process);
    for connection in slice.connections.iter().filter(mine) {
        if !graph.connections.get(&connection.id).is_some_and(|wanted| is_same(wanted, connection)) {
            rest.push(Change::Disconnect { connection: connection.clone(), replaced: false });
        }
    }
    for report in has {
        let (Some(wanted), Some(known)) = (graph.components.get(&report.id), told.get(&report.id)) else {
            continue;
        };
        let is_as_then = then.components.get(&report.id).is_some_and(|c| c.config == wanted.config);
        if wanted.config != known.config && is_as_then && report.state != State::Fault {
            let (from, to) = (known.config.clone(), wanted.config.clone());
            let (from_state, to_state) = (report.state, report.state);
            rest.push(Change::Configure { id: report.id.clone(), from, to, from_state, to_state });
        }
    }
    for connection in graph.connections.values().filter(mine).filter(|c| then.connections.contains_key(&c.id))
    {
        let has_it = slice.connections.iter().any(|c| c.id == connection.id && is_same(c, connection));
        if !has_it {
            rest.push(Change::Connect { connection: connection.clone() });
        }
    }
    stops.into_iter().chain(rest).chain(goes).collect()
}

/// Stands for a component of which its name alone is known.
fn nameless(state: State) -> Component {
    let class = ClassInfo {
        plugin: String::new(),
        version: String::new(),
        hash: String::new(),
        name: String::new(),
        doc: String::new(),
        safety: Safety::None,
        hardware: false,
        safe_from_any_thread: false,
        programs: Programs::None,
        execution: Execution::default(),
        limits: ExecutionLimits::default(),
        config_schema: serde_json::Value::Null,
        ports: Ports::default(),
    };
    Component {
        class: Arc::new(class),
        config: serde_json::Value::Null,
        execution: Execution::default(),
        ports: Arc::default(),
        state,
        health: Health::Ok,
        fault: String::new(),
    }
}

impl Gcm {
    /// Makes a process in its session have what is wanted. `slice`: what it was told to have when it came, and
    /// the graph was as `then`.
    pub(super) async fn reconcile(&self, process: &Name, session: u64, slice: Slice, then: Arc<SystemGraph>) {
        let Some(everything) = Target::everything().within(process) else { return };
        let part = [Request::Stop { targets: vec![everything] }];
        let since = self.inner.claims.arrive();
        let claim = loop {
            let until = Instant::now() + self.inner.each_change;
            // The claim is of all that there may be, not of a plan.
            let all = |_: &SystemGraph| Ok(Planned { plan: Plan::default(), is_whole: false });
            match self.claim_part(&part, (since, until), all).await {
                Ok((claim, ..)) => break claim,
                Err(refusal) => log::warn!("process {process} may have more than is wanted: {refusal}"),
            }
            if !self.hears(process, session) {
                return;
            }
        };
        let lcm = match self.lcm_of(process) {
            Ok(lcm) if self.hears(process, session) => lcm,
            _ => return,
        };
        let has = match lcm.inventory().await {
            Ok(inventory) => inventory.components,
            Err(refusal) => return log::warn!("the inventory of {process} cannot be had: {refusal}"),
        };
        for change in amends(&self.graph(), &then, process, &slice, &has) {
            if !self.hears(process, session) {
                return;
            }
            log::warn!("{}: process {process} has it otherwise than was decided", text::line(&change));
            if let Err(refusal) = self.amend(&*lcm, process, &change).await {
                self.not_amended(&change, &refusal);
            }
        }
        drop(claim);
    }

    async fn amend(&self, lcm: &dyn Lcm, process: &Name, change: &Change) -> Result<(), Refusal> {
        let deadline = Instant::now() + self.inner.each_change;
        let done = lcm.apply(change.clone(), Order::from(deadline));
        match self.in_time(process, &text::asked(change), deadline, done).await {
            Ok(report) => {
                self.enter_states(&[&report]);
                Ok(())
            }
            Err(Refusal::ConnectionNotFound { .. } | Refusal::ComponentNotFound { .. }) => Ok(()),
            Err(refusal) => Err(refusal),
        }
    }

    /// Shows beside a component that it is otherwise than is listed.
    fn not_amended(&self, change: &Change, refusal: &Refusal) {
        log::error!("{}: {refusal}", text::line(change));
        let id = super::changes::id_of(change);
        self.edit_if(|graph| {
            let Some(component) = Arc::make_mut(graph).components.get_mut(id) else { return false };
            if component.state != State::Fault {
                component.fault = format!("{} could not be taken back: {refusal}", text::asked(change));
            }
            true
        });
    }
}
