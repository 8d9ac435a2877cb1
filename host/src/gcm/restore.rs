//! Gives a process that was started again the components and connections it was to have.
//!
//! Invariant: the process counts as RESTARTING until that is done, however often it is interrupted; nothing
//! that moves something is put in motion, and what is stopped meanwhile stays stopped. A component that
//! cannot be made again is named with the reason, and keeps no other from coming back.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use trocar_lcm_api::{Decision, clock};
use trocar_model::{
    Change, ComponentId, Connection, Entry, Health, Here, Name, Plan, Process, ProcessState, Refusal, State,
    StopReason, SystemGraph, Verb, open_ends, restore,
};

use super::Gcm;
use super::carrying::Carrying;
use super::changes::id_of;
use super::observed::After;
use super::text;

/// Time for one connection to another process, which may end in the middle of it.
const LINKED: Duration = Duration::from_secs(2);

/// Time for a session to end here that its process has ended.
const GONE: Duration = Duration::from_secs(2);

/// Components that do not come back, and what is to be said about them.
#[derive(Default)]
struct Away {
    unmade: BTreeSet<ComponentId>,
    /// Notes beside components that are there.
    notes: BTreeMap<ComponentId, Vec<String>>,
}

/// A process on its way back.
struct Back {
    process: Name,
    session: u64,
    /// Place of the restoring among all decisions.
    since: Decision,
    /// The decisions by which its components run.
    grants: BTreeMap<ComponentId, Decision>,
}

impl Back {
    /// Returns the decision by which a component goes on: without a grant each Stop is later.
    fn granted(&self, id: &ComponentId) -> Decision {
        self.grants.get(id).copied().unwrap_or(Decision::NONE)
    }
}

impl Away {
    fn note(&mut self, id: &ComponentId, why: String) {
        log::error!("{id}: {why}");
        self.notes.entry(id.clone()).or_default().push(why);
    }

    /// Returns an end of a connection that does not come back.
    fn end<'c>(&self, connection: &'c Connection) -> Option<&'c ComponentId> {
        [&connection.server, &connection.client]
            .into_iter()
            .map(|end| &end.component)
            .find(|id| self.unmade.contains(id))
    }
}

impl Gcm {
    /// Makes the components anew that a process was to have and has not, in its session `session`.
    pub(super) async fn restore(self, process: Name, session: u64, here: Here) {
        let decide = |graph: &SystemGraph| {
            let wanted = self.inner.sessions.lock().on_return.of(graph, &process);
            Ok(restore(graph, &process, &wanted, &here))
        };
        let since = self.inner.claims.arrive();
        let (claim, plan) = loop {
            let doing = format!("making the components of process {process} again");
            let by = (since, clock::now() + self.inner.each_change);
            let planned = tokio::select! {
                planned = self.claim_for(doing, &[], by, decide) => planned,
                () = self.gone(&process, session) => return,
            };
            match planned {
                Ok((claim, _, plan)) => break (claim, plan),
                Err(refusal) => {
                    log::error!("the components of process {process} are not made again yet: {refusal}");
                }
            }
        };
        let carrying = Carrying::begin(&self, claim);
        // A component that is made again has no grant on record until it runs again.
        let back = Back { process: process.clone(), session, since, grants: self.grants(&process) };
        let mut made = Vec::new();
        let again = self.make_again(&carrying, &plan, &back, &here, &mut made).await;
        let Some(away) = again else { return };
        self.made_again(&mut made, &back);
        match away.unmade.len() {
            0 => log::info!("process {process} has again all that it was to have"),
            n => log::warn!(
                "process {process} has again what it was to have, but for {n} of it: `trocar ls` says why"
            ),
        }
        // News told before would cover the notes.
        self.hear_out(&process).await;
        self.noted(away);
        self.attached_again(&carrying, &process, session).await;
        drop(carrying);
        self.link_missing(process).await;
    }

    /// Tells whether a component that was made is of the class that is on record: its plugin may be another
    /// one since.
    fn is_as_decided(&self, made: &Change) -> bool {
        let (id, graph) = (id_of(made), self.graph());
        let class = graph.components.get(id).map(|component| &component.class);
        self.inner.ledger.wanted().components.get(id).map(|component| &component.class) == class
    }

    /// Puts on record what was made again: of which classes it is, and by which grants it runs.
    fn made_again(&self, made: &mut Vec<Change>, back: &Back) {
        let made = std::mem::take(made);
        if made.is_empty() {
            return;
        }
        // A component that goes on by itself does so by no later decision than before.
        let starts = made.iter().find(|change| matches!(change, Change::Run { to: State::Active, .. }));
        let granted = starts.and_then(|start| back.grants.get(id_of(start)).copied());
        let decision = granted.unwrap_or(back.since).0;
        self.inner.ledger.enter(|_| {
            let revision = self.graph().revision;
            let changes = self.on_record(&made, back.since);
            (Entry::Changed { revision, decision, changes }, None)
        });
    }

    /// Returns the decisions by which the components of a process run.
    fn grants(&self, process: &Name) -> BTreeMap<ComponentId, Decision> {
        let wanted = self.inner.ledger.wanted();
        let mine = wanted.components.iter().filter(|(id, _)| id.process == *process);
        mine.filter_map(|(id, c)| Some((id.clone(), Decision(c.grant?.decision)))).collect()
    }

    /// Carries out all changes of the plan; `None`: the process is gone. `made_again`: done, and not on
    /// record yet.
    async fn make_again(
        &self,
        carrying: &Carrying<'_>,
        plan: &Plan,
        back: &Back,
        here: &Here,
        made_again: &mut Vec<Change>,
    ) -> Option<Away> {
        let (process, session, mut away) = (&back.process, back.session, Away::default());
        self.skipped(plan, here, &mut away);
        // What is to run, and does not yet, is no more than what was wanted before: the next GCM goes on from
        // there.
        let mut to_start: BTreeSet<&ComponentId> = plan.changes.iter().filter_map(started).collect();
        let mut made = Vec::new();
        for change in &plan.changes {
            if !self.hears(process, session) {
                return None;
            }
            if let Some(id) = started(change) {
                to_start.remove(id);
                made_again.extend(made.extract_if(.., |made| id_of(made) == id));
            }
            // The change is made when that process has its components again.
            if self.awaits(change, process) || self.is_idle(change, &mut away) {
                continue;
            }
            let remote = matches!(change, Change::Connect { connection } if !connection.is_near());
            let deadline = clock::now() + if remote { LINKED } else { self.inner.each_change };
            // A Stop of which this GCM does not know, since it was decided by the one before, holds it off.
            let decision = match change {
                Change::Run { id, to: State::Active, .. } => back.granted(id),
                _ => back.since,
            };
            let done = tokio::select! {
                // A change that is not begun yet is not begun for a session that is over.
                biased;
                () = self.gone(process, session) => return None,
                done = carrying.one_of(change, decision, deadline) => done,
            };
            // The process says that this session is over, before that was noticed here: it comes again.
            if let Err(Refusal::ProcessLost { process: lost, .. }) = &done
                && lost == process
            {
                let _ = tokio::time::timeout(GONE, self.gone(process, session)).await;
            }
            match done {
                Ok(_)
                    if is_made(change) && to_start.contains(id_of(change)) && self.is_as_decided(change) =>
                {
                    made.push(change.clone());
                }
                Ok(_) => {
                    made_again.push(change.clone());
                    // One that is made and not configured yet is no more than what was wanted before.
                    if !matches!(change, Change::Create { .. }) {
                        self.made_again(made_again, back);
                    }
                }
                Err(Refusal::ProcessLost { .. }) if !self.hears(process, session) => return None,
                // The other process ended, too, or cannot be reached yet.
                Err(
                    refusal @ (Refusal::ProcessLost { .. }
                    | Refusal::Unreachable { .. }
                    | Refusal::LcmTimeout { .. }),
                ) if remote => {
                    log::warn!("{}: {refusal}", text::line(change));
                    if let Change::Connect { connection } = change {
                        self.not_linked(connection, &refusal).await;
                    }
                }
                Err(refusal) => {
                    if let (Change::Run { id, .. }, Refusal::WrongState { .. }) = (change, &refusal) {
                        self.stays_stopped(id, back.since);
                    }
                    self.not_done(change, &refusal, &mut away);
                }
            }
        }
        Some(away)
    }

    /// Says what the plan has left out.
    fn skipped(&self, plan: &Plan, here: &Here, away: &mut Away) {
        let made = |id: &ComponentId| {
            let creates = |c: &Change| matches!(c, Change::Create { id: made, .. } if made == id);
            here.components.contains_key(id) || plan.changes.iter().any(creates)
        };
        for skipped in &plan.skipped {
            if made(&skipped.id) {
                away.note(&skipped.id, skipped.why.clone());
            } else {
                log::error!("{}: {}", skipped.id, skipped.why);
                self.not_made(&skipped.id, &skipped.why, away);
            }
        }
    }

    /// True for a connection to another process that is not there, or not whole yet.
    fn awaits(&self, change: &Change, process: &Name) -> bool {
        let Change::Connect { connection } = change else { return false };
        let graph = self.graph();
        [&connection.client, &connection.server].iter().map(|end| &end.component.process).any(|other| {
            let there = |p: &Process| p.state == ProcessState::Attached;
            other != process && !graph.processes.get(other).is_some_and(there)
        })
    }

    /// Tells whether a change cannot be done, because a component it needs does not come back.
    fn is_idle(&self, change: &Change, away: &mut Away) -> bool {
        match change {
            Change::Connect { connection } => {
                if let Some(end) = away.end(connection).cloned() {
                    self.not_connected(connection, &format!("{end} could not be made again"), away);
                    return true;
                }
                false
            }
            Change::Run { id, verb: Verb::Start, .. } => {
                let graph = self.graph();
                let Some(component) = graph.components.get(id) else { return true };
                if away.unmade.contains(id) || component.state != State::Ready {
                    return true;
                }
                let open = open_ends(&graph, id, component);
                if !open.is_empty() {
                    away.note(id, format!("it is not started: nothing gives it {}", open.join(", ")));
                }
                !open.is_empty()
            }
            other => away.unmade.contains(id_of(other)),
        }
    }

    /// Ends when that session of the process has.
    async fn gone(&self, process: &Name, session: u64) {
        let mut graphs = self.watch();
        // The sender lives as long as this GCM.
        let _ = graphs.wait_for(|_| !self.hears(process, session)).await;
    }

    /// Stops the components that were stopped by request while they were made; once none of them is left, the
    /// process is attached, in one step.
    async fn attached_again(&self, carrying: &Carrying<'_>, process: &Name, session: u64) {
        let mut tried = BTreeSet::new();
        loop {
            let mut owed = Vec::new();
            self.edit(|graph| {
                let mut sessions = self.inner.sessions.lock();
                if sessions.holder(process) != Some(session) {
                    return;
                }
                owed = sessions.on_return.owed(graph, process);
                owed.retain(|(id, _)| !tried.contains(id));
                if owed.is_empty()
                    && let Some(p) = graph.processes.get_mut(process)
                {
                    p.state = ProcessState::Attached;
                    sessions.on_return.here(process, &[]);
                }
            });
            if owed.is_empty() {
                return;
            }
            for (id, from) in owed {
                let to = State::Stopped(StopReason::Requested);
                let stop = Change::Run { id: id.clone(), verb: Verb::Stop, from, to };
                if let Err(refusal) = carrying.one(&stop, clock::now() + self.inner.each_change).await {
                    log::error!("{id} cannot be stopped: {refusal}");
                }
                tried.insert(id);
            }
        }
    }

    /// Marks a component as not there although it should be.
    fn not_made(&self, id: &ComponentId, why: &str, away: &mut Away) {
        self.edit(|graph| {
            if let Some(component) = graph.components.get_mut(id) {
                component.state = State::Fault;
                component.health = Health::Lost;
                component.fault =
                    format!("its process was started again and it could not be made anew: {why}; remove it and create it anew");
            }
        });
        away.unmade.insert(id.clone());
        let graph = self.graph();
        let mine =
            graph.connections.values().filter(|c| [&c.client, &c.server].iter().any(|e| e.component == *id));
        for connection in mine {
            self.not_connected(connection, &format!("{id} could not be made again"), away);
        }
    }

    fn not_connected(&self, connection: &Connection, why: &str, away: &mut Away) {
        let mut gone = false;
        self.edit(|graph| {
            gone = graph.connections.remove(&connection.id).is_some();
            graph.revision += u64::from(gone);
        });
        if !gone {
            return;
        }
        self.cut_off(vec![After::Cut { is_left: !connection.is_near(), connection: connection.clone() }]);
        let text = format!(
            "connection {} from {} to {} is gone: {why}",
            connection.id.0, connection.server, connection.client
        );
        match &connection.client.component {
            client if away.unmade.contains(client) => log::error!("{text}"),
            client => away.note(client, text),
        }
    }

    fn not_done(&self, change: &Change, refusal: &Refusal, away: &mut Away) {
        let id = id_of(change);
        match change {
            Change::Create { .. } => {
                log::error!("{}: {refusal}", text::line(change));
                self.not_made(id, &refusal.to_string(), away);
            }
            Change::Connect { connection } => self.not_connected(connection, &refusal.to_string(), away),
            // The component exists, and stands as its LCM reports.
            Change::Run { .. } => away.note(id, format!("it is not started: {refusal}")),
            _ => away.note(id, refusal.to_string()),
        }
    }

    /// Notes beside components what of them did not come back, until their LCM reports anew. A component in
    /// FAULT says why itself.
    fn noted(&self, away: Away) {
        for (id, whys) in away.notes {
            self.edit(|graph| {
                if let Some(component) = graph.components.get_mut(&id).filter(|c| c.state != State::Fault) {
                    component.fault = format!("since its process was started again: {}", whys.join("; "));
                }
            });
        }
    }
}

/// The component that a change sets in motion.
fn started(change: &Change) -> Option<&ComponentId> {
    match change {
        Change::Run { id, to: State::Active, .. } => Some(id),
        _ => None,
    }
}

fn is_made(change: &Change) -> bool {
    matches!(change, Change::Create { .. } | Change::Configure { .. })
}
