//! Queues into one component, and the meaning of their entries.
//!
//! Invariant: every entry that carries a reply is answered, executed or not; every event a full queue could
//! not take is counted and reported.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};

use trocar_model::ComponentId;
use trocar_plugin_api::abi::{Outcome, PEER_LOST};
use trocar_rt::mailbox::{EntryHead, Mailbox};
use trocar_rt::reply::ReplyPool;
use trocar_rt::wake::Waker;

use super::boundary::RangeCheck;
use super::context;

/// Kinds of mailbox entries. The goal of a plain command ages as its connection and its server's class say.
pub(super) const ENTRY_COMMAND: u32 = 0;
pub(super) const ENTRY_EVENT: u32 = 1;
/// A command that says itself until when it may be begun.
pub(super) const ENTRY_DUE: u32 = 2;

/// Shortest time between two reports of one connection's losses, ns.
const TELL_NS: u64 = 1_000_000_000;

/// Place of a command or handler in its class's present description: its ABI id, which moves when ports in
/// front of it come or go.
#[derive(Debug)]
pub(super) struct Position(AtomicU32);

/// No description has that many members.
const WITHDRAWN: u32 = u32::MAX;

impl Position {
    pub(super) fn new(id: usize) -> Arc<Position> {
        Arc::new(Position(AtomicU32::new(id as u32)))
    }

    /// `None` when the description does not hold it any more. A thread that is about to enter the instance
    /// asks inside.
    pub(super) fn get(&self) -> Option<u32> {
        Some(self.0.load(Ordering::Acquire)).filter(|id| *id != WITHDRAWN)
    }

    pub(super) fn put(&self, id: Option<usize>) {
        self.0.store(id.map_or(WITHDRAWN, |id| id as u32), Ordering::Release);
    }
}

/// A queue into one component: commands of one client, or events of one connection.
pub(super) struct Inbox {
    pub(super) mailbox: Mailbox,
    pub(super) replies: Arc<ReplyPool>,
    /// Targets by an entry's index: commands or handlers of the class.
    pub(super) targets: Vec<Arc<Position>>,
    /// True for events of one connection; false for commands of one client.
    pub(super) events: bool,
    /// Source of the entries.
    pub(super) from: From,
    /// Checks of entries by their index, where another process fills the queue.
    checks: Vec<Check>,
    losses: Losses,
    /// Time within which its connection wants commands carried out, ns; 0 = none given.
    pub(super) deadline_ns: u64,
    failures: Failures,
    closed: AtomicBool,
    /// Rung when entries were taken: somebody here tells a client on another machine of the room.
    taken: Option<Arc<Waker>>,
}

/// A component at either end of a queue, which is warned of what goes wrong there.
pub(super) trait Party: Send + Sync {
    fn id(&self) -> &ComponentId;

    /// Reports a sentence that begins with `about` and goes on with `how`; the newest of each `about` stays.
    fn warn_about(&self, about: &str, how: &str);
}

/// Source of a queue's entries.
pub(super) enum From {
    /// The control plane.
    Outside,
    Component(Weak<dyn Party>),
    /// A component of another process.
    Remote(ComponentId),
}

/// Conditions under which an entry of another process is run.
pub(super) struct Check {
    pub(super) bytes: usize,
    pub(super) range: Option<RangeCheck>,
}

/// Counts of entries without a waiting caller that were taken and then failed or never ran.
#[derive(Default)]
struct Failures {
    /// Commands that ran and failed.
    failed: AtomicU64,
    /// Commands and events that never ran: Stop, Disconnect, Remove, another description, or too long a wait.
    unexecuted: AtomicU64,
    /// Sentence of the last failure.
    last: Mutex<Sentence>,
    told: [AtomicU64; 2],
}

/// Bytes of a failure's sentence that are kept.
const SENTENCE_BYTES: usize = 160;

struct Sentence {
    len: usize,
    bytes: [u8; SENTENCE_BYTES],
}

impl Default for Sentence {
    fn default() -> Self {
        Sentence { len: 0, bytes: [0; SENTENCE_BYTES] }
    }
}

/// Part of a queue's losses that is reported already.
#[derive(Default)]
struct Losses {
    told: AtomicU64,
    told_ns: AtomicU64,
}

impl Inbox {
    /// Queue for commands of one client, whose connection gives them `deadline_ns`; 0: none given.
    pub(super) fn commands(
        mailbox: Mailbox,
        replies: Arc<ReplyPool>,
        targets: Vec<Arc<Position>>,
        from: From,
        deadline_ns: u64,
    ) -> Arc<Inbox> {
        let inbox = Self::of(mailbox, replies, targets, from, false, Vec::new());
        Arc::new(Inbox { deadline_ns, ..inbox })
    }

    /// Queue for events of one connection.
    pub(super) fn events(mailbox: Mailbox, targets: Vec<Arc<Position>>, from: From) -> Arc<Inbox> {
        Arc::new(Self::of(mailbox, ReplyPool::new(1, 0, 0), targets, from, true, Vec::new()))
    }

    /// Queue for commands of a client in another process.
    pub(super) fn remote_commands(
        mailbox: Mailbox,
        replies: Arc<ReplyPool>,
        targets: Vec<Arc<Position>>,
        from: From,
        checks: Vec<Check>,
        (deadline_ns, taken): (u64, Option<Arc<Waker>>),
    ) -> Arc<Inbox> {
        Arc::new(Inbox { deadline_ns, taken, ..Self::of(mailbox, replies, targets, from, false, checks) })
    }

    /// Queue for events of a component of another process.
    pub(super) fn remote_events(
        mailbox: Mailbox,
        targets: Vec<Arc<Position>>,
        from: From,
        checks: Vec<Check>,
    ) -> Arc<Inbox> {
        Arc::new(Self::of(mailbox, ReplyPool::new(1, 0, 0), targets, from, true, checks))
    }

    fn of(
        mailbox: Mailbox,
        replies: Arc<ReplyPool>,
        targets: Vec<Arc<Position>>,
        from: From,
        events: bool,
        checks: Vec<Check>,
    ) -> Inbox {
        Inbox {
            mailbox,
            replies,
            targets,
            events,
            from,
            checks,
            deadline_ns: 0,
            losses: Losses::default(),
            failures: Failures::default(),
            closed: AtomicBool::new(false),
            taken: None,
        }
    }

    /// The component that fills the queue, if it is in this process, and its name.
    pub(super) fn sender(&self) -> (Option<Arc<dyn Party>>, String) {
        match &self.from {
            From::Outside => (None, "outside".to_owned()),
            From::Remote(id) => (None, id.to_string()),
            From::Component(from) => {
                let from = from.upgrade();
                let name =
                    from.as_ref().map_or_else(|| "one that is gone".into(), |from| from.id().to_string());
                (from, name)
            }
        }
    }

    /// Tells whether an entry meets its check, where another process may have put anything there.
    #[inline]
    pub(super) fn admits(&self, head: EntryHead, payload: &[u8]) -> bool {
        self.checks.is_empty() || self.is_as_agreed(head, payload)
    }

    #[inline(never)]
    fn is_as_agreed(&self, head: EntryHead, payload: &[u8]) -> bool {
        let Some(check) = self.checks.get(head.index as usize) else { return false };
        let in_range = || check.range.as_ref().is_none_or(|range| range.holds_in(payload));
        let is_kind = match head.kind {
            ENTRY_EVENT => self.events,
            ENTRY_COMMAND | ENTRY_DUE => !self.events,
            _ => false,
        };
        is_kind && payload.len() == check.bytes && in_range()
    }

    /// Notes that entries were taken. Real-time.
    #[inline]
    pub(super) fn note_taken(&self) {
        if let Some(bell) = &self.taken {
            context::wake(bell);
        }
    }

    /// Takes nothing more; answers everything still queued with `outcome`, unexecuted.
    pub(super) fn close(&self, outcome: Outcome) {
        self.closed.store(outcome == PEER_LOST, Ordering::Release);
        self.mailbox.close(|head| self.refuse(head, outcome));
    }

    /// Tells whether its connection was cut.
    pub(super) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    /// True for commands that are all withdrawn from the description: the connection is about to be cut.
    pub(super) fn is_withdrawn(&self) -> bool {
        !self.events && !self.targets.is_empty() && self.targets.iter().all(|target| target.get().is_none())
    }

    /// Answers everything still queued with `outcome`, unexecuted, even while its component does not return
    /// from an entry.
    pub(super) fn refuse_all(&self, outcome: Outcome) {
        let superseded = |head: EntryHead| {
            self.replies.fail(head.reply, outcome);
        };
        self.mailbox.throw_out(|head| self.refuse(head, outcome), superseded);
    }

    /// Answers one entry, unexecuted; an entry without a waiting caller is counted. Real-time.
    pub(super) fn refuse(&self, head: EntryHead, outcome: Outcome) {
        if head.reply == 0 {
            self.failures.unexecuted.fetch_add(1, Ordering::Relaxed);
        } else {
            self.replies.fail(head.reply, outcome);
        }
    }

    /// Counts a command that ran and failed without a waiting caller. Real-time.
    pub(super) fn note_failure(&self, text: &[u8]) {
        self.failures.failed.fetch_add(1, Ordering::Relaxed);
        // The lock fails while another thread reads the previous sentence: that one is reported.
        if let Ok(mut last) = self.failures.last.try_lock() {
            last.len = text.len().min(SENTENCE_BYTES);
            let len = last.len;
            last.bytes[..len].copy_from_slice(&text[..len]);
        }
    }

    /// Commands without a waiting caller that ran and failed.
    pub(super) fn failed(&self) -> u64 {
        self.failures.failed.load(Ordering::Relaxed)
    }

    /// Commands without a waiting caller, and events, that were taken and never ran.
    pub(super) fn unexecuted(&self) -> u64 {
        self.failures.unexecuted.load(Ordering::Relaxed)
    }

    /// Warns both ends of commands that were only sent and that failed or never ran since the last report.
    /// Managers only.
    pub(super) fn tell_failures(&self, to: &dyn Party) {
        let now = [self.failed(), self.unexecuted()];
        let fresh = [0, 1].map(|i| self.failures.told[i].swap(now[i], Ordering::Relaxed) != now[i]);
        // A component that is not ACTIVE handles no events: that is not worth a report every second.
        if self.events {
            return;
        }
        let (from, sender) = self.sender();
        let say = |what: &str, how: &str| {
            to.warn_about(&format!("commands sent by {sender} {what}"), how);
            if let Some(from) = &from {
                from.warn_about(&format!("commands it sent to {} {what}", to.id()), how);
            }
        };
        if fresh[0] {
            // The step's side only tries the lock, so it never waits for this.
            let text = self.failures.last.try_lock().map_or_else(
                |_| String::new(),
                |last| trocar_model::plain::sentence(&last.bytes[..last.len]),
            );
            let last = if text.is_empty() { "without a reason" } else { &text };
            say("failed", &format!(": {} so far, the last one: {last}", now[0]));
        }
        if fresh[1] {
            say(
                "never ran",
                &format!(
                    ": {} so far were still queued when it stopped or was cut off, or had waited too long",
                    now[1]
                ),
            );
        }
    }

    /// Entries lost so far in the queue, for the books: unlike [`Inbox::losses`] also commands that
    /// `drop_oldest` threw out.
    pub(super) fn counted_losses(&self) -> u64 {
        let stats = self.mailbox.stats();
        stats.rejected + stats.dropped.saturating_sub(stats.superseded)
    }

    /// Entries lost to a full queue so far. Commands replaced by newer ones were replaced by their policy,
    /// and do not count.
    pub(super) fn losses(&self) -> u64 {
        let stats = self.mailbox.stats();
        stats.rejected + if self.events { stats.dropped } else { 0 }
    }

    /// Number of entries lost to a full queue since the last report; 0 while that is less than a second ago.
    /// Managers only.
    pub(super) fn untold_losses(&self, now_ns: u64) -> u64 {
        let lost = self.losses();
        let told = self.losses.told.load(Ordering::Relaxed);
        let told_ns = self.losses.told_ns.load(Ordering::Relaxed);
        if lost == told || (told_ns != 0 && now_ns < told_ns + TELL_NS) {
            return 0;
        }
        self.losses.told.store(lost, Ordering::Relaxed);
        self.losses.told_ns.store(now_ns, Ordering::Relaxed);
        // Another process may have written a lower count than it had.
        lost.saturating_sub(told)
    }
}

#[cfg(test)]
mod tests {
    use trocar_rt::mailbox::{Overflow, Push};

    use super::*;

    #[test]
    fn what_is_thrown_out_is_counted_unless_somebody_waits_for_its_answer() {
        let inbox = Inbox::events(Mailbox::new(4, 0, 0), Vec::new(), From::Outside);
        let waited_for = EntryHead { reply: 1 << 40, ..EntryHead::default() };
        for head in [EntryHead::default(), waited_for, EntryHead::default()] {
            assert_eq!(inbox.mailbox.push(head, &[], Overflow::Reject), Push::Queued);
        }
        inbox.refuse_all(PEER_LOST);
        assert_eq!(inbox.unexecuted(), 2);
        assert_eq!(inbox.mailbox.push(EntryHead::default(), &[], Overflow::Reject), Push::Queued);
        inbox.close(PEER_LOST);
        assert_eq!((inbox.unexecuted(), inbox.failed()), (3, 0));
    }

    #[test]
    fn a_failure_is_counted_and_its_sentence_cut_to_its_room() {
        let inbox = Inbox::events(Mailbox::new(1, 0, 0), Vec::new(), From::Outside);
        inbox.note_failure(&[b'x'; 2 * SENTENCE_BYTES]);
        inbox.note_failure(b"no paper");
        let last = inbox.failures.last.try_lock().unwrap();
        assert_eq!((inbox.failed(), &last.bytes[..last.len]), (2, &b"no paper"[..]));
    }

    #[test]
    fn losses_are_told_once_and_at_most_once_a_second() {
        let inbox = Inbox::events(Mailbox::new(1, 0, 0), Vec::new(), From::Outside);
        let push = || inbox.mailbox.push(EntryHead::default(), &[], Overflow::Reject);
        assert_eq!(inbox.untold_losses(5), 0, "nothing was lost yet");
        assert_eq!(push(), Push::Queued);
        assert_eq!((push(), push()), (Push::Full, Push::Full));
        assert_eq!(inbox.untold_losses(5), 2);
        assert_eq!(push(), Push::Full);
        assert_eq!(inbox.untold_losses(6), 0, "told less than a second ago");
        assert_eq!(inbox.untold_losses(5 + TELL_NS), 1);
    }
}
