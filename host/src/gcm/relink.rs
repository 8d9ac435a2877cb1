//! Connections between two processes that are to be and lack a half: they are linked again, or show why not.
//!
//! Invariant: a connection is linked again only while both processes are there, and one of its halves is not,
//! or was made for an earlier run of the other process.

use std::time::Duration;

use trocar_lcm_api::{Decision, clock};
use trocar_model::{Connection, End, Name, Plan, ProcessState, Proxy, Refusal, Request, SystemGraph};

use super::Gcm;

/// Longest wait for others who have work at the ends, and then for both halves.
const AGAIN: Duration = Duration::from_secs(5);

impl Gcm {
    /// Links the connections of a process that lack a half although both processes are there: one process was
    /// away while the other half was made.
    pub(super) async fn link_missing(self, process: Name) {
        let missing: Vec<Connection> = {
            let graph = self.graph();
            let mine = graph.connections.values().filter(|c| c.ends_in(&process));
            mine.filter(|c| self.is_missing(&graph, c)).cloned().collect()
        };
        let Some(session) = self.inner.sessions.lock().holder(&process) else { return };
        for connection in missing {
            match self.link_again(&connection).await {
                Ok(()) => {}
                Err(refusal) => {
                    log::error!("connection {} is not linked again: {refusal}", connection.id.0);
                    self.not_linked(&connection, &refusal).await;
                    if is_busy(&refusal) {
                        // The others of this process need not wait for it.
                        tokio::spawn(self.clone().link_when_free(process.clone(), session, connection));
                    }
                }
            }
        }
    }

    /// Links a connection once nobody else has work at its ends: others may take longer than they are waited
    /// for.
    async fn link_when_free(self, process: Name, session: u64, connection: Connection) {
        while self.hears(&process, session) {
            match self.link_again(&connection).await {
                Err(refusal) if is_busy(&refusal) => {}
                Err(refusal) => {
                    log::error!("connection {} is not linked again: {refusal}", connection.id.0);
                    return self.not_linked(&connection, &refusal).await;
                }
                Ok(()) => return,
            }
        }
    }

    /// Links a connection that lacks a half.
    async fn link_again(&self, connection: &Connection) -> Result<(), Refusal> {
        let ends = [&connection.client, &connection.server];
        let [client, server] = ends.map(Clone::clone);
        let part = [Request::Connect { client, server, options: connection.options.clone() }];
        let by = (Decision::NONE, clock::now() + AGAIN);
        let doing = format!("linking connection {} again", connection.id.0);
        let _claim = self.claim_for(doing, &part, by, |_| Ok(Plan::default())).await?;
        for end in ends {
            // A half that was made just now.
            self.hear_out(&end.component.process).await;
        }
        if self.is_missing(&self.graph(), connection) {
            self.link(connection, clock::now() + AGAIN).await?;
        }
        Ok(())
    }

    /// Tells whether both processes are there, but not both have their half, made for the other one.
    fn is_missing(&self, graph: &SystemGraph, connection: &Connection) -> bool {
        let ends = [End::Client, End::Server].map(|end| (end, &connection.port(end).component.process));
        let attached =
            |process: &Name| graph.processes.get(process).is_some_and(|p| p.state == ProcessState::Attached);
        let is_to_be = graph.connections.contains_key(&connection.id)
            && !connection.is_near()
            && !graph.is_guests(&connection.client)
            && ends.iter().all(|(_, process)| attached(process));
        let sessions = self.inner.sessions.lock();
        // Made for an earlier run of the other process it leads nowhere.
        let leads_to = |half: &Proxy, other: &Name| {
            sessions.card(other).is_none_or(|card| half.peer.is_empty() || half.peer == card.instance)
        };
        let [(_, client), (_, server)] = ends;
        let has_half = |end, other: &Name| {
            // An entry without a carrier only says why there is no half.
            let half = graph.proxies.get(&(connection.id, end)).filter(|half| !half.carrier.is_empty());
            half.is_some_and(|half| leads_to(half, other))
        };
        is_to_be && !(has_half(End::Client, server) && has_half(End::Server, client))
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
                let none = Proxy {
                    process: process.clone(),
                    epoch: 0,
                    why,
                    carrier: String::new(),
                    peer: String::new(),
                };
                if !proxies.contains_key(&(connection.id, end)) {
                    proxies.insert((connection.id, end), none);
                }
            }
        });
    }
}

fn is_busy(refusal: &Refusal) -> bool {
    matches!(refusal, Refusal::Busy { .. })
}
