//! Connections with one end in another process.
//!
//! Invariant: the half stays in `Remote` as long as the GCM wants the connection; the two LCMs alone decide
//! whether it is linked.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use trocar_lcm_api::{ClassOf, RemoteEnd};
use trocar_links::Card;
use trocar_model::{Connection, Link, Ports, Refusal, bindings, idle_connection};

use super::super::Report;
use super::super::boundary::OwnClass;
use super::super::carriers::OneEnd;
use super::super::ends::{Role, SameClass};
use super::super::loss::Loss;
use super::LocalLcm;

/// Time left before the deadline for the answer about a link that is not ready.
const WAY: Duration = Duration::from_millis(20);

impl LocalLcm {
    pub(super) fn own_card(&self) -> Option<Card> {
        self.carriers.halves().next().map(|halves| halves.card().clone())
    }

    /// Makes the half of a connection that is here, and for a client waits until it is linked.
    pub(super) async fn link_remote(&self, end: RemoteEnd, deadline: Instant) -> Result<Report, Refusal> {
        let RemoteEnd { connection, ports: theirs, class, card } = end;
        let unreachable = |why: String| Refusal::Unreachable {
            client: connection.client.clone(),
            server: connection.server.clone(),
            why,
        };
        let halves = self.carriers.reaching(&connection, &card).map_err(&unreachable)?;
        let role =
            if connection.client.component.process == self.hub.process { Role::Client } else { Role::Server };
        let mine = match role {
            Role::Client => &connection.client.component,
            Role::Server => &connection.server.component,
        };
        let slot = self.slot(mine)?;
        let ours = slot.instance.ports();
        let (client, server) = match role {
            Role::Client => (&ours, &theirs),
            Role::Server => (&theirs, &ours),
        };
        let required = role == Role::Client && is_required(&connection, client, server)?;
        let idle = match role {
            Role::Client => idle_connection(client, &connection.client, server, &connection.server),
            Role::Server => None,
        };
        let (tell, told) = oneshot::channel();
        let (id, tell) = (connection.id.0, (role == Role::Client).then_some(tell));
        let (ours, here, same_class) = (connection.clone(), slot.here(), self.same_class(role, class));
        halves.add(OneEnd { connection: ours, role, here, required, theirs, card, same_class }, tell)?;
        if role == Role::Client {
            let until = deadline.checked_sub(WAY).unwrap_or(deadline);
            let linked = match tokio::time::timeout_at(until.into(), told).await {
                Ok(Ok(linked)) => linked,
                Ok(Err(_)) => Err("this process shuts down".into()),
                Err(_) => Err(halves.why_not(id)),
            };
            if let Err(why) = linked {
                self.unlink_remote(id, Loss::Cut).await;
                return Err(unreachable(why));
            }
        }
        let mut report = slot.instance.report(false);
        report.warnings.extend(idle);
        Ok(report)
    }

    /// Way for a client to find the class of its server in this process.
    fn same_class(&self, role: Role, of: ClassOf) -> SameClass {
        match (role, self.classes.clone()) {
            (Role::Client, Some(classes)) => Box::new(move || {
                let (info, class) = classes.present(&of.name, &of.hash)?;
                Some(OwnClass { info, class })
            }),
            _ => Box::new(|| None),
        }
    }

    /// Removes the half of a connection; returns the client's or server's report, `None` when there is no
    /// half.
    pub(super) async fn unlink_remote(&self, connection: u64, how: Loss) -> Option<Report> {
        let (tell, told) = oneshot::channel();
        let has = self.carriers.halves().find(|halves| halves.connections().contains(&connection))?;
        let instance = has.remove(connection, how, tell)?;
        // A failure means that the thread for it has ended, and all halves with it.
        let _ = told.await;
        Some(instance.report(false))
    }
}

fn is_required(connection: &Connection, client: &Arc<Ports>, server: &Arc<Ports>) -> Result<bool, Refusal> {
    let ends = (&connection.client, &connection.server);
    Ok(match bindings(client, ends.0, server, ends.1, &connection.options)? {
        Link::Stream { input, .. } => !client.inputs[input].optional,
        Link::Interface { required, .. } => !client.required[required].optional,
    })
}
