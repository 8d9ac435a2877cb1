//! Identity of a caller, for the audit line.

use tonic::Request;
use trocar_model::ComponentId;

use super::Caller;
use crate::control::caller::Peer;
use crate::control::services::FOR_COMPONENT;

/// Returns the caller: a component of this process, a user at an address, or a host for one of its
/// components.
pub(super) fn identity<T>(request: &Request<T>) -> String {
    if let Some(Caller(path)) = request.extensions().get() {
        return path.clone();
    }
    let from = request.extensions().get::<Peer>().map_or_else(|| "local".into(), Peer::to_string);
    let named = request.metadata().get(FOR_COMPONENT).and_then(|v| ComponentId::parse(v.to_str().ok()?).ok());
    match named {
        Some(component) => format!("{component} through {from}"),
        None => from,
    }
}
