//! The carrier `memfd`: memory that both ends map, of one process or of two of one machine.
//!
//! Invariant: between two processes and, where it is pinned, inside one the memory is the same, laid out and
//! used by the same code (`lcm/remote`); inside one process both ends are joined at once, without a session.

use std::sync::Arc;

use trocar_lcm_api::HalfReport;
use trocar_links::Card;
use trocar_model::Refusal;
use trocar_rt::wake::Waker;

use super::super::ends::Joined;
use super::super::remote::{NAME, Near, Remote};
use super::{Both, Carrier, Halves};

pub(super) struct Memfd {
    /// `None` where this process does not listen for others.
    remote: Option<Remote>,
    near: Near,
}

impl Memfd {
    /// # Errors
    /// The socket cannot be made there, or the machine gives no more threads.
    pub(super) fn start(
        card: Option<Card>,
        news: impl Fn(HalfReport) + Send + 'static,
        bell: Arc<Waker>,
    ) -> std::io::Result<Memfd> {
        let remote = card.map(|card| Remote::in_memory(card, news)).transpose()?;
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
