//! Queues into one component, and what their entries mean.
//!
//! Invariant: every entry that carries a reply is answered, executed or not.

use std::sync::Arc;

use trocar_plugin_api::abi::Outcome;
use trocar_rt::mailbox::{EntryHead, Mailbox};
use trocar_rt::reply::ReplyPool;

/// Kinds of mailbox entries.
pub(super) const ENTRY_COMMAND: u32 = 0;
pub(super) const ENTRY_EVENT: u32 = 1;

/// A queue into one component: commands of one client, or events of one connection.
pub(super) struct Inbox {
    pub(super) mailbox: Mailbox,
    pub(super) replies: Arc<ReplyPool>,
    /// What an entry's index means: command id or handler id of the class.
    pub(super) targets: Vec<u32>,
}

impl Inbox {
    /// Takes nothing more; answers everything still queued with `outcome`, unexecuted.
    pub(super) fn close(&self, outcome: Outcome) {
        self.mailbox.close(|head| {
            self.replies.fail(head.reply, outcome);
        });
    }

    /// Answers everything still queued with `outcome`, unexecuted.
    pub(super) fn refuse_all(&self, outcome: Outcome) {
        let refuse = |head: EntryHead| {
            self.replies.fail(head.reply, outcome);
        };
        self.mailbox.drain(|head, _| refuse(head), refuse);
    }
}
