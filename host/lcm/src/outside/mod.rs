//! The view from outside: a state row or an output read once; events, states and outputs followed.
//!
//! Invariant: costs the component one push into a bounded queue for each output and event with readers
//! outside, and one more where frames are wanted as well, however many readers there are; a slow reader loses
//! items, counted.

mod event;
mod follow;
mod output;
mod read;
mod shared;

use std::sync::Arc;

use serde_json::Value;
use tokio::sync::broadcast;
use trocar_lcm_api::News;
use trocar_model::{ComponentId, MemberId, Refusal, Type, ValueError, decode};

use super::instance::Instance;
pub(super) use follow::subscribe;
pub(super) use read::read;
use shared::Shared;

/// All outputs and events with readers outside.
#[derive(Default)]
pub(super) struct Outside {
    outputs: Shared<(u32, String, bool), output::SharedOutput>,
    events: Shared<(u32, MemberId), event::SharedEvent>,
}

/// The components of this process and their news, as they are looked at from outside.
pub(super) trait Shows {
    /// # Errors
    /// There is no such component.
    fn component(&self, id: &ComponentId) -> Result<Arc<Instance>, Refusal>;

    fn outside(&self) -> &Outside;

    fn news(&self) -> broadcast::Receiver<News>;
}

/// Sentence about a value that does not fit: its bytes come from the plugin, and so does the error.
pub(super) fn misfit(instance: &Instance, e: &ValueError) -> String {
    format!("its class {} made a value that does not fit the type: {e}", instance.info.full_name())
}

fn not_shown(instance: &Instance, entry: &'static str, e: &ValueError) -> Refusal {
    Refusal::ComponentRefused { id: instance.id.clone(), entry, text: misfit(instance, e) }
}

fn shown(instance: &Instance, entry: &'static str, ty: &Type, bytes: &[u8]) -> Result<Value, Refusal> {
    decode(ty, bytes).map_err(|e| not_shown(instance, entry, &e))
}

pub(super) fn wrong_kind(member: &MemberId, is: String, wanted: &str) -> Refusal {
    Refusal::WrongKind { member: member.clone(), is, wanted: wanted.to_owned() }
}
