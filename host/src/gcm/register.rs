//! Takes processes in, and again with what they still have.
//!
//! Invariant: a process that was lost or replaced while it was taken in changes nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tokio::sync::{mpsc, oneshot};
use trocar_lcm_api::{Decision, Inventory, Lcm, Report};
use trocar_links::Card;
use trocar_model::{
    Change, Component, ComponentId, Connection, ConnectionId, Entry, Here, Incarnation, Name, Process,
    ProcessState, Refusal, Safety, State, StopReason, SystemGraph, WantedComponent,
};

use super::Gcm;
use super::follow::follow;
use super::observed::{After, loosen, observe};
use super::reconcile::{differs, rests};
use super::remote::settle;
use super::sessions::{Claimed, Registered, Registration, Sessions, Slice};

/// Callers that may wait at once until the news of a process is entered.
const ASKING: usize = 64;
/// State of a component that a Stop has named.
const STOPPED: State = State::Stopped(StopReason::Requested);
/// No GCM has counted so much farther than the one after it.
const AHEAD: u64 = 1 << 32;

impl Gcm {
    /// Takes a process in and follows its news until it is lost. A process that comes back (same instance, or
    /// with a slice from before this GCM) keeps its components and its epoch; another incarnation gets what
    /// the last one was to have, made anew.
    ///
    /// # Errors
    /// The name is taken by another process that is heard; it cannot be put on record, where another GCM
    /// could lead.
    pub async fn register(
        &self,
        who: Registration,
        lcm: Arc<dyn Lcm>,
        inventory: Inventory,
    ) -> Result<Registered, Refusal> {
        let seen = inventory.decision;
        self.inner.claims.count_on(seen);
        let stopped_here = inventory.stopped_here.clone();
        // Before the inventory is entered, so that no news falls between.
        let news = lcm.news();
        let (asks, asked) = mpsc::channel(ASKING);
        let claimed = self.claim_name(&who, lcm.clone(), asks, inventory.card.clone())?;
        let Claimed { session, epoch, back, .. } = claimed;
        let word = self.word_of(&who, &claimed);
        // Whoever asks for this may go meanwhile.
        let mut held = Claiming { gcm: self, process: &who.process, session, is_entered: false };
        if who.guest.is_empty() {
            let incarnation = Incarnation { instance: who.instance, epoch };
            let came = self.enter(Entry::Came { process: who.process.clone(), incarnation });
            // Before anything is made in it: the next GCM knows whom it has made that in.
            self.inner.ledger.durable(came).await?;
        }
        let mut taken = TakenIn::default();
        // One after the other: a GCM that was started again has beats to give beside many that come at once.
        let turn = self.inner.takes_in.lock().await;
        self.edit(|graph| {
            let mut sessions = self.inner.sessions.lock();
            // Its end was told, or it was replaced, while it was taken in.
            if sessions.holder(&who.process) == Some(session) {
                taken = take_in(&mut sessions, graph, &who, &claimed, &word, inventory);
            }
        });
        drop(turn);
        held.is_entered = true;
        drop(held);
        let back_word = if back { "is back" } else { "registered" };
        log::info!("process {} {back_word} (epoch {epoch}, pid {})", who.process, who.pid);
        if taken.is_brought && who.guest.is_empty() {
            self.bring(&who.process, seen);
            let owed = self.stopped_before(&who.process, seen);
            taken.owed.retain(|(id, _)| !owed.iter().any(|(other, _)| other == id));
            taken.owed.extend(owed);
        }
        self.join_wires(taken.joined);
        self.cut_off(taken.loose);
        self.cut_strays(taken.strays);
        let (gcm, lcm) = (Arc::downgrade(&self.inner), Arc::downgrade(&lcm));
        tokio::spawn(follow(gcm, who.process.clone(), session, lcm, news, asked));
        self.stop_owed(session, taken.owed);
        self.heard_stop(&who.process, stopped_here);
        let untold = match back {
            true => self.inner.sessions.lock().take_untold(&who.process),
            // Another incarnation moves nothing by itself.
            false => {
                self.inner.sessions.lock().forgets(&who.process);
                None
            }
        };
        if let Some(untold) = untold {
            self.tell_untold(&who.process, untold);
        }
        let then = taken.differs.then(|| self.graph());
        tokio::spawn(self.clone().settle_in(who, session, taken.gets_back, then));
        Ok(Registered { session, epoch, term: self.term(), revision: self.graph().revision })
    }

    /// Gives a process its name, if that is free, and its epoch.
    fn claim_name(
        &self,
        who: &Registration,
        lcm: Arc<dyn Lcm>,
        asks: mpsc::Sender<oneshot::Sender<()>>,
        card: Option<Card>,
    ) -> Result<Claimed, Refusal> {
        // The disk is waited for without the lock.
        let keeps = self.inner.sessions.lock().keeps(who);
        let epoch = match keeps.filter(|epoch| self.inner.ids.may_be(*epoch)) {
            Some(epoch) => self.inner.ids.not_below(epoch),
            None => self.inner.ids.next_epoch(),
        };
        // Taken before the lock: an editor of the graph may take the lock of the sessions inside.
        let graph = self.graph();
        self.inner.sessions.lock().claim(&graph, epoch, who, lcm, asks, card)
    }

    /// Returns the word that counts for what a process is to have.
    fn word_of(&self, who: &Registration, claimed: &Claimed) -> Word {
        // First, since what is under way may be decided meanwhile.
        let under_way = self.inner.claims.under_way(&who.process);
        let wanted = self.inner.ledger.wanted();
        // A GCM whose journal was behind, or that has none, knows less than the process.
        let is_ahead = !claimed.was_here && who.revision > self.inner.began_at;
        let mut mine = wanted.components.keys().filter(|id| id.process == who.process).peekable();
        // One that comes from elsewhere under a name of which nothing is wanted.
        let has_none = || self.graph().components.keys().all(|id| id.process != who.process);
        let is_strange = !claimed.back && mine.peek().is_none() && under_way.is_empty() && has_none();
        let is_on_record = wanted.processes.contains_key(&who.process);
        if is_ahead || is_strange || !is_on_record || !who.guest.is_empty() {
            return Word::OfProcess;
        }
        let granted = mine.filter(|id| wanted.may_run(id, claimed.epoch)).cloned().collect();
        Word::OnRecord { granted, under_way: under_way.into_iter().collect() }
    }

    /// Puts on record what a process has brought along that was not on record.
    fn bring(&self, process: &Name, decision: Decision) {
        self.inner.ledger.enter(|wanted| {
            let graph = self.graph();
            let epoch = graph.processes.get(process).map_or(0, |process| process.epoch);
            let mine = graph.components.iter().filter(|(id, _)| id.process == *process);
            let as_wanted = |id: &ComponentId, seen: &Component| {
                let state = if self.is_stopped(id, seen, decision) { STOPPED } else { seen.state };
                let component = Component { state, ..seen.clone() };
                WantedComponent::seen(&component, graph.revision, decision.0, epoch)
            };
            let components: Vec<_> = mine.map(|(id, c)| (id.clone(), as_wanted(id, c))).collect();
            let wires =
                graph.connections.values().filter(|c| c.ends_in(process) && !graph.is_guests(&c.client));
            let connections: Vec<_> = wires.cloned().collect();
            let (revision, process) = (graph.revision, process.clone());
            let had = wanted.components.keys().any(|id| id.process == process)
                || wanted.connections.values().any(|c| c.ends_in(&process));
            match !had && components.is_empty() && connections.is_empty() {
                true => (Entry::Noted, None),
                false => (Entry::Brought { revision, process, components, connections }, None),
            }
        });
    }

    /// Tells whether a component is seen running that a Stop named after that decision: while its process was
    /// not known here, or was taken in.
    fn is_stopped(&self, id: &ComponentId, seen: &Component, decision: Decision) -> bool {
        seen.state == State::Active && self.inner.claims.is_stopped_since(id, decision)
    }

    fn stopped_before(&self, process: &Name, decision: Decision) -> Vec<(ComponentId, State)> {
        let graph = self.graph();
        let mine = graph.components.iter().filter(|(id, _)| id.process == *process);
        let stopped = mine.filter(|(id, component)| self.is_stopped(id, component, decision));
        stopped.map(|(id, component)| (id.clone(), component.state)).collect()
    }

    /// Puts connections on record that two processes have brought along.
    fn join_wires(&self, joined: Vec<Connection>) {
        if joined.is_empty() {
            return;
        }
        self.inner.ledger.enter(|_| {
            let revision = self.graph().revision;
            let changes = joined.into_iter().map(|connection| Change::Connect { connection }).collect();
            (Entry::Changed { revision, decision: 0, changes }, None)
        });
    }

    /// Makes a process that is here have what is wanted, and nothing else. `here`: what it has, when it lacks
    /// something; `then`: the graph when it came, when it may have something else.
    async fn settle_in(
        self,
        who: Registration,
        session: u64,
        here: Option<Here>,
        then: Option<Arc<SystemGraph>>,
    ) {
        let process = who.process.clone();
        let (mut here, lacks) = (here.clone().unwrap_or_default(), here.is_some());
        if let Some(then) = then {
            match self.reconcile(&process, session, &who.slice, &then, !lacks).await {
                Some(has) if lacks || self.lacks_some(&process, &has) => {
                    here.components = has.iter().map(|report| (report.id.clone(), report.state)).collect();
                    let whole = |c: &Connection| {
                        [&c.client, &c.server].iter().all(|end| {
                            end.component.process != process || here.components.contains_key(&end.component)
                        })
                    };
                    let graph = self.graph();
                    let wires = graph.connections.values().filter(|c| c.is_near() && c.ends_in(&process));
                    let has = who.slice.connections.iter().map(|c| c.id).collect::<BTreeSet<_>>();
                    let stands = |c: &&Connection| whole(c) && (!lacks || has.contains(&c.id));
                    here.connections = wires.filter(stands).map(|c| c.id).collect();
                    return self.give_back(process, session, here).await;
                }
                _ if lacks => {}
                _ => return self.link_missing(process).await,
            }
        }
        match lacks {
            true => self.restore(process, session, here).await,
            false => self.link_missing(process).await,
        }
    }

    fn lacks_some(&self, process: &Name, has: &[Report]) -> bool {
        let graph = self.graph();
        let mut mine = graph.components.keys().filter(|id| id.process == *process);
        mine.any(|id| !has.iter().any(|report| report.id == *id))
    }

    /// Has a process made whole that was attached already.
    async fn give_back(self, process: Name, session: u64, here: Here) {
        self.edit(|graph| {
            let mut sessions = self.inner.sessions.lock();
            if sessions.holder(&process) == Some(session)
                && let Some(there) = graph.processes.get_mut(&process)
            {
                there.state = ProcessState::Restarting;
                sessions.on_return.begin(&process);
            }
        });
        self.restore(process, session, here).await;
    }
}

/// A session that is not entered yet: it ends with its registration.
struct Claiming<'a> {
    gcm: &'a Gcm,
    process: &'a Name,
    session: u64,
    is_entered: bool,
}

impl Drop for Claiming<'_> {
    fn drop(&mut self) {
        if !self.is_entered {
            self.gcm.lost(self.process, self.session);
        }
    }
}

/// The word that counts for what a process is to have.
enum Word {
    /// The record of what was decided: the process is evidence of how it stands.
    OnRecord {
        /// Components that may run: their start was decided for this incarnation.
        granted: BTreeSet<ComponentId>,
        /// Components of which requests under way have the last word.
        under_way: BTreeSet<ComponentId>,
    },
    /// Its own: there is no other.
    OfProcess,
}

/// Tasks that remain when a process is entered in the graph.
#[derive(Default)]
struct TakenIn {
    /// Connections that do not fit any more.
    loose: Vec<After>,
    /// The word of the process was taken for what was decided.
    is_brought: bool,
    /// The process may have something else than is wanted.
    differs: bool,
    /// Connections of which there was no record.
    joined: Vec<Connection>,
    /// Halves to be cut, by process.
    strays: Vec<(Name, Connection)>,
    /// Components to be stopped that run.
    owed: Vec<(ComponentId, State)>,
    /// Parts that are here already, when the process gets back the others.
    gets_back: Option<Here>,
}

/// Enters a process with what it has and what it is to have.
fn take_in(
    sessions: &mut Sessions,
    graph: &mut SystemGraph,
    who: &Registration,
    claimed: &Claimed,
    word: &Word,
    inventory: Inventory,
) -> TakenIn {
    let mut taken = TakenIn::default();
    // Numbers do not come back, as far as some GCM can have come to them.
    let come_to = |now: u64, told: u64| if told.saturating_sub(now) <= AHEAD { now.max(told) } else { now };
    graph.revision = come_to(graph.revision, who.revision);
    let last = who.slice.connections.iter().map(|c| c.id.0.saturating_add(1)).max();
    graph.next_connection = come_to(graph.next_connection, last.unwrap_or_default());
    graph.proxies.retain(|_, half| half.process != who.process);
    sessions.counts_anew(&who.process);
    sessions.is_entered(&who.process);
    match word {
        Word::OnRecord { granted, under_way } => {
            let may = (granted, under_way);
            as_on_record(sessions, graph, (who, claimed), may, &inventory, &mut taken);
        }
        Word::OfProcess => {
            let cut = adopt(graph, who, &inventory, &sessions.connecting);
            taken.strays.extend(cut.into_iter().map(|connection| (who.process.clone(), connection)));
            taken.is_brought = true;
            taken.owed = sessions.on_return.owed(graph, &who.process);
            sessions.on_return.here(&who.process, &taken.owed);
        }
    }
    match word {
        Word::OfProcess => _ = sessions.believed.insert(who.process.clone()),
        Word::OnRecord { .. } => _ = sessions.believed.remove(&who.process),
    }
    taken.joined = settle(sessions, graph, who, &mut taken.strays, &mut taken.loose);
    // A component that is not configured yet does not have all its ports.
    if taken.gets_back.is_none() {
        let has = inventory.components.iter().map(|report| &report.id).collect();
        taken.loose.extend(loosen(graph, &has));
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

/// Enters how the parts of a process stand of which there is a record: it is to have those, and nothing else.
fn as_on_record(
    sessions: &mut Sessions,
    graph: &mut SystemGraph,
    (who, claimed): (&Registration, &Claimed),
    (granted, under_way): (&BTreeSet<ComponentId>, &BTreeSet<ComponentId>),
    inventory: &Inventory,
    taken: &mut TakenIn,
) {
    // The process may be lost, and come back, in the middle of its restart.
    let goes_on = claimed.back && sessions.on_return.is_unfinished(&who.process);
    let settled = granted.difference(under_way).cloned().collect();
    let lacks = lacks(graph, &who.process, inventory, &settled);
    taken.differs = !under_way.is_empty() || differs(graph, who, inventory, granted);
    let may_run = |id: &ComponentId| granted.contains(id) || under_way.contains(id);
    let runs = inventory.components.iter().filter(|report| report.state == State::Active);
    let unasked = runs.filter(|report| !may_run(&report.id));
    let unasked: Vec<_> = unasked.map(|report| (report.id.clone(), report.state)).collect();
    taken.loose.extend(rests(graph, &settled, &inventory.components, !lacks && !goes_on));
    if goes_on || lacks {
        sessions.on_return.begin(&who.process);
        // A component that was only just made is wanted as it was decided, not as it is seen.
        sessions.on_return.keep(graph, &who.process, under_way);
        taken.gets_back = Some(already(graph, who, inventory, &mut taken.loose));
        taken.owed = unasked;
    } else {
        inventory.components.iter().for_each(|report| taken.loose.extend(observe(graph, report)));
        taken.owed = sessions.on_return.owed(graph, &who.process);
        sessions.on_return.here(&who.process, &taken.owed);
        let owed: BTreeSet<_> = taken.owed.iter().map(|(id, _)| id.clone()).collect();
        taken.owed.extend(unasked.into_iter().filter(|(id, _)| !owed.contains(id)));
    }
}

/// Tells whether a process has not all that it is to have, or not whole: what goes on by itself and is READY
/// was made anew, and not started yet when its GCM ended.
fn lacks(
    graph: &SystemGraph,
    process: &Name,
    inventory: &Inventory,
    granted: &BTreeSet<ComponentId>,
) -> bool {
    let goes_on = |id: &ComponentId, component: &Component| {
        component.class.safety != Safety::Actuator && granted.contains(id)
    };
    let is_whole = |id: &ComponentId, component: &Component| {
        let has = inventory.components.iter().find(|report| report.id == *id);
        has.is_some_and(|report| match report.state {
            State::Created => component.state == State::Created,
            State::Ready => component.state != State::Active || !goes_on(id, component),
            _ => true,
        })
    };
    let mut mine = graph.components.iter().filter(|(id, _)| id.process == *process);
    mine.any(|(id, component)| !is_whole(id, component))
}

/// Enters the parts a process has already of those it gets back; the rest stays listed as lost.
fn already(
    graph: &mut SystemGraph,
    who: &Registration,
    inventory: &Inventory,
    loose: &mut Vec<After>,
) -> Here {
    let mut here = Here::default();
    for report in &inventory.components {
        if !graph.components.contains_key(&report.id) {
            log::warn!("{} exists in process {} and is not known here", report.id, who.process);
            continue;
        }
        // Its ports are told once it is configured.
        let ports = report.ports.clone().filter(|_| report.state != State::Created);
        loose.extend(observe(graph, &Report { ports, ..report.clone() }));
        here.components.insert(report.id.clone(), report.state);
    }
    here.connections = who.slice.connections.iter().map(|c| c.id).collect();
    here
}

/// Enters the components and connections of a process of which there is no earlier word: those it was told to
/// have, as far as it still has them. Returns the connections that it has to give up. [`settle`] handles
/// those to other processes.
fn adopt(
    graph: &mut SystemGraph,
    who: &Registration,
    inventory: &Inventory,
    connecting: &BTreeSet<u64>,
) -> Vec<Connection> {
    let mut cut = Vec::new();
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
        if graph.connections.contains_key(&connection.id) || connecting.contains(&connection.id.0) {
            log::warn!(
                "connection {} from {} to {} is not known here: another one has its number",
                connection.id.0,
                connection.client,
                connection.server
            );
            cut.push(connection);
            continue;
        }
        graph.connections.insert(connection.id, connection);
    }
    cut
}
