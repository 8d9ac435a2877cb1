//! Enters the reports of LCMs in the graph: states, ports, and the connections that went with a port.
//!
//! Invariant: after a report no connection of that component ends in a port it does not have or that does not
//! fit any more; every connection that goes is logged and is a new revision.

use std::time::Instant;

use trocar_lcm_api::Report;
use trocar_model::{Change, Component, ComponentId, Connection, ConnectionId, Entry, Refusal, SystemGraph};

use super::Gcm;
use super::changes::UNDO;

/// A connection that was taken out of the graph.
#[derive(Clone, Debug)]
pub(crate) struct Loose {
    pub(super) connection: Connection,
    /// An LCM may still have it.
    pub(super) is_left: bool,
}

impl Loose {
    /// A connection that LCMs still have.
    pub(super) fn cut(connection: Connection) -> Loose {
        Loose { connection, is_left: true }
    }
}

/// Enters what an LCM reported; components the graph does not have are not added. Returns the connections
/// that went.
pub(crate) fn observe(graph: &mut SystemGraph, report: &Report) -> Vec<Loose> {
    let Some(component) = graph.components.get_mut(&report.id) else { return Vec::new() };
    component.state = report.state;
    component.health = report.health;
    component.fault.clone_from(&report.fault);
    let others = report.ports.as_ref().filter(|ports| **ports != component.ports);
    let changed = others.is_some();
    if let Some(ports) = others {
        component.ports = ports.clone();
    }
    let mut gone = Vec::new();
    for number in &report.lost_connections {
        let id = ConnectionId(*number);
        if let Some(c) = graph.connections.get(&id).filter(|c| touches(c, &report.id)).cloned() {
            log::warn!("{}: its port went at {}", cut(&c), report.id);
            graph.connections.remove(&id);
            // Another LCM has the other half.
            gone.push(Loose { is_left: !c.is_near(), connection: c });
        }
    }
    if !gone.is_empty() {
        graph.revision += 1;
    }
    if changed {
        gone.extend(loosen(graph, &report.id));
    }
    gone
}

/// Puts a component back to its known state, after a report that came late: neither that report nor the
/// request behind it counts.
pub(super) fn stand_by(graph: &mut SystemGraph, id: &ComponentId, known: Option<Component>) {
    if let (Some(component), Some(known)) = (graph.components.get_mut(id), known) {
        (component.state, component.health, component.fault) = (known.state, known.health, known.fault);
    }
}

/// Takes the connections of a component that do not fit any more out of the graph.
pub(super) fn loosen(graph: &mut SystemGraph, id: &ComponentId) -> Vec<Loose> {
    let mut taken = Vec::new();
    for (number, why) in graph.loose_ends(id) {
        if let Some(connection) = graph.connections.remove(&number) {
            log::warn!("{}: {why}", cut(&connection));
            taken.push(Loose::cut(connection));
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
        let deadline = Instant::now() + UNDO;
        if !connection.is_near() {
            return self.unlink(&connection, false, deadline).await.map(|_| ());
        }
        let lcm = self.lcm_of(&connection.client.component.process)?;
        lcm.apply(Change::Disconnect { connection, replaced: false }, deadline.into()).await.map(|_| ())
    }

    /// Puts on record that connections were taken out of the graph, and has the LCMs cut those that they may
    /// still have. Not waited for.
    pub(super) fn cut_off(&self, loose: Vec<Loose>) {
        if loose.is_empty() {
            return;
        }
        let connections = loose.iter().map(|loose| loose.connection.id).collect();
        self.enter(Entry::Cut { revision: self.graph().revision, connections });
        for Loose { connection, .. } in loose.into_iter().filter(|loose| loose.is_left) {
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
