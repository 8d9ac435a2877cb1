//! Changes that a process has done after the GCM had given them up: it stood still, or its answer took its
//! time.
//!
//! Invariant: what a caller was told to have failed does not stay: it is taken back, and where that cannot be
//! done the list and the record say how it stands.

use serde_json::Value;
use trocar_lcm_api::{Decision, clock};
use trocar_model::{
    Change, ComponentId, Connection, Entry, Name, Plan, Refusal, Request, State, SystemGraph, Verb, Which,
};

use super::observed::After;
use super::{Gcm, text};

impl Gcm {
    /// Has the process be as was decided, although it has done this change of that decision late. Not waited
    /// for.
    pub(super) fn done_late(&self, process: &Name, change: Change, decision: Decision) {
        log::warn!("{} was done in process {process} after it had been given up", text::asked(&change));
        let Change::Run { id, to: State::Active, .. } = &change else {
            return self.straighten(process, change, decision);
        };
        // A component that moves is stopped at once; the process leaves one alone that was started since.
        if self.granted_by(id).is_none() {
            self.stop_late(id, decision);
        }
    }

    /// Has the process be as was decided, whether it has done this change of that decision or not. Not waited
    /// for.
    pub(super) fn straighten(&self, process: &Name, change: Change, decision: Decision) {
        let Some(session) = self.inner.sessions.lock().holder(process) else { return };
        let asked = text::asked(&change);
        let (gcm, process) = (self.clone(), process.clone());
        tokio::spawn(async move {
            while gcm.hears(&process, session) {
                match gcm.straight(&process, session, (&change, decision)).await {
                    Ok(()) => break,
                    // It is looked at again, or comes anew with what it has.
                    Err(Refusal::Busy { .. } | Refusal::LcmTimeout { .. }) => {}
                    Err(Refusal::ProcessLost { .. }) => return,
                    Err(refusal) => return log::error!("{asked} cannot be taken back: {refusal}"),
                }
            }
            if matches!(&change, Change::Disconnect { connection, .. } if !connection.is_near()) {
                // Its half is made again, where it is still wanted.
                gcm.link_missing(process).await;
            }
        });
    }

    async fn straight(
        &self,
        process: &Name,
        session: u64,
        (change, decision): (&Change, Decision),
    ) -> Result<(), Refusal> {
        let doing = format!("taking back {}, which was done late", text::asked(change));
        let by = (self.inner.claims.arrive(), clock::now() + self.inner.each_change);
        let claimed = self.claim_for(doing, &[about(change)], by, |_| Ok(Plan::default())).await;
        let (_claim, graph, _) = claimed?;
        if !self.hears(process, session) {
            return Err(Refusal::lost(process.clone()));
        }
        let order = |change: Change| self.takes_back(process, session, change);
        match change {
            Change::Create { id, component } if !graph.components.contains_key(id) => {
                order(Change::Destroy { id: id.clone(), component: component.clone() }).await
            }
            Change::Destroy { id, .. } => {
                let has = self.lcm_of(process)?.inventory().await?.components;
                if graph.components.contains_key(id) && !has.iter().any(|report| report.id == *id) {
                    self.is_gone(id);
                }
                Ok(())
            }
            // It has done that to a component that was there before, or before it got its settings.
            Change::Configure { id, .. } if self.inner.sessions.lock().is_set_since(id, decision) => Ok(()),
            Change::Configure { id, to, .. } => {
                let Some(component) = graph.components.get(id).filter(|c| c.config != *to) else {
                    return Ok(());
                };
                if matches!(component.state, State::Active | State::Fault) {
                    // One that moves is given no settings that nobody asked for; a failed one takes none.
                    self.is_configured_so(id, to);
                    return Ok(());
                }
                let (from, back) = (to.clone(), component.config.clone());
                let (from_state, to_state) = (component.state, component.state);
                let done =
                    order(Change::Configure { id: id.clone(), from, to: back, from_state, to_state }).await;
                self.keeps_settings(id, to, &done);
                done
            }
            Change::Run { id, verb, .. } => {
                self.stands_late(id, *verb);
                Ok(())
            }
            Change::Connect { connection } if !has(&graph, connection) => {
                order(Change::Disconnect { connection: connection.clone(), replaced: false }).await
            }
            Change::Disconnect { connection, .. } if connection.is_near() && has(&graph, connection) => {
                let again = order(Change::Connect { connection: connection.clone() }).await;
                if again.is_err() {
                    self.is_cut(connection);
                }
                Ok(())
            }
            Change::Create { .. } | Change::Connect { .. } | Change::Disconnect { .. } => Ok(()),
        }
    }

    /// Decides that a component has the settings that it has, where it refuses others: it may have failed
    /// before they came to their turn.
    pub(super) fn keeps_settings(&self, id: &ComponentId, has: &Value, given: &Result<(), Refusal>) {
        let is_open = |refusal: &Refusal| matches!(refusal.reason(), "LCM_TIMEOUT" | "PROCESS_LOST" | "BUSY");
        if given.as_ref().is_err_and(|refusal| !is_open(refusal)) {
            self.is_configured_so(id, has);
        }
    }

    async fn takes_back(&self, process: &Name, session: u64, change: Change) -> Result<(), Refusal> {
        let (lcm, deadline) = (self.lcm_of(process)?, clock::now() + self.inner.each_change);
        let done = lcm.apply(change.clone(), deadline.into());
        match self.in_time(process, &text::asked(&change), deadline, done).await {
            Ok(report) => {
                self.enter_states(process, Some(session), &[&report]);
                Ok(())
            }
            Err(Refusal::ConnectionNotFound { .. } | Refusal::ComponentNotFound { .. }) => Ok(()),
            Err(refusal) => {
                self.not_amended(&change, &refusal);
                Err(refusal)
            }
        }
    }

    /// Decides that a component is gone, with its connections.
    fn is_gone(&self, id: &ComponentId) {
        let mut loose = Vec::new();
        self.decide(|revision| {
            let mut changes = Vec::new();
            self.edit(|graph| {
                let ends = |c: &Connection| c.client.component == *id || c.server.component == *id;
                let cut: Vec<_> = graph.connections.values().filter(|c| ends(c)).cloned().collect();
                changes.extend(cut.iter().map(|connection| Change::Disconnect {
                    connection: connection.clone(),
                    replaced: false,
                }));
                loose.extend(cut.into_iter().map(|connection| {
                    let is_left = !connection.is_near();
                    After::Cut { connection, is_left }
                }));
                if let Some(component) = graph.components.get(id) {
                    changes.push(Change::Destroy { id: id.clone(), component: Box::new(component.clone()) });
                }
                let before = graph.revision;
                graph.apply(&Plan { changes: changes.clone(), skipped: Vec::new() });
                graph.revision = before;
            });
            (Entry::Changed { revision, decision: 0, changes }, None)
        });
        self.inner.holds.lock().removed(id);
        self.cut_off(loose);
    }

    /// Decides that a connection is cut.
    fn is_cut(&self, connection: &Connection) {
        self.edit(|graph| {
            graph.connections.remove(&connection.id);
            graph.revision += 1;
        });
        let is_left = !connection.is_near();
        self.cut_off(vec![After::Cut { connection: connection.clone(), is_left }]);
    }

    /// Decides that a component stands as it does.
    fn stands_late(&self, id: &ComponentId, verb: Verb) {
        self.inner.ledger.enter(|wanted| {
            let graph = self.graph();
            let stands = graph.components.get(id).map(|component| component.state);
            let was = wanted.components.get(id).map(|component| component.state);
            match (stands, was) {
                (Some(to), Some(from)) if to != from && to != State::Active => {
                    let changes = vec![Change::Run { id: id.clone(), verb, from, to }];
                    (Entry::Changed { revision: graph.revision, decision: 0, changes }, None)
                }
                _ => (Entry::Noted, None),
            }
        });
    }
}

fn has(graph: &SystemGraph, connection: &Connection) -> bool {
    let is_same = |c: &Connection| (&c.client, &c.server) == (&connection.client, &connection.server);
    graph.connections.get(&connection.id).is_some_and(is_same)
}

/// Returns a request that touches what the change does.
fn about(change: &Change) -> Request {
    match change {
        Change::Create { id, .. }
        | Change::Destroy { id, .. }
        | Change::Configure { id, .. }
        | Change::Run { id, .. } => Request::Remove { id: id.clone(), force: false },
        Change::Connect { connection: c } | Change::Disconnect { connection: c, .. } => {
            Request::Disconnect { which: Which::Pair { client: c.client.clone(), server: c.server.clone() } }
        }
    }
}
