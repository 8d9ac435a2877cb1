//! Loom models: every interleaving of two or three threads over the lock-free cores, within loom's bounds.
//!
//! Run with `RUSTFLAGS="--cfg loom" cargo test -p trocar-rt --release --lib loom_`.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use loom::thread;

use crate::cell::BindingCell;
use crate::mailbox::{EntryHead, Mailbox, Overflow, Push};
use crate::pool::FramePool;
use crate::reply::{Reply, ReplyPool};
use crate::state::state_table;
use crate::stream::{DropPolicy, Meta, Payload, Queue, StreamReader, stream_link};
use crate::team::Team;
use crate::wake::Waker;

/// Runs the model, and fails when loom found nothing to interleave: such a model shows nothing. (loom compares
/// an access with the last one of the same atomic only, so a thread's own load can hide a conflict from it.)
fn model(f: impl Fn() + Sync + Send + 'static) {
    model_within(3, f);
}

/// As [`model`], with at most this many switches away from a thread that could go on.
pub(crate) fn model_within(preemptions: usize, f: impl Fn() + Sync + Send + 'static) {
    let runs = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&runs);
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(preemptions);
    builder.check(move || {
        counted.fetch_add(1, Ordering::Relaxed);
        f();
    });
    assert!(runs.load(Ordering::Relaxed) > 1, "loom tried one interleaving only");
}

fn row(n: u64) -> [u8; 16] {
    let mut row = [0; 16];
    row[..8].copy_from_slice(&n.to_ne_bytes());
    row[8..].copy_from_slice(&(!n).to_ne_bytes());
    row
}

#[test]
fn loom_a_state_reader_gets_whole_rows_or_none() {
    model(|| {
        let (mut writer, reader) = state_table(16, 3);
        let thread = thread::spawn(move || {
            for n in 0..4 {
                writer.publish(n, n, |out| out.copy_from_slice(&row(n)));
            }
        });
        let mut out = [0; 16];
        if let Some(info) = reader.row(0, &mut out).ok().or_else(|| reader.delayed(1, &mut out).ok()) {
            assert_eq!((info.stamp_ns, info.tick, out), (info.row, info.row, row(info.row)), "torn row");
        }
        thread.join().unwrap();
    });
}

#[test]
fn loom_a_notification_is_never_lost() {
    model(|| {
        let waker = Arc::new(Waker::new());
        let other = Arc::clone(&waker);
        let done = Arc::new(AtomicUsize::new(0));
        let told = Arc::clone(&done);
        let thread = thread::spawn(move || {
            told.store(1, Ordering::Relaxed);
            other.notify();
        });
        assert!(waker.wait(None), "without a deadline a wait ends by a notification only");
        assert_eq!(done.load(Ordering::Relaxed), 1);
        thread.join().unwrap();
    });
}

#[test]
fn loom_two_notifiers_are_both_seen() {
    model(|| {
        let waker = Arc::new(Waker::new());
        let mail = Arc::new(Mailbox::new(2, 0, 0));
        let threads: Vec<_> = (0..2)
            .map(|_| {
                let (waker, mail) = (Arc::clone(&waker), Arc::clone(&mail));
                thread::spawn(move || {
                    assert_eq!(mail.push(EntryHead::default(), &[], Overflow::Reject), Push::Queued);
                    waker.notify();
                })
            })
            .collect();
        let mut seen = 0;
        while seen < 2 {
            assert!(waker.wait(None));
            seen += mail.drain(|_, _| {}, |_| {});
        }
        threads.into_iter().for_each(|t| t.join().unwrap());
    });
}

fn head(index: u32, reply: u64) -> EntryHead {
    EntryHead { index, reply, ..EntryHead::default() }
}

fn push(mail: &Mailbox, reply: u64, overflow: Overflow, found: &dyn Fn(EntryHead)) {
    match mail.push(head(0, reply), &reply.to_ne_bytes(), overflow) {
        Push::Queued => {}
        Push::DroppedOldest(old) => found(old),
        Push::Full => found(head(0, reply)),
        other => panic!("{other:?}"),
    }
}

/// Two pushes against a drain, into a mailbox of one: each head must turn up exactly once.
fn every_head_turns_up_once(overflow: Overflow) {
    model(move || {
        let mail = Arc::new(Mailbox::new(1, 8, 1));
        let sums = Arc::new(AtomicUsize::new(0));
        let (other, sum) = (Arc::clone(&mail), Arc::clone(&sums));
        let found = move |h: EntryHead| {
            sum.fetch_add(1 << (8 * h.reply), Ordering::Relaxed);
        };
        let theirs = found.clone();
        let thread = thread::spawn(move || push(&other, 1, overflow, &theirs));
        push(&mail, 2, overflow, &found);
        mail.drain(
            |h, data| {
                assert_eq!(data, h.reply.to_ne_bytes(), "the payload of another entry");
                found(h);
            },
            &found,
        );
        thread.join().unwrap();
        mail.close(&found);
        assert_eq!(sums.load(Ordering::Relaxed), 0x01_01_00, "heads found, one byte each");
    });
}

#[test]
fn loom_a_rejecting_mailbox_loses_no_head() {
    every_head_turns_up_once(Overflow::Reject);
}

#[test]
fn loom_a_dropping_mailbox_loses_no_head() {
    every_head_turns_up_once(Overflow::DropOldest);
}

#[test]
fn loom_a_latest_wins_mailbox_loses_no_head() {
    every_head_turns_up_once(Overflow::LatestWins);
}

/// A server that sleeps once it has consumed all notifications must not leave an entry behind.
fn no_entry_stays_without_a_notification(overflow: Overflow) {
    model(move || {
        let server = Arc::new((Mailbox::new(1, 0, 1), Waker::new()));
        let threads: Vec<_> = (1..=2)
            .map(|reply| {
                let server = Arc::clone(&server);
                thread::spawn(move || {
                    let (mail, waker) = &*server;
                    if let Push::Queued | Push::DroppedOldest(_) = mail.push(head(0, reply), &[], overflow) {
                        waker.notify();
                    }
                })
            })
            .collect();
        let (mail, waker) = &*server;
        if waker.take() {
            mail.drain(|_, _| {}, |_| {});
        }
        threads.into_iter().for_each(|t| t.join().unwrap());
        if waker.take() {
            mail.drain(|_, _| {}, |_| {});
        }
        assert!(mail.is_empty(), "queued, and the server sleeps");
    });
}

#[test]
fn loom_a_dropping_mailbox_never_leaves_its_server_asleep() {
    no_entry_stays_without_a_notification(Overflow::DropOldest);
}

#[test]
fn loom_a_latest_wins_mailbox_never_leaves_its_server_asleep() {
    no_entry_stays_without_a_notification(Overflow::LatestWins);
}

/// A push against a close of a mailbox of one that holds `queued` entries: each accepted head is handed back once.
fn a_close_hands_every_head_back(queued: u64) {
    model(move || {
        let mail = Arc::new(Mailbox::new(1, 8, 0));
        let sums = Arc::new(AtomicUsize::new(0));
        let found = {
            let sums = Arc::clone(&sums);
            move |h: EntryHead| {
                sums.fetch_add(1 << (8 * h.reply), Ordering::Relaxed);
            }
        };
        (0..queued).for_each(|_| push(&mail, 2, Overflow::Reject, &found));
        let (other, theirs) = (Arc::clone(&mail), found.clone());
        let thread = thread::spawn(move || match other.push(head(0, 1), &[], Overflow::DropOldest) {
            Push::Queued => {}
            Push::DroppedOldest(old) => theirs(old),
            Push::Full | Push::Closed => theirs(head(0, 1)),
            other => panic!("{other:?}"),
        });
        mail.close(&found);
        thread.join().unwrap();
        let expected = if queued == 1 { 0x01_01_00 } else { 0x01_00 };
        assert_eq!(sums.load(Ordering::Relaxed), expected, "heads found, one byte each");
        assert!(mail.is_empty());
    });
}

#[test]
fn loom_a_push_against_a_close_is_refused_or_handed_back() {
    a_close_hands_every_head_back(0);
}

#[test]
fn loom_a_dropping_push_against_a_close_loses_no_head() {
    a_close_hands_every_head_back(1);
}

#[test]
fn loom_a_caller_is_answered_or_gives_up_and_the_cell_is_free_again() {
    model(|| {
        let pool = ReplyPool::new(1, 1, 0);
        let ticket = pool.acquire().unwrap();
        let (server, token) = (Arc::clone(&pool), ticket.token());
        let thread = thread::spawn(move || match server.begin(token, -1) {
            Some(running) => {
                running.finish(7, |ret, _| {
                    ret[0] = 42;
                    0
                });
                true
            }
            None => false,
        });
        let mut got = 0;
        let reply = ticket.wait(1, |ret, _| got = ret[0]);
        let began = thread.join().unwrap();
        match reply {
            Reply::Done(status) => assert_eq!((status, got, began), (7, 42, true)),
            Reply::DeadlineNotStarted => assert!(!began, "given up and run all the same"),
            Reply::DeadlineMayRun => assert!(began, "nobody has begun it"),
        }
        assert_eq!(pool.in_use(), 0, "after {reply:?}");
        assert!(pool.begin(token, -1).is_none(), "an old token must fit nothing");
    });
}

/// A value whose reads and whose end loom orders.
struct Tracked(loom::cell::UnsafeCell<u32>, Arc<AtomicUsize>);

impl Tracked {
    fn new(number: u32, drops: &Arc<AtomicUsize>) -> Box<Self> {
        Box::new(Self(loom::cell::UnsafeCell::new(number), Arc::clone(drops)))
    }

    fn number(&self) -> u32 {
        // SAFETY: written only by the drop; loom fails the model when that is not ordered after this read.
        self.0.with(|n| unsafe { *n })
    }
}

// SAFETY: loom checks the order of all accesses, which is what the model is about.
unsafe impl Sync for Tracked {}

impl Drop for Tracked {
    fn drop(&mut self) {
        // SAFETY: as for `number`.
        self.0.with_mut(|n| unsafe { *n = 0 });
        self.1.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn loom_a_replaced_binding_is_dropped_after_its_callers_left() {
    model(|| {
        let drops = Arc::default();
        let cell = Arc::new(BindingCell::new(Tracked::new(1, &drops)));
        let callers: Vec<_> = (0..2)
            .map(|_| {
                let cell = Arc::clone(&cell);
                thread::spawn(move || {
                    let guard = cell.enter();
                    assert_ne!(guard.number(), 0, "dropped under a caller");
                })
            })
            .collect();
        cell.swap(Tracked::new(2, &drops));
        cell.reclaim();
        callers.into_iter().for_each(|t| t.join().unwrap());
        assert_eq!(cell.reclaim(), 0);
        assert_eq!(drops.load(Ordering::Relaxed), 1);
        assert_eq!(cell.enter().number(), 2);
    });
}

#[test]
fn loom_a_slot_is_lent_to_one_and_comes_back_after_its_last_frame() {
    model(|| {
        let pool = FramePool::new(1, 8, 0).unwrap();
        let mut writing = pool.loan().unwrap();
        writing.parts_mut().0[0] = 1;
        let frame = writing.freeze(0);
        let other = frame.clone();
        let thread = thread::spawn(move || {
            assert_eq!(other.header()[0], 1);
            if let Ok(mut mine) = other.try_unique() {
                mine.parts_mut().0[0] = 2;
            }
        });
        if let Ok(mut mine) = frame.try_unique() {
            assert_eq!(mine.parts_mut().0[0], 1, "written by another holder");
        }
        thread.join().unwrap();
        assert_eq!(pool.stats().free, 1);
        assert!(pool.loan().is_some());
    });
}

/// What a holder wrote beside its slot is seen by the next one, and every loan is a slot or counted as refused.
#[test]
fn loom_a_slot_goes_from_holder_to_holder_and_refusals_are_counted() {
    model(|| {
        let shared = Arc::new((FramePool::new(1, 8, 0).unwrap(), Plain::new()));
        let borrow = |(pool, content): &(Arc<FramePool>, Plain)| {
            if let Some(frame) = pool.loan() {
                content.set(content.get() + 1);
                drop(frame);
            }
        };
        let theirs = Arc::clone(&shared);
        let thread = thread::spawn(move || borrow(&theirs));
        borrow(&shared);
        thread.join().unwrap();
        let stats = shared.0.stats();
        assert_eq!(shared.1.get() + stats.exhausted, 2, "{stats:?}");
        assert_eq!((stats.free, stats.high_water), (1, 1), "{stats:?}");
    });
}

/// The last of several readers gives the slot back: whoever writes it next comes after all of them.
#[test]
fn loom_a_slot_is_written_again_after_its_last_reader() {
    model(|| {
        let shared = Arc::new((FramePool::new(1, 8, 0).unwrap(), Plain::new()));
        let (pool, content) = &*shared;
        let frame = pool.loan().unwrap().freeze(0);
        let (other, theirs) = (frame.clone(), Arc::clone(&shared));
        let thread = thread::spawn(move || {
            assert_eq!(theirs.1.get(), 0, "written under a reader");
            drop(other);
        });
        assert_eq!(content.get(), 0, "written under a reader");
        // In place when the other reader has gone already, else whenever the slot is free again.
        if let Ok(_mine) = frame.try_unique() {
            content.set(1);
        }
        if let Some(_again) = pool.loan() {
            content.set(1);
        }
        thread.join().unwrap();
        assert_eq!(pool.stats().free, 1);
    });
}

/// Three samples against a reader that looks twice: order, wholeness and the counts.
fn samples_come_in_order_and_all_are_counted(queue: Queue) {
    model(move || {
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: 8 }, queue);
        let thread = thread::spawn(move || {
            for seq in 1..=3u64 {
                let _ = writer.push(&(seq * 10).to_ne_bytes(), Meta { stamp_ns: 0, seq });
            }
            writer
        });
        let (mut last, mut gaps) = (0, 0);
        let mut look = |reader: &mut StreamReader| {
            let Some(sample) = reader.next() else { return false };
            assert_eq!(sample.data, (sample.meta.seq * 10).to_ne_bytes(), "torn sample");
            assert!(sample.meta.seq > last, "{} after {last}", sample.meta.seq);
            gaps += sample.meta.seq - last - 1;
            last = sample.meta.seq;
            true
        };
        look(&mut reader);
        let writer = thread.join().unwrap();
        while look(&mut reader) {}
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken + stats.dropped), (3, 3), "{stats:?}");
        assert_eq!(gaps + (3 - last), stats.dropped, "gaps");
    });
}

#[test]
fn loom_a_latest_link_counts_every_sample() {
    samples_come_in_order_and_all_are_counted(Queue::Latest);
}

#[test]
fn loom_a_dropping_queue_counts_every_sample() {
    samples_come_in_order_and_all_are_counted(Queue::Fifo { depth: 1, drop: DropPolicy::DropOldest });
}

#[test]
fn loom_a_keeping_queue_counts_every_sample() {
    samples_come_in_order_and_all_are_counted(Queue::Fifo { depth: 1, drop: DropPolicy::DropNewest });
}

/// A value whose accesses loom checks: each must be ordered after those that conflict with it.
pub(crate) struct Plain(loom::cell::UnsafeCell<u64>);

// SAFETY: loom checks the order of all accesses, which is what the models are about.
unsafe impl Sync for Plain {}

impl Plain {
    pub(crate) fn new() -> Self {
        Self(loom::cell::UnsafeCell::new(0))
    }

    pub(crate) fn get(&self) -> u64 {
        // SAFETY: as for the `Sync` above.
        self.0.with(|value| unsafe { *value })
    }

    pub(crate) fn set(&self, n: u64) {
        // SAFETY: as for the `Sync` above.
        self.0.with_mut(|value| unsafe { *value = n });
    }
}

/// Jobs after each other whose data live on the owner's stack: a helper that comes late must not touch the next
/// job with the last one's, and the owner must see what every slice wrote.
fn a_team_is_done_when_it_says_so(preemptions: usize, threads: usize, jobs: u64) {
    model_within(preemptions, move || {
        let team = Team::new(threads, |_| {}).unwrap();
        for job in 1..=jobs {
            let slices = [Plain::new(), Plain::new()];
            let status = team.run(2, &|slice| {
                let mine = &slices[slice as usize];
                mine.set(mine.get() + job);
                if slice == 1 { -3 } else { 0 }
            });
            assert_eq!(status, -3);
            assert!(slices.iter().all(|s| s.get() == job), "each slice runs once");
        }
    });
}

#[test]
fn loom_a_team_of_two_is_done_when_it_says_so() {
    a_team_is_done_when_it_says_so(3, 2, 2);
}

#[test]
fn loom_a_team_of_three_is_done_when_it_says_so() {
    a_team_is_done_when_it_says_so(1, 3, 1);
}

/// Whoever comes while a job is at work runs alone; whoever comes after it finds the desk as if it were new.
#[test]
fn loom_two_callers_of_a_team_keep_out_of_each_others_way() {
    model_within(1, || {
        let team = Arc::new(Team::new(2, |_| {}).unwrap());
        let run = |team: &Team| {
            let slices = [Plain::new(), Plain::new()];
            let status = team.run(2, &|slice| {
                slices[slice as usize].set(slices[slice as usize].get() + 1);
                0
            });
            assert_eq!(status, 0);
            assert!(slices.iter().all(|s| s.get() == 1), "each slice runs once");
        };
        let other = Arc::clone(&team);
        let thread = thread::spawn(move || run(&other));
        run(&team);
        thread.join().unwrap();
    });
}
