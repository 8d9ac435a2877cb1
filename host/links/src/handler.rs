//! The trait by which a user of the sessions hears of them.

use std::sync::Arc;

use crate::session::{Lost, Message, Session};

/// Told on the thread of the sessions: a handler that waits makes other processes believe that this one is
/// dead.
pub trait Handler: Send + 'static {
    /// The two processes made sure of each other.
    fn met(&mut self, session: &Arc<Session>);
    /// The process sent a message.
    fn said(&mut self, session: &Arc<Session>, message: Message);
    /// The process is gone. Nothing comes of this session any more.
    fn lost(&mut self, session: &Arc<Session>, why: &Lost);
}
