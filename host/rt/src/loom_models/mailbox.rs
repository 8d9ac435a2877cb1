//! Mailboxes and the wakers beside them: each head turns up once, and no entry stays without a notification.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use loom::thread;

use super::{Plain, model, model_within};
use crate::mailbox::{EntryHead, Mailbox, Overflow, Push};
use crate::mark::Mark;
use crate::wake::Waker;

#[test]
fn loom_a_notification_is_never_lost() {
    model(|| {
        let waker = Arc::new(Waker::new());
        let other = Arc::clone(&waker);
        let done = Arc::new(Plain::new());
        let told = Arc::clone(&done);
        let thread = thread::spawn(move || {
            told.set(1);
            other.notify();
        });
        assert!(waker.wait(None), "without a deadline a wait ends by a notification only");
        assert_eq!(done.get(), 1);
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

/// A push against a close of a mailbox of one that holds `queued` entries: each accepted head is handed back
/// once.
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

/// As above with entries queued before: a push that finds no room after all must not have hidden one from the
/// drain.
#[test]
fn loom_a_push_that_drops_nothing_hides_no_entry_from_the_drain() {
    model_within(2, || {
        let server = Arc::new((Mailbox::new(1, 0, 1), Waker::new()));
        let send = |(mail, waker): &(Mailbox, Waker), reply| {
            if let Push::Queued | Push::DroppedOldest(_) =
                mail.push(head(0, reply), &[], Overflow::DropOldest)
            {
                waker.notify();
            }
        };
        send(&server, 1);
        let threads: Vec<_> = (2..=3)
            .map(|reply| {
                let server = Arc::clone(&server);
                thread::spawn(move || send(&server, reply))
            })
            .collect();
        let (mail, waker) = &*server;
        for _ in 0..2 {
            if waker.take() {
                mail.drain(|_, _| {}, |_| {});
            }
        }
        threads.into_iter().for_each(|t| t.join().unwrap());
        if waker.take() {
            mail.drain(|_, _| {}, |_| {});
        }
        assert!(mail.is_empty(), "queued, and the server sleeps");
    });
}

/// An entry that is thrown out while the server drains is run or refused, once, and the payload is still its
/// own.
#[test]
fn loom_what_is_thrown_out_during_a_drain_is_run_or_refused_once() {
    model(|| {
        let mail = Arc::new(Mailbox::new(2, 8, 0));
        let sums = Arc::new(AtomicUsize::new(0));
        let found = {
            let sums = Arc::clone(&sums);
            move |h: EntryHead| {
                sums.fetch_add(1 << (8 * h.reply), Ordering::Relaxed);
            }
        };
        (1..=2).for_each(|reply| push(&mail, reply, Overflow::Reject, &found));
        let (other, theirs) = (Arc::clone(&mail), found.clone());
        let thread = thread::spawn(move || other.throw_out(&theirs, &theirs));
        mail.drain(
            |h, data| {
                assert_eq!(data, h.reply.to_ne_bytes(), "the payload of another entry");
                found(h);
            },
            &found,
        );
        thread.join().unwrap();
        mail.throw_out(&found, &found);
        assert_eq!(sums.load(Ordering::Relaxed), 0x01_01_00, "heads found, one byte each");
        assert!(mail.is_empty());
        assert_eq!(mail.push(head(0, 3), &[], Overflow::Reject), Push::Queued, "it takes more afterwards");
    });
}

/// A drain that meets an entry in the hands of a throwing-out thread goes to sleep over those behind it: that
/// thread tells the server of the entries it leaves. Without the mark in between, it may not see what the
/// drain has left to it.
#[test]
fn loom_what_is_pushed_behind_a_throwing_out_does_not_stay_without_a_mark() {
    model(|| {
        let server = Arc::new((Mailbox::new(2, 0, 0), Mark::default()));
        assert_eq!(server.0.push(head(0, 1), &[], Overflow::Reject), Push::Queued);
        server.1.set();
        let (theirs, ours) = (Arc::clone(&server), Arc::clone(&server));
        let manager = thread::spawn(move || {
            let (mail, mark) = &*theirs;
            mail.throw_out(|_| {}, |_| {});
            mark.meet();
            if mail.has_ready() {
                mark.set();
            }
        });
        let client = thread::spawn(move || {
            let (mail, mark) = &*ours;
            assert_eq!(mail.push(head(0, 2), &[], Overflow::Reject), Push::Queued);
            mark.set();
        });
        let (mail, mark) = &*server;
        let look = || {
            if mark.take_if_set() {
                mail.drain(|_, _| {}, |_| {});
            }
        };
        look();
        manager.join().unwrap();
        client.join().unwrap();
        look();
        assert!(mail.is_empty(), "queued, and the server sleeps");
    });
}
