//! Queued entries of a component and their execution: commands, events, answers.
//!
//! Invariant: every entry that carries a reply is answered once; component code runs only for the holder of
//! the entry lock.

use std::sync::Arc;

use trocar_plugin_api::abi::{DEADLINE, DISABLED, EXECUTED, INVALID_ARGUMENT, Outcome, PEER_LOST};
use trocar_rt::mailbox::EntryHead;
use trocar_rt::os;

use super::super::boundary::{as_bytes, replaced, text_in};
use super::super::inbox::{ENTRY_DUE, ENTRY_EVENT, Inbox};
use super::super::{context, pending};
use super::{Core, Entered};

/// Tells the tap of a queued command that is not carried out.
#[cold]
fn tell_queued(entered: &mut Entered<'_>, command: Option<u32>, arg: &[u8], outcome: Outcome) {
    let tap = entered.inner().command_tap.as_ref().filter(|tap| tap.is_listened());
    if let Some((tap, command)) = tap.zip(command) {
        tap.to.tell_queued(command, arg, outcome);
    }
}

/// Number of times a caller runs the entries that others queued into a passive component meanwhile; then the
/// component's own thread goes on.
const ROUNDS: usize = 2;

impl Core {
    /// Changes the list of queues; managers only.
    pub(crate) fn edit_inboxes(&self, f: impl FnOnce(&mut Vec<Arc<Inbox>>)) {
        self.peers.edit_inboxes(f);
    }

    /// All queues into the component.
    pub(crate) fn queues(&self) -> Vec<Arc<Inbox>> {
        self.peers.inboxes.enter().clone()
    }

    /// Commands and events lost in full queues, including those of connections that are gone.
    pub(crate) fn queue_losses(&self) -> [u64; 2] {
        let mut lost = self.books.lost_before();
        for inbox in self.peers.inboxes.enter().iter() {
            lost[usize::from(inbox.events)] += inbox.counted_losses();
        }
        lost
    }

    /// Answers everything queued, unexecuted; called after the reason was noted.
    pub(crate) fn refuse_queued(&self, outcome: Outcome) {
        // A call is queued, marked, and then checks once more whether it is allowed: either it is found here
        // or it sees why not.
        self.signalled.meet();
        let inboxes = self.peers.inboxes.enter();
        inboxes.iter().for_each(|inbox| inbox.refuse_all(outcome));
        // Entries behind one that was just in hand here may have been left by the component's own thread: see
        // `throw_out`.
        self.signalled.meet();
        if inboxes.iter().any(|inbox| inbox.mailbox.has_ready()) {
            self.signalled.set();
            self.wake();
        }
    }

    /// Runs the queued entries: those already there, plus once those that arrived meanwhile. Real-time.
    pub(crate) fn drain(&self, entered: &mut Entered<'_>) {
        self.peers.inboxes.look(|inboxes| self.drain_all(entered, inboxes));
    }

    fn drain_all(&self, entered: &mut Entered<'_>, inboxes: &[Arc<Inbox>]) {
        for inbox in inboxes {
            if inbox.mailbox.is_empty() {
                continue;
            }
            let run = |head: EntryHead, payload: &[u8]| {
                let Some(target) = inbox.targets.get(head.index as usize) else { return };
                let turn_away = |entered: &mut Entered<'_>, outcome| {
                    if head.kind != ENTRY_EVENT {
                        tell_queued(entered, target.get(), payload, outcome);
                    }
                    inbox.refuse(head, outcome);
                };
                if !inbox.admits(head, payload) {
                    return turn_away(entered, INVALID_ARGUMENT);
                }
                match (head.kind, target.get()) {
                    (ENTRY_EVENT, Some(_)) if !self.is_active() => inbox.refuse(head, self.turned_away()),
                    (ENTRY_EVENT, Some(handler)) => {
                        self.deliver(entered, handler, payload);
                        // Published here, as no step follows.
                        if !self.owes_row() {
                            self.publish_state(entered);
                        }
                    }
                    (_, Some(_)) if head.reply == 0 && !self.is_active() => {
                        turn_away(entered, self.turned_away())
                    }
                    (_, Some(command)) if self.is_late(entered, inbox, head, command, payload) => {
                        turn_away(entered, DEADLINE)
                    }
                    (_, Some(command)) => self.answer(entered, inbox, command, head.reply, payload),
                    // The command is no longer in the description.
                    (_, None) => inbox.refuse(head, DISABLED),
                }
            };
            // Superseded by a newer one of the same command.
            let skip = |head: EntryHead| replaced(&inbox.replies, head.reply);
            inbox.mailbox.drain(run, skip);
            inbox.note_taken();
        }
    }

    /// Tells whether a command has waited longer than it says, or longer than its goal is valid. Running it
    /// would move a device by a wish from before a standstill. Real-time.
    fn is_late(
        &self,
        entered: &mut Entered<'_>,
        inbox: &Inbox,
        head: EntryHead,
        command: u32,
        arg: &[u8],
    ) -> bool {
        if head.kind == ENTRY_DUE {
            return os::now_ns() > head.stamp_ns;
        }
        // A goal without a stamp does not age.
        if head.stamp_ns == 0 {
            return false;
        }
        let goal = entered.inner().goals.get(command as usize).copied().unwrap_or_default();
        goal.with(arg)
            .may_wait_ns(inbox.deadline_ns, self.is_actuator(), self.period_ns())
            .is_some_and(|longest_ns| os::now_ns().saturating_sub(head.stamp_ns) > longest_ns)
    }

    fn answer(&self, entered: &mut Entered<'_>, inbox: &Inbox, command: u32, reply: u64, payload: &[u8]) {
        let running = if reply == 0 {
            None
        } else {
            match inbox.replies.begin(reply, PEER_LOST) {
                Some(running) => Some(running),
                // The caller gave up before it began: not executed, as it was told.
                None => return tell_queued(entered, Some(command), payload, DEADLINE),
            }
        };
        let mut err = entered.err_buf();
        let ret = entered.inner().ret.as_mut_ptr();
        let outcome = if self.is_active() {
            self.command_inside(entered, command, payload.as_ptr(), ret.cast(), &raw mut err)
        } else {
            let outcome = self.turned_away();
            tell_queued(entered, Some(command), payload, outcome);
            outcome
        };
        if running.is_some() {
            // The caller may read as soon as it has the answer, also from other components that ran inside
            // this command.
            pending::publish();
            self.publish_state(entered);
        }
        if running.is_none() && outcome != EXECUTED {
            inbox.note_failure(text_in(&err));
        }
        if let Some(running) = running {
            let text = text_in(&err);
            let value = as_bytes(&entered.inner().ret);
            running.finish(outcome, |ret, room| {
                let n = ret.len().min(value.len());
                ret[..n].copy_from_slice(&value[..n]);
                let n = room.len().min(text.len());
                room[..n].copy_from_slice(&text[..n]);
                n
            });
        }
    }

    /// Runs the entries queued while a thread was inside a passive component.
    #[inline]
    pub(crate) fn drain_if_passive(&self) {
        if self.is_passive() {
            self.drain_passive();
        }
    }

    #[inline(never)]
    fn drain_passive(&self) {
        if context::is_deferred() {
            self.wake();
            return;
        }
        let work = |mut entered: Entered<'_>| {
            self.drain(&mut entered);
            self.pay_safe(&mut entered);
        };
        let free = || self.object.is_free();
        if self.signalled.serve(ROUNDS, || self.object.try_enter(), free, work) {
            // Also where this is its own thread, which may be about to rest.
            context::wake(&self.waker);
        }
    }
}
