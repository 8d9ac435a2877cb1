//! Carriers of a connection's data: one trait, and one file for each carrier.
//!
//! Invariant: a carrier is asked when connections are made, cut, shown and looked after, never for a sample
//! or a call: those find cells that are bound already.

mod halves;
mod heap;
mod inline;
mod memfd;
mod net;

use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::oneshot;
use trocar_lcm_api::{HalfReport, LinkDetail};
use trocar_links::Card;
use trocar_model::{ComponentId, Connection, Link, Ports, Refusal};
use trocar_rt::wake::Waker;

use super::described::PortSet;
use super::ends::{Here, Joined, Role, SameClass, Tell};
use super::instance::Instance;
use super::loss::Loss;
use super::remote::Afar;
use inline::Inline;
use memfd::Memfd;
use net::Net;

/// Name of the carrier of calls within one thread.
const INLINE: &str = "inline";

/// A connection with both ends in this process.
pub(super) struct Both<'c> {
    pub(super) connection: &'c Connection,
    pub(super) client: &'c Here,
    pub(super) server: &'c Here,
    /// Ports of the client and of the server, as they are now.
    pub(super) to: Arc<PortSet>,
    pub(super) from: Arc<PortSet>,
    pub(super) link: Link,
}

impl Both<'_> {
    /// Reason why only a direct call reaches the server's commands; `None` where that is not so.
    fn is_called_directly(&self) -> Option<String> {
        let (client, server) = (&self.client.instance, &self.server.instance);
        match self.link {
            Link::Stream { .. } => None,
            _ if are_together(client, server) => {
                Some(format!("commands of {} are called directly in the thread of {}", server.id, client.id))
            }
            Link::Interface { .. } => None,
        }
    }
}

/// Tells whether calls from one to the other run in the caller's thread.
fn are_together(client: &Instance, server: &Instance) -> bool {
    client.executor_id() == server.executor_id() || server.is_passive()
}

/// A connection with one end in this process, and the facts known of the other end.
pub(super) struct OneEnd {
    pub(super) connection: Connection,
    pub(super) role: Role,
    pub(super) here: Here,
    /// True when the client cannot do without it.
    pub(super) required: bool,
    /// Ports of the component at the other end, and its process.
    pub(super) theirs: Arc<Ports>,
    pub(super) card: Card,
    /// For a client: whether the code of the server's class is here.
    pub(super) same_class: SameClass,
}

/// One way for data to travel.
pub(super) trait Carrier: Send + Sync {
    /// Name by which connections are pinned to it and shown.
    fn name(&self) -> &'static str;

    /// # Errors
    /// The sentence why it cannot carry between these two ends of this process.
    fn joins(&self, both: &Both<'_>) -> Result<(), String>;

    /// Connects two ends of this process: streams, calls, events and reads.
    ///
    /// # Errors
    /// The ends do not fit, or the machine lacks a resource.
    fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal>;

    /// Its connections to other processes; `None` for a carrier that stays within this one.
    fn halves(&self) -> Option<&dyn Halves> {
        None
    }

    /// Looks after its connections, off the step path; true: call again soon.
    fn tend(&self) -> bool {
        false
    }

    /// Cuts its connections to other processes, and ends its threads.
    fn stop(&self) {}
}

/// Connections of one carrier to other processes.
pub(super) trait Halves: Send + Sync {
    /// Data by which other processes reach this one.
    fn card(&self) -> &Card;

    /// # Errors
    /// The sentence why the process of this card cannot be reached.
    fn reaches(&self, card: &Card) -> Result<(), String>;

    /// Links this end with the other one from now on whenever possible; `tell` is called at the first time.
    ///
    /// # Errors
    /// The ends do not go together.
    fn add(&self, end: OneEnd, tell: Option<Tell>) -> Result<(), Refusal>;

    /// Removes the half of a connection; `tell` is sent when its wires are cut. Returns the component that is
    /// here; `None` when there is none.
    fn remove(&self, connection: u64, how: Loss, tell: oneshot::Sender<()>) -> Option<Arc<Instance>>;

    /// Reason why the half of this connection is not linked, as far as known.
    fn why_not(&self, connection: u64) -> String;

    /// Removes the connections at those `lost` ports of this component that have changed; returns their
    /// numbers.
    fn cut_misfits(&self, component: &ComponentId, lost: &[String]) -> Vec<u64>;

    fn connections(&self) -> Vec<u64>;

    fn details(&self) -> Vec<LinkDetail>;

    /// State of each half.
    fn reports(&self) -> Vec<HalfReport>;
}

/// All carriers of this process.
pub(super) struct Carriers {
    inline: Inline,
    heap: heap::Heap,
    memfd: Memfd,
    /// `None` where this process is not reached from other machines.
    net: Option<Net>,
}

impl Carriers {
    /// Starts the carriers. `socket`: where this process listens for others of its machine, `afar`: for those
    /// of other machines, if it does; `news` gets the state of each half; `bell` is rung when a carrier needs
    /// to be tended.
    ///
    /// # Errors
    /// The socket or the address cannot be had, or the machine gives no more threads.
    pub(super) fn start(
        process: &str,
        (socket, afar): (Option<PathBuf>, Option<Afar>),
        news: impl Fn(HalfReport) + Clone + Send + 'static,
        bell: Arc<Waker>,
    ) -> std::io::Result<Arc<Carriers>> {
        let card = socket.map(|socket| Card::own(process, socket)).transpose()?;
        let net = afar.zip(card.clone()).map(|(afar, card)| Net::start(afar, card, news.clone()));
        let net = net.transpose()?;
        let card = net.as_ref().map(Net::card).or(card);
        let memfd = Memfd::start(card, news, bell)?;
        Ok(Arc::new(Carriers { inline: Inline, heap: heap::Heap, memfd, net }))
    }

    /// The best carrier first.
    fn all(&self) -> impl Iterator<Item = &dyn Carrier> {
        let here: [&dyn Carrier; 3] = [&self.inline, &self.heap, &self.memfd];
        here.into_iter().chain(self.net.as_ref().map(|net| net as &dyn Carrier))
    }

    /// Connects two ends of this process by the carrier the connection is pinned to, or by the best there is.
    ///
    /// # Errors
    /// No carrier can, or as for [`Carrier::join`].
    pub(super) fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal> {
        let pinned = both.connection.options.carrier.as_str();
        let mut reasons = Vec::new();
        for carrier in self.all().filter(|c| pinned.is_empty() || c.name() == pinned) {
            match carrier.joins(both) {
                Ok(()) => return carrier.join(both),
                Err(why) => reasons.push(format!("\"{}\" cannot be had here, as {why}", carrier.name())),
            }
        }
        let what = format!("Connect {}", both.connection.client);
        let why = format!("carrier: {}", reasons.join("; "));
        Err(Refusal::ArgumentInvalid { what, why, field: "options.carrier".to_owned() })
    }

    /// Halves of the carriers that leave this process.
    pub(super) fn halves(&self) -> impl Iterator<Item = &dyn Halves> {
        self.all().filter_map(|carrier| carrier.halves())
    }

    /// Finds the carrier that reaches the process of this card; it must be the pinned one if the connection
    /// is pinned.
    ///
    /// # Errors
    /// The sentence why no carrier does.
    pub(super) fn reaching(&self, connection: &Connection, card: &Card) -> Result<&dyn Halves, String> {
        let pinned = connection.options.carrier.as_str();
        let mut reasons = Vec::new();
        for carrier in self.all().filter(|c| pinned.is_empty() || c.name() == pinned) {
            let Some(halves) = carrier.halves() else { continue };
            match halves.reaches(card) {
                Ok(()) => return Ok(halves),
                Err(why) => reasons.push(why),
            }
        }
        match reasons.is_empty() {
            true => Err("this process was started without a place to listen for others".into()),
            false => Err(reasons.join("; ")),
        }
    }

    /// Looks after the connections of all carriers; true: call again soon. Managers only.
    pub(super) fn tend(&self) -> bool {
        self.all().filter(|carrier| carrier.tend()).count() > 0
    }

    pub(super) fn stop(&self) {
        self.all().for_each(|carrier| carrier.stop());
    }
}
