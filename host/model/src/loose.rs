//! Connections that no longer fit, once the ports of a component are others than before.
//!
//! Invariant: judged by [`bindings`] as at Connect, so that GCM and LCM come to the same answer.

use crate::{ComponentId, ConnectionId, Refusal, SystemGraph, bindings};

impl SystemGraph {
    /// The connections of a component that would be refused now, each with the reason; in the order of their numbers.
    pub fn loose_ends(&self, id: &ComponentId) -> Vec<(ConnectionId, Refusal)> {
        let of = |c: &ComponentId| self.components.get(c).map(|c| c.ports.clone());
        let mut loose = Vec::new();
        for connection in self.connections.values() {
            let (client, server) = (&connection.client, &connection.server);
            if client.component != *id && server.component != *id {
                continue;
            }
            let (Some(a), Some(b)) = (of(&client.component), of(&server.component)) else { continue };
            if let Err(why) = bindings(&a, client, &b, server, &connection.options) {
                loose.push((connection.id, why));
            }
        }
        loose
    }
}
