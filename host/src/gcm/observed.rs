//! Enters the reports of LCMs in the graph: states, ports, and the connections that went with a port.
//!
//! Invariant: after a report no connection of that component ends in a port it does not have or that does not
//! fit any more; every connection that goes is logged and is a new revision.

use std::time::Instant;

use trocar_lcm_api::Report;
use trocar_model::{Change, Component, ComponentId, Connection, ConnectionId, Refusal, SystemGraph};

use super::Gcm;
use super::changes::UNDO;

/// Enters what an LCM reported; components the graph does not have are not added. Returns the connections
/// that no longer fit and which the LCM did not say it had cut, and those of which another LCM has the other
/// half.
pub(crate) fn observe(graph: &mut SystemGraph, report: &Report) -> Vec<Connection> {
    let Some(component) = graph.components.get_mut(&report.id) else { return Vec::new() };
    component.state = report.state;
    component.health = report.health;
    component.fault.clone_from(&report.fault);
    let others = report.ports.as_ref().filter(|ports| **ports != component.ports);
    let changed = others.is_some();
    if let Some(ports) = others {
        component.ports = ports.clone();
    }
    let (mut gone, mut halves) = (false, Vec::new());
    for number in &report.lost_connections {
        let id = ConnectionId(*number);
        if let Some(c) = graph.connections.get(&id).filter(|c| touches(c, &report.id)).cloned() {
            log::warn!("{}: its port went at {}", cut(&c), report.id);
            graph.connections.remove(&id);
            gone = true;
            if !c.is_near() {
                halves.push(c);
            }
        }
    }
    if gone {
        graph.revision += 1;
    }
    if changed {
        halves.extend(loosen(graph, &report.id));
    }
    halves
}

/// Puts a component back to its known state, after a report that came late: neither that report nor the
/// request behind it counts.
pub(super) fn stand_by(graph: &mut SystemGraph, id: &ComponentId, known: Option<Component>) {
    if let (Some(component), Some(known)) = (graph.components.get_mut(id), known) {
        (component.state, component.health, component.fault) = (known.state, known.health, known.fault);
    }
}

/// Takes the connections of a component that do not fit any more out of the graph.
pub(super) fn loosen(graph: &mut SystemGraph, id: &ComponentId) -> Vec<Connection> {
    let mut taken = Vec::new();
    for (number, why) in graph.loose_ends(id) {
        if let Some(connection) = graph.connections.remove(&number) {
            log::warn!("{}: {why}", cut(&connection));
            taken.push(connection);
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

    /// Has the LCMs cut what was taken out of the graph, should they still have it. Not waited for.
    pub(super) fn cut_off(&self, connections: Vec<Connection>) {
        for connection in connections {
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
