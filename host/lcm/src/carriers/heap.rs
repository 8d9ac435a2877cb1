//! The carrier `heap`: queues, mailboxes and reply cells in the memory of this process, woken through a
//! futex.
//!
//! Invariant: every wire can be cut at any moment: callers inside finish on the old binding, later ones see
//! UNBOUND.

use std::sync::{Arc, Weak};

use trocar_lcm_api::LinkDetail;
use trocar_loader::convert::back;
use trocar_model::{Binding, Command, Link, Refusal, Type};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::mailbox::Mailbox;
use trocar_rt::reply::ReplyPool;
use trocar_rt::stream::{StreamCounters, stream_link};

use super::super::boundary::{
    Consumer, DEFAULT_DEADLINE_NS, ERR_BYTES, EventCell, EventSink, FnCell, Handler, InCell, InLink, Newest,
    OutCell, OutLink, Shape,
};
use super::super::described::PortSet;
use super::super::ends::Joined;
use super::super::inbox::{From, Inbox, Party};
use super::super::instance::Instance;
use super::super::passage::{MAILBOX_DEPTH, Passage, REPLY_CELLS, passing, target};
use super::{Both, Carrier, INLINE, are_together};

const NAME: &str = "heap";

pub(super) struct Heap;

impl Carrier for Heap {
    fn name(&self) -> &'static str {
        NAME
    }

    fn joins(&self, both: &Both<'_>) -> Result<(), String> {
        both.is_called_directly().map_or(Ok(()), Err)
    }

    fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal> {
        Ok(Box::new(OnHeap::join(both)?))
    }
}

/// One connection of this process.
pub(super) struct OnHeap {
    connection: u64,
    client: Arc<Instance>,
    server: Arc<Instance>,
    /// True when the connection asked for this carrier by name.
    pinned: bool,
    ends: Ends,
}

enum Ends {
    Stream {
        input: Arc<InCell>,
        output: Arc<OutCell>,
        link: Arc<InLink>,
        stats: StreamCounters,
        shape: Shape,
        /// Samples that may wait.
        depth: usize,
    },
    Interface {
        functions: Vec<Arc<FnCell>>,
        events: Vec<Arc<EventCell>>,
        commands_in: Arc<Inbox>,
        events_in: Arc<Inbox>,
    },
}

impl OnHeap {
    pub(super) fn join(both: &Both<'_>) -> Result<OnHeap, Refusal> {
        let (client, server) = (&both.client.instance, &both.server.instance);
        let ends = match &both.link {
            Link::Stream { input, output, adapt } => streams(both, *input, *output, *adapt)?,
            Link::Interface { binding, .. } => interfaces(both, binding),
        };
        client.reclaim();
        server.reclaim();
        Ok(OnHeap {
            connection: both.connection.id.0,
            client: client.clone(),
            server: server.clone(),
            pinned: both.connection.options.carrier == NAME,
            ends,
        })
    }

    fn name(&self) -> &'static str {
        if are_together(&self.client, &self.server) && !self.pinned { INLINE } else { NAME }
    }
}

impl Joined for OnHeap {
    fn cut(&self) {
        match &self.ends {
            Ends::Stream { input, output, .. } => {
                output.remove(|l| l.connection == self.connection);
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
                self.server.books.lose(commands_in.events, commands_in.counted_losses());
                self.client.books.lose(events_in.events, events_in.counted_losses());
                commands_in.close(PEER_LOST);
                let before = events_in.unexecuted();
                events_in.close(PEER_LOST);
                self.client.books.lose(events_in.events, events_in.unexecuted() - before);
                self.server.books.lose(commands_in.events, commands_in.unexecuted());
                commands_in.tell_failures(&*self.server);
            }
        }
    }

    fn still_fits(&self, binding: &Binding, (to, from): (&PortSet, &PortSet)) -> bool {
        let Ends::Interface { functions, events, commands_in, events_in } = &self.ends else { return false };
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

    fn is_stream(&self) -> bool {
        matches!(self.ends, Ends::Stream { .. })
    }

    fn detail(&self) -> LinkDetail {
        let carrier = self.name().into();
        let mut detail = LinkDetail { connection: self.connection, carrier, ..Default::default() };
        match &self.ends {
            Ends::Stream { link, stats, shape, depth, output: cell, .. } => {
                let s = stats.stats();
                detail.passed = s.taken;
                detail.dropped = s.dropped.saturating_sub(s.skipped) + cell.exhausted();
                detail.skipped = s.skipped;
                detail.depth = *depth as u64;
                detail.bytes = cell.bytes_of(s.taken, *shape);
                detail.latency_p50_ns = link.latency.percentile(0.50);
                detail.latency_p99_ns = link.latency.percentile(0.99);
            }
            Ends::Interface { commands_in, events_in, .. } => {
                let (c, e) = (commands_in.mailbox.stats(), events_in.mailbox.stats());
                detail.passed = c.pushed + e.pushed;
                // Goals replaced by a newer one before they were looked at.
                detail.skipped = c.superseded;
                detail.dropped = c.dropped.saturating_sub(c.superseded) + c.rejected + e.dropped + e.rejected;
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

fn streams(both: &Both<'_>, input: usize, output: usize, adapt: bool) -> Result<Ends, Refusal> {
    let (connection, client) = (both.connection, &both.client.instance);
    let (to_set, from_set) = (&*both.to, &*both.from);
    let (from, to) = (&from_set.ports.outputs[output].ty, &to_set.ports.inputs[input]);
    let (out_cell, in_cell) = (from_set.slots.output(output), to_set.slots.input(input));
    let ty = passing(connection, from, &to.ty, out_cell)?;
    let shape = Shape::of(&ty);
    let Passage { payload, queue, depth, adapt } = Passage::of(connection, &ty, to, adapt);
    let (writer, reader) = stream_link(payload, queue);
    let stats = writer.counters();
    let described: Arc<str> = back::port(&ty).into();
    let max_age_ns = connection.options.max_age_ns.unwrap_or(0);
    let (newest, stamp) = Newest::here();
    let link = Arc::new(InLink::new(reader, depth, max_age_ns, newest, described.clone(), adapt));
    in_cell.connect(Some(link.clone()));
    let consumer = Consumer::Here(client.core.clone(), (max_age_ns > 0).then_some(stamp));
    let out = Arc::new(OutLink::new(connection.id.0, writer, consumer, to_set.ports.looks_on(input)));
    out_cell.add(out, &ty, &described);
    Ok(Ends::Stream { input: in_cell.clone(), output: out_cell.clone(), link, stats, shape, depth })
}

fn interfaces(both: &Both<'_>, binding: &Binding) -> Ends {
    let (connection, client, server) = (both.connection, &both.client.instance, &both.server.instance);
    let (to_set, from_set) = (&*both.to, &*both.from);
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
        From::Component(Arc::downgrade(client) as Weak<dyn Party>),
        connection.options.deadline_ns.unwrap_or(0),
    );
    server.edit_inboxes(|all| all.push(commands_in.clone()));
    let handlers: Vec<_> = to_set.ports.required.iter().flat_map(|r| &r.handlers).collect();
    let max_payload =
        binding.handlers.iter().map(|(h, _)| size(handlers[*h].payload.as_ref())).max().unwrap_or(0);
    let events_in = Inbox::events(
        Mailbox::new(depth, max_payload, 0),
        binding.handlers.iter().map(|(h, _)| to_set.handlers[*h].clone()).collect(),
        From::Component(Arc::downgrade(server) as Weak<dyn Party>),
    );
    client.edit_inboxes(|all| all.push(events_in.clone()));

    let deadline_ns = connection.options.deadline_ns.unwrap_or(DEFAULT_DEADLINE_NS);
    let functions = binding.functions.iter().enumerate().map(|(index, (function, id))| {
        let cell = to_set.slots.function(*function);
        let to = target(&server.core, from_set, *id, &commands_in, index, deadline_ns);
        cell.bind(to, back::command(commands[*id]));
        cell.clone()
    });
    let functions = functions.collect();
    let events = binding.handlers.iter().enumerate().map(|(index, (handler, event))| {
        let cell = from_set.slots.event(*event);
        let sink = Arc::new(EventSink::Handler(Handler {
            observer: client.core.clone(),
            inbox: events_in.clone(),
            index: index as u32,
            position: to_set.handlers[*handler].clone(),
            direct: handlers[*handler].direct,
        }));
        cell.edit(|sinks| sinks.push(sink));
        cell.clone()
    });
    let events = events.collect();
    Ends::Interface { functions, events, commands_in, events_in }
}
