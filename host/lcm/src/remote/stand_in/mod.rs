//! Stand-ins: where the other end of a connection is on another machine, somebody here stands in for it.
//!
//! The end that is here is wired to memory as if the other process had it, too. In truth a stand-in has
//! it: it takes what is put there to the other machine, where the stand-in for this end puts it into the
//! memory there, and back. So the components, and all that is between them and that memory, are the same
//! as between two processes of one machine. Invariant: whatever comes is checked for its length before
//! it is put anywhere; how long a queue is, is decided here.

mod client;
mod codec;
mod reader;
mod server;
#[cfg(test)]
mod tests;
mod writer;

use std::os::fd::OwnedFd;
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_lcm_api::LinkDetail;
use trocar_model::Ports;
use trocar_net::line::{Clock, Lane, Line, Outbox};
use trocar_rt::segment::{Agreed, StreamShape};
use trocar_rt::stream::{Payload, RemoteViews};

use super::super::instance::Instance;
use super::super::passage::lane;
use super::server::Offer;
use super::terms::{Way, commands};
pub(super) use codec::{Kind, Link, Take};

/// Most stand-ins of one line whose connections were cut while calls were under way.
const MOST_LEAVING: usize = 64;

/// Samples longer than this many bytes go over the bulk lane, as all frames do.
const LONG: usize = 16 << 10;

/// Somebody who stands in for the other end of one connection.
pub(super) trait StandIn: Send + Sync {
    /// Takes in a message of the stand-in at the other end.
    ///
    /// # Errors
    /// It is none it may send.
    fn came(&self, kind: Kind, content: Take<'_>, clock: &Clock) -> Result<(), String>;

    /// Appends what is to be sent now; true: there is more.
    fn fill(&self, link: Link, out: &mut Outbox) -> bool;

    /// Rows and state of the server, for the other end to begin with.
    fn state(&self) -> Vec<u8> {
        Vec::new()
    }

    /// Corrects the figures of the end that is here by what happens between the two memories.
    fn correct(&self, detail: &mut LinkDetail);

    /// Commands that the loss of the line leaves undone, as far as is known here.
    fn lost(&self) -> u64 {
        0
    }

    /// Takes no more of what the end that is here has put, and still puts: its figures are final.
    fn halt(&self) {}

    /// The connection was cut.
    fn leave(&self) {}

    /// Tells, of a connection that was cut, whether nothing is under way any more.
    fn is_over(&self) -> bool {
        true
    }
}

/// All stand-ins of one line.
pub(super) struct StandIns {
    line: Arc<Line>,
    /// Stand-ins of each lane.
    prompt: Mutex<Vec<Entry>>,
    bulk: Mutex<Vec<Entry>>,
}

/// The lane of what passes in this way.
fn lane_of(way: &Way) -> Lane {
    match way {
        Way::Stream { shape: StreamShape { payload: Payload::Frame, .. }, .. } => Lane::Bulk,
        Way::Stream { shape: StreamShape { payload: Payload::Plain { bytes }, .. }, .. } if *bytes > LONG => {
            Lane::Bulk
        }
        Way::Stream { .. } | Way::Calls { .. } => Lane::Prompt,
    }
}

struct Entry {
    link: Link,
    stand_in: Arc<dyn StandIn>,
    /// The connection is cut; calls under way are carried to their end.
    leaving: bool,
}

/// A stand-in that has memory, and what the end that is here is wired to.
pub(super) struct Placed {
    pub(super) stand_in: Arc<dyn StandIn>,
    /// The memory, for the client that is here.
    pub(super) memory: OwnedFd,
    /// Its view of pools.
    pub(super) views: Arc<RemoteViews>,
}

impl StandIns {
    pub(super) fn new(line: Arc<Line>) -> StandIns {
        StandIns { line, prompt: Mutex::default(), bulk: Mutex::default() }
    }

    /// Stands in for the client of a server that is here, in the memory of its offer.
    ///
    /// # Errors
    /// The sentence why that cannot be.
    pub(super) fn for_client(
        &self,
        offer: &mut Offer,
        way: &Way,
        (instance, server): (&Arc<Instance>, &Ports),
        agreed: Agreed,
    ) -> Result<Arc<dyn StandIn>, String> {
        let bell = self.line.bell(lane_of(way));
        let memory = offer.fd().map_err(|e| e.to_string())?;
        offer.ring(bell);
        let stand_in: Arc<dyn StandIn> = match (offer, way) {
            (Offer::Output { pools, .. }, Way::Stream { ty, shape, .. }) => {
                writer::carries(ty)?;
                let views = RemoteViews::new(way.header_bytes());
                Arc::new(reader::AbsentReader::open(memory, *shape, agreed, (pools.clone(), views))?)
            }
            (_, Way::Calls { binding, shape }) => {
                let all = commands(server);
                let bound = binding.functions.iter().enumerate();
                let lanes = bound.map(|(index, (_, id))| lane(all[*id], index)).collect();
                Arc::new(client::AbsentClient::open(
                    memory,
                    shape,
                    agreed,
                    (lanes, bell.clone()),
                    Arc::downgrade(instance),
                )?)
            }
            _ => return Err("the component's ports are others by now".into()),
        };
        Ok(stand_in)
    }

    /// Stands in for the server of a client that is here, in memory of its own; `state` is what the other
    /// stand-in says the client is to know.
    ///
    /// # Errors
    /// The sentence why that cannot be.
    pub(super) fn for_server(&self, way: &Way, agreed: Agreed, state: &[u8]) -> Result<Placed, String> {
        let bell = self.line.bell(Lane::Prompt).clone();
        let views = RemoteViews::new(way.header_bytes());
        let (stand_in, memory): (Arc<dyn StandIn>, _) = match way {
            Way::Stream { ty, shape, depth, .. } => {
                let (writer, memory) =
                    writer::AbsentWriter::create(ty, (*shape, *depth), agreed, views.clone())
                        .map_err(|e| e.to_string())?;
                (Arc::new(writer), memory)
            }
            Way::Calls { shape, .. } => {
                let (server, memory) =
                    server::AbsentServer::create(shape, agreed, bell).map_err(|e| e.to_string())?;
                (Arc::new(server), memory)
            }
        };
        let mut state = Take::new(state);
        while let Some((kind, content)) = state.message()? {
            stand_in.came(kind, content, self.line.clock())?;
        }
        Ok(Placed { stand_in, memory, views })
    }

    /// A time of the other end's clock, by this one.
    pub(super) fn here(&self, theirs_ns: u64) -> u64 {
        self.line.clock().here(theirs_ns)
    }

    /// The bell of whoever sends what a client says.
    pub(super) fn bell(&self) -> &Arc<trocar_rt::wake::Waker> {
        self.line.bell(Lane::Prompt)
    }

    pub(super) fn add(&self, link: Link, way: &Way, stand_in: Arc<dyn StandIn>) {
        let lane = lane_of(way);
        self.of(lane).lock().push(Entry { link, stand_in, leaving: false });
        self.line.bell(lane).notify();
    }

    fn of(&self, lane: Lane) -> &Mutex<Vec<Entry>> {
        match lane {
            Lane::Prompt => &self.prompt,
            Lane::Bulk => &self.bulk,
        }
    }

    /// Tells the other end that this one is ready: from now on it may send.
    pub(super) fn ready(&self, link: Link) -> Result<(), String> {
        let content = codec::content(link, |_| ());
        self.line.say(Kind::Ready as u8, content).map_err(|e| e.to_string())
    }

    /// Tells the other end that nobody comes to this link.
    pub(super) fn forgo(&self, link: Link) -> Result<(), String> {
        let content = codec::content(link, |_| ());
        self.line.say(Kind::Left as u8, content).map_err(|e| e.to_string())
    }

    /// The connection was cut.
    pub(super) fn leave(&self, link: Link) {
        for lane in [Lane::Prompt, Lane::Bulk] {
            let mut all = self.of(lane).lock();
            for entry in all.iter_mut().filter(|entry| entry.link == link) {
                entry.leaving = true;
                entry.stand_in.leave();
            }
            // A peer that leaves calls unanswered, or never says that it has left, keeps so many.
            if all.iter().filter(|entry| entry.leaving).count() > MOST_LEAVING
                && let Some(oldest) = all.iter().position(|entry| entry.leaving)
            {
                all.remove(oldest);
            }
            drop(all);
            self.line.bell(lane).notify();
        }
    }

    /// Takes in a message; one for a link that is gone says nothing any more.
    pub(super) fn came(&self, lane: Lane, kind: Kind, content: &[u8]) -> Result<(), String> {
        let mut content = Take::new(content);
        let link = Link { connection: content.u64()?, epoch: content.u64()? };
        let found = match (lane, kind.is_sample()) {
            // One thread fills a queue: that of its lane.
            (_, true) => self.find(lane, link),
            (Lane::Prompt, false) => self.find(lane, link).or_else(|| self.find(Lane::Bulk, link)),
            (Lane::Bulk, false) => return Err(format!("{kind:?} on the bulk lane")),
        };
        let Some((of, stand_in)) = found else { return Ok(()) };
        stand_in.came(kind, content, self.line.clock())?;
        if kind == Kind::Ready {
            // There may be something to send already.
            self.line.bell(of).notify();
        }
        Ok(())
    }

    fn find(&self, lane: Lane, link: Link) -> Option<(Lane, Arc<dyn StandIn>)> {
        let all = self.of(lane).lock();
        all.iter().find(|entry| entry.link == link).map(|entry| (lane, entry.stand_in.clone()))
    }

    /// Tells a client's end of the line and the clocks at both ends.
    pub(super) fn tell_of_line(&self, detail: &mut LinkDetail) {
        let clock = self.line.clock();
        detail.round_trip_ns = clock.round_trip_ns();
        (detail.clock_offset_ns, detail.clock_bound_ns) = (clock.offset_ns(), clock.bound_ns());
    }

    /// Appends what is to be sent now on this lane, for the thread that sends there; true: there is more.
    pub(super) fn fill(&self, lane: Lane, out: &mut Outbox) -> bool {
        let all = self.of(lane);
        let (mut at, mut more) = (0, false);
        // A long sample is copied while others find their stand-ins.
        loop {
            let next = all.lock().get(at).map(|entry| (entry.link, entry.stand_in.clone()));
            let Some((link, stand_in)) = next else { break };
            at += 1;
            more |= stand_in.fill(link, out);
        }
        // Dropped outside the lock: they give back memory, which takes its time.
        let over: Vec<_> =
            all.lock().extract_if(.., |entry| entry.leaving && entry.stand_in.is_over()).collect();
        drop(over);
        more
    }
}
