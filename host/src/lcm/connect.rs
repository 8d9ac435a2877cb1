//! Wires two components of this process together, and takes the wires away again.
//!
//! Invariant: what binds to what was decided by `model::bindings`; here it is only done. Every wire can be cut at any
//! moment: callers inside finish on the old binding, later ones see UNBOUND.

use std::sync::Arc;

use trocar_model::{
    Binding, Command, ComponentId, ConnectOptions, Connection, Link, Name, PortId, PortType, Queue, Refusal,
    Type, bindings,
};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::mailbox::{Mailbox, Overflow};
use trocar_rt::reply::ReplyPool;
use trocar_rt::stream::{self, DropPolicy, Payload, StreamCounters, stream_link};

use super::api::LinkDetail;
use super::boundary::{
    CommandTarget, Consumer, DEFAULT_DEADLINE_NS, ERR_BYTES, EventCell, EventSink, FnBinding, FnCell,
    Handler, InCell, InLink, Lane, Newest, OutCell, OutLink, RangeCheck, ReadTarget, Reader, Shape,
};
use super::convert::back;
use super::dynamic::PortSet;
use super::inbox::{From, Inbox};
use super::instance::Instance;

/// Commands or events one connection may have waiting.
pub(super) const MAILBOX_DEPTH: usize = 64;
/// Blocking calls one connection may have under way at once.
pub(super) const REPLY_CELLS: usize = 8;

/// One connection of this process.
pub(super) struct Wired {
    pub(super) id: u64,
    pub(super) client: Arc<Instance>,
    pub(super) client_port: Name,
    pub(super) server: Arc<Instance>,
    pub(super) server_port: Name,
    /// The client cannot do without it.
    pub(super) required: bool,
    options: ConnectOptions,
    ends: Ends,
}

enum Ends {
    Stream {
        input: Arc<InCell>,
        output: Arc<OutCell>,
        link: Arc<InLink>,
        stats: StreamCounters,
        bytes: usize,
        /// Samples that may wait.
        depth: usize,
        frames: bool,
    },
    Interface {
        functions: Vec<Arc<FnCell>>,
        events: Vec<Arc<EventCell>>,
        commands_in: Arc<Inbox>,
        events_in: Arc<Inbox>,
    },
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
        let (from, to) = (server.described.now(), client.described.now());
        let link =
            bindings(&to.ports, &connection.client, &from.ports, &connection.server, &connection.options)?;
        let wired = |ends, required| Wired {
            id: connection.id.0,
            client: client.clone(),
            client_port: connection.client.port.clone(),
            server: server.clone(),
            server_port: connection.server.port.clone(),
            required,
            options: connection.options.clone(),
            ends,
        };
        match link {
            Link::Stream { input, output, adapt } => {
                let ends = streams(connection, (client, &to, input), (server, &from, output), adapt)?;
                Ok(wired(ends, !to.ports.inputs[input].optional))
            }
            Link::Interface { required, binding, .. } => {
                let ends = interfaces(connection, (client, &to), (server, &from), &binding);
                Ok(wired(ends, !to.ports.required[required].optional))
            }
        }
    }

    /// True for interfaces whose descriptions now would be wired just as they are: same functions to same commands, same
    /// events to same handlers.
    pub(super) fn still_fits(&self) -> bool {
        let Ends::Interface { functions, events, commands_in, events_in } = &self.ends else { return false };
        let (from, to) = (self.server.described.now(), self.client.described.now());
        let end = |id: &ComponentId, port: &Name| PortId { component: id.clone(), port: port.clone() };
        let (client, server) =
            (end(&self.client.id, &self.client_port), end(&self.server.id, &self.server_port));
        let Ok(Link::Interface { binding, .. }) =
            bindings(&to.ports, &client, &from.ports, &server, &self.options)
        else {
            return false;
        };
        let calls = binding.functions.iter().zip(functions.iter().zip(&commands_in.targets));
        let hears = binding.handlers.iter().zip(events.iter().zip(&events_in.targets));
        binding.functions.len() == functions.len()
            && binding.handlers.len() == events.len()
            && calls.into_iter().all(|((f, c), (cell, target))| {
                Arc::ptr_eq(to.slots.function(*f), cell) && Arc::ptr_eq(&from.commands[*c], target)
            })
            && hears.into_iter().all(|((h, e), (cell, target))| {
                Arc::ptr_eq(from.slots.event(*e), cell) && Arc::ptr_eq(&to.handlers[*h], target)
            })
    }

    /// Cuts the wires; queued commands are answered PEER_LOST.
    pub(super) fn disconnect(&self) {
        match &self.ends {
            Ends::Stream { input, output, .. } => {
                output.remove(|l| l.connection == self.id);
                input.connect(None);
            }
            Ends::Interface { functions, events, commands_in, events_in } => {
                functions.iter().for_each(|f| f.unbind());
                let mine =
                    |s: &EventSink| matches!(s, EventSink::Handler(h) if Arc::ptr_eq(&h.inbox, events_in));
                for event in events {
                    event.edit(|sinks| sinks.retain(|s| !mine(s)));
                }
                self.server.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, commands_in)));
                self.client.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, events_in)));
                self.server.counters.keep_losses(commands_in);
                self.client.counters.keep_losses(events_in);
                commands_in.close(PEER_LOST);
                let before = events_in.unexecuted();
                events_in.close(PEER_LOST);
                self.client.counters.lose(events_in, events_in.unexecuted() - before);
                self.server.counters.lose(commands_in, commands_in.unexecuted());
                commands_in.tell_toll(&self.server);
            }
        }
        if self.client.reclaim() + self.server.reclaim() > 0 {
            // A cycle under way may still look at what was cut; it is dropped after it.
            self.client.look_at_ports();
        }
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
            Ends::Stream { link, stats, bytes, depth, output: cell, frames, .. } => {
                let s = stats.stats();
                detail.passed = s.taken;
                detail.dropped = s.dropped + cell.exhausted();
                detail.depth = *depth as u64;
                detail.bytes = s.taken * *bytes as u64;
                if *frames {
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
                detail.rejected = c.rejected + e.rejected;
                detail.depth = c.depth;
                detail.high_water = c.high_water.max(e.high_water);
                detail.failed = commands_in.failed();
                detail.unexecuted = commands_in.unexecuted() + events_in.unexecuted();
            }
        }
        detail
    }
}

/// The type that passes: the output's, or the input's where the output has none of its own yet.
pub(super) fn passing(
    connection: &Connection,
    from: &PortType,
    to: &PortType,
    cell: &OutCell,
) -> Result<PortType, Refusal> {
    let mismatch = |difference: String| Refusal::TypeMismatch {
        client: connection.client.clone(),
        server: connection.server.clone(),
        what: "samples".into(),
        difference,
    };
    match (from, to) {
        (PortType::Any, PortType::Any) => cell.passing().ok_or_else(|| {
            mismatch("neither end has a type: connect the output to a typed input first".into())
        }),
        (PortType::Any, typed) => {
            let now = cell.passing();
            let agree = match (&now, typed) {
                (None, _) => true,
                (Some(PortType::Plain(a)), PortType::Plain(b)) => a.same(b),
                (
                    Some(PortType::Frame { header, format, .. }),
                    PortType::Frame { header: h, format: f, .. },
                ) => header.same(h) && format == f,
                _ => false,
            };
            if agree {
                return Ok(typed.clone());
            }
            Err(mismatch("the untyped output has taken another type from its first connection".into()))
        }
        (typed, _) => Ok(typed.clone()),
    }
}

fn streams(
    connection: &Connection,
    (client, to_set, input): (&Arc<Instance>, &PortSet, usize),
    (server, from_set, output): (&Arc<Instance>, &PortSet, usize),
    adapt: bool,
) -> Result<Ends, Refusal> {
    let (from, to) = (&from_set.ports.outputs[output].ty, &to_set.ports.inputs[input]);
    let (out_cell, in_cell) = (from_set.slots.output(output), to_set.slots.input(input));
    let ty = passing(connection, from, &to.ty, out_cell)?;
    let shape = Shape::of(&ty);
    let payload = if shape.frame { Payload::Frame } else { Payload::Plain { bytes: shape.bytes } };
    let adapt = match (&ty, &to.ty) {
        (PortType::Plain(from), PortType::Plain(to)) if adapt => {
            to.copy_plan(from).map(|plan| (plan, to.size()))
        }
        _ => None,
    };
    let queue = match connection.options.queue.unwrap_or(to.default_queue()) {
        Queue::Latest => stream::Queue::Latest,
        Queue::Fifo { depth, drop_oldest } => stream::Queue::Fifo {
            depth,
            drop: if drop_oldest { DropPolicy::DropOldest } else { DropPolicy::DropNewest },
        },
    };
    let depth = if let stream::Queue::Fifo { depth, .. } = queue { depth } else { 1 };
    let (writer, reader) = stream_link(payload, queue);
    let stats = writer.counters();
    let described: Arc<str> = back::port(&ty).into();
    let max_age_ns = connection.options.max_age_ns.unwrap_or(0);
    let (newest, stamp) = Newest::here();
    let link = Arc::new(InLink::new(reader, depth, max_age_ns, newest, described.clone(), adapt));
    in_cell.connect(Some(link.clone()));
    let consumer = Consumer::Here(client.clone(), (max_age_ns > 0).then_some(stamp));
    let out = Arc::new(OutLink::new(connection.id.0, writer, consumer));
    out_cell.add(out, &ty, &described);
    client.reclaim();
    server.reclaim();
    Ok(Ends::Stream {
        input: in_cell.clone(),
        output: out_cell.clone(),
        link,
        stats,
        bytes: shape.bytes,
        depth,
        frames: shape.frame,
    })
}

fn interfaces(
    connection: &Connection,
    (client, to_set): (&Arc<Instance>, &PortSet),
    (server, from_set): (&Arc<Instance>, &PortSet),
    binding: &Binding,
) -> Ends {
    let depth = connection.options.mailbox.unwrap_or(MAILBOX_DEPTH);
    let commands: Vec<&Command> = from_set.ports.provided.iter().flat_map(|p| &p.commands).collect();
    let size = |ty: Option<&Type>| ty.map_or(0, Type::size);
    let bound = || binding.functions.iter().map(|(_, c)| commands[*c]);
    let max_arg = bound().map(|c| size(c.arg.as_ref().map(|a| &a.ty))).max().unwrap_or(0);
    let max_ret = bound().map(|c| size(c.ret.as_ref())).max().unwrap_or(0);
    let commands_in = Inbox::commands(
        Mailbox::new(depth, max_arg, binding.functions.len()),
        ReplyPool::new(REPLY_CELLS, max_ret, ERR_BYTES),
        binding.functions.iter().map(|(_, c)| from_set.commands[*c].clone()).collect(),
        From::Component(Arc::downgrade(client)),
    );
    server.edit_inboxes(|all| all.push(commands_in.clone()));
    let handlers: Vec<_> = to_set.ports.required.iter().flat_map(|r| &r.handlers).collect();
    let max_payload =
        binding.handlers.iter().map(|(h, _)| size(handlers[*h].payload.as_ref())).max().unwrap_or(0);
    let events_in = Inbox::events(
        Mailbox::new(depth, max_payload, 0),
        binding.handlers.iter().map(|(h, _)| to_set.handlers[*h].clone()).collect(),
        From::Component(Arc::downgrade(server)),
    );
    client.edit_inboxes(|all| all.push(events_in.clone()));

    let deadline_ns = connection.options.deadline_ns.unwrap_or(DEFAULT_DEADLINE_NS);
    let functions = binding.functions.iter().enumerate().map(|(index, (function, id))| {
        let cell = to_set.slots.function(*function);
        let to = target(server, from_set, *id, &commands_in, index, deadline_ns);
        cell.bind(to, back::command(commands[*id]));
        cell.clone()
    });
    let functions = functions.collect();
    let events = binding.handlers.iter().enumerate().map(|(index, (handler, event))| {
        let cell = from_set.slots.event(*event);
        let sink = Arc::new(EventSink::Handler(Handler {
            observer: client.clone(),
            inbox: events_in.clone(),
            index: index as u32,
            position: to_set.handlers[*handler].clone(),
            direct: handlers[*handler].direct,
        }));
        cell.edit(|sinks| sinks.push(sink));
        cell.clone()
    });
    let events = events.collect();
    client.reclaim();
    server.reclaim();
    Ends::Interface { functions, events, commands_in, events_in }
}

/// What a function is bound to for the command at position `id` of the server's set, queued through `inbox` where it has
/// to be.
pub(super) fn target(
    server: &Arc<Instance>,
    set: &PortSet,
    id: usize,
    inbox: &Arc<Inbox>,
    index: usize,
    deadline_ns: u64,
) -> FnBinding {
    let Some(command) = set.ports.provided.iter().flat_map(|p| &p.commands).nth(id) else {
        return FnBinding::Unbound;
    };
    let arg_bytes = command.arg.as_ref().map_or(0, |a| a.ty.size());
    let ret_bytes = command.ret.as_ref().map_or(0, Type::size);
    let range = command.arg.as_ref().and_then(RangeCheck::of);
    match command.kind.is_read() {
        true => {
            let from = match set.system_command(id) {
                Some(which) => Reader::System(which),
                None => Reader::Class(set.commands[id].clone()),
            };
            FnBinding::Read(ReadTarget { server: server.clone(), from, arg_bytes, ret_bytes, range })
        }
        false => FnBinding::Command(CommandTarget {
            server: server.clone(),
            command: set.commands[id].clone(),
            lane: lane(command, index),
            range,
            inbox: inbox.clone(),
            deadline_ns,
        }),
    }
}

/// What a command is queued as, at this place among the functions of its connection.
pub(super) fn lane(command: &Command, index: usize) -> Lane {
    Lane {
        index: index as u32,
        arg_bytes: command.arg.as_ref().map_or(0, |a| a.ty.size()),
        ret_bytes: command.ret.as_ref().map_or(0, Type::size),
        overflow: match command.overflow {
            trocar_model::Overflow::Reject => Overflow::Reject,
            trocar_model::Overflow::LatestWins => Overflow::LatestWins,
            trocar_model::Overflow::DropOldest => Overflow::DropOldest,
        },
    }
}
