//! Wires of a connection whose halves are linked: cells bound, queues and bells in place.
//!
//! Invariant: as for connections inside the process, every wire can be cut at any moment: callers inside
//! finish on the old binding, later ones see UNBOUND. Queued calls are answered.

mod client;

use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use trocar_lcm_api::LinkDetail;
use trocar_loader::convert::back;
use trocar_loader::system;
use trocar_model::{Binding, Connection, PortType, Ports};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::segment::{Agreed, ServedCalls, Stream};
use trocar_rt::stream::{FarPools, StreamCounters, StreamWriter};
use trocar_rt::wake::Waker;

use super::super::boundary::{
    Consumer, EventCell, EventSink, FarEvents, FarHandler, OutCell, OutLink, RangeCheck, Reader, Shape,
};
use super::super::described::PortSet;
use super::super::ends::Here;
use super::super::inbox::{Check, Inbox};
use super::super::instance::{Instance, Misuse, ShownRows, View};
use super::face::{Face, Shown};
use super::serving::{Desk, Served};
use super::terms::{Reading, Way, commands, size};

pub(super) use client::{ClientWires, Own};

/// The server's memory, before the client has it.
pub(super) enum Offer {
    Output { stream: Stream<StreamWriter>, pools: Arc<FarPools> },
    Calls(Box<ServedCalls>),
}

/// The server's wires.
pub(super) enum ServerWires {
    Output {
        output: Arc<OutCell>,
        stats: StreamCounters,
        /// Number of the first sample that was offered; 0: none was.
        first: Arc<AtomicU64>,
        pools: Arc<FarPools>,
        /// Number of pools the client was told of.
        told: usize,
        shape: Shape,
    },
    Calls {
        events: Vec<Arc<EventCell>>,
        to: Arc<FarEvents>,
        commands_in: Arc<Inbox>,
        face: Arc<Face>,
        bell: Arc<Waker>,
        desk: Desk,
        /// Failed commands and commands that never ran, as the client was told.
        toll: (u64, u64),
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

/// Tells whether the command with this number is GetState.
fn is_status(server: &Ports, id: usize) -> bool {
    id == server.first_command(server.provided.len().saturating_sub(1)) + system::GET_STATE
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "the component's ports are others by now")
}

fn full(why: String) -> io::Error {
    io::Error::other(why)
}

impl Offer {
    /// # Errors
    /// The machine lacks that much memory.
    pub(super) fn make(way: &Way, agreed: Agreed, bell: &Arc<Waker>) -> io::Result<Offer> {
        Ok(match way {
            Way::Stream { shape, .. } => {
                let pools = FarPools::ringing(bell.clone());
                Offer::Output { stream: Stream::<StreamWriter>::create(*shape, agreed, &pools)?, pools }
            }
            Way::Calls { shape, .. } => Offer::Calls(Box::new(ServedCalls::create(shape, agreed)?)),
        })
    }

    pub(super) fn fd(&self) -> io::Result<OwnedFd> {
        let fd = match self {
            Offer::Output { stream, .. } => stream.fd(),
            Offer::Calls(calls) => calls.fd(),
        };
        fd.ok_or_else(|| io::Error::other("memory without a file"))?.try_clone_to_owned()
    }

    /// Gives the pools of the output itself their places.
    pub(super) fn expect_pools(&self, way: &Way, set: &PortSet) {
        let (Offer::Output { pools, .. }, Way::Stream { output, .. }) = (self, way) else { return };
        for file in set.slots.output(*output).pool_files() {
            pools.place_of(file.number());
        }
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
        desk: impl FnOnce(Vec<Served>) -> Desk,
    ) -> io::Result<ServerWires> {
        match (offer, way) {
            (Offer::Output { stream, pools }, Way::Stream { output, ty, observes, .. }) => {
                let cell = set.slots.output(*output).clone();
                let stats = stream.end.counters();
                let newest_ns = connection.options.max_age_ns.map(|_| stream.newest_ns);
                let first = Arc::new(AtomicU64::new(0));
                let consumer = Consumer::Far { bell: stream.for_reader, newest_ns, first: first.clone() };
                let link = Arc::new(OutLink::new(connection.id.0, stream.end, consumer, *observes));
                cell.add(link, ty, &back::port(ty).into());
                here.instance.reclaim();
                Ok(ServerWires::Output { output: cell, stats, first, pools, told: 0, shape: Shape::of(ty) })
            }
            (Offer::Calls(calls), Way::Calls { binding, .. }) => {
                Self::serve(*calls, binding, connection, (here, set), rows, desk)
            }
            _ => Err(gone()),
        }
    }

    fn serve(
        calls: ServedCalls,
        binding: &Binding,
        connection: &Connection,
        (here, set): (&Here, &PortSet),
        rows: Option<Arc<ShownRows>>,
        desk: impl FnOnce(Vec<Served>) -> Desk,
    ) -> io::Result<ServerWires> {
        let all = commands(&set.ports);
        let server = &here.instance;
        here.executor.add_bell(calls.for_server.clone(), server.clone()).map_err(full)?;
        let reader = |id: usize| match set.system_command(id) {
            Some(which) => Reader::System(which),
            None => Reader::Class(set.commands[id].clone()),
        };
        let bound = || binding.functions.iter().map(|(_, id)| *id);
        let reading = |id: usize| Reading::of(&set.ports, &all, id, rows.is_some());
        let published = bound().filter(|id| reading(*id) == Some(Reading::Published));
        let tables = calls.reads.into_iter().zip(calls.whys);
        let shown = published
            .zip(tables)
            .map(|(id, (results, whys))| Shown::new(reader(id), size(all[id].ret.as_ref()), results, whys));
        let own = bound().filter(|id| reading(*id) == Some(Reading::Here));
        let own = own.zip(calls.own_reads).map(|(id, word)| (set.commands[id].clone(), word));
        let face = Face::new(calls.server, shown.collect(), own.collect(), rows.clone());
        let checks = bound().map(|id| Check {
            bytes: size(all[id].arg.as_ref().map(|a| &a.ty)),
            range: all[id].arg.as_ref().and_then(RangeCheck::of),
        });
        let asked = |id: usize| matches!(reading(id), Some(Reading::Asked | Reading::Here));
        let served = bound().enumerate().filter(|(_, id)| asked(*id)).map(|(index, id)| Served {
            index: index as u32,
            from: reader(id),
            arg_bytes: size(all[id].arg.as_ref().map(|a| &a.ty)),
            range: all[id].arg.as_ref().and_then(RangeCheck::of),
            ret_bytes: size(all[id].ret.as_ref()),
        });
        let desk = desk(served.collect());
        let commands_in = Inbox::far_commands(
            calls.commands,
            calls.replies,
            bound().map(|id| set.commands[id].clone()).collect(),
            here.from(&connection.client.component),
            checks.collect(),
            connection.options.deadline_ns.unwrap_or(0),
        );
        server.edit_inboxes(|all| all.push(commands_in.clone()));
        let to = Arc::new(FarEvents { mailbox: calls.events, bell: calls.for_client });
        let events = binding.handlers.iter().enumerate().map(|(index, (_, event))| {
            let cell = set.slots.event(*event);
            let sink = Arc::new(EventSink::Far(FarHandler { to: to.clone(), index: index as u32 }));
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
            desk,
            toll: (0, 0),
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
                        sinks.retain(|s| !matches!(&**s, EventSink::Far(h) if Arc::ptr_eq(&h.to, to)));
                    });
                }
                server.edit_views(|views| {
                    views.retain(|view| !std::ptr::addr_eq(Arc::as_ptr(view), Arc::as_ptr(face)))
                });
                server.edit_inboxes(|all| all.retain(|i| !Arc::ptr_eq(i, commands_in)));
                server.counters.lose(commands_in.events, commands_in.lost());
                commands_in.close(PEER_LOST);
                server.counters.lose(commands_in.events, commands_in.unexecuted());
                commands_in.tell_toll(&**server);
                here.executor.remove_bell(bell.clone());
            }
        }
        settle(server);
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
    pub(super) fn untold_toll(&mut self) -> Option<(u64, u64)> {
        let ServerWires::Calls { commands_in, toll, .. } = self else { return None };
        let now = (commands_in.failed(), commands_in.unexecuted());
        (std::mem::replace(toll, now) != now).then_some(now)
    }

    /// Takes note of the number of reads that have panicked in the process of the client, as that process
    /// reports.
    pub(super) fn panicked(&self, count: u64, text: &[u8], (here, other): (&Here, &str)) {
        let ServerWires::Calls { panicked, .. } = self else { return };
        let more = count.saturating_sub(panicked.fetch_max(count, Ordering::Relaxed)).min(MOST_PANICS);
        if more > 0 {
            let text = format!("{} (in process {other})", trocar_model::plain::sentence(text));
            here.instance.counters.failed_times(Misuse::ReadPanicked, more, text.as_bytes());
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

/// Asks for another look: a cycle under way may still look at the cut wires, which are dropped after it.
fn settle(instance: &Arc<Instance>) {
    if instance.reclaim() > 0 {
        instance.look_at_ports();
    }
}

/// Bytes in front of the frames of a stream; 0 without frames.
pub(super) fn header_bytes(way: &Way) -> usize {
    match way {
        Way::Stream { ty: PortType::Frame { header, .. }, .. } => header.size(),
        _ => 0,
    }
}
