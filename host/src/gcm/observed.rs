//! Enters the reports of LCMs in the graph: states, ports, and the connections that went with a port.
//!
//! Invariant: after a report no connection of that component ends in a port it does not have or that does not
//! fit any more; every connection that goes is logged and is a new revision.

use std::collections::BTreeSet;
use std::sync::Arc;

use trocar_lcm_api::{Decision, Report, clock};
use trocar_model::{
    Change, Component, ComponentId, Connection, ConnectionId, Entry, Name, Refusal, State, StopReason,
    SystemGraph, Verb,
};

use super::Gcm;
use super::changes::UNDO;

/// Something to be seen to after the graph was edited.
#[derive(Clone, Debug)]
pub(crate) enum After {
    /// A connection was taken out.
    Cut {
        connection: Connection,
        /// An LCM may still have it.
        is_left: bool,
    },
    /// A component failed.
    Failed(ComponentId),
    /// A component that ran was stopped by something else than a request, and stands so.
    Rests(ComponentId, State),
    /// A process has done a change that was given up.
    Late(Name, Box<Change>, Decision),
}

impl After {
    /// A connection that LCMs still have.
    pub(super) fn cut(connection: Connection) -> After {
        After::Cut { connection, is_left: true }
    }
}

/// Enters what an LCM reported; components the graph does not have are not added.
pub(crate) fn observe(graph: &mut SystemGraph, report: &Report) -> Vec<After> {
    let Some(component) = graph.components.get_mut(&report.id) else { return Vec::new() };
    let mut after = Vec::new();
    if report.state == State::Fault && component.state != State::Fault {
        after.push(After::Failed(report.id.clone()));
    }
    let by_itself = matches!(report.state, State::Stopped(StopReason::PeerLost | StopReason::Interlock));
    if by_itself && component.state == State::Active {
        after.push(After::Rests(report.id.clone(), report.state));
    }
    component.state = report.state;
    component.health = report.health;
    component.fault.clone_from(&report.fault);
    let others = report.ports.as_ref().filter(|ports| **ports != component.ports);
    let changed = others.is_some();
    if let Some(ports) = others {
        component.ports = ports.clone();
    }
    let before = after.len();
    for number in &report.lost_connections {
        let id = ConnectionId(*number);
        if let Some(c) = graph.connections.get(&id).filter(|c| touches(c, &report.id)).cloned() {
            log::warn!("{}: its port went at {}", cut(&c), report.id);
            graph.connections.remove(&id);
            // Another LCM has the other half.
            after.push(After::Cut { is_left: !c.is_near(), connection: c });
        }
    }
    if after.len() > before {
        graph.revision += 1;
    }
    if changed {
        after.extend(loosen(graph, &BTreeSet::from([&report.id])));
    }
    after
}

/// Puts a component back to its known state, after a report that came late: neither that report nor the
/// request behind it counts.
pub(super) fn stand_by(graph: &mut SystemGraph, id: &ComponentId, known: Option<Component>) {
    if let (Some(component), Some(known)) = (graph.components.get_mut(id), known) {
        (component.state, component.health, component.fault) = (known.state, known.health, known.fault);
    }
}

/// Takes the connections of these components that do not fit any more out of the graph.
pub(super) fn loosen(graph: &mut SystemGraph, ids: &BTreeSet<&ComponentId>) -> Vec<After> {
    let mut taken = Vec::new();
    for (number, why) in graph.loose_ends(ids) {
        if let Some(connection) = graph.connections.remove(&number) {
            log::warn!("{}: {why}", cut(&connection));
            taken.push(After::cut(Arc::unwrap_or_clone(connection)));
        }
    }
    if !taken.is_empty() {
        graph.revision += 1;
    }
    taken
}

fn touches(connection: &Connection, id: &ComponentId) -> bool {
    connection.client.component == *id || connection.server.component == *id
}

fn cut(c: &Connection) -> String {
    format!("connection {} from {} to {} is cut", c.id.0, c.server, c.client)
}

impl Gcm {
    async fn cut(&self, connection: Connection) -> Result<(), Refusal> {
        let deadline = clock::now() + UNDO;
        if !connection.is_near() {
            return self.unlink(&connection, false, deadline).await.map(|_| ());
        }
        let lcm = self.lcm_of(&connection.client.component.process)?;
        lcm.apply(Change::Disconnect { connection, replaced: false }, deadline.into()).await.map(|_| ())
    }

    /// Puts on record that components failed and that connections were taken out of the graph, and has the
    /// LCMs cut those that they may still have. Not waited for.
    pub(super) fn cut_off(&self, loose: Vec<After>) {
        let mut left = Vec::new();
        let mut connections = Vec::new();
        for after in loose {
            match after {
                After::Cut { connection, is_left } => {
                    connections.push(connection.id);
                    left.extend(is_left.then_some(connection));
                }
                After::Failed(component) => _ = self.enter(Entry::Failed { component }),
                After::Late(process, change, decision) => self.done_late(&process, *change, decision),
                // It goes on by another grant alone.
                After::Rests(id, to) => {
                    let rest = Change::Run { id, verb: Verb::Stop, from: State::Active, to };
                    self.inner.ledger.enter(|_| {
                        let revision = self.graph().revision;
                        (Entry::Changed { revision, decision: 0, changes: vec![rest] }, None)
                    });
                }
            }
        }
        if !connections.is_empty() {
            self.inner.ledger.enter(|_| (Entry::Cut { revision: self.graph().revision, connections }, None));
        }
        for connection in left {
            let gcm = self.clone();
            tokio::spawn(async move {
                let number = connection.id.0;
                match gcm.cut(connection).await {
                    // The LCM had cut the connection itself.
                    Ok(_) | Err(Refusal::ConnectionNotFound { .. }) => {}
                    Err(refusal) => log::error!("connection {number} cannot be cut: {refusal}"),
                }
            });
        }
    }
}
