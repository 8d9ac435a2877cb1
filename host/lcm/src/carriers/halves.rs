//! Halves of connections to other processes, over whichever medium.

use std::sync::Arc;

use tokio::sync::oneshot;
use trocar_lcm_api::{HalfReport, LinkDetail};
use trocar_links::Card;
use trocar_model::{ComponentId, Refusal};

use super::super::ends::Tell;
use super::super::instance::Instance;
use super::super::loss::Loss;
use super::super::remote::{Half, Remote};
use super::{Halves, OneEnd};

impl Halves for Remote {
    fn card(&self) -> &Card {
        Remote::card(self)
    }

    fn reaches(&self, card: &Card) -> Result<(), String> {
        Remote::reaches(self, card)
    }

    fn add(&self, end: OneEnd, tell: Option<Tell>) -> Result<(), Refusal> {
        let OneEnd { connection, role, here, required, theirs, card, same_class } = end;
        let half =
            Half::new((connection, role), here, required, (theirs, card, same_class), tell, self.name());
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
