//! List: the graph or a part of it, at once, or as soon as it differs from what the caller knows.
//!
//! Invariant: an etag depends on the states in which the listed content last changed, so a caller that asks
//! again with it misses no change, only states between. Who waits costs a change nothing that is not listed.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::watch;
use tonic::Status;
use trocar_model::{ComponentId, Refusal, SystemGraph};
use trocar_proto::v1;

use super::part::Part;
use super::refuse;
use super::standing::Places;
use crate::gcm::Gcm;

/// Content of an answer.
pub(super) struct Listed {
    pub(super) whole: Arc<SystemGraph>,
    /// The part of it that was asked for.
    pub(super) part: SystemGraph,
    pub(super) etag: String,
}

/// Returns what `request` names. With an etag it first waits until the etag differs, until `until`, or until
/// the port closes.
///
/// # Errors
/// Nothing has that name, or the maximum number of calls waits already.
pub(super) async fn listed(
    gcm: &Gcm,
    request: &v1::ListRequest,
    until: Instant,
    mut closing: watch::Receiver<()>,
    places: &Places,
) -> Result<Listed, Status> {
    let (history, mut graphs) = (gcm.history().clone(), gcm.watch());
    let which = Part::read(&request.path).map_err(refuse)?;
    let (mut held, mut has_waited) = (None, false);
    loop {
        let whole = graphs.borrow_and_update().clone();
        let part = part(&whole, &which).map_err(refuse)?;
        let etag = history.tag(&part);
        if has_waited || etag != request.unless_etag {
            return Ok(Listed { whole, part, etag });
        }
        if held.is_none() {
            held = Some(places.take()?);
        }
        let otherwise = async {
            while graphs.changed().await.is_ok() {
                let now = graphs.borrow_and_update().clone();
                let touched = history.since(whole.seen, &now);
                if touched.is_none_or(|touched| which.concerns(&touched, &now)) {
                    return;
                }
            }
        };
        tokio::select! {
            () = otherwise => {}
            () = tokio::time::sleep_until(until.into()) => has_waited = true,
            _ = closing.changed() => has_waited = true,
        }
    }
}

fn part(whole: &SystemGraph, which: &Part) -> Result<SystemGraph, Refusal> {
    let mut part = whole.clone();
    if *which != Part::Everything {
        which.keep(&mut part)?;
        let SystemGraph { components, connections, .. } = &mut part;
        let holds = |id: &ComponentId| components.contains_key(id);
        connections.retain(|_, c| holds(&c.client.component) || holds(&c.server.component));
    }
    Ok(part)
}
