//! Takes processes in, and again with what they still have.
//!
//! Invariant: a process that was lost or replaced while it was taken in changes nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tokio::sync::mpsc;
use trocar_lcm_api::{Inventory, Lcm, Report};
use trocar_model::{
    Component, ComponentId, Connection, ConnectionId, Entry, Here, Incarnation, Name, Process, ProcessState,
    Refusal, State, SystemGraph, WantedComponent,
};

use super::Gcm;
use super::follow::follow;
use super::observed::{Loose, loosen, observe};
use super::reconcile::differs;
use super::remote::settle;
use super::sessions::{Claimed, Registered, Registration, Sessions, Slice};

/// Callers that may wait at once until the news of a process is entered.
const ASKING: usize = 64;

impl Gcm {
    /// Takes a process in and follows its news until it is lost. A process that comes back (same instance, or
    /// with a slice from before this GCM) keeps its components and its epoch; another incarnation gets what
    /// the last one was to have, made anew.
    ///
    /// # Errors
    /// The name is taken by another process that is heard; the epoch cannot be made durable.
    pub async fn register(
        &self,
        who: Registration,
        lcm: Arc<dyn Lcm>,
        inventory: Inventory,
    ) -> Result<Registered, Refusal> {
        self.inner.claims.count_on(inventory.decision);
        let is_guest = !who.guest.is_empty();
        let stopped_here = inventory.stopped_here.clone();
        // Before the inventory is entered, so that no news falls between.
        let news = lcm.news();
        let (asks, asked) = mpsc::channel(ASKING);
        let claimed = {
            // Taken before the lock: an editor of the graph may take the lock of the sessions inside.
            let (graph, card) = (self.graph(), inventory.card.clone());
            self.inner.sessions.lock().claim(&graph, &self.inner.ids, &who, lcm.clone(), asks, card)?
        };
        let Claimed { session, epoch, back } = claimed;
        let is_on_record = self.inner.ledger.wanted().processes.contains_key(&who.process);
        if !is_guest {
            let incarnation = Incarnation { instance: who.instance, epoch };
            self.enter(Entry::Came { process: who.process.clone(), incarnation });
        }
        let granted = is_on_record.then(|| self.granted(&who.process, epoch));
        let mut taken = TakenIn::default();
        self.edit(|graph| {
            let mut sessions = self.inner.sessions.lock();
            // Its end was told, or it was replaced, while it was taken in.
            if sessions.holder(&who.process) == Some(session) {
                taken = take_in(&mut sessions, graph, &who, &claimed, inventory, granted.as_ref());
            }
        });
        let word = if back { "is back" } else { "registered" };
        log::info!("process {} {word} (epoch {epoch}, pid {})", who.process, who.pid);
        if taken.is_brought && !is_guest {
            self.bring(&who.process);
        }
        self.cut_off(taken.loose);
        self.cut_strays(taken.strays);
        let (gcm, lcm) = (Arc::downgrade(&self.inner), Arc::downgrade(&lcm));
        tokio::spawn(follow(gcm, who.process.clone(), session, lcm, news, asked));
        self.stop_owed(session, taken.owed);
        self.heard_stop(&who.process, stopped_here);
        let untold = match taken.gets_back {
            // Another incarnation moves nothing by itself.
            Some(_) => {
                self.inner.sessions.lock().forgets(&who.process);
                None
            }
            None => self.inner.sessions.lock().take_untold(&who.process),
        };
        if let Some(untold) = untold {
            self.tell_untold(&who.process, untold);
        }
        match taken.gets_back {
            Some(here) => _ = tokio::spawn(self.clone().restore(who.process, session, here)),
            None => {
                _ = tokio::spawn(self.clone().settle_in(who, session, taken.differs.then(|| self.graph())))
            }
        }
        Ok(Registered { session, epoch, term: self.term(), revision: self.graph().revision })
    }
}

impl Gcm {
    /// Returns the components of a process that may run: those whose start was decided for this incarnation of
    /// it, or is not decided yet.
    fn granted(&self, process: &Name, epoch: u64) -> BTreeSet<ComponentId> {
        let wanted = self.inner.ledger.wanted();
        let mine = wanted.components.keys().filter(|id| id.process == *process);
        let granted: BTreeSet<_> = mine.filter(|id| wanted.is_granted(id, epoch)).cloned().collect();
        drop(wanted);
        granted.into_iter().chain(self.inner.claims.under_way(process)).collect()
    }

    /// Puts on record what a process has brought along that was not on record.
    fn bring(&self, process: &Name) {
        let graph = self.graph();
        let epoch = graph.processes.get(process).map_or(0, |process| process.epoch);
        let mine = graph.components.iter().filter(|(id, _)| id.process == *process);
        let as_wanted = |component: &Component| WantedComponent::seen(component, graph.revision, epoch);
        self.enter(Entry::Brought {
            revision: graph.revision,
            process: process.clone(),
            components: mine.map(|(id, component)| (id.clone(), as_wanted(component))).collect(),
            connections: graph.connections.values().filter(|c| c.ends_in(process)).cloned().collect(),
        });
    }

    /// Makes a process that is here have what is wanted, and nothing else.
    async fn settle_in(self, who: Registration, session: u64, differs_from: Option<Arc<SystemGraph>>) {
        if let Some(then) = differs_from {
            self.reconcile(&who.process, session, who.slice, then).await;
        }
        self.link_missing(who.process).await;
    }
}

/// Tasks that remain when a process is entered in the graph.
#[derive(Default)]
struct TakenIn {
    /// Connections that do not fit any more.
    loose: Vec<Loose>,
    /// The word of the process was taken for what was decided.
    is_brought: bool,
    /// The process may have something else than is wanted.
    differs: bool,
    /// Halves to be cut, by process.
    strays: Vec<(Name, Connection)>,
    /// Components to be stopped that run.
    owed: Vec<(ComponentId, State)>,
    /// Parts that are here already, when the process gets back the others.
    gets_back: Option<Here>,
}

/// Enters a process with what it has and what it is to have. `granted`: those of its components that may run;
/// `None`: there is no word of it.
fn take_in(
    sessions: &mut Sessions,
    graph: &mut SystemGraph,
    who: &Registration,
    claimed: &Claimed,
    inventory: Inventory,
    granted: Option<&BTreeSet<ComponentId>>,
) -> TakenIn {
    let mut taken = TakenIn::default();
    let empty = who.slice.components.is_empty() && inventory.components.is_empty();
    let begins = !claimed.back && empty && graph.components.keys().any(|id| id.process == who.process);
    // What was decided counts, where it is known: a process is evidence of how it stands.
    let is_known = claimed.back && granted.is_some() && who.revision <= graph.revision;
    graph.revision = graph.revision.max(who.revision);
    let is_there = |id: &ComponentId| inventory.components.iter().any(|report| report.id == *id);
    let lacks = is_known && graph.components.keys().any(|id| id.process == who.process && !is_there(id));
    // The process may be lost, and come back, in the middle of its restart.
    let goes_on = claimed.back && sessions.wanted.is_unfinished(&who.process);
    graph.proxies.retain(|_, half| half.process != who.process);
    sessions.counts_anew(&who.process);
    if begins || goes_on || lacks {
        sessions.wanted.begin(&who.process);
        taken.gets_back = Some(already(graph, who, &inventory));
    } else {
        if is_known {
            inventory.components.iter().for_each(|report| taken.loose.extend(observe(graph, report)));
        } else {
            adopt(graph, who, &inventory);
            taken.is_brought = true;
        }
        taken.owed = sessions.wanted.owed(graph, &who.process);
        sessions.wanted.here(&who.process, &taken.owed);
        if let Some(granted) = granted.filter(|_| is_known) {
            let runs = |report: &&Report| report.state == State::Active && !granted.contains(&report.id);
            let owed = |id: &ComponentId| taken.owed.iter().any(|(other, _)| other == id);
            let unasked: Vec<_> =
                inventory.components.iter().filter(runs).filter(|report| !owed(&report.id)).collect();
            taken.owed.extend(unasked.into_iter().map(|report| (report.id.clone(), report.state)));
        }
    }
    taken.differs = is_known && differs(graph, who, &inventory);
    settle(sessions, graph, who, &mut taken.strays, &mut taken.loose);
    // A component that is not configured yet does not have all its ports.
    if taken.gets_back.is_none() {
        taken.loose.extend(inventory.components.iter().flat_map(|report| loosen(graph, &report.id)));
    }
    for half in inventory.halves {
        let key = (ConnectionId(half.connection), half.end);
        graph.proxies.extend(half.proxy.map(|proxy| (key, proxy)));
    }
    let before = graph.processes.get(&who.process);
    let (last_exit, restarts) = before.map(|p| (p.last_exit.clone(), p.restarts)).unwrap_or_default();
    let state = match taken.gets_back {
        Some(_) => ProcessState::Restarting,
        None => ProcessState::Attached,
    };
    let now = Process {
        epoch: claimed.epoch,
        state,
        endpoint: who.endpoint.clone(),
        pid: who.pid,
        classes: inventory.classes,
        last_exit,
        restarts,
        warnings: inventory.warnings,
        guest: who.guest.clone(),
    };
    graph.processes.insert(who.process.clone(), now);
    taken
}

/// Enters the parts a process has already of those it gets back; the rest stays listed as lost.
fn already(graph: &mut SystemGraph, who: &Registration, inventory: &Inventory) -> Here {
    let mut here = Here::default();
    for report in &inventory.components {
        if !graph.components.contains_key(&report.id) {
            log::warn!("{} exists in process {} and is not known here", report.id, who.process);
            continue;
        }
        // Its ports are told once it is configured.
        let ports = report.ports.clone().filter(|_| report.state != State::Created);
        observe(graph, &Report { ports, ..report.clone() });
        here.components.insert(report.id.clone(), report.state);
    }
    here.connections = who.slice.connections.iter().map(|c| c.id).collect();
    here
}

/// Enters the components and connections of a process of which there is no earlier word: those it was told to
/// have, as far as it still has them. [`settle`] handles the connections to other processes.
fn adopt(graph: &mut SystemGraph, who: &Registration, inventory: &Inventory) {
    let Slice { mut components, mut connections } = who.slice.clone();
    let mine = |c: &Connection| c.is_near() && c.ends_in(&who.process);
    graph.components.retain(|id, _| id.process != who.process);
    graph.connections.retain(|_, c| !mine(c));
    connections.retain(mine);
    let reports: BTreeMap<&ComponentId, &Report> = inventory.components.iter().map(|r| (&r.id, r)).collect();
    components.retain(|(id, _)| id.process == who.process && reports.contains_key(id));
    graph.components.extend(components);
    for report in &inventory.components {
        if graph.components.contains_key(&report.id) {
            observe(graph, report);
        } else {
            log::warn!("{} exists in process {} and is not known here", report.id, who.process);
        }
    }
    for connection in connections {
        let known = |id: &ComponentId| graph.components.contains_key(id);
        if !known(&connection.client.component) || !known(&connection.server.component) {
            continue;
        }
        graph.next_connection = graph.next_connection.max(connection.id.0 + 1);
        if graph.connections.contains_key(&connection.id) {
            log::warn!(
                "connection {} from {} to {} is not known here: another one has its number",
                connection.id.0,
                connection.client,
                connection.server
            );
            continue;
        }
        graph.connections.insert(connection.id, connection);
    }
}
