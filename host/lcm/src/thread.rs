//! The part of a thread that its components know.

use std::sync::Arc;

use trocar_rt::executor::Pace;
use trocar_rt::wake::Waker;

use super::context::ExecutorId;

/// The thread of one or several components.
#[derive(Clone)]
pub(super) struct Thread {
    pub(super) id: ExecutorId,
    pub(super) waker: Arc<Waker>,
    /// Way the thread finds its cycles.
    pub(super) pace: Pace,
    /// True when the thread looks at its queues in the cycle only and is not woken in between.
    pub(super) polls: bool,
}
