//! The carrier `memfd`: memory that both ends map, the only one so far that leaves a process.
//!
//! Invariant: between two processes and, where it is pinned, inside one the memory is the same, laid out and
//! used by the same code (`lcm/remote`); inside one process both ends are joined at once, without a session.

use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::oneshot;
use trocar_lcm_api::{HalfReport, LinkDetail};
use trocar_links::Card;
use trocar_model::{ComponentId, Refusal};
use trocar_rt::wake::Waker;

use super::super::ends::{Joined, Tell};
use super::super::instance::Instance;
use super::super::loss::Loss;
use super::super::remote::{Half, NAME, Near, Remote};
use super::{Both, Carrier, Halves, OneEnd};

pub(super) struct Memfd {
    /// `None` where this process does not listen for others.
    remote: Option<Remote>,
    near: Near,
}

impl Memfd {
    /// # Errors
    /// The socket cannot be made there, or the machine gives no more threads.
    pub(super) fn start(
        process: &str,
        socket: Option<PathBuf>,
        news: impl Fn(HalfReport) + Send + 'static,
        bell: Arc<Waker>,
    ) -> std::io::Result<Memfd> {
        let remote = socket.map(|socket| Remote::start(process, socket, news)).transpose()?;
        Ok(Memfd { remote, near: Near::new(bell) })
    }
}

impl Carrier for Memfd {
    fn name(&self) -> &'static str {
        NAME
    }

    fn joins(&self, both: &Both<'_>) -> Result<(), String> {
        both.is_called_directly().map_or(Ok(()), Err)
    }

    fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal> {
        self.near.join(both.connection, both.client, both.server)
    }

    fn halves(&self) -> Option<&dyn Halves> {
        self.remote.as_ref().map(|remote| remote as &dyn Halves)
    }

    fn tend(&self) -> bool {
        self.near.tend()
    }

    fn stop(&self) {
        if let Some(remote) = &self.remote {
            remote.stop();
        }
    }
}

impl Halves for Remote {
    fn card(&self) -> &Card {
        Remote::card(self)
    }

    fn reaches(&self, card: &Card) -> Result<(), String> {
        self.card().reaches(card).map_err(|e| e.to_string())
    }

    fn add(&self, end: OneEnd, tell: Option<Tell>) -> Result<(), Refusal> {
        let OneEnd { connection, role, here, required, theirs, card, same_class } = end;
        let half = Half::new((connection, role), here, required, (theirs, card, same_class), tell);
        half.terms(false)?;
        Remote::add(self, half);
        Ok(())
    }

    fn remove(&self, connection: u64, how: Loss, tell: oneshot::Sender<()>) -> Option<Arc<Instance>> {
        Remote::remove(self, connection, how, tell).map(|half| half.here.instance.clone())
    }

    fn why_not(&self, connection: u64) -> String {
        Remote::why_not(self, connection)
    }

    fn cut_misfits(&self, component: &ComponentId, lost: &[String]) -> Vec<u64> {
        Remote::cut_misfits(self, component, lost)
    }

    fn connections(&self) -> Vec<u64> {
        Remote::connections(self)
    }

    fn details(&self) -> Vec<LinkDetail> {
        Remote::details(self)
    }

    fn reports(&self) -> Vec<HalfReport> {
        Remote::reports(self)
    }
}
