//! Makes a process that came back have what is wanted of it, and nothing else: what a request had begun there
//! that was never decided is taken away again.
//!
//! Invariant: no actuator is set in motion, and nothing else that was not in motion by a grant that still
//! counts; what requests under way have done is left to them until they end.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use trocar_lcm_api::{Inventory, Lcm, Order, Report, clock};
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, Connection, Entry, Execution, ExecutionLimits, Health, Name,
    Plan, Ports, Programs, Refusal, Request, Safety, State, StopReason, SystemGraph, Target, Verb,
};

use super::carrying::Carrying;
use super::claims::Planned;
use super::observed::After;
use super::sessions::{Registration, Slice};
use super::{Gcm, text};

/// Pause before they are looked for once more.
const AGAIN: Duration = Duration::from_secs(1);
/// Times that differences are looked for before what is left is only shown.
const TIMES: u32 = 3;

/// Tells whether a process may have something else than is wanted of it.
pub(super) fn differs(
    graph: &SystemGraph,
    who: &Registration,
    inventory: &Inventory,
    granted: &BTreeSet<ComponentId>,
) -> bool {
    let look = Look { graph, then: graph, process: &who.process, slice: &who.slice, granted, connects: true };
    !look.amends(&inventory.components).is_empty()
}

/// Everything that a process is compared with.
struct Look<'a> {
    graph: &'a SystemGraph,
    /// The graph when the process came.
    then: &'a SystemGraph,
    process: &'a Name,
    /// Everything that it was told to have when it came.
    slice: &'a Slice,
    /// Components that may run.
    granted: &'a BTreeSet<ComponentId>,
    /// Connections that it lacks are made, too.
    connects: bool,
}

impl Look<'_> {
    /// Returns the changes that take away what a process has and should not, and put back what it has
    /// otherwise. `has`: how its components stand.
    fn amends(&self, has: &[Report]) -> Vec<Change> {
        let told: BTreeMap<&ComponentId, &Component> =
            self.slice.components.iter().map(|(id, c)| (id, c)).collect();
        let mine: Vec<&Report> = has.iter().filter(|report| report.id.process == *self.process).collect();
        let goes = |report: &&&Report| self.is_another(&report.id, told.get(&report.id).copied());
        let gone: BTreeSet<&ComponentId> = mine.iter().filter(goes).map(|report| &report.id).collect();
        let (mut stops, mut rest, mut destroyed) = (Vec::new(), Vec::new(), Vec::new());
        for report in &mine {
            let (id, to) = (report.id.clone(), State::Stopped(StopReason::Requested));
            let back = told.get(&id).and_then(|known| self.configured_back(report, known));
            let may_run = self.granted.contains(&id) && !gone.contains(&id);
            if report.state == State::Active && !may_run {
                stops.push(Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to });
            }
            if gone.contains(&id) {
                let component = told.get(&id).map_or_else(|| nameless(report.state), |c| (*c).clone());
                destroyed.push(Change::Destroy { id, component: Box::new(component) });
            } else {
                rest.extend(back);
            }
        }
        let is_same = |a: &Connection, b: &Connection| a.client == b.client && a.server == b.server;
        let near = |c: &&Connection| c.is_near() && c.ends_in(self.process);
        let cut = |c: &Connection| [&c.client, &c.server].iter().any(|end| gone.contains(&end.component));
        let mut wires = Vec::new();
        for connection in self.slice.connections.iter().filter(near) {
            let wanted = self.graph.connections.get(&connection.id);
            if cut(connection) || !wanted.is_some_and(|wanted| is_same(wanted, connection)) {
                wires.push(Change::Disconnect { connection: connection.clone(), replaced: false });
            }
        }
        let is_there = |id: &ComponentId| mine.iter().any(|report| report.id == *id) && !gone.contains(id);
        for connection in self.graph.connections.values().filter(near) {
            let has_it =
                self.slice.connections.iter().any(|c| c.id == connection.id && is_same(c, connection));
            let was_to_be = self.then.connections.contains_key(&connection.id);
            let ends = [&connection.client.component, &connection.server.component];
            // With a component that is made anew its connections are, too.
            if self.connects && !has_it && was_to_be && ends.into_iter().all(is_there) {
                wires.push(Change::Connect { connection: connection.clone() });
            }
        }
        let again = mine.iter().filter(|report| goes_on(self.graph, self.granted, report));
        let again = again.filter(|report| !gone.contains(&report.id));
        let again = again.map(|report| Change::Run {
            id: report.id.clone(),
            verb: Verb::Resume,
            from: report.state,
            to: State::Active,
        });
        stops.into_iter().chain(rest).chain(wires).chain(destroyed).chain(again).collect()
    }

    /// Tells whether a component is none that is wanted: unknown, of another class, or on another thread.
    fn is_another(&self, id: &ComponentId, told: Option<&Component>) -> bool {
        let Some(wanted) = self.graph.components.get(id) else { return true };
        let was = self.then.components.get(id);
        let is_as_then =
            was.is_some_and(|was| was.class == wanted.class && was.execution == wanted.execution);
        let is_other = |told: &Component| {
            (told.class.full_name(), &told.class.hash, &told.execution)
                != (wanted.class.full_name(), &wanted.class.hash, &wanted.execution)
        };
        is_as_then && told.is_some_and(is_other)
    }

    fn configured_back(&self, report: &Report, told: &Component) -> Option<Change> {
        let wanted = self.graph.components.get(&report.id)?;
        let is_as_then = self.then.components.get(&report.id).is_some_and(|c| c.config == wanted.config);
        if wanted.config == told.config || !is_as_then {
            return None;
        }
        let (from, to) = (told.config.clone(), wanted.config.clone());
        // One that goes on keeps the settings that it runs by; any other one is stopped before.
        let stands = match report.state {
            State::Active if !self.granted.contains(&report.id) => State::Stopped(StopReason::Requested),
            stands => stands,
        };
        let (from_state, to_state) = (stands, stands);
        Some(Change::Configure { id: report.id.clone(), from, to, from_state, to_state })
    }
}

/// Tells whether a component goes on by the grant that it has: a request that was never decided has stopped
/// it, and it moves nothing. A Stop that was not recorded has left its latch in the process, which holds that
/// off.
fn goes_on(graph: &SystemGraph, granted: &BTreeSet<ComponentId>, report: &Report) -> bool {
    let moves_nothing = graph.components.get(&report.id).is_some_and(|c| c.class.safety != Safety::Actuator);
    moves_nothing && granted.contains(&report.id) && report.state == State::Stopped(StopReason::Requested)
}

/// Returns the components that may run and stand still: what brought them to rest was never decided, and they
/// go on by another grant alone. `is_whole`: nothing is made and started there again.
pub(super) fn rests(
    graph: &SystemGraph,
    granted: &BTreeSet<ComponentId>,
    has: &[Report],
    is_whole: bool,
) -> Vec<After> {
    let moves = |id: &ComponentId| {
        graph.components.get(id).is_some_and(|component| component.class.safety == Safety::Actuator)
    };
    let rests =
        has.iter().filter(|report| granted.contains(&report.id)).filter(|report| match report.state {
            State::Active | State::Fault => false,
            State::Stopped(_) => !goes_on(graph, granted, report),
            State::Created | State::Ready => is_whole || moves(&report.id),
        });
    rests.map(|report| After::Rests(report.id.clone(), report.state)).collect()
}

fn is_start(change: &Change) -> bool {
    matches!(change, Change::Run { to: State::Active, .. })
}

/// Stands for a component of which its name alone is known.
pub(super) fn nameless(state: State) -> Component {
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

/// Notes a change in what a process was told to have.
fn note(slice: &mut Slice, change: &Change) {
    match change {
        Change::Destroy { id, .. } => slice.components.retain(|(other, _)| other != id),
        Change::Configure { id, to, .. } => {
            for (_, component) in slice.components.iter_mut().filter(|(other, _)| other == id) {
                component.config.clone_from(to);
            }
        }
        Change::Connect { connection } => slice.connections.push(connection.clone()),
        Change::Disconnect { connection, .. } => slice.connections.retain(|c| c.id != connection.id),
        Change::Create { .. } | Change::Run { .. } => {}
    }
}

impl Gcm {
    /// Makes a process in its session have nothing but what is wanted. `slice`: what it was told to have when
    /// it came, and the graph was as `then`. Returns what it has afterwards; `None`: the session is over, or
    /// nobody can tell. `connects`: makes connections that it lacks, too.
    pub(super) async fn reconcile(
        &self,
        process: &Name,
        session: u64,
        slice: &Slice,
        then: &SystemGraph,
        connects: bool,
    ) -> Option<Vec<Report>> {
        let everything = Target::everything().within(process)?;
        let part = [Request::Stop { targets: vec![everything] }];
        let since = self.inner.claims.arrive();
        let mut slice = slice.clone();
        let mut time = 1;
        while time <= TIMES {
            if !self.hears(process, session) {
                return None;
            }
            let until = clock::now() + self.inner.each_change;
            // The claim is of all that there may be, not of a plan.
            let all = |_: &SystemGraph| Ok(Planned { plan: Plan::default(), is_whole: false });
            let doing = format!("comparing what process {process} has with what was decided");
            let claim = match self.claim_for(doing, &part, (since, until), all).await {
                Ok((claim, ..)) => claim,
                Err(refusal) => {
                    log::warn!("process {process} may have something else than is wanted: {refusal}");
                    continue;
                }
            };
            let lcm = self.lcm_of(process).ok().filter(|_| self.hears(process, session))?;
            let has = match lcm.inventory().await {
                Ok(inventory) => inventory.components,
                Err(refusal) => {
                    log::warn!("the inventory of {process} cannot be had: {refusal}");
                    time += 1;
                    continue;
                }
            };
            let (graph, granted) = (self.graph(), self.granted(process));
            let amends = Look { graph: &graph, then, process, slice: &slice, granted: &granted, connects }
                .amends(&has);
            self.cut_off(rests(&graph, &granted, &has, connects));
            if amends.is_empty() {
                return Some(has);
            }
            let carrying = Carrying::begin(self, claim);
            for change in amends {
                if !self.hears(process, session) {
                    return None;
                }
                log::warn!("{}: process {process} has it otherwise than was decided", text::line(&change));
                let amended = match &change {
                    Change::Run { id, to: State::Active, .. } => self.again(&carrying, id, &change).await,
                    _ => self.amend(&*lcm, (process, session), &change).await,
                };
                match amended {
                    Ok(()) => note(&mut slice, &change),
                    Err(_) if !self.hears(process, session) => return None,
                    Err(refusal @ Refusal::WrongState { .. }) if is_start(&change) => {
                        self.rests_all_the_same(&change, &refusal);
                    }
                    Err(refusal) if time == TIMES => {
                        self.not_amended(&change, &refusal);
                        if let Change::Configure { id, from, .. } = &change {
                            self.keeps_settings(id, from, &Err(refusal));
                        }
                    }
                    Err(refusal) => log::warn!("{}: {refusal}", text::line(&change)),
                }
            }
            drop(carrying);
            if time < TIMES {
                tokio::time::sleep(AGAIN * (time - 1)).await;
            }
            time += 1;
        }
        let lcm = self.lcm_of(process).ok().filter(|_| self.hears(process, session))?;
        lcm.inventory().await.ok().map(|inventory| inventory.components)
    }

    /// Returns the components of a process that may run now.
    fn granted(&self, process: &Name) -> BTreeSet<ComponentId> {
        let epoch = self.graph().processes.get(process).map_or(0, |process| process.epoch);
        let wanted = self.inner.ledger.wanted();
        let mine = wanted.components.keys().filter(|id| id.process == *process);
        mine.filter(|id| wanted.may_run(id, epoch)).cloned().collect()
    }

    async fn amend(
        &self,
        lcm: &dyn Lcm,
        (process, session): (&Name, u64),
        change: &Change,
    ) -> Result<(), Refusal> {
        // A component that has failed takes no settings, and one that moves none that nobody asked for.
        if let Change::Configure { id, from, from_state: State::Fault | State::Active, .. } = change {
            self.is_configured_so(id, from);
            return Ok(());
        }
        let deadline = clock::now() + self.inner.each_change;
        let done = lcm.apply(change.clone(), Order::from(deadline));
        match self.in_time(process, &text::asked(change), deadline, done).await {
            Ok(report) => {
                self.enter_states(process, Some(session), &[&report]);
                // One that is stopped for its settings goes on with those that it is to have.
                let granted = self.granted(process);
                if matches!(change, Change::Run { .. }) && !goes_on(&self.graph(), &granted, &report) {
                    self.cut_off(vec![After::Rests(report.id, report.state)]);
                }
                Ok(())
            }
            Err(Refusal::ConnectionNotFound { .. } | Refusal::ComponentNotFound { .. }) => Ok(()),
            Err(refusal) => Err(refusal),
        }
    }

    /// Has a component go on by the decision of its grant: a Stop that came since holds it off.
    async fn again(&self, carrying: &Carrying<'_>, id: &ComponentId, change: &Change) -> Result<(), Refusal> {
        let Some(granted) = self.granted_by(id) else { return Ok(()) };
        let deadline = clock::now() + self.inner.each_change;
        carrying.one_of(change, granted, deadline).await.map(|_| ())
    }

    /// Puts on record that a component stands still which is held off: a Stop is later than its grant.
    fn rests_all_the_same(&self, change: &Change, refusal: &Refusal) {
        log::warn!("{}: {refusal}", text::line(change));
        if let Change::Run { id, from, .. } = change {
            self.cut_off(vec![After::Rests(id.clone(), *from)]);
        }
    }

    /// Decides that a component has the settings that it has.
    pub(super) fn is_configured_so(&self, id: &ComponentId, config: &serde_json::Value) {
        self.decide(|revision| {
            let mut changes = Vec::new();
            self.edit(|graph| {
                let Some(component) = graph.components.get_mut(id) else { return };
                let from = std::mem::replace(&mut component.config, config.clone());
                let (from_state, to_state) = (component.state, component.state);
                let (id, to) = (id.clone(), config.clone());
                changes.push(Change::Configure { id, from, to, from_state, to_state });
            });
            (Entry::Changed { revision, decision: 0, changes }, None)
        });
    }

    /// Shows beside a component that it is otherwise than is listed.
    pub(super) fn not_amended(&self, change: &Change, refusal: &Refusal) {
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
