//! How the data of a connection travel: one trait, and one file for each way.
//!
//! Invariant: a carrier is asked when connections are made, cut, shown and looked after, never for a sample or a call: those find
//! cells that are bound already.

mod heap;
mod inline;
mod memfd;

use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::oneshot;
use trocar_lcm_api::{HalfReport, LinkDetail};
use trocar_links::Card;
use trocar_model::{Binding, ComponentId, Connection, Link, Ports, Refusal};
use trocar_rt::wake::Waker;

use super::dynamic::PortSet;
use super::far::{Here, Kin, Role, Tell};
use super::instance::{Instance, Loss};
use inline::Inline;
use memfd::Memfd;

/// A connection of which both ends are here.
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
    /// Why nothing but a direct call reaches the server's commands; `None` where that is not so.
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

/// What the one calls in the other runs in the caller's thread.
fn are_together(client: &Instance, server: &Instance) -> bool {
    client.executor_id() == server.executor_id() || server.is_passive()
}

/// A connection of which one end is here, and what is known of the other one.
pub(super) struct OneEnd {
    pub(super) connection: Connection,
    pub(super) role: Role,
    pub(super) here: Here,
    /// The client cannot do without it.
    pub(super) required: bool,
    /// Ports of the component at the other end, and its process.
    pub(super) theirs: Arc<Ports>,
    pub(super) card: Card,
    /// Of a client: whether the code of the server's class is here.
    pub(super) kin: Kin,
}

/// A way for data to travel.
pub(super) trait Carrier: Send + Sync {
    /// As it is pinned and shown.
    fn name(&self) -> &'static str;

    /// # Errors
    /// The sentence why it cannot carry between these two ends of this process.
    fn joins(&self, both: &Both<'_>) -> Result<(), String>;

    /// Connects two ends of this process: streams, calls, events and reads.
    ///
    /// # Errors
    /// What does not fit, or what the machine does not give.
    fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal>;

    /// Its connections to other processes; `None` where it does not leave this one.
    fn halves(&self) -> Option<&dyn Halves> {
        None
    }

    /// Looks after what it has joined, off the step path; true: again soon.
    fn tend(&self) -> bool {
        false
    }

    /// Cuts what leaves this process, and ends its threads.
    fn stop(&self) {}
}

/// Two ends of this process as a carrier has joined them.
pub(super) trait Joined: Send + Sync {
    /// Cuts them; whoever waits is answered.
    fn cut(&self);

    /// Whether it would be joined just as it is by this binding of these ports, the client's and the server's.
    fn still_fits(&self, binding: &Binding, ports: (&PortSet, &PortSet)) -> bool;

    fn is_stream(&self) -> bool;

    /// The carrier's name and figures so far.
    fn detail(&self) -> LinkDetail;
}

/// The connections of one carrier that leave this process.
pub(super) trait Halves: Send + Sync {
    /// What other processes need to know to reach this one.
    fn card(&self) -> &Card;

    /// # Errors
    /// The sentence why the process of this card cannot be reached.
    fn reaches(&self, card: &Card) -> Result<(), String>;

    /// From now on this end is linked with the other one whenever it can be; `tell` hears of the first time.
    ///
    /// # Errors
    /// The ends do not go together.
    fn add(&self, end: OneEnd, tell: Option<Tell>) -> Result<(), Refusal>;

    /// The half of a connection goes; `tell` hears when its wires are cut. The component that is here; `None` when it has none.
    fn remove(&self, connection: u64, how: Loss, tell: oneshot::Sender<()>) -> Option<Arc<Instance>>;

    /// Why the half of this connection is not linked, as far as anybody knows.
    fn why_not(&self, connection: u64) -> String;

    /// Lets the connections go whose ports at this component, of those that were lost, are not what they were; which those are.
    fn cut_misfits(&self, component: &ComponentId, lost: &[String]) -> Vec<u64>;

    fn connections(&self) -> Vec<u64>;

    fn details(&self) -> Vec<LinkDetail>;

    /// How each half stands.
    fn reports(&self) -> Vec<HalfReport>;
}

/// All carriers of this process.
pub(super) struct Carriers {
    inline: Inline,
    heap: heap::Heap,
    memfd: Memfd,
}

impl Carriers {
    /// `socket`: where this process listens for others, if it does; `news` hears how each half stands; `bell` is rung when a carrier
    /// has to be tended.
    ///
    /// # Errors
    /// The socket cannot be made there, or the machine gives no more threads.
    pub(super) fn start(
        process: &str,
        socket: Option<PathBuf>,
        news: impl Fn(HalfReport) + Send + 'static,
        bell: Arc<Waker>,
    ) -> std::io::Result<Arc<Carriers>> {
        let memfd = Memfd::start(process, socket, news, bell)?;
        Ok(Arc::new(Carriers { inline: Inline, heap: heap::Heap, memfd }))
    }

    /// The best one first.
    fn all(&self) -> [&dyn Carrier; 3] {
        [&self.inline, &self.heap, &self.memfd]
    }

    /// Connects two ends of this process by the carrier the connection is pinned to, or by the best there is.
    ///
    /// # Errors
    /// No carrier can, or as for [`Carrier::join`].
    pub(super) fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal> {
        let pinned = both.connection.options.carrier.as_str();
        let mut reasons = Vec::new();
        for carrier in self.all().into_iter().filter(|c| pinned.is_empty() || c.name() == pinned) {
            match carrier.joins(both) {
                Ok(()) => return carrier.join(both),
                Err(why) => reasons.push(format!("\"{}\" cannot be had here, as {why}", carrier.name())),
            }
        }
        let what = format!("Connect {}", both.connection.client);
        let why = format!("carrier: {}", reasons.join("; "));
        Err(Refusal::ArgumentInvalid { what, why, field: "options.carrier".to_owned() })
    }

    /// Those that leave this process.
    pub(super) fn halves(&self) -> impl Iterator<Item = &dyn Halves> {
        self.all().into_iter().filter_map(|carrier| carrier.halves())
    }

    /// The one that reaches the process of this card, and that the connection is pinned to if it is pinned.
    ///
    /// # Errors
    /// The sentence why none does.
    pub(super) fn reaching(&self, connection: &Connection, card: &Card) -> Result<&dyn Halves, String> {
        let pinned = connection.options.carrier.as_str();
        let mut reasons = Vec::new();
        for carrier in self.all().into_iter().filter(|c| pinned.is_empty() || c.name() == pinned) {
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

    /// Looks after what was joined; true: again soon. Managers only.
    pub(super) fn tend(&self) -> bool {
        self.all().map(|carrier| carrier.tend()).contains(&true)
    }

    pub(super) fn stop(&self) {
        self.all().into_iter().for_each(|carrier| carrier.stop());
    }
}
