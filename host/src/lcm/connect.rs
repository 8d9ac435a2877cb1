//! Wires two components of this process together, and takes the wires away again.
//!
//! Invariant: what binds to what was decided by `model::bindings`; here it is only done. Every wire can be cut at any
//! moment: callers inside finish on the old binding, later ones see UNBOUND.

use std::sync::Arc;

use trocar_model::{
    Binding, Command, CommandKind, Connection, Input, Link, Output, PortType, Ports, Queue, Refusal, Type,
    bindings,
};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::mailbox::{Mailbox, Overflow};
use trocar_rt::reply::ReplyPool;
use trocar_rt::stream::{self, DropPolicy, Payload, StreamCounters, stream_link};

use super::api::LinkDetail;
use super::boundary::{
    CommandTarget, DEFAULT_DEADLINE_NS, ERR_BYTES, EventSink, FnBinding, InLink, OutLink, RangeCheck,
    ReadTarget,
};
use super::inbox::Inbox;
use super::instance::Instance;

/// Commands or events one connection may have waiting.
const MAILBOX_DEPTH: usize = 64;
/// Blocking calls one connection may have under way at once.
const REPLY_CELLS: usize = 8;

/// One connection of this process.
pub(super) struct Wired {
    pub(super) id: u64,
    pub(super) client: Arc<Instance>,
    pub(super) server: Arc<Instance>,
    /// The client cannot do without it.
    pub(super) required: bool,
    ends: Ends,
}

enum Ends {
    Stream { input: usize, output: usize, link: Arc<InLink>, stats: StreamCounters, bytes: usize },
    Interface { functions: Vec<usize>, events: Vec<usize>, commands_in: Arc<Inbox>, events_in: Arc<Inbox> },
}

impl Wired {
    /// Wires up what the plan decided.
    ///
    /// # Errors
    /// The mismatch refusals of `model::bindings`, should the ports have changed since the plan.
    pub(super) fn connect(
        connection: &Connection,
        client: &Arc<Instance>,
        server: &Arc<Instance>,
    ) -> Result<Wired, Refusal> {
        let (client_ports, server_ports) = (client.ports(), server.ports());
        let link = bindings(
            &client_ports,
            &connection.client,
            &server_ports,
            &connection.server,
            &connection.options,
        )?;
        let wired = |ends, required| Wired {
            id: connection.id.0,
            client: client.clone(),
            server: server.clone(),
            required,
            ends,
        };
        match link {
            Link::Stream { adapt: true, .. } => Err(Refusal::NotImplemented {
                what: "adapting a stream by name".into(),
                hint: "give both ends the same payload layout".into(),
            }),
            Link::Stream { input, output, .. } => {
                let (from, to) = (&server_ports.outputs[output], &client_ports.inputs[input]);
                let ends = streams(connection, client, input, to, server, output, from);
                Ok(wired(ends, !to.optional))
            }
            Link::Interface { required, binding, .. } => {
                let optional = client_ports.required[required].optional;
                let ends = interfaces(connection, client, &client_ports, server, &server_ports, &binding);
                Ok(wired(ends, !optional))
            }
        }
    }

    /// Cuts the wires; queued commands are answered PEER_LOST.
    pub(super) fn disconnect(&self) {
        match &self.ends {
            Ends::Stream { input, output, .. } => {
                self.server.slots.output(*output).edit(|links| links.retain(|l| l.connection != self.id));
                self.client.slots.input(*input).link.swap(Box::new(None));
            }
            Ends::Interface { functions, events, commands_in, events_in } => {
                for function in functions {
                    self.client.slots.bind_function(*function, FnBinding::Unbound);
                }
                for event in events {
                    self.server.slots.event(*event).edit(|sinks| {
                        sinks.retain(
                            |s| !matches!(&**s, EventSink::Handler { inbox, .. } if Arc::ptr_eq(inbox, events_in)),
                        );
                    });
                }
                self.server.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, commands_in)));
                self.client.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, events_in)));
                commands_in.close(PEER_LOST);
            }
        }
        self.client.reclaim();
        self.server.reclaim();
    }

    /// True for a stream whose ends are stepped by the same thread.
    pub(super) fn is_stream(&self) -> bool {
        matches!(self.ends, Ends::Stream { .. })
    }

    pub(super) fn detail(&self) -> LinkDetail {
        let same = self.client.executor_id() == self.server.executor_id();
        let carrier = if same || self.server.is_passive() { "inline" } else { "heap" };
        let mut detail = LinkDetail { connection: self.id, carrier: carrier.into(), ..Default::default() };
        match &self.ends {
            Ends::Stream { link, stats, bytes, output, .. } => {
                let s = stats.stats();
                let cell = self.server.slots.output(*output);
                detail.passed = s.taken;
                detail.dropped = s.dropped + cell.exhausted();
                detail.bytes = s.taken * *bytes as u64;
                if cell.frame {
                    let written = cell.seq.load(std::sync::atomic::Ordering::Relaxed).max(1);
                    let total = cell.total_bytes.load(std::sync::atomic::Ordering::Relaxed);
                    detail.bytes = (total as f64 / written as f64 * s.taken as f64) as u64;
                }
                detail.latency_p50_ns = link.latency.percentile(0.50);
                detail.latency_p99_ns = link.latency.percentile(0.99);
            }
            Ends::Interface { commands_in, events_in, .. } => {
                let (c, e) = (commands_in.mailbox.stats(), events_in.mailbox.stats());
                detail.passed = c.pushed + e.pushed;
                detail.dropped = c.dropped + c.rejected + e.dropped + e.rejected;
            }
        }
        detail
    }
}

fn streams(
    connection: &Connection,
    client: &Arc<Instance>,
    input: usize,
    to: &Input,
    server: &Arc<Instance>,
    output: usize,
    from: &Output,
) -> Ends {
    let (payload, bytes) = match &from.ty {
        PortType::Plain(t) => (Payload::Plain { bytes: t.size() }, t.size()),
        PortType::Frame { header, .. } => (Payload::Frame, header.size()),
        PortType::Any => (Payload::Plain { bytes: 0 }, 0),
    };
    let default = if to.fifo > 0 { Queue::Fifo { depth: to.fifo, drop_oldest: true } } else { Queue::Latest };
    let queue = match connection.options.queue.unwrap_or(default) {
        Queue::Latest => stream::Queue::Latest,
        Queue::Fifo { depth, drop_oldest } => stream::Queue::Fifo {
            depth,
            drop: if drop_oldest { DropPolicy::DropOldest } else { DropPolicy::DropNewest },
        },
    };
    let (writer, reader) = stream_link(payload, queue);
    let stats = writer.counters();
    let link = Arc::new(InLink::new(reader, connection.options.max_age_ns.unwrap_or(0)));
    client.slots.input(input).link.swap(Box::new(Some(link.clone())));
    let out = Arc::new(OutLink::new(connection.id.0, writer, Some(client.clone())));
    server.slots.output(output).edit(|links| links.push(out));
    Ends::Stream { input, output, link, stats, bytes }
}

fn interfaces(
    connection: &Connection,
    client: &Arc<Instance>,
    client_ports: &Ports,
    server: &Arc<Instance>,
    server_ports: &Ports,
    binding: &Binding,
) -> Ends {
    let depth = connection.options.mailbox.unwrap_or(MAILBOX_DEPTH);
    let commands: Vec<&Command> = server_ports.provided.iter().flat_map(|p| &p.commands).collect();
    let size = |ty: Option<&Type>| ty.map_or(0, Type::size);
    let bound = || binding.functions.iter().map(|(_, c)| commands[*c]);
    let max_arg = bound().map(|c| size(c.arg.as_ref().map(|a| &a.ty))).max().unwrap_or(0);
    let max_ret = bound().map(|c| size(c.ret.as_ref())).max().unwrap_or(0);
    let commands_in = Arc::new(Inbox {
        mailbox: Mailbox::new(depth, max_arg, binding.functions.len()),
        replies: ReplyPool::new(REPLY_CELLS, max_ret, ERR_BYTES),
        targets: binding.functions.iter().map(|(_, c)| *c as u32).collect(),
    });
    server.edit_inboxes(|all| all.push(commands_in.clone()));
    let handlers: Vec<_> = client_ports.required.iter().flat_map(|r| &r.handlers).collect();
    let max_payload =
        binding.handlers.iter().map(|(h, _)| size(handlers[*h].payload.as_ref())).max().unwrap_or(0);
    let events_in = Arc::new(Inbox {
        mailbox: Mailbox::new(depth, max_payload, 0),
        replies: ReplyPool::new(1, 0, 0),
        targets: binding.handlers.iter().map(|(h, _)| *h as u32).collect(),
    });
    client.edit_inboxes(|all| all.push(events_in.clone()));

    for (index, (function, id)) in binding.functions.iter().enumerate() {
        let command = commands[*id];
        let deadline_ns = connection.options.deadline_ns.unwrap_or(DEFAULT_DEADLINE_NS);
        client.slots.bind_function(*function, target(server, command, *id, &commands_in, index, deadline_ns));
    }
    for (index, (_, event)) in binding.handlers.iter().enumerate() {
        let sink =
            EventSink::Handler { observer: client.clone(), inbox: events_in.clone(), index: index as u32 };
        server.slots.event(*event).edit(|sinks| sinks.push(Arc::new(sink)));
    }
    Ends::Interface {
        functions: binding.functions.iter().map(|(f, _)| *f).collect(),
        events: binding.handlers.iter().map(|(_, e)| *e).collect(),
        commands_in,
        events_in,
    }
}

/// What a function is bound to for one command, queued through `inbox` where it has to be.
pub(super) fn target(
    server: &Arc<Instance>,
    command: &Command,
    id: usize,
    inbox: &Arc<Inbox>,
    index: usize,
    deadline_ns: u64,
) -> FnBinding {
    let ret_bytes = command.ret.as_ref().map_or(0, Type::size);
    let range = command.arg.as_ref().and_then(RangeCheck::of);
    match command.kind {
        CommandKind::Read | CommandKind::QualifiedRead => {
            FnBinding::Read(ReadTarget { server: server.clone(), command: id as u32, ret_bytes, range })
        }
        _ => FnBinding::Command(CommandTarget {
            server: server.clone(),
            command: id as u32,
            arg_bytes: command.arg.as_ref().map_or(0, |a| a.ty.size()),
            ret_bytes,
            range,
            overflow: match command.overflow {
                trocar_model::Overflow::Reject => Overflow::Reject,
                trocar_model::Overflow::LatestWins => Overflow::LatestWins,
                trocar_model::Overflow::DropOldest => Overflow::DropOldest,
            },
            inbox: inbox.clone(),
            index: index as u32,
            deadline_ns,
        }),
    }
}
