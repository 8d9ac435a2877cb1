//! Connections that no longer fit, once the ports of a component are others than before.
//!
//! Invariant: judged by [`bindings`] as at Connect, so that GCM and LCM come to the same answer; only the
//! GCM, which knows the whole graph, sees what tags forbid.

use std::collections::BTreeSet;

use crate::plan::forbidden;
use crate::{ComponentId, ConnectionId, Refusal, SystemGraph, bindings};

impl SystemGraph {
    /// Returns the connections that would be refused now that the ports of these components are others, each
    /// with the reason: their own, in the order of their numbers, then those that tags forbid.
    pub fn loose_ends(&self, ids: &BTreeSet<&ComponentId>) -> Vec<(ConnectionId, Refusal)> {
        let of = |c: &ComponentId| self.components.get(c).map(|c| c.ports.clone());
        let mut loose = Vec::new();
        for connection in self.connections.values() {
            let (client, server) = (&connection.client, &connection.server);
            if !ids.contains(&client.component) && !ids.contains(&server.component) {
                continue;
            }
            let (Some(a), Some(b)) = (of(&client.component), of(&server.component)) else { continue };
            if let Err(why) = bindings(&a, client, &b, server, &connection.options) {
                loose.push((connection.id, why));
            }
        }
        for (number, why) in forbidden(self) {
            if !loose.iter().any(|(known, _)| *known == number) {
                loose.push((number, why));
            }
        }
        loose
    }
}
