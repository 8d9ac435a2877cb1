//! The server's half: an output or an interface whose queues, tables and bells lie in memory it offers.
//!
//! Invariant: as for connections inside the process, every wire can be cut at any moment: callers inside
//! finish on the old binding, later ones see UNBOUND. Queued calls are answered.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use trocar_lcm_api::LinkDetail;
use trocar_loader::convert::back;
use trocar_model::{Binding, Command, Connection};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::segment::{Agreed, ServedCalls, Stream, Word};
use trocar_rt::state::StateWriter;
use trocar_rt::stream::{RemotePools, StreamCounters, StreamWriter};
use trocar_rt::wake::Waker;

use super::super::books::Misuse;
use super::super::boundary::{
    Consumer, EventCell, EventSink, OutCell, OutLink, RangeCheck, RemoteEvents, RemoteHandler, Shape,
};
use super::super::core::{ShownRows, View};
use super::super::described::PortSet;
use super::super::ends::Here;
use super::super::inbox::{Check, Inbox, Position};
use super::face::{Face, Shown};
use super::serving::{QuestionQueue, Served};
use super::terms::{Reading, Way, commands, size};

/// The server's memory, before the client has it.
pub(super) enum Offer {
    Output {
        stream: Stream<StreamWriter>,
        pools: Arc<RemotePools>,
    },
    /// With the bell of whoever stands in for the client, rung when something is shown.
    Calls(Box<ServedCalls>, Option<Arc<Waker>>),
}

/// The server's wires.
pub(super) enum ServerWires {
    Output {
        output: Arc<OutCell>,
        stats: StreamCounters,
        /// Number of the first sample that was offered; 0: none was.
        first: Arc<AtomicU64>,
        pools: Arc<RemotePools>,
        /// Number of pools the client was told of.
        told: usize,
        shape: Shape,
    },
    Calls {
        events: Vec<Arc<EventCell>>,
        to: Arc<RemoteEvents>,
        commands_in: Arc<Inbox>,
        face: Arc<Face>,
        bell: Arc<Waker>,
        questions: QuestionQueue,
        /// Failed commands and commands that never ran, as the client was told.
        failures: (u64, u64),
        /// Reads that panicked in the client's process, as that process told.
        panicked: AtomicU64,
    },
}

/// Samples an output has offered to one link: number `first` and those after it, `count` in all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Offered {
    /// 0: none yet.
    pub(super) first: u64,
    pub(super) count: u64,
    /// Writes of the output, read before the other counts.
    pub(super) written: u64,
}

/// Most panicked reads that another process may report at once: sums of them fit.
const MOST_PANICS: u64 = 1 << 32;

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "the component's ports are others by now")
}

impl Offer {
    /// # Errors
    /// The machine lacks that much memory.
    pub(super) fn make(way: &Way, agreed: Agreed, bell: &Arc<Waker>) -> io::Result<Offer> {
        Ok(match way {
            Way::Stream { shape, .. } => {
                let pools = RemotePools::ringing(bell.clone());
                Offer::Output { stream: Stream::<StreamWriter>::create(*shape, agreed, &pools)?, pools }
            }
            Way::Calls { shape, .. } => Offer::Calls(Box::new(ServedCalls::create(shape, agreed)?), None),
        })
    }

    pub(super) fn fd(&self) -> io::Result<OwnedFd> {
        let fd = match self {
            Offer::Output { stream, .. } => stream.fd(),
            Offer::Calls(calls, _) => calls.fd(),
        };
        fd.ok_or_else(|| io::Error::other("memory without a file"))?.try_clone_to_owned()
    }

    /// Rings this bell, in place of that in the memory, whenever there is something for the client.
    pub(super) fn ring(&mut self, bell: &Arc<Waker>) {
        match self {
            Offer::Output { stream, .. } => stream.for_reader = bell.clone(),
            Offer::Calls(calls, shows) => {
                calls.for_client = bell.clone();
                calls.replies.ringing(bell.clone());
                *shows = Some(bell.clone());
            }
        }
    }

    /// Gives the pools of the output itself their places.
    pub(super) fn expect_pools(&self, way: &Way, set: &PortSet) {
        let (Offer::Output { pools, .. }, Way::Stream { output, .. }) = (self, way) else { return };
        for file in set.slots.output(*output).pool_files() {
            pools.place_of(file.number());
        }
    }
}

/// The commands of a server that a connection has bound, by their numbers in its ports.
struct Bound<'a> {
    set: &'a PortSet,
    all: Vec<&'a Command>,
    binding: &'a Binding,
    /// True when the client's process sees the rows of the server.
    shows_rows: bool,
}

impl Bound<'_> {
    fn ids(&self) -> impl Iterator<Item = usize> {
        self.binding.functions.iter().map(|(_, id)| *id)
    }

    fn reading(&self, id: usize) -> Option<Reading> {
        Reading::of(&self.set.ports, &self.all, id, self.shows_rows)
    }

    /// Conditions on an entry for this command that another process puts into the queue.
    fn check(&self, id: usize) -> Check {
        let arg = self.all[id].arg.as_ref();
        Check { bytes: size(arg.map(|a| &a.ty)), range: arg.and_then(RangeCheck::of) }
    }

    fn ret_bytes(&self, id: usize) -> usize {
        size(self.all[id].ret.as_ref())
    }

    /// Reads whose results are published, each in its tables.
    fn shown(&self, tables: impl Iterator<Item = (StateWriter, StateWriter)>) -> Vec<Shown> {
        let published = self.ids().filter(|id| self.reading(*id) == Some(Reading::Published));
        let shown = published
            .zip(tables)
            .map(|(id, (results, whys))| Shown::new(self.set.reader(id), self.ret_bytes(id), results, whys));
        shown.collect()
    }

    /// Reads that the client computes itself, each with the place for its number.
    fn computed_there(&self, places: impl IntoIterator<Item = Word>) -> Vec<(Arc<Position>, Word)> {
        let own = self.ids().filter(|id| self.reading(*id) == Some(Reading::Here));
        own.zip(places).map(|(id, word)| (self.set.commands[id].clone(), word)).collect()
    }

    /// Reads that the client may have to ask for.
    fn served(&self) -> Vec<Served> {
        let asked = |id: usize| matches!(self.reading(id), Some(Reading::Asked | Reading::Here));
        let served = self.ids().enumerate().filter(|(_, id)| asked(*id)).map(|(index, id)| {
            let Check { bytes: arg_bytes, range } = self.check(id);
            let (from, ret_bytes) = (self.set.reader(id), self.ret_bytes(id));
            Served { index: index as u32, from, arg_bytes, range, ret_bytes }
        });
        served.collect()
    }
}

impl ServerWires {
    /// Wires the offer up; the client is ready.
    ///
    /// # Errors
    /// The thread can be woken by no more connections.
    pub(super) fn connect(
        offer: Offer,
        way: &Way,
        connection: &Connection,
        (here, set): (&Here, &PortSet),
        rows: Option<Arc<ShownRows>>,
        questions: impl FnOnce(Vec<Served>) -> QuestionQueue,
    ) -> io::Result<ServerWires> {
        match (offer, way) {
            (Offer::Output { stream, pools }, Way::Stream { output, ty, observes, .. }) => {
                let cell = set.slots.output(*output).clone();
                let stats = stream.end.counters();
                let newest_ns = connection.options.max_age_ns.map(|_| stream.newest_ns);
                let first = Arc::new(AtomicU64::new(0));
                let consumer = Consumer::Remote { bell: stream.for_reader, newest_ns, first: first.clone() };
                let link = Arc::new(OutLink::new(connection.id.0, stream.end, consumer, *observes));
                cell.add(link, ty, &back::port(ty).into());
                here.instance.reclaim();
                Ok(ServerWires::Output { output: cell, stats, first, pools, told: 0, shape: Shape::of(ty) })
            }
            (Offer::Calls(calls, shows), Way::Calls { binding, .. }) => {
                Self::serve((*calls, shows), binding, connection, (here, set), rows, questions)
            }
            _ => Err(gone()),
        }
    }

    fn serve(
        (calls, shows): (ServedCalls, Option<Arc<Waker>>),
        binding: &Binding,
        connection: &Connection,
        (here, set): (&Here, &PortSet),
        rows: Option<Arc<ShownRows>>,
        questions: impl FnOnce(Vec<Served>) -> QuestionQueue,
    ) -> io::Result<ServerWires> {
        let server = &here.instance;
        here.executor.add_bell(calls.for_server.clone(), server.core.clone()).map_err(io::Error::other)?;
        let bound = Bound { set, all: commands(&set.ports), binding, shows_rows: rows.is_some() };
        let shown = bound.shown(calls.reads.into_iter().zip(calls.whys));
        let face = Face::new(calls.server, shown, bound.computed_there(calls.own_reads), rows, shows.clone());
        let questions = questions(bound.served());
        let commands_in = Inbox::remote_commands(
            calls.commands,
            calls.replies,
            bound.ids().map(|id| set.commands[id].clone()).collect(),
            here.from(&connection.client.component),
            bound.ids().map(|id| bound.check(id)).collect(),
            (connection.options.deadline_ns.unwrap_or(0), shows.clone()),
        );
        server.edit_inboxes(|all| all.push(commands_in.clone()));
        let to = Arc::new(RemoteEvents { mailbox: calls.events, bell: calls.for_client });
        let events = binding.handlers.iter().enumerate().map(|(index, (_, event))| {
            let cell = set.slots.event(*event);
            let sink = Arc::new(EventSink::Remote(RemoteHandler { to: to.clone(), index: index as u32 }));
            cell.edit(|sinks| sinks.push(sink));
            cell.clone()
        });
        let events = events.collect();
        server.edit_views(|views| views.push(face.clone()));
        // After the wiring: rows published from now on are shown by the thread that publishes them.
        server.show_row();
        face.show_positions();
        face.show_figures(server);
        face.show_standing(server);
        server.reclaim();
        Ok(ServerWires::Calls {
            events,
            to,
            commands_in,
            face,
            bell: calls.for_server,
            questions,
            failures: (0, 0),
            panicked: AtomicU64::new(0),
        })
    }

    /// Cuts the wires.
    pub(super) fn disconnect(&self, connection: &Connection, here: &Here) {
        let server = &here.instance;
        match self {
            ServerWires::Output { output, .. } => output.remove(|l| l.connection == connection.id.0),
            ServerWires::Calls { events, to, commands_in, face, bell, .. } => {
                for event in events {
                    event.edit(|sinks| {
                        sinks.retain(|s| !matches!(&**s, EventSink::Remote(h) if Arc::ptr_eq(&h.to, to)));
                    });
                }
                server.edit_views(|views| {
                    views.retain(|view| !std::ptr::addr_eq(Arc::as_ptr(view), Arc::as_ptr(face)))
                });
                server.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, commands_in)));
                server.books.lose(commands_in.events, commands_in.counted_losses());
                commands_in.close(PEER_LOST);
                server.books.lose(commands_in.events, commands_in.unexecuted());
                commands_in.tell_failures(&**server);
                here.executor.remove_bell(bell.clone());
            }
        }
        server.settle();
    }

    /// Tells whether these are the wires of the present binding.
    pub(super) fn still_fit(&self, binding: &Binding, set: &PortSet) -> bool {
        let ServerWires::Calls { events, commands_in, .. } = self else { return false };
        let mut commands = binding.functions.iter().map(|(_, id)| &set.commands[*id]);
        let mut emitted = binding.handlers.iter().map(|(_, id)| set.slots.event(*id));
        let targets = &commands_in.targets;
        (targets.len(), events.len()) == (commands.len(), emitted.len())
            && targets.iter().all(|target| commands.next().is_some_and(|now| Arc::ptr_eq(now, target)))
            && events.iter().all(|event| emitted.next().is_some_and(|now| Arc::ptr_eq(now, event)))
    }

    /// Tells whether frames came from more pools than a link carries.
    pub(super) fn has_overflowed(&self) -> bool {
        matches!(self, ServerWires::Output { pools, .. } if pools.has_overflowed())
    }

    /// Tells whether frames may wait until their pools are announced.
    pub(super) fn lends(&self) -> bool {
        matches!(self, ServerWires::Output { shape: Shape { frame: true, .. }, .. })
    }

    /// Takes back frames that the reader has released, when the writer is idle.
    pub(super) fn collect(&self) {
        if let ServerWires::Output { pools, .. } = self {
            pools.collect_if_idle();
        }
    }

    pub(super) fn is_output(&self) -> bool {
        matches!(self, ServerWires::Output { .. })
    }

    /// Samples offered so far; only for an output.
    pub(super) fn offered(&self) -> Option<Offered> {
        let ServerWires::Output { output, stats, first, .. } = self else { return None };
        Some(Self::counted(output.seq.load(Ordering::Relaxed), stats.stats().pushed, first))
    }

    fn counted(written: u64, count: u64, first: &AtomicU64) -> Offered {
        // A counted sample has stored its number before.
        fence(Ordering::Acquire);
        Offered { first: first.load(Ordering::Relaxed), count, written }
    }

    /// Cuts the wires and returns their last figures. For an output also the samples it has offered: those
    /// that wait will not be seen any more.
    pub(super) fn end(&self, connection: &Connection, here: &Here) -> (LinkDetail, Option<Offered>) {
        let ServerWires::Output { output, stats, first, shape, .. } = self else {
            self.disconnect(connection, here);
            return (self.detail(), None);
        };
        let written = output.seq.load(Ordering::Relaxed);
        self.disconnect(connection, here);
        let stats = stats.stats();
        let (passed, skipped) = (stats.taken, stats.skipped);
        // Samples that wait are lost with the link.
        let dropped = stats.pushed.saturating_sub(passed + skipped);
        let bytes = output.bytes_of(passed, *shape);
        let detail = LinkDetail { passed, dropped, skipped, bytes, ..LinkDetail::default() };
        (detail, Some(Self::counted(written, stats.pushed, first)))
    }

    /// Commands that were only sent: how many failed and how many never ran; `None` if unchanged since the
    /// last call.
    pub(super) fn untold_failures(&mut self) -> Option<(u64, u64)> {
        let ServerWires::Calls { commands_in, failures, .. } = self else { return None };
        let now = (commands_in.failed(), commands_in.unexecuted());
        (std::mem::replace(failures, now) != now).then_some(now)
    }

    /// Takes note of the number of reads that have panicked in the process of the client, as that process
    /// reports.
    pub(super) fn panicked(&self, count: u64, text: &[u8], (here, other): (&Here, &str)) {
        let ServerWires::Calls { panicked, .. } = self else { return };
        let more = count.saturating_sub(panicked.fetch_max(count, Ordering::Relaxed)).min(MOST_PANICS);
        if more > 0 {
            let text = format!("{} (in process {other})", trocar_model::plain::sentence(text));
            here.instance.books.failed_times(Misuse::ReadPanicked, more, text.as_bytes());
        }
    }

    pub(super) fn detail(&self) -> LinkDetail {
        match self {
            ServerWires::Output { output, stats, shape, .. } => {
                let s = stats.stats();
                LinkDetail {
                    passed: s.taken,
                    dropped: s.dropped.saturating_sub(s.skipped) + output.exhausted(),
                    skipped: s.skipped,
                    bytes: output.bytes_of(s.taken, *shape),
                    ..LinkDetail::default()
                }
            }
            // The client tells the figures of the queues.
            ServerWires::Calls { commands_in, .. } => LinkDetail {
                failed: commands_in.failed(),
                unexecuted: commands_in.unexecuted(),
                ..LinkDetail::default()
            },
        }
    }
}
