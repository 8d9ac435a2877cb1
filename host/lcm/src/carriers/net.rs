//! The carrier `net`: encrypted lines between processes, of any machines.
//!
//! Invariant: the ends are wired to memory as by the carrier `memfd`; stand-ins (`lcm/remote/stand_in`) take
//! what is put there over the line.

use std::io;

use trocar_lcm_api::HalfReport;
use trocar_links::Card;
use trocar_model::Refusal;

use super::super::ends::Joined;
use super::super::remote::{Afar, NET, Remote};
use super::{Both, Carrier, Halves};

pub(super) struct Net(Remote);

impl Net {
    /// # Errors
    /// The address cannot be had, or the machine gives no more threads.
    pub(super) fn start(
        afar: Afar,
        card: Card,
        news: impl Fn(HalfReport) + Send + 'static,
    ) -> io::Result<Net> {
        Ok(Net(Remote::afar(afar, card, news)?))
    }

    /// The card with the address at which other machines reach this process.
    pub(super) fn card(&self) -> Card {
        self.0.card().clone()
    }
}

fn no(both: &Both<'_>) -> String {
    format!("both ends are in process {}", both.client.instance.id.process)
}

impl Carrier for Net {
    fn name(&self) -> &'static str {
        NET
    }

    fn joins(&self, both: &Both<'_>) -> Result<(), String> {
        Err(no(both))
    }

    fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal> {
        let (client, server) = (both.connection.client.clone(), both.connection.server.clone());
        Err(Refusal::Unreachable { client, server, why: no(both) })
    }

    fn halves(&self) -> Option<&dyn Halves> {
        Some(&self.0)
    }

    fn stop(&self) {
        self.0.stop();
    }
}
