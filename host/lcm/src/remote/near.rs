//! Both halves of a connection inside one process, joined at once in memory that both map, as between two
//! processes.
//!
//! Invariant: the ends share the memory alone. Reads are the exception: they look at the server's state
//! table, which is in this very process. Frames a reader still holds when its connection is cut stay as they
//! are until it lets go.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use parking_lot::{Mutex, MutexGuard};
use trocar_lcm_api::LinkDetail;
use trocar_loader::convert::back;
use trocar_model::{Binding, Connection, PortType, Ports, Refusal};
use trocar_rt::pool::PoolFile;
use trocar_rt::segment::Agreed;
use trocar_rt::stream::{RemotePools, RemoteViews};
use trocar_rt::wake::Waker;

use super::super::described::PortSet;
use super::super::ends::{Here, Joined};
use super::super::loss::Loss;
use super::super::passage::{passing, target};
use super::asks::Asks;
use super::client::ClientWires;
use super::memory::NAME;
use super::missed::Missed;
use super::server::{Offer, Offered, ServerWires};
use super::serving::QuestionQueue;
use super::terms::{Terms, Way, commands};

/// Connections of this kind in one process.
pub(crate) struct Near {
    streams: Mutex<Vec<Weak<Stream>>>,
    /// Frames of streams that were cut.
    left: Arc<Mutex<Vec<Frames>>>,
    /// Rung when an output gives frames of a pool its reader does not know.
    bell: Arc<Waker>,
    epoch: AtomicU64,
}

/// The frames of one stream.
struct Frames {
    pools: Arc<RemotePools>,
    views: Arc<RemoteViews>,
    reader: Arc<Waker>,
    /// Number of the pools the reader knows.
    known: usize,
}

/// A stream with all that is needed to make it anew.
struct Stream {
    connection: Connection,
    client: Here,
    server: Here,
    bell: Arc<Waker>,
    /// Store of its frames after it is cut.
    left: Arc<Mutex<Vec<Frames>>>,
    stage: Mutex<Stage>,
}

#[derive(Default)]
struct Stage {
    /// `None`: cut, or worn out and not made anew yet.
    wires: Option<Pair>,
    cut: bool,
    frames: Option<Frames>,
    /// Figures from before it was made anew.
    before: LinkDetail,
    /// Writes of the output while it was not linked.
    missed: Missed,
}

struct Pair {
    client: ClientWires,
    server: ServerWires,
}

struct Calls {
    connection: Connection,
    client: Here,
    server: Here,
    wires: Pair,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock()
}

impl Near {
    pub(crate) fn new(bell: Arc<Waker>) -> Near {
        Near { streams: Mutex::default(), left: Arc::default(), bell, epoch: AtomicU64::new(1) }
    }

    /// # Errors
    /// The ends do not fit, or the machine lacks memory or bells.
    pub(crate) fn join(
        &self,
        connection: &Connection,
        client: &Here,
        server: &Here,
    ) -> Result<Box<dyn Joined>, Refusal> {
        let of =
            |here: &Here, other: &Here| Here { other: Some(Arc::downgrade(&other.instance)), ..here.clone() };
        let (client, server) = (of(client, server), of(server, client));
        let ends = (connection, &client, &server);
        let (terms, to, from) = terms(ends)?;
        let epoch = self.epoch.fetch_add(1, Ordering::Relaxed);
        let (wires, frames) =
            Pair::make(ends, (terms, epoch), (&to, &from), &self.bell).map_err(|e| cannot(connection, &e))?;
        let connection = connection.clone();
        if frames.is_none() && !wires.server.is_output() {
            return Ok(Box::new(Calls { connection, client, server, wires }));
        }
        let stage = Mutex::new(Stage { wires: Some(wires), frames, ..Stage::default() });
        let (bell, left) = (self.bell.clone(), self.left.clone());
        let stream = Arc::new(Stream { connection, client, server, bell, left, stage });
        locked(&self.streams).push(Arc::downgrade(&stream));
        Ok(Box::new(stream))
    }

    /// Gives readers the pools of the frames that wait for them, and takes back frames they have released;
    /// true while there are frames to look after.
    pub(crate) fn tend(&self) -> bool {
        let all: Vec<Arc<Stream>> = {
            let mut streams = locked(&self.streams);
            streams.retain(|stream| stream.strong_count() > 0);
            streams.iter().filter_map(Weak::upgrade).collect()
        };
        let soon = all.iter().filter(|stream| stream.tend(&self.epoch)).count() > 0;
        let mut left = locked(&self.left);
        left.retain(|frames| !frames.pools.are_back());
        soon || !left.is_empty()
    }
}

fn cannot(connection: &Connection, why: &io::Error) -> Refusal {
    let (client, server) = (connection.client.clone(), connection.server.clone());
    Refusal::Unreachable { client, server, why: format!("no memory for it: {why}") }
}

type Ends<'e> = (&'e Connection, &'e Here, &'e Here);

/// Determines the terms by the present ports, and returns those ports: the client's and the server's.
fn terms((connection, client, server): Ends<'_>) -> Result<(Terms, Arc<PortSet>, Arc<PortSet>), Refusal> {
    let (to, from) = (client.instance.described.now(), server.instance.described.now());
    let mut terms = Terms::of(connection, &to.ports, &typed(connection, &from), false)?;
    match &mut terms.way {
        Way::Stream { input, output, .. } => {
            let (given, taken) = (&from.ports.outputs[*output].ty, &to.ports.inputs[*input].ty);
            passing(connection, given, taken, from.slots.output(*output))?;
        }
        // Nothing has to be published where both ends can look at the table.
        Way::Calls { shape, .. } => shape.reads.clear(),
    }
    Ok((terms, to, from))
}

/// The server's ports, the untyped output with the type it has taken.
fn typed(connection: &Connection, from: &PortSet) -> Ports {
    let mut ports = Ports::clone(&from.ports);
    let mut outputs = ports.outputs.iter_mut().enumerate();
    let mine = outputs.find(|(_, output)| connection.server.port == output.name.as_str());
    if let Some((at, output)) = mine
        && output.ty == PortType::Any
        && let Some(ty) = from.slots.output(at).passing()
    {
        output.ty = ty;
    }
    ports
}

impl Pair {
    fn make(
        (connection, client, server): Ends<'_>,
        (terms, epoch): (Terms, u64),
        (to, from): (&PortSet, &PortSet),
        bell: &Arc<Waker>,
    ) -> io::Result<(Pair, Option<Frames>)> {
        let agreed = Agreed { hash: terms.hash, epoch };
        let way = terms.way;
        let offer = Offer::make(&way, agreed, bell)?;
        let memory = offer.fd()?;
        offer.expect_pools(&way, from);
        let at_server =
            ServerWires::connect(offer, &way, connection, (server, from), None, |_| QuestionQueue::closed())?;
        let views = RemoteViews::new(way.header_bytes());
        let nobody = Asks::of_nobody(connection.id.0, epoch);
        let ports = (&*from.ports, nobody, None);
        let at_client = ClientWires::connect(
            (memory, agreed, None),
            &way,
            connection,
            (client, to),
            ports,
            views.clone(),
        );
        let at_client = match at_client {
            Ok(wires) => wires,
            Err(e) => {
                at_server.disconnect(connection, server);
                return Err(e);
            }
        };
        if let Way::Calls { binding, .. } = &way {
            look_directly(connection, binding, server, (to, from));
        }
        let mut frames = match (&at_server, &at_client) {
            (ServerWires::Output { pools, .. }, ClientWires::Input { bell, .. }) if at_server.lends() => {
                Some(Frames { pools: pools.clone(), views, reader: bell.clone(), known: 0 })
            }
            _ => None,
        };
        if let Some(frames) = &mut frames {
            frames.know();
        }
        Ok((Pair { client: at_client, server: at_server }, frames))
    }

    /// Cuts the wires; returns their last figures, and the samples that the output has offered to the link.
    fn cut(&self, (connection, client, server): Ends<'_>) -> (LinkDetail, Option<Offered>) {
        self.client.disconnect(client, Loss::Cut);
        let (last, offered) = self.server.end(connection, server);
        // A sample that a cycle under way still takes counts among the lost ones already, and counts once.
        let taken = offered.map(|offered| offered.count.saturating_sub(last.dropped + last.skipped));
        let all = self.client.detail().merged(last);
        (LinkDetail { passed: taken.unwrap_or(all.passed), ..all }, offered)
    }
}

/// Binds reads directly to the server.
fn look_directly(
    connection: &Connection,
    binding: &Binding,
    server: &Here,
    (to, from): (&PortSet, &PortSet),
) {
    let all = commands(&from.ports);
    let reads = binding.functions.iter().filter(|(_, id)| all[*id].kind.is_read());
    for (function, id) in reads {
        let deadline_ns = connection.options.deadline_ns.unwrap_or_default();
        let read = target(&server.instance.core, from, *id, &from.external, *id, deadline_ns);
        to.slots.function(*function).bind(read, back::command(all[*id]));
    }
}

impl Frames {
    /// Maps the pools that the reader does not know.
    fn know(&mut self) {
        let before = self.known;
        while let Some(number) = self.pools.at(self.known) {
            // A pool that is gone already has no frames that could come.
            if let Some(file) = PoolFile::numbered(number) {
                // Out of files or of addresses: the next look may find some.
                let Ok(fd) = file.fd().try_clone_to_owned() else { break };
                let Ok(view) = PoolFile::open(fd, file.shape()) else { break };
                self.views.know(self.known, view);
            }
            self.known += 1;
        }
        if self.known > before {
            // A frame may wait for this pool.
            self.reader.notify();
        }
    }
}

impl Stream {
    /// True while there are frames to look after.
    fn tend(&self, epoch: &AtomicU64) -> bool {
        let mut stage = locked(&self.stage);
        if let Some(frames) = &mut stage.frames {
            frames.know();
            frames.pools.collect_if_idle();
        }
        let worn = stage.wires.as_ref().is_none_or(|wires| wires.server.has_overflowed());
        if worn && !stage.cut {
            self.renew(&mut stage, epoch);
        }
        stage.frames.is_some()
    }

    /// Makes the stream anew: its frames came from more pools than a link carries.
    fn renew(&self, stage: &mut Stage, epoch: &AtomicU64) {
        let ends = (&self.connection, &self.client, &self.server);
        self.take(stage);
        let epoch = epoch.fetch_add(1, Ordering::Relaxed);
        let made = terms(ends).and_then(|(terms, to, from)| {
            Pair::make(ends, (terms, epoch), (&to, &from), &self.bell).map_err(|e| cannot(ends.0, &e))
        });
        match made {
            Ok((wires, frames)) => {
                stage.wires = Some(wires);
                stage.frames = frames;
            }
            Err(refusal) => {
                let stem = format!("{} has no samples for the time being", self.connection.client);
                self.client.instance.warn_about(&stem, &format!(": {refusal}"));
            }
        }
    }

    /// Cuts the wires, if there are any; the frames stay as they are until the reader lets go.
    fn take(&self, stage: &mut Stage) {
        let Some(wires) = stage.wires.take() else { return };
        let (last, offered) = wires.cut((&self.connection, &self.client, &self.server));
        stage.before = std::mem::take(&mut stage.before).followed_by(&last);
        if let Some(offered) = offered {
            stage.missed.ended(offered);
        }
        locked(&self.left).extend(stage.frames.take());
    }
}

impl Joined for Arc<Stream> {
    fn cut(&self) {
        let mut stage = locked(&self.stage);
        stage.cut = true;
        self.take(&mut stage);
        self.bell.notify();
    }

    fn still_fits(&self, _: &Binding, _: (&PortSet, &PortSet)) -> bool {
        false
    }

    fn is_stream(&self) -> bool {
        true
    }

    fn detail(&self) -> LinkDetail {
        let stage = locked(&self.stage);
        let now = stage.wires.as_ref().map(Pair::detail).unwrap_or_default();
        let mut all = stage.before.clone().followed_by(&now);
        all.dropped += stage.missed.so_far(stage.wires.as_ref().and_then(|wires| wires.server.offered()));
        LinkDetail { connection: self.connection.id.0, carrier: NAME.into(), ..all }
    }
}

impl Pair {
    fn detail(&self) -> LinkDetail {
        self.client.detail().merged(self.server.detail())
    }
}

impl Joined for Calls {
    fn cut(&self) {
        self.wires.cut((&self.connection, &self.client, &self.server));
    }

    fn still_fits(&self, binding: &Binding, (to, from): (&PortSet, &PortSet)) -> bool {
        self.wires.client.still_fit(binding, to) && self.wires.server.still_fit(binding, from)
    }

    fn is_stream(&self) -> bool {
        false
    }

    fn detail(&self) -> LinkDetail {
        LinkDetail { connection: self.connection.id.0, carrier: NAME.into(), ..self.wires.detail() }
    }
}
