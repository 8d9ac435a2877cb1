//! The bounded mailbox of one client at one server: any thread pushes, the server's thread drains.
//!
//! An entry belongs to the thread that moved its slot's sequence to *busy*, and that thread ends by queueing
//! or taking an entry. So a drain that stops at a busy slot is always followed by a notification: of the
//! push, or of the thread that threw entries out.
//! Every head that is dropped is handed to exactly one caller, so that its reply can be answered.
//! Another process may write the words of a mailbox: none of them is trusted for an address, a length or an
//! end of a loop.

#[cfg(all(test, loom))]
mod models;
mod slots;
#[cfg(all(test, not(loom)))]
mod tests;

use slots::{Body, Claim, FREE, READY, SMALL, Slot, after, phase};

use crate::buf::{AlignedBuf, copy, round_up};
use crate::exclusive::TryCell;
use crate::region::{Bytes, Layout, Place, Plain, Table, told};
use crate::sync::{AtomicU32, AtomicU64, Ordering, Padded, Scope, Shared, rest, spin_loop};

/// Head of an entry, before its payload.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct EntryHead {
    /// Meaning given by the user of the mailbox (command, event, …).
    pub kind: u32,
    /// Which command or event of the server's binding; `LatestWins` is per index.
    pub index: u32,
    /// Token of the reply cell, 0 = no reply wanted.
    pub reply: u64,
    /// When it was pushed, or until when it may be begun, as `kind` says; ns of the monotonic clock.
    pub stamp_ns: u64,
}

/// Behaviour of a full mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// The new entry is refused.
    Reject,
    /// Only the newest entry of an index counts: older ones still queued are skipped at the drain, and make
    /// room when the mailbox is full.
    LatestWins,
    /// The oldest entry, of whatever index, is dropped.
    DropOldest,
}

/// Result of a push. Notify the server after `Queued` and `DroppedOldest`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use = "a dropped or refused entry must be answered"]
pub enum Push {
    Queued,
    /// Refused, counted in `rejected`. Under `DropOldest` only while the oldest entry is being copied out by
    /// a thread that was suspended over it; under `LatestWins` only behind entries of other indices.
    Full,
    /// Queued, at the cost of this older entry, which will not be drained: answer its reply.
    DroppedOldest(EntryHead),
    /// Refused: the payload is longer than the mailbox's `payload_bytes`. Counted in `rejected`.
    TooLong,
    /// Refused: the mailbox was closed. Counted in `rejected`.
    Closed,
}

/// Counters of a mailbox since it was made, in entries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MailboxStats {
    /// Number of entries that fit.
    pub depth: u64,
    /// Number of entries queued now.
    pub queued: u64,
    /// The most that were ever queued at once.
    pub high_water: u64,
    /// Accepted.
    pub pushed: u64,
    /// Accepted and later dropped: overflow, superseded, or still queued at close.
    pub dropped: u64,
    /// Dropped, and no loss: a newer one of the same index took their place, as `LatestWins` asks for.
    pub superseded: u64,
    /// Refused.
    pub rejected: u64,
}

/// Attempts of a push against other threads before it returns `Full`.
const ATTEMPTS: usize = if cfg!(loom) { 6 } else { 256 };
/// Sleep of `close` between two looks at an entry in another thread's hands, ns: twice as long each time,
/// from the shorter to the longer.
const RESTS_NS: std::ops::RangeInclusive<u64> = 20_000..=1_000_000;
/// Set in `tail` when the mailbox is closed: no push can claim a position any more.
const CLOSED: u64 = 1 << 63;

/// Bounded, many producers, one consumer.
pub struct Mailbox {
    depth: u64,
    payload_bytes: usize,
    stride: usize,
    slots: Table<Slot>,
    payloads: Bytes,
    /// Per index: position + 1 of the newest entry pushed with `LatestWins`.
    newest: Table<AtomicU64>,
    ours: Place<Padded<Clients>>,
    theirs: Place<Padded<Server>>,
    /// Threads that can write all this: of this process, or of another one, too.
    scope: Scope,
    /// The server's own copy of the entry it handles, so that the slot is free meanwhile.
    handled: TryCell<AlignedBuf>,
}

/// The line that pushes write. A push looks at the server's line only when it must: with one client and one
/// server each has its line to itself for most entries, which is what makes that case fast.
#[repr(C)]
struct Clients {
    tail: AtomicU64,
    /// A value that `head` once had. As it only grows, there is at least the room this one leaves.
    head_seen: AtomicU64,
    high_water: AtomicU64,
    replaced: AtomicU64,
    gave_way: AtomicU64,
    rejected: AtomicU64,
    superseded: AtomicU64,
}

// SAFETY: atomic numbers.
unsafe impl Plain for Clients {}

/// The line that the drain writes (and a push that drops the oldest).
#[repr(C)]
struct Server {
    head: AtomicU64,
    skipped: AtomicU64,
    superseded: AtomicU64,
}

// SAFETY: atomic numbers.
unsafe impl Plain for Server {}

impl Mailbox {
    /// A mailbox of `depth` entries (at least 1) with up to `payload_bytes` each, whose commands have the
    /// indices `0..indices`.
    pub fn new(depth: usize, payload_bytes: usize, indices: usize) -> Self {
        Layout::on_heap(|layout| Self::lay_out(layout, depth, payload_bytes, indices))
    }

    /// As [`Mailbox::new`], in memory that the other end may have in another process, with the same numbers.
    pub fn lay_out(layout: &mut Layout, depth: usize, payload_bytes: usize, indices: usize) -> Self {
        let depth = depth.max(1);
        let slots = (depth + 1).next_power_of_two();
        let stride = round_up(payload_bytes, 16);
        let zero = || AtomicU64::new(0);
        Self {
            depth: depth as u64,
            payload_bytes,
            stride,
            slots: layout.table(slots, |at| Slot {
                sequence: AtomicU64::new(phase(at as u64, FREE)),
                index: AtomicU32::new(0),
                body: Shared::new(Body::default()),
                small: Shared::new([0; SMALL / 8]),
            }),
            payloads: layout.bytes(if stride > SMALL { stride * slots } else { 0 }),
            newest: layout.table(indices, |_| zero()),
            ours: layout.place(|| {
                Padded(Clients {
                    tail: zero(),
                    head_seen: zero(),
                    high_water: zero(),
                    replaced: zero(),
                    gave_way: zero(),
                    rejected: zero(),
                    superseded: zero(),
                })
            }),
            theirs: layout.place(|| Padded(Server { head: zero(), skipped: zero(), superseded: zero() })),
            scope: layout.scope(),
            handled: TryCell::new(AlignedBuf::new(stride)),
        }
    }

    /// Queues an entry. Any thread; never waits; copies the payload.
    #[inline]
    pub fn push(&self, head: EntryHead, payload: &[u8], overflow: Overflow) -> Push {
        let pushed = if payload.len() > self.payload_bytes {
            Push::TooLong
        } else {
            self.try_push(head, payload, overflow)
        };
        match pushed {
            Push::Queued => {}
            Push::DroppedOldest(_) => {
                count(&self.ours.0.gave_way);
                if overflow == Overflow::LatestWins {
                    count(&self.ours.0.superseded);
                }
            }
            Push::Full | Push::TooLong | Push::Closed => count(&self.ours.0.rejected),
        }
        pushed
    }

    #[inline]
    fn try_push(&self, head: EntryHead, payload: &[u8], overflow: Overflow) -> Push {
        for _ in 0..ATTEMPTS {
            let tail = self.ours.0.tail.load(Ordering::Acquire);
            if tail & CLOSED != 0 {
                return Push::Closed;
            }
            let oldest = self.oldest_for(tail);
            if tail.saturating_sub(oldest) < self.depth {
                if self.slot(tail).sequence.load(Ordering::Acquire) != phase(tail, FREE) {
                    // The entry one round ago is still being copied out, or this tail is out of date.
                    spin_loop();
                } else if self.claim_tail(tail) {
                    self.fill(tail, head, payload, overflow);
                    self.raise_high_water(after(tail).wrapping_sub(oldest));
                    return Push::Queued;
                }
                continue;
            }
            let may_drop = match overflow {
                Overflow::Reject => return Push::Full,
                Overflow::DropOldest => true,
                Overflow::LatestWins => self.would_be_superseded(oldest, head.index),
            };
            if may_drop {
                // The room for the new entry is checked first: it stays, and a claimed entry must not be put
                // back, since a drain that met it would have gone to sleep over it.
                if self.slot(tail).sequence.load(Ordering::Acquire) == phase(tail, FREE) && self.claim(oldest)
                {
                    return self.push_instead_of(oldest, tail, head, payload, overflow);
                }
                spin_loop();
            } else if let Some(dropped) = self.replace_newest(tail, head, payload) {
                return Push::DroppedOldest(dropped);
            } else if self.theirs.0.head.load(Ordering::Acquire) == oldest {
                return Push::Full;
            }
        }
        Push::Full
    }

    /// With the mailbox full and its oldest slot owned, nobody else can claim the tail: the spare slot of the
    /// ring, found free before, takes the new entry before the oldest gives its place up, so exactly one
    /// entry pays for it.
    fn push_instead_of(
        &self,
        oldest: u64,
        tail: u64,
        head: EntryHead,
        payload: &[u8],
        overflow: Overflow,
    ) -> Push {
        if !self.claim_tail(tail) {
            // Closed meanwhile: `close` takes the oldest then.
            self.slot(oldest).sequence.store(phase(oldest, READY), Ordering::Release);
            return Push::Closed;
        }
        // SAFETY: the slot of `oldest` is owned by this thread until `release`.
        let dropped = unsafe { *self.slot(oldest).body.exclusive() }.head;
        self.release(oldest);
        self.fill(tail, head, payload, overflow);
        Push::DroppedOldest(dropped)
    }

    /// Puts the new content into the last entry of the mailbox, where that is of the same index.
    fn replace_newest(&self, tail: u64, head: EntryHead, payload: &[u8]) -> Option<EntryHead> {
        let last = self.newest.get(head.index as usize)?.load(Ordering::Acquire).checked_sub(1)?;
        if after(last) != tail || !self.claim(last) {
            return None;
        }
        // SAFETY: the slot of `last` is owned by this thread until it is made ready again.
        let dropped = unsafe { *self.slot(last).body.exclusive() }.head;
        count(&self.ours.0.replaced);
        self.write(last, head, payload);
        self.slot(last).sequence.store(phase(last, READY), Ordering::Release);
        Some(dropped)
    }

    /// Hands entries to `run` in order: those queued at entry, plus once those that arrived meanwhile;
    /// entries that a newer one superseded go to `skip`. Returns how many were run. The payload is 16-byte
    /// aligned and valid during the call; the slot is already free then. Server's thread only: while a drain
    /// runs, a second one (from inside `run`, or another thread) does nothing and returns 0.
    #[inline]
    pub fn drain(&self, run: impl FnMut(EntryHead, &[u8]), skip: impl FnMut(EntryHead)) -> usize {
        self.drain_some(usize::MAX, run, skip)
    }

    /// As [`Mailbox::drain`], for `most` entries at most; the others stay queued.
    pub fn drain_some(
        &self,
        most: usize,
        mut run: impl FnMut(EntryHead, &[u8]),
        mut skip: impl FnMut(EntryHead),
    ) -> usize {
        let Some(mut mine) = self.handled.try_enter() else { return 0 };
        let mut handled = 0;
        for _ in 0..2 {
            let end = self.ours.0.tail.load(Ordering::Acquire) & !CLOSED;
            for _ in 0..self.slots.len() {
                if handled == most {
                    return handled;
                }
                let at = match self.claim_oldest(end) {
                    Claim::Mine(at) => at,
                    Claim::InWork => return handled,
                    Claim::Empty => break,
                };
                // SAFETY: the slot of `at` is owned by this thread until `release`.
                let Body { head, len } = unsafe { self.slot(at).body.fetch() };
                let len = (len as usize).min(self.payload_bytes);
                let superseded = self.newest_of(head.index) > after(at);
                if !superseded {
                    // SAFETY: both blocks have `stride >= len` bytes here, and the slot is owned.
                    unsafe { copy(self.payload(at), mine.at(0), len) };
                }
                self.release(at);
                if superseded {
                    count(&self.theirs.0.skipped);
                    count(&self.theirs.0.superseded);
                    skip(head);
                } else {
                    handled += 1;
                    run(head, &mine.as_mut_slice()[..len]);
                }
            }
        }
        handled
    }

    /// Hands the heads of what is queued now to `refuse` instead of running it; those that a newer one
    /// superseded go to `skip`. Any thread, also while a drain is inside an entry: then that drain does not
    /// find them any more. An entry that is just being pushed or taken is looked at for `COPYING_NS`, not
    /// waited for: then it stays, with all behind it, for its own notification. Beside a drain, the caller
    /// meets the server's mark afterwards, and sets it where an entry is ready then: the drain may have left
    /// the entries behind one that was in hand here.
    pub fn throw_out(&self, mut refuse: impl FnMut(EntryHead), mut skip: impl FnMut(EntryHead)) {
        let end = self.ours.0.tail.load(Ordering::Acquire) & !CLOSED;
        for _ in 0..self.slots.len() {
            let Claim::Mine(at) = self.claim_patiently(end) else { return };
            // SAFETY: the slot of `at` is owned by this thread until `release`.
            let head = unsafe { *self.slot(at).body.exclusive() }.head;
            let superseded = self.newest_of(head.index) > after(at);
            self.release(at);
            if superseded {
                count(&self.theirs.0.skipped);
                count(&self.theirs.0.superseded);
                skip(head);
            } else {
                refuse(head);
            }
        }
    }

    /// Refuses every push from now on; what is queued stays for a drain, and an entry that is just being
    /// pushed comes to be ready. Any thread.
    pub fn seal(&self) {
        self.ours.0.tail.fetch_or(CLOSED, Ordering::AcqRel);
    }

    /// Refuses every push from now on and hands the heads of what is still queued to `skip`. Manager's
    /// thread: sleeps until a push that is just copying is done, so that a suspended one gets a processor
    /// whatever the priorities are. A pushing process may have died over its push, so for another process
    /// some ms are enough: an entry it has not written then is handed out as a head of zeros.
    pub fn close(&self, mut skip: impl FnMut(EntryHead)) {
        let end = self.ours.0.tail.fetch_or(CLOSED, Ordering::AcqRel) & !CLOSED;
        let mut rest_ns = *RESTS_NS.start();
        let mut left = self.slots.len();
        while left > 0 {
            match self.claim_patiently(end) {
                Claim::Mine(at) => {
                    // SAFETY: the slot of `at` is owned by this thread until `release`.
                    let dropped = unsafe { *self.slot(at).body.exclusive() }.head;
                    self.release(at);
                    count(&self.theirs.0.skipped);
                    skip(dropped);
                    left -= 1;
                }
                // Another process may have died in the middle of its push.
                Claim::InWork if self.scope == Scope::Machine && rest_ns == *RESTS_NS.end() => {
                    return self.abandon(end, left, skip);
                }
                // By the clock: a push that looked for sleepers would cost every push.
                Claim::InWork => {
                    rest(rest_ns);
                    rest_ns = (2 * rest_ns).min(*RESTS_NS.end());
                }
                Claim::Empty => return,
            }
        }
    }

    /// Takes the entries of a closed mailbox behind one that stays in another thread's hands, `left` at most.
    /// A push that has its position and goes on later is told that it is queued, so it counts here; an entry
    /// that is just being taken belongs to its taker.
    fn abandon(&self, end: u64, left: usize, mut skip: impl FnMut(EntryHead)) {
        let oldest = self.theirs.0.head.load(Ordering::Acquire);
        for at in (oldest..end).take(left) {
            let head = if self.claim(at) {
                // SAFETY: the slot of `at` is owned by this thread, for good.
                unsafe { *self.slot(at).body.exclusive() }.head
            } else if self.slot(at).sequence.load(Ordering::Acquire) == phase(at, FREE) {
                EntryHead::default()
            } else {
                continue;
            };
            count(&self.theirs.0.skipped);
            skip(head);
        }
        // A later drain finds none of them.
        self.theirs.0.head.store(end.max(oldest), Ordering::Release);
    }

    /// Tells whether no entry is queued, nor just being pushed.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Tells whether the oldest entry can be taken. The thread that pushes or takes it now notifies the
    /// server of it.
    pub fn has_ready(&self) -> bool {
        let oldest = self.theirs.0.head.load(Ordering::Acquire);
        self.slot(oldest).sequence.load(Ordering::Acquire) == phase(oldest, READY)
    }

    #[inline]
    fn len(&self) -> u64 {
        let head = self.theirs.0.head.load(Ordering::Acquire);
        (self.ours.0.tail.load(Ordering::Acquire) & !CLOSED).saturating_sub(head)
    }

    /// Returns the counters now; each is exact, all together are of nearly the same moment.
    pub fn stats(&self) -> MailboxStats {
        let pushed = self.ours.0.tail.load(Ordering::Acquire) & !CLOSED;
        MailboxStats {
            depth: self.depth,
            queued: self.len().min(self.depth),
            high_water: self.ours.0.high_water.load(Ordering::Relaxed).min(self.depth),
            pushed: told(pushed.wrapping_add(self.ours.0.replaced.load(Ordering::Relaxed))),
            dropped: told(
                (self.ours.0.gave_way.load(Ordering::Relaxed))
                    .wrapping_add(self.theirs.0.skipped.load(Ordering::Relaxed)),
            ),
            superseded: told(
                (self.ours.0.superseded.load(Ordering::Relaxed))
                    .wrapping_add(self.theirs.0.superseded.load(Ordering::Relaxed)),
            ),
            rejected: told(self.ours.0.rejected.load(Ordering::Relaxed)),
        }
    }

    /// Returns the oldest position, or a lower one when even that leaves room and is no new high water.
    #[inline]
    fn oldest_for(&self, tail: u64) -> u64 {
        let clients = &self.ours.0;
        let seen = clients.head_seen.load(Ordering::Relaxed);
        let queued = tail.saturating_sub(seen);
        if queued < self.depth && queued < clients.high_water.load(Ordering::Relaxed) {
            return seen;
        }
        let oldest = self.theirs.0.head.load(Ordering::Acquire);
        if oldest > seen {
            clients.head_seen.store(oldest, Ordering::Relaxed);
        }
        oldest
    }

    fn newest_of(&self, index: u32) -> u64 {
        self.newest.get(index as usize).map_or(0, |newest| newest.load(Ordering::Acquire))
    }

    /// Tells whether the entry at `oldest` is superseded, or will be by a push of `index`. Still true when
    /// the claim of that very position succeeds afterwards: its index cannot change before it is taken.
    fn would_be_superseded(&self, oldest: u64, index: u32) -> bool {
        let slot = self.slot(oldest);
        if slot.sequence.load(Ordering::Acquire) != phase(oldest, READY) {
            return false;
        }
        let old = slot.index.load(Ordering::Relaxed);
        old == index || self.newest_of(old) > after(oldest)
    }

    #[inline]
    fn raise_high_water(&self, queued: u64) {
        if queued > self.ours.0.high_water.load(Ordering::Relaxed) {
            self.ours.0.high_water.fetch_max(queued.min(self.depth), Ordering::Relaxed);
        }
    }
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

// SAFETY: bodies and payloads are reached only by the owner of their slot, passed on with Release and
// Acquire.
unsafe impl Send for Mailbox {}
// SAFETY: as above.
unsafe impl Sync for Mailbox {}
