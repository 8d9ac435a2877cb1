//! The carrier `inline`: calls of one end run on in the other one, in the same thread.
//!
//! Invariant: it has the parts of a connection on the heap, which stay empty as long as everything can run at
//! once: another thread may use the client's functions, and an instance that is entered already is not
//! entered again.

use trocar_model::Refusal;

use super::super::ends::Joined;
use super::heap::OnHeap;
use super::{Both, Carrier, INLINE, are_together};

pub(super) struct Inline;

impl Carrier for Inline {
    fn name(&self) -> &'static str {
        INLINE
    }

    fn joins(&self, both: &Both<'_>) -> Result<(), String> {
        let (client, server) = (&both.client.instance, &both.server.instance);
        match are_together(client, server) {
            true => Ok(()),
            false => Err(format!("{} and {} have threads of their own", server.id, client.id)),
        }
    }

    fn join(&self, both: &Both<'_>) -> Result<Box<dyn Joined>, Refusal> {
        Ok(Box::new(OnHeap::join(both)?))
    }
}
