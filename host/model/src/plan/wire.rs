//! Connect and Disconnect.
//!
//! Invariant: a client end has at most one source; every connection has been bound by [`crate::bindings`] on
//! the ports as they are now. No component's state changes.

use super::circle::{check_circle, is_stream};
use super::tags::check_tags;
use super::{Planner, carrier, host_of};
use crate::connect::{directions, same_payload};
use crate::refusal::duration;
use crate::{
    Change, ConnectOptions, Connection, ConnectionId, Execution, ExecutionModel, Link, PortId, PortType,
    Queue, Refusal, Safety, SystemGraph, Which, bindings,
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
        if let Link::Stream { input, output, .. } = link {
            let ends = (&a.ports.inputs[input].ty, &b.ports.outputs[output].ty);
            check_any(&self.graph, ends, client, server)?;
        }
        let mut connection = Connection {
            // 0 is what an unset number looks like on the wire.
            id: ConnectionId(self.graph.next_connection.max(1)),
            client: client.clone(),
            server: server.clone(),
            options: options.clone(),
        };
        if connection.options.max_age_ns.is_none() {
            connection.options.max_age_ns = default_max_age(&self.graph, &connection);
        }
        check_circle(&self.graph, &connection, &link)?;
        check_tags(&self.graph, &connection, &link)?;
        check_options(&connection, &link)?;
        carrier::check(&self.graph, "Connect", &connection)?;
        if let Some(connection) = old {
            self.push(Change::Disconnect { connection, replaced: true });
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
                Which::Pair { client, server } => {
                    // A missing name is told as such, and so are ends the wrong way round.
                    let (a, b) =
                        (self.graph.component(&client.component)?, self.graph.component(&server.component)?);
                    directions(&a.ports, client, &b.ports, server)?;
                    format!("from {server} to {client}")
                }
            };
            return Err(Refusal::ConnectionNotFound { asked, known: self.graph.connection_list() });
        };
        let of = |end: &PortId| self.graph.attached(&end.component.process).map(|_| ());
        // The half of a process that is away goes when it comes back.
        of(&connection.client).or_else(|lost| of(&connection.server).map_err(|_| lost))?;
        self.push(Change::Disconnect { connection, replaced: false });
        Ok(())
    }
}

/// Returns the input with a type, beside this client, that gave an untyped output its type.
pub fn made_of<'g>(
    graph: &'g SystemGraph,
    client: &PortId,
    server: &PortId,
) -> Option<(&'g PortId, &'g PortType)> {
    // The client's present source, which this one may replace, says nothing about the server.
    let others = graph.connections.values().filter(|c| c.server == *server && c.client != *client);
    let typed = others.filter_map(|c| {
        let ports = &graph.components.get(&c.client.component)?.ports;
        let input = ports.inputs.iter().find(|i| c.client.port == i.name.as_str())?;
        (!matches!(input.ty, PortType::Any)).then_some((&c.client, &input.ty))
    });
    typed.min_by_key(|(port, _)| *port)
}

/// Checks the type: the first input with a type gives it to an untyped output; two untyped ends alone have
/// nothing to agree on.
fn check_any(
    graph: &SystemGraph,
    (input, output): (&PortType, &PortType),
    client: &PortId,
    server: &PortId,
) -> Result<(), Refusal> {
    if !matches!(output, PortType::Any) {
        return Ok(());
    }
    match (input, made_of(graph, client, server)) {
        (PortType::Any, None) => Err(Refusal::FormatMismatch {
            client: client.clone(),
            server: server.clone(),
            wants: "whatever it is connected to".to_owned(),
            has: "what an input makes of it: connect it to an input that has a type first".to_owned(),
        }),
        (PortType::Any, Some(_)) | (_, None) => Ok(()),
        (wanted, Some((_, has))) => same_payload(client, server, wanted, has),
    }
}

/// Returns the default of `max_age`: three periods, where an actuator takes samples that come on a grid;
/// otherwise none.
pub fn default_max_age(graph: &SystemGraph, connection: &Connection) -> Option<u64> {
    let client = graph.components.get(&connection.client.component)?;
    if client.class.safety != Safety::Actuator || !is_stream(graph, connection) {
        return None;
    }
    let mut execution: &Execution = &graph.components.get(&connection.server.component)?.execution;
    for _ in 0..graph.components.len() {
        let Some(host) = host_of(execution) else { break };
        execution = &graph.components.get(&host)?.execution;
    }
    let on_grid = matches!(execution.model, Some(ExecutionModel::Periodic | ExecutionModel::Stream));
    execution.period_ns.filter(|_| on_grid).map(|period| period.saturating_mul(3).min(MAX_NS))
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
    Ok(())
}
