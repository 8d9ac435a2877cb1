//! The client's half: calls, reads and events bound to the memory, or an input that reads from it.
//!
//! Invariant: as for all wires; a read is computed here only with the code the server's process has.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use trocar_lcm_api::LinkDetail;
use trocar_loader::convert::back;
use trocar_model::{Binding, Command, Connection, CopyRun, PortType, Ports};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::os;
use trocar_rt::segment::{Agreed, RemoteCalls, Rows, Stream, Word};
use trocar_rt::state::StateReader;
use trocar_rt::stream::{RemoteViews, StreamCounters, StreamReader};
use trocar_rt::wake::Waker;

use super::super::boundary::{
    DEFAULT_DEADLINE_NS, FnBinding, FnCell, InCell, InLink, Newest, OwnClass, OwnRead, OwnRows, Panics,
    RangeCheck, RemoteCommand, RemoteRead, RemoteServer, RemoteSource, RemoteTable, Shape,
};
use super::super::described::PortSet;
use super::super::ends::Here;
use super::super::inbox::{Check, Inbox};
use super::super::loss::Loss;
use super::super::passage::lane;
use super::asks::Asks;
use super::terms::{Reading, Way, commands, is_status, of_rows, size};

/// The client's wires.
pub(super) enum ClientWires {
    Input {
        input: Arc<InCell>,
        link: Arc<InLink>,
        stats: StreamCounters,
        depth: usize,
        bell: Arc<Waker>,
        views: Arc<RemoteViews>,
        bytes: usize,
    },
    Calls {
        functions: Vec<Arc<FnCell>>,
        server: Arc<RemoteServer>,
        events_in: Arc<Inbox>,
        bell: Arc<Waker>,
        asks: Arc<Asks>,
        /// Panics of reads computed here.
        panics: Arc<Panics>,
        /// Number of them that the server's process was told.
        told: u64,
    },
}

/// Parts a client needs to compute reads itself: the class of its server, and the rows its process shows.
pub(super) struct Own {
    pub(super) class: OwnClass,
    pub(super) rows: OwnedFd,
}

/// Sources of the reads of one connection, each given out once and in their order.
struct Reads<'a, T, P> {
    /// The server's ports.
    ports: &'a Ports,
    asks: &'a Arc<Asks>,
    own: Option<(Arc<OwnRows>, OwnClass)>,
    tables: T,
    positions: P,
}

impl<T, P> Reads<'_, T, P>
where
    T: Iterator<Item = (StateReader, StateReader)>,
    P: Iterator<Item = Word>,
{
    /// The source of the read with this number; its process is asked where there is no other.
    fn source(&mut self, reading: Reading, id: usize, command: &Command) -> RemoteSource {
        let (ports, asks) = (self.ports, self.asks);
        let source = match reading {
            Reading::Published => self.tables.next().map(|(results, whys)| {
                RemoteSource::Table(RemoteTable { results, whys, status: is_status(ports, id) })
            }),
            Reading::Here => self.own.as_ref().zip(self.positions.next()).map(|((rows, class), at)| {
                RemoteSource::Here(OwnRead::new(rows, at, command, class, ports), asks.clone())
            }),
            Reading::Asked => None,
        };
        source.unwrap_or_else(|| RemoteSource::Ask(asks.clone()))
    }
}

impl ClientWires {
    /// Wires up the memory of the server.
    ///
    /// # Errors
    /// The memory is not as agreed, or the thread can be woken by no more connections.
    pub(super) fn connect(
        (memory, agreed, bell): (OwnedFd, Agreed, Option<Arc<Waker>>),
        way: &Way,
        connection: &Connection,
        (here, set): (&Here, &PortSet),
        (server, asks, own): (&Ports, Arc<Asks>, Option<Own>),
        views: Arc<RemoteViews>,
    ) -> io::Result<ClientWires> {
        match way {
            Way::Stream { input, ty, shape, depth, adapt, .. } => {
                let stream = Stream::<StreamReader>::open(memory, *shape, agreed, &views)?;
                let cell = set.slots.input(*input).clone();
                Self::read(stream, views, connection, here, (cell, ty, *depth, adapt.clone()))
            }
            Way::Calls { binding, shape } => {
                let mut calls = RemoteCalls::open(memory, shape, agreed)?;
                // Whoever stands in for the server is rung in place of the server's thread.
                calls.for_server = bell.unwrap_or(calls.for_server);
                Self::call(calls, binding, connection, (here, set), (server, asks, own))
            }
        }
    }

    #[expect(clippy::type_complexity, reason = "the parts of `Way::Stream` a reader needs")]
    fn read(
        stream: Stream<StreamReader>,
        views: Arc<RemoteViews>,
        connection: &Connection,
        here: &Here,
        (cell, ty, depth, adapt): (Arc<InCell>, &PortType, usize, Option<(Vec<CopyRun>, usize)>),
    ) -> io::Result<ClientWires> {
        here.executor
            .add_bell(stream.for_reader.clone(), here.instance.core.clone())
            .map_err(io::Error::other)?;
        let stats = stream.end.counters();
        let max_age_ns = connection.options.max_age_ns.unwrap_or(0);
        let newest = Newest::Remote(stream.newest_ns, os::now_ns());
        let link = Arc::new(InLink::new(stream.end, depth, max_age_ns, newest, back::port(ty).into(), adapt));
        cell.connect(Some(link.clone()));
        here.instance.reclaim();
        let bytes = Shape::of(ty).bytes;
        Ok(ClientWires::Input { input: cell, link, stats, depth, bell: stream.for_reader, views, bytes })
    }

    fn call(
        calls: RemoteCalls,
        binding: &Binding,
        connection: &Connection,
        (here, set): (&Here, &PortSet),
        (ports, asks, own): (&Ports, Arc<Asks>, Option<Own>),
    ) -> io::Result<ClientWires> {
        let client = &here.instance;
        let panics = Arc::new(Panics::default());
        let rows = |own: Own| -> io::Result<_> {
            let (bytes, agreed) = of_rows(&own.class.info);
            let rows = Rows::<StateReader>::open(own.rows, bytes, agreed)?;
            Ok((OwnRows::new(&own.class, rows.end, panics.clone()), own.class))
        };
        let own = own.map(rows).transpose()?;
        here.executor.add_bell(calls.for_client.clone(), client.core.clone()).map_err(io::Error::other)?;
        let handlers: Vec<_> = set.ports.required.iter().flat_map(|r| &r.handlers).collect();
        let checks = binding
            .handlers
            .iter()
            .map(|(h, _)| Check { bytes: size(handlers[*h].payload.as_ref()), range: None });
        let events_in = Inbox::remote_events(
            calls.events,
            binding.handlers.iter().map(|(h, _)| set.handlers[*h].clone()).collect(),
            here.from(&connection.server.component),
            checks.collect(),
        );
        client.edit_inboxes(|all| all.push(events_in.clone()));
        let server = RemoteServer::new(calls.commands, calls.replies, calls.server, calls.for_server);
        let deadline_ns = connection.options.deadline_ns.unwrap_or(DEFAULT_DEADLINE_NS);
        let all = commands(ports);
        let tables = calls.reads.into_iter().zip(calls.whys);
        let mut reads = Reads { ports, asks: &asks, own, tables, positions: calls.own_reads.into_iter() };
        let functions = binding.functions.iter().enumerate().map(|(index, (function, id))| {
            let command = all[*id];
            let range = command.arg.as_ref().and_then(RangeCheck::of);
            let (server, lane) = (server.clone(), lane(command, index));
            let to = match Reading::of(ports, &all, *id, reads.own.is_some()) {
                Some(reading) => FnBinding::RemoteRead(RemoteRead {
                    server,
                    index: lane.index,
                    source: reads.source(reading, *id, command),
                    arg_bytes: lane.arg_bytes,
                    ret_bytes: lane.ret_bytes,
                    range,
                    deadline_ns,
                }),
                None => FnBinding::RemoteCommand(RemoteCommand { server, lane, range, deadline_ns }),
            };
            let cell = set.slots.function(*function);
            cell.bind(to, back::command(command));
            cell.clone()
        });
        let functions = functions.collect();
        client.reclaim();
        Ok(ClientWires::Calls { functions, server, events_in, bell: calls.for_client, asks, panics, told: 0 })
    }

    /// Tells whether these are the wires of the present binding.
    pub(super) fn still_fit(&self, binding: &Binding, set: &PortSet) -> bool {
        let ClientWires::Calls { functions, events_in, .. } = self else { return false };
        let mut bound = binding.functions.iter().map(|(function, _)| set.slots.function(*function));
        let mut handlers = binding.handlers.iter().map(|(handler, _)| &set.handlers[*handler]);
        let targets = &events_in.targets;
        (functions.len(), targets.len()) == (bound.len(), handlers.len())
            && functions.iter().all(|function| bound.next().is_some_and(|now| Arc::ptr_eq(now, function)))
            && targets.iter().all(|target| handlers.next().is_some_and(|now| Arc::ptr_eq(now, target)))
    }

    /// Number of reads computed here that panicked, and the sentence of the last one; `None` if unchanged
    /// since the last call.
    pub(super) fn untold_panics(&mut self) -> Option<(u64, String)> {
        let ClientWires::Calls { panics, told, .. } = self else { return None };
        let (now, text) = panics.so_far();
        (std::mem::replace(told, now) != now).then_some((now, text))
    }

    /// Answers the callers that wait for the server, and takes its output from the input. Any thread; gives
    /// back no memory, which would take time.
    pub(super) fn lose(&self) {
        match self {
            ClientWires::Calls { server, asks, .. } => {
                server.lose();
                asks.end();
            }
            ClientWires::Input { input, .. } => input.connect(None),
        }
    }

    /// Cuts the wires. Unless the server is lost, calls that have begun there are carried to their end and
    /// answered.
    pub(super) fn disconnect(&self, here: &Here, how: Loss) {
        let client = &here.instance;
        match (how, self) {
            (Loss::Peer, _) => self.lose(),
            (_, ClientWires::Calls { asks, .. }) => asks.end(),
            _ => {}
        }
        match self {
            ClientWires::Input { input, bell, .. } => {
                input.connect(None);
                here.executor.remove_bell(bell.clone());
            }
            ClientWires::Calls { functions, events_in, bell, .. } => {
                functions.iter().for_each(|f| f.unbind());
                client.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, events_in)));
                client.books.lose(events_in.events, events_in.counted_losses());
                let before = events_in.unexecuted();
                events_in.close(PEER_LOST);
                client.books.lose(events_in.events, events_in.unexecuted() - before);
                here.executor.remove_bell(bell.clone());
            }
        }
        client.settle();
    }

    pub(super) fn detail(&self) -> LinkDetail {
        match self {
            ClientWires::Input { link, stats, depth, bytes, .. } => {
                let passed = stats.stats().taken;
                LinkDetail {
                    passed,
                    depth: *depth as u64,
                    bytes: passed.saturating_mul(*bytes as u64),
                    latency_p50_ns: link.latency.percentile(0.50),
                    latency_p99_ns: link.latency.percentile(0.99),
                    ..LinkDetail::default()
                }
            }
            ClientWires::Calls { server, events_in, .. } => {
                let (c, e) = (server.commands.stats(), events_in.mailbox.stats());
                LinkDetail {
                    passed: c.pushed + e.pushed,
                    skipped: c.superseded,
                    dropped: c.dropped.saturating_sub(c.superseded) + c.rejected + e.dropped + e.rejected,
                    rejected: c.rejected + e.rejected,
                    depth: c.depth,
                    high_water: c.high_water.max(e.high_water),
                    unexecuted: events_in.unexecuted(),
                    ..LinkDetail::default()
                }
            }
        }
    }
}
