//! Connections between two processes: both LCMs are told of both ends; they link them by themselves.
//!
//! Invariant: either both have their half or none, and the server's is there first, so that its client finds
//! it. The half of a process that is away counts as gone; a half it still has when it comes back, and should
//! not, is cut.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::oneshot;
use trocar_lcm_api::{ClassOf, RemoteEnd, Report, clock};
use trocar_links::Card;
use trocar_model::{Change, Connection, Name, PortId, PortType, Refusal, SystemGraph, made_of};

use super::Gcm;
use super::changes::UNDO;
use super::observed::After;
use super::sessions::{Registration, Sessions};

impl Gcm {
    /// Has both halves made and linked. Neither stays when nobody waits for them any more: a process that
    /// stood still may make its half later than that.
    pub(super) async fn link_or_none(
        &self,
        connection: &Connection,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        let (tell, told) = oneshot::channel();
        let (gcm, wanted) = (self.clone(), connection.clone());
        tokio::spawn(async move {
            let connection = wanted;
            let linked = gcm.link(&connection, deadline).await;
            let Err(Ok(_)) = tell.send(linked) else { return };
            let is_wanted =
                |c: &Connection| (&c.client, &c.server) == (&connection.client, &connection.server);
            if gcm.graph().connections.get(&connection.id).is_some_and(is_wanted) {
                return;
            }
            log::warn!("connection {} was made too late: it is taken back", connection.id.0);
            match gcm.unlink(&connection, false, clock::now() + UNDO).await {
                // A half that a process away still has is cut when it is back.
                Ok(_) | Err(Refusal::ConnectionNotFound { .. } | Refusal::ProcessLost { .. }) => {}
                Err(refusal) => log::error!("undoing connection {}: {refusal}", connection.id.0),
            }
        });
        told.await.unwrap_or_else(|_| Err(Refusal::Internal { text: "linking broke off".into() }))
    }

    /// Has both halves made and linked.
    pub(super) async fn link(&self, connection: &Connection, deadline: Instant) -> Result<Report, Refusal> {
        let graph = self.graph();
        let (client, server) = (&connection.client, &connection.server);
        if graph.is_guests(client) {
            // The guest calls from outside, so neither LCM has a half.
            let made = Change::Connect { connection: connection.clone() };
            return self.lcm_of(&client.component.process)?.apply(made, deadline.into()).await;
        }
        let of_client = self.end(&graph, connection, client)?;
        let of_server = self.end(&graph, connection, server)?;
        let card = Some(of_server.card.clone());
        let at_server = self.lcm_of(&server.component.process)?;
        let at_client = self.lcm_of(&client.component.process)?;
        at_server.link(of_client, deadline).await?;
        let linked = tokio::select! {
            linked = at_client.link(of_server, deadline) => linked,
            // The client would wait for the half until the deadline, and the restore of that process for
            // both.
            away = self.away(&server.component.process, card) => Err(away),
        };
        let Err(refusal) = linked else { return linked };
        for (lcm, end) in [(at_client, client), (at_server, server)] {
            let undo = Change::Disconnect { connection: connection.clone(), replaced: false };
            let process = &end.component.process;
            match lcm.apply(undo, (clock::now() + UNDO).into()).await {
                // A half that was not made, or went with its process.
                Ok(_) | Err(Refusal::ConnectionNotFound { .. } | Refusal::ProcessLost { .. }) => {}
                Err(undone) => log::error!("undoing connection {} at {process}: {undone}", connection.id.0),
            }
        }
        Err(refusal)
    }

    /// Ends when the incarnation of a process that is reached by this card does not answer any more.
    async fn away(&self, process: &Name, card: Option<Card>) -> Refusal {
        let mut graphs = self.watch();
        // The sender lives as long as this GCM.
        let _ = graphs.wait_for(|_| self.inner.sessions.lock().card(process) != card).await;
        Refusal::lost(process.clone())
    }

    /// Has both halves taken away: the client's first, whose component may still call. The half of a process
    /// that is away is gone.
    pub(super) async fn unlink(
        &self,
        connection: &Connection,
        replaced: bool,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        let change = || Change::Disconnect { connection: connection.clone(), replaced };
        if self.graph().is_guests(&connection.client) {
            return self.lcm_of(&connection.client.component.process)?.apply(change(), deadline.into()).await;
        }
        let mut told = None;
        for end in [&connection.client, &connection.server] {
            let done = match self.lcm_of(&end.component.process) {
                Ok(lcm) => lcm.apply(change(), deadline.into()).await,
                Err(away) => Err(away),
            };
            match (done, told.take()) {
                (Ok(_), Some(Ok(first))) => told = Some(Ok(first)),
                (Ok(report), _) => told = Some(Ok(report)),
                // The half went with its component, or with its process.
                (
                    Err(
                        refusal @ (Refusal::ConnectionNotFound { .. }
                        | Refusal::ProcessLost { .. }
                        | Refusal::ProcessNotFound { .. }),
                    ),
                    first,
                ) => told = first.or(Some(Err(refusal))),
                (Err(refusal), _) => return Err(refusal),
            }
        }
        told.unwrap_or_else(|| Err(Refusal::Internal { text: "a connection without ends".into() }))
    }

    /// Has halves cut that belong to no known connection. Not waited for.
    pub(super) fn cut_strays(&self, strays: Vec<(Name, Connection)>) {
        for (process, connection) in strays {
            let Ok(lcm) = self.lcm_of(&process) else { continue };
            let number = connection.id.0;
            log::warn!(
                "process {process} still has its half of connection {number}, which is gone: it is cut"
            );
            tokio::spawn(async move {
                let cut = Change::Disconnect { connection, replaced: false };
                match lcm.apply(cut, (clock::now() + UNDO).into()).await {
                    Ok(_) | Err(Refusal::ConnectionNotFound { .. }) => {}
                    Err(refusal) => {
                        log::error!("the half of connection {number} at {process} cannot be cut: {refusal}");
                    }
                }
            });
        }
    }

    /// Returns what the other process has to know of one end.
    fn end(&self, graph: &SystemGraph, connection: &Connection, end: &PortId) -> Result<RemoteEnd, Refusal> {
        let component = graph.component(&end.component)?;
        let class = ClassOf { name: component.class.full_name(), hash: component.class.hash.clone() };
        let mut ports = component.ports.clone();
        if let Some(ty) = agreed(graph, connection) {
            let ports = Arc::make_mut(&mut ports);
            let of_inputs = ports.inputs.iter_mut().map(|i| (&i.name, &mut i.ty));
            let of_outputs = ports.outputs.iter_mut().map(|o| (&o.name, &mut o.ty));
            let mine = of_inputs.chain(of_outputs).find(|(name, _)| end.port == name.as_str());
            mine.into_iter().for_each(|(_, is)| ty.clone_into(is));
        }
        Ok(RemoteEnd {
            connection: connection.clone(),
            ports,
            class,
            card: self.card_of(connection, &end.component.process)?,
        })
    }

    fn card_of(&self, connection: &Connection, process: &Name) -> Result<Card, Refusal> {
        // A process that is not heard now has told nothing that is still true.
        self.lcm_of(process)?;
        let card = self.inner.sessions.lock().card(process);
        card.ok_or_else(|| Refusal::Unreachable {
            client: connection.client.clone(),
            server: connection.server.clone(),
            why: format!("process {process} listens for no other process: it runs without a state directory"),
        })
    }
}

/// Returns the type that passes between two ends without a type: a third component gave it to the output.
/// Neither process may know that component.
fn agreed<'g>(graph: &'g SystemGraph, connection: &Connection) -> Option<&'g PortType> {
    let (client, server) = (&connection.client, &connection.server);
    let of = |end: &PortId| graph.components.get(&end.component).map(|c| &c.ports);
    let untyped = |name: &str, port: &PortId, ty: &PortType| port.port == name && *ty == PortType::Any;
    let input = of(client)?.inputs.iter().any(|i| untyped(&i.name, client, &i.ty));
    let output = of(server)?.outputs.iter().any(|o| untyped(&o.name, server, &o.ty));
    made_of(graph, client, server).filter(|_| input && output).map(|(_, ty)| ty)
}

/// The process of the other end.
fn other<'c>(connection: &'c Connection, process: &Name) -> &'c Name {
    match &connection.client.component.process {
        client if client == process => &connection.server.component.process,
        client => client,
    }
}

/// Decides which connections to other processes a registering process has. Decisions of this GCM count first.
/// A connection from before this GCM of which there is no record counts as soon as both processes have
/// brought it along, and one of them is believed; these are returned. `strays`: the halves to be cut, by
/// process; `loose`: connections that are taken out.
pub(super) fn settle(
    sessions: &mut Sessions,
    graph: &mut SystemGraph,
    who: &Registration,
    strays: &mut Vec<(Name, Connection)>,
    loose: &mut Vec<After>,
) -> Vec<Connection> {
    let (me, mut joined) = (&who.process, Vec::new());
    let ends_known = |graph: &SystemGraph, c: &Connection| {
        [&c.client, &c.server].iter().all(|end| graph.components.contains_key(&end.component))
    };
    let remote = |c: &&Connection| !c.is_near() && c.ends_in(me);
    let without: Vec<Connection> =
        graph.connections.values().filter(remote).filter(|c| !ends_known(graph, c)).cloned().collect();
    for connection in without {
        graph.connections.remove(&connection.id);
        graph.revision += 1;
        loose.push(After::Cut { connection: connection.clone(), is_left: false });
        strays.push((other(&connection, me).clone(), connection));
    }
    let mut brought = Vec::new();
    for connection in who.slice.connections.iter().filter(remote) {
        graph.next_connection = graph.next_connection.max(connection.id.0 + 1);
        let ends = |c: &Connection| {
            c.id == connection.id && c.client == connection.client && c.server == connection.server
        };
        if graph.connections.get(&connection.id).is_some_and(ends) {
            continue;
        }
        let peer = other(connection, me);
        if !sessions.knows(peer) {
            brought.push(connection.clone());
            continue;
        }
        let theirs = sessions.brought.entry(peer.clone()).or_default();
        let agreed = theirs.iter().position(ends).map(|at| theirs.swap_remove(at)).is_some();
        let is_given = sessions.connecting.contains(&connection.id.0);
        let free = !is_given
            && !graph.connections.contains_key(&connection.id)
            && graph.source_of(&connection.client).is_none();
        let believed = sessions.believed.contains(me) || sessions.believed.contains(peer);
        if agreed && free && believed && ends_known(graph, connection) {
            joined.push(connection.clone());
            graph.connections.insert(connection.id, connection.clone());
            continue;
        }
        strays.push((me.clone(), connection.clone()));
        if agreed {
            strays.push((peer.clone(), connection.clone()));
        }
    }
    sessions.brought.insert(me.clone(), brought);
    strays.extend(awaited(sessions, me));
    joined
}

/// Takes out the connections to a process that other processes have brought along: it does not have them, or
/// does not come any more.
pub(super) fn awaited(sessions: &mut Sessions, process: &Name) -> Vec<(Name, Connection)> {
    let mut strays = Vec::new();
    for (other, theirs) in sessions.brought.iter_mut().filter(|(other, _)| *other != process) {
        let (mine, left): (Vec<_>, Vec<_>) =
            std::mem::take(theirs).into_iter().partition(|c| c.ends_in(process));
        *theirs = left;
        strays.extend(mine.into_iter().map(|connection| (other.clone(), connection)));
    }
    sessions.brought.retain(|_, theirs| !theirs.is_empty());
    strays
}
