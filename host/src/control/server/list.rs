//! List: the graph or a part of it, at once, or as soon as it differs from what the caller knows.
//!
//! Invariant: an etag depends on the listed content alone, so a caller that asks again with it misses no
//! change, only states between.

use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher;
use std::sync::Arc;
use std::time::Instant;

use prost_reflect::prost::Message;
use tokio::sync::watch;
use tonic::Status;
use trocar_model::{ComponentId, Refusal, SystemGraph};
use trocar_proto::v1;

use super::part::keep_only;
use super::refuse;
use super::standing::Places;
use crate::control::convert::{self, Figures};

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
    mut graphs: watch::Receiver<Arc<SystemGraph>>,
    request: &v1::ListRequest,
    until: Instant,
    mut closing: watch::Receiver<()>,
    places: &Places,
) -> Result<Listed, Status> {
    let mut held = None;
    loop {
        let whole = graphs.borrow_and_update().clone();
        let part = part(&whole, &request.path).map_err(refuse)?;
        let etag = etag(&whole, &part);
        if etag == request.unless_etag {
            if held.is_none() {
                held = Some(places.take()?);
            }
            tokio::select! {
                changed = graphs.changed() => if changed.is_ok() { continue },
                () = tokio::time::sleep_until(until.into()) => {}
                _ = closing.changed() => {}
            }
        }
        return Ok(Listed { whole, part, etag });
    }
}

fn part(whole: &SystemGraph, path: &str) -> Result<SystemGraph, Refusal> {
    let mut part = whole.clone();
    if !path.is_empty() {
        keep_only(&mut part, path)?;
        let kept: Vec<ComponentId> = part.components.keys().cloned().collect();
        let holds = |id: &ComponentId| kept.contains(id);
        part.connections.retain(|_, c| holds(&c.client.component) || holds(&c.server.component));
    }
    Ok(part)
}

/// Hashes the listed content without its revision: an accepted change without effect makes no other graph.
fn etag(whole: &SystemGraph, part: &SystemGraph) -> String {
    let listed = convert::list(whole, part, 0, &Figures::default());
    let listed = v1::ListResponse { revision: 0, ..listed };
    let mut hasher = DefaultHasher::new();
    hasher.write(&listed.encode_to_vec());
    format!("{:016x}", hasher.finish())
}
