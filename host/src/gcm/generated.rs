//! Ports that a configuration makes: a request set that connects them beside the Create is carried out in
//! parts.
//!
//! Invariant: a refusal in a later part takes all before it back; without such ports there is one part.

use std::time::Instant;

use trocar_model::{Plan, Refusal, Request, SystemGraph, plan_all};

use super::Gcm;
use super::answer::Executed;
use super::carrying::Carrying;

/// Returns the plan of the requests, or of the first ones that must be done before the others can be planned,
/// and their number.
///
/// # Errors
/// Every refusal of the plan.
pub(super) fn first_part(graph: &SystemGraph, requests: &[Request]) -> Result<(Plan, usize), Refusal> {
    let refusal = match plan_all(graph, requests) {
        Ok(plan) => return Ok((plan, requests.len())),
        Err(refusal) => refusal,
    };
    match before(requests, &refusal) {
        Some(first) => Ok((plan_all(graph, &requests[..first])?, first)),
        None => Err(refusal),
    }
}

/// Returns the number of requests before the first that connects a port which is not known yet, of a
/// component that is created here with a configuration, or given another one.
fn before(requests: &[Request], refusal: &Refusal) -> Option<usize> {
    let Refusal::InterfaceNotFound { port, .. } = refusal else { return None };
    let makes = |request: &Request| match request {
        Request::Create { id, config: Some(config), .. } => {
            *id == port.component && config.as_object().is_some_and(|settings| !settings.is_empty())
        }
        Request::Configure { id, patch, .. } => {
            *id == port.component && patch.as_object().is_some_and(|settings| !settings.is_empty())
        }
        _ => false,
    };
    let connects = |request: &Request| match request {
        Request::Connect { client, server, .. } => client == port || server == port,
        _ => false,
    };
    let (made, connected) = (requests.iter().position(makes)?, requests.iter().position(connects)?);
    (made < connected).then_some(connected)
}

impl Gcm {
    /// Plans and does what had to wait for ports; `done` has what was done before.
    ///
    /// # Errors
    /// Every refusal of the plan or a component, and PartTaken; then all parts are undone.
    pub(super) async fn other_parts(
        &self,
        requests: &[Request],
        carrying: &Carrying<'_>,
        done: &mut Executed,
        deadline: Instant,
    ) -> Result<(), Refusal> {
        let mut waiting = requests;
        while !waiting.is_empty() {
            let made = async {
                let (plan, first) = first_part(&self.graph(), waiting)?;
                carrying.widen(&plan, first == waiting.len())?;
                let mut more = Executed { plan, ..Executed::default() };
                carrying.all_or_nothing(&mut more, deadline).await?;
                Ok((more, first))
            };
            let (more, first) = match made.await {
                Ok(made) => made,
                Err(refusal) => {
                    carrying.undo(&done.plan.changes).await;
                    return Err(refusal);
                }
            };
            done.plan.changes.extend(more.plan.changes);
            done.plan.skipped.extend(more.plan.skipped);
            done.reports.extend(more.reports);
            waiting = &waiting[first..];
        }
        Ok(())
    }
}
