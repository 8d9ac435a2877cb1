//! Connections between two processes that are to be and lack a half: they are linked again, or show why not.
//!
//! Invariant: a connection is linked again only while both processes are there and one of its halves is not.

use std::time::Duration;

use trocar_lcm_api::{Decision, clock};
use trocar_model::{Connection, End, Name, Plan, ProcessState, Proxy, Refusal, Request, SystemGraph};

use super::Gcm;

/// Time to link again what a process that was away has lost.
const AGAIN: Duration = Duration::from_secs(5);

impl Gcm {
    /// Links the connections of a process that lack a half although both processes are there: one process was
    /// away while the other half was made.
    pub(super) async fn link_missing(self, process: Name) {
        let deadline = clock::now() + AGAIN;
        let missing: Vec<Connection> = {
            let graph = self.graph();
            let mine = graph.connections.values().filter(|c| c.ends_in(&process));
            mine.filter(|c| is_missing(&graph, c)).cloned().collect()
        };
        for connection in missing {
            let (client, server) = (connection.client.clone(), connection.server.clone());
            let part = [Request::Connect { client, server, options: connection.options.clone() }];
            let (by, doing) =
                ((Decision::NONE, deadline), format!("linking connection {} again", connection.id.0));
            let claim = self.claim_for(doing, &part, by, |_| Ok(Plan::default())).await;
            let linked = match claim {
                Ok(_claim) if !is_missing(&self.graph(), &connection) => Ok(()),
                Ok(_claim) => self.link(&connection, deadline).await.map(|_| ()),
                Err(refusal) => Err(refusal),
            };
            if let Err(refusal) = linked {
                log::error!("connection {} is not linked again: {refusal}", connection.id.0);
                self.not_linked(&connection, &refusal).await;
            }
        }
    }

    /// Shows why a connection that is to be has no halves.
    pub(super) async fn not_linked(&self, connection: &Connection, refusal: &Refusal) {
        let ends = [End::Client, End::Server].map(|end| (end, &connection.port(end).component.process));
        for (_, process) in ends {
            // News of the end of a half that was made for nothing would cover the reason.
            self.hear_out(process).await;
        }
        self.edit(|graph| {
            let SystemGraph { proxies, connections, .. } = graph;
            // Entries of connections that have gone since are removed.
            proxies.retain(|(id, _), half| !half.carrier.is_empty() || connections.contains_key(id));
            if !connections.contains_key(&connection.id) {
                return;
            }
            for (end, process) in ends {
                let why = refusal.to_string();
                let none = Proxy { process: process.clone(), epoch: 0, why, carrier: String::new() };
                if !proxies.contains_key(&(connection.id, end)) {
                    proxies.insert((connection.id, end), none);
                }
            }
        });
    }
}

/// Tells whether both processes are there, but not both have their half.
fn is_missing(graph: &SystemGraph, connection: &Connection) -> bool {
    let attached =
        |process: &Name| graph.processes.get(process).is_some_and(|p| p.state == ProcessState::Attached);
    // An entry without a carrier only says why there is no half.
    let has_half =
        |end| graph.proxies.get(&(connection.id, end)).is_some_and(|half| !half.carrier.is_empty());
    graph.connections.contains_key(&connection.id)
        && !connection.is_near()
        && !graph.is_guests(&connection.client)
        && [&connection.client, &connection.server].iter().all(|end| attached(&end.component.process))
        && !(has_half(End::Client) && has_half(End::Server))
}
