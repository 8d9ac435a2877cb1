//! Facts about single changes: whose LCM carries one out, and the times that changes get beside the deadline
//! of their request.
//!
//! Invariant: pure; whatever asks an LCM for changes takes its times from here.

use std::time::Duration;

use trocar_model::{Change, ComponentId, Refusal};

/// Time a rollback gets for each change, beyond the request's own deadline.
pub(super) const UNDO: Duration = Duration::from_secs(2);
/// Time a component gets to stop before it is removed, or after it was found to hang.
pub(super) const HUNG: Duration = Duration::from_secs(1);

/// Returns the component whose LCM carries the change out.
pub(crate) fn id_of(change: &Change) -> &ComponentId {
    match change {
        Change::Create { id, .. }
        | Change::Destroy { id, .. }
        | Change::Configure { id, .. }
        | Change::Run { id, .. } => id,
        Change::Connect { connection } | Change::Disconnect { connection, .. } => {
            &connection.client.component
        }
    }
}

/// Tells whether a change was refused because it is so already.
pub(crate) fn is_so(change: &Change, refusal: &Refusal) -> bool {
    match refusal {
        Refusal::ComponentNotFound { .. } => matches!(change, Change::Destroy { .. }),
        Refusal::ConnectionNotFound { .. } => matches!(change, Change::Disconnect { .. }),
        _ => false,
    }
}
