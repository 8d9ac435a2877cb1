//! Connect and Disconnect.
//!
//! Invariant: a client end has at most one source; what is connected has been bound by [`crate::bindings`] on the ports
//! as they are now. Nobody's state changes.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use super::Planner;
use crate::connect::directions;
use crate::refusal::duration;
use crate::{
    Change, ComponentId, ConnectOptions, Connection, ConnectionId, ExecutionModel, Link, PortId, Queue,
    Refusal, SystemGraph, Which, bindings,
};

/// Most samples, commands or events that one connection may queue.
const MAX_DEPTH: usize = 65_536;
/// Longest deadline or age, ns (one hour).
const MAX_NS: u64 = 3_600_000_000_000;

impl Planner {
    pub(super) fn connect(
        &mut self,
        client: &PortId,
        server: &PortId,
        options: &ConnectOptions,
    ) -> Result<(), Refusal> {
        for end in [client, server] {
            self.graph.attached(&end.component.process)?;
        }
        let (a, b) = (self.graph.component(&client.component)?, self.graph.component(&server.component)?);
        directions(&a.ports, client, &b.ports, server)?;
        let old = self.graph.source_of(client).cloned();
        if let Some(old) = old.as_ref().filter(|_| !options.replace) {
            return Err(if old.server == *server {
                Refusal::ConnectionExists { id: old.id.0, client: client.clone(), server: server.clone() }
            } else {
                Refusal::AlreadyConnected { client: client.clone(), server: old.server.clone() }
            });
        }
        let link = bindings(&a.ports, client, &b.ports, server, options)?;
        let connection = Connection {
            // 0 is what an unset number looks like on the wire.
            id: ConnectionId(self.graph.next_connection.max(1)),
            client: client.clone(),
            server: server.clone(),
            options: options.clone(),
        };
        check_circle(&self.graph, &connection, &link)?;
        check_options(&connection, &link)?;
        let (from, to) = (&server.component.process, &client.component.process);
        if from != to {
            return Err(Refusal::NotImplemented {
                what: format!("a connection between processes `{to}` and `{from}`"),
                hint: "Create both components in one process; connections across processes come with a later version."
                    .to_owned(),
            });
        }
        if let Some(connection) = old {
            self.push(Change::Disconnect { connection });
        }
        self.push(Change::Connect { connection });
        Ok(())
    }

    pub(super) fn disconnect(&mut self, which: &Which) -> Result<(), Refusal> {
        let found = match which {
            Which::Id(id) => self.graph.connections.get(id),
            Which::Pair { client, server } => self.graph.source_of(client).filter(|c| c.server == *server),
        };
        let Some(connection) = found.cloned() else {
            let asked = match which {
                Which::Id(id) => id.0.to_string(),
                Which::Pair { client, server } => format!("{client} → {server}"),
            };
            return Err(Refusal::ConnectionNotFound { asked, known: self.graph.connection_list() });
        };
        for end in [&connection.client, &connection.server] {
            self.graph.attached(&end.component.process)?;
        }
        self.push(Change::Disconnect { connection });
        Ok(())
    }
}

fn check_options(connection: &Connection, link: &Link) -> Result<(), Refusal> {
    let options = &connection.options;
    let bad = |field: &str, why: String| {
        let (what, field) = (format!("Connect {}", connection.client), format!("options.{field}"));
        Err(Refusal::ArgumentInvalid { what, why: format!("{field}: {why}"), field })
    };
    let stream = matches!(link, Link::Stream { .. });
    if let Some(queue) = options.queue {
        if !stream {
            return bad("queue", "an interface has a mailbox, not a queue of samples".to_owned());
        }
        if let Queue::Fifo { depth, .. } = queue
            && !(1..=MAX_DEPTH).contains(&depth)
        {
            return bad("queue", format!("a depth of {depth} samples is outside 1 to {MAX_DEPTH}"));
        }
    }
    if let Some(depth) = options.mailbox {
        if stream {
            return bad("mailbox", "a stream has a queue of samples, not a mailbox".to_owned());
        }
        if !(1..=MAX_DEPTH).contains(&depth) {
            return bad("mailbox", format!("a depth of {depth} is outside 1 to {MAX_DEPTH}"));
        }
    }
    if options.deadline_ns.is_some() && stream {
        return bad("deadline", "nobody waits on a stream".to_owned());
    }
    for (field, ns) in [("max_age", options.max_age_ns), ("deadline", options.deadline_ns)] {
        if let Some(ns) = ns
            && !(1..=MAX_NS).contains(&ns)
        {
            return bad(field, format!("{} is outside 1 ns to {}", duration(ns), duration(MAX_NS)));
        }
    }
    if !["", "inline", "heap"].contains(&options.carrier.as_str()) {
        return bad("carrier", format!("{:?} is none of \"inline\", \"heap\"", options.carrier));
    }
    Ok(())
}

/// Refuses `new` when it closes a circle of direct calls. A wire that it replaces need not be left out: it leaves or enters
/// the very component where the circle would close, so no shortest way uses it.
fn check_circle(graph: &SystemGraph, new: &Connection, link: &Link) -> Result<(), Refusal> {
    let Some((caller, called)) = direct(graph, new, matches!(link, Link::Stream { .. })) else {
        return Ok(());
    };
    let mut calls: BTreeMap<ComponentId, BTreeSet<ComponentId>> = BTreeMap::new();
    for connection in graph.connections.values() {
        let stream = graph
            .components
            .get(&connection.client.component)
            .is_some_and(|c| c.ports.inputs.iter().any(|i| connection.client.port == i.name.as_str()));
        if let Some((from, to)) = direct(graph, connection, stream) {
            calls.entry(from).or_default().insert(to);
        }
    }
    // Breadth first from what would be called back to the caller; `came` is also the set of the visited.
    let mut came: BTreeMap<ComponentId, Option<ComponentId>> = BTreeMap::from([(called.clone(), None)]);
    let mut queue = VecDeque::from([called]);
    while let Some(at) = queue.pop_front() {
        if at == caller {
            let mut path = vec![at.clone()];
            let mut step = came.get(&at).cloned().flatten();
            while let Some(id) = step {
                step = came.get(&id).cloned().flatten();
                path.push(id);
            }
            path.push(caller);
            path.reverse();
            return Err(Refusal::SyncCycle { path });
        }
        for next in calls.get(&at).into_iter().flatten() {
            if !came.contains_key(next) {
                came.insert(next.clone(), Some(at.clone()));
                queue.push_back(next.clone());
            }
        }
    }
    Ok(())
}

/// Who calls whom in one thread through this connection: pinned inline, or a stream within one chain that is not pinned
/// to a queue.
fn direct(graph: &SystemGraph, c: &Connection, stream: bool) -> Option<(ComponentId, ComponentId)> {
    let (client, server) = (&c.client.component, &c.server.component);
    let chained = || stream && head(graph, client).is_some_and(|h| Some(h) == head(graph, server));
    match c.options.carrier.as_str() {
        "heap" => None,
        "inline" if !stream => Some((client.clone(), server.clone())),
        "inline" => Some((server.clone(), client.clone())),
        _ => chained().then(|| (server.clone(), client.clone())),
    }
}

/// The head of the stream chain in which a component runs; a head that was removed still holds its chain together, since
/// it may be made again.
fn head(graph: &SystemGraph, id: &ComponentId) -> Option<ComponentId> {
    let mut at = id.clone();
    for _ in 0..=graph.components.len() {
        let Some(component) = graph.components.get(&at) else { return Some(at) };
        match &component.execution.stream_of {
            Some(above) => at = ComponentId::parse(above).ok()?,
            None => return (component.execution.model == Some(ExecutionModel::Stream)).then_some(at),
        }
    }
    None
}
