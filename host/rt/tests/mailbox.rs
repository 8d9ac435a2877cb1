//! The mailbox promises order per client, its overflow policies, and that no head is ever lost.
#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;

use proptest::prelude::*;
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};

fn head(index: u32, reply: u64) -> EntryHead {
    EntryHead { kind: 1, index, reply, stamp_ns: reply }
}

fn push(mail: &Mailbox, index: u32, reply: u64, overflow: Overflow) -> Push {
    mail.push(head(index, reply), &reply.to_ne_bytes(), overflow)
}

/// (run, skipped) replies of one drain.
fn drain(mail: &Mailbox) -> (Vec<u64>, Vec<u64>) {
    let (mut run, mut skipped) = (Vec::new(), Vec::new());
    let handled = mail.drain(
        |h, data| {
            assert_eq!(data, h.reply.to_ne_bytes(), "the payload of another entry");
            assert_eq!(data.as_ptr() as usize % 16, 0);
            run.push(h.reply);
        },
        |h| skipped.push(h.reply),
    );
    assert_eq!(handled, run.len());
    (run, skipped)
}

#[test]
fn entries_come_out_in_order_with_head_and_payload() {
    let mail = Mailbox::new(4, 8, 2);
    (1..=4).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::Reject), Push::Queued));
    assert!(!mail.is_empty());
    assert_eq!(drain(&mail), (vec![1, 2, 3, 4], vec![]));
    assert!(mail.is_empty());
}

#[test]
fn a_full_mailbox_rejects_and_counts() {
    let mail = Mailbox::new(2, 8, 1);
    (1..=2).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::Reject), Push::Queued));
    assert_eq!(push(&mail, 0, 3, Overflow::Reject), Push::Full);
    let stats = mail.stats();
    assert_eq!((stats.depth, stats.queued, stats.high_water), (2, 2, 2));
    assert_eq!((stats.pushed, stats.dropped, stats.rejected), (2, 0, 1));
}

#[test]
fn dropping_the_oldest_hands_its_head_to_the_pusher() {
    let mail = Mailbox::new(2, 8, 1);
    (1..=2).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::DropOldest), Push::Queued));
    assert_eq!(push(&mail, 0, 3, Overflow::DropOldest), Push::DroppedOldest(head(0, 1)));
    assert_eq!(drain(&mail), (vec![2, 3], vec![]));
    assert_eq!(mail.stats().dropped, 1);
}

#[test]
fn only_the_newest_of_an_index_runs_and_the_order_of_the_others_is_kept() {
    let mail = Mailbox::new(8, 8, 2);
    let _ = push(&mail, 0, 1, Overflow::LatestWins);
    let _ = push(&mail, 1, 2, Overflow::Reject);
    let _ = push(&mail, 0, 3, Overflow::LatestWins);
    assert_eq!(drain(&mail), (vec![2, 3], vec![1]));
    assert_eq!((mail.stats().dropped, mail.stats().superseded), (1, 1));
}

#[test]
fn the_latest_wins_also_when_the_mailbox_is_full_of_its_own_kind() {
    let mail = Mailbox::new(3, 8, 1);
    (1..=3).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::LatestWins), Push::Queued));
    for n in 4..=9 {
        assert_eq!(push(&mail, 0, n, Overflow::LatestWins), Push::DroppedOldest(head(0, n - 3)));
    }
    assert_eq!(drain(&mail), (vec![9], vec![7, 8]));
    assert_eq!((mail.stats().dropped, mail.stats().superseded), (8, 8));
}

#[test]
fn the_latest_wins_over_the_last_entry_behind_others_that_stay() {
    let mail = Mailbox::new(2, 8, 2);
    let _ = push(&mail, 1, 1, Overflow::Reject);
    let _ = push(&mail, 0, 2, Overflow::LatestWins);
    assert_eq!(push(&mail, 0, 3, Overflow::LatestWins), Push::DroppedOldest(head(0, 2)));
    assert_eq!(drain(&mail), (vec![1, 3], vec![]));
    let stats = mail.stats();
    assert_eq!((stats.pushed, stats.dropped, stats.superseded), (3, 1, 1));
}

#[test]
fn the_latest_is_refused_behind_a_mailbox_full_of_others() {
    let mail = Mailbox::new(2, 8, 2);
    (1..=2).for_each(|n| assert_eq!(push(&mail, 1, n, Overflow::Reject), Push::Queued));
    assert_eq!(push(&mail, 0, 3, Overflow::LatestWins), Push::Full);
}

#[test]
fn a_payload_that_does_not_fit_is_refused() {
    let mail = Mailbox::new(2, 4, 1);
    assert_eq!(mail.push(head(0, 1), &[0; 5], Overflow::DropOldest), Push::TooLong);
    assert_eq!(mail.push(head(0, 1), &[0; 3], Overflow::DropOldest), Push::Queued);
    assert_eq!(mail.drain(|_, data| assert_eq!(data.len(), 3), |_| {}), 1);
    assert_eq!(mail.stats().rejected, 1);
}

#[test]
fn a_drain_handles_what_arrives_meanwhile_once_and_no_more() {
    let mail = Mailbox::new(8, 8, 1);
    let _ = push(&mail, 0, 1, Overflow::Reject);
    let mut next = 2;
    let handled = mail.drain(
        |_, _| {
            assert_eq!(push(&mail, 0, next, Overflow::Reject), Push::Queued);
            next += 1;
        },
        |_| {},
    );
    assert_eq!(handled, 2, "one that was there, one that came meanwhile");
    assert_eq!(mail.stats().queued, 1);
}

#[test]
fn the_slot_of_the_entry_being_run_is_free_already() {
    let mail = Mailbox::new(1, 8, 1);
    let _ = push(&mail, 0, 1, Overflow::Reject);
    mail.drain(
        |h, data| {
            if h.reply == 1 {
                assert_eq!(push(&mail, 0, 2, Overflow::Reject), Push::Queued);
            }
            assert_eq!(data, h.reply.to_ne_bytes(), "overwritten while in use");
        },
        |_| {},
    );
    assert!(mail.is_empty());
}

#[test]
fn a_drain_inside_a_drain_does_nothing() {
    let mail = Mailbox::new(4, 8, 1);
    (1..=2).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::Reject), Push::Queued));
    let handled = mail.drain(|_, _| assert_eq!(mail.drain(|_, _| {}, |_| {}), 0), |_| {});
    assert_eq!(handled, 2);
}

#[test]
fn a_handler_that_panics_leaves_the_mailbox_in_use() {
    let mail = Mailbox::new(4, 8, 1);
    (1..=2).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::Reject), Push::Queued));
    let drained = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        mail.drain(|_, _| panic!("on purpose"), |_| {})
    }));
    assert!(drained.is_err());
    assert_eq!(drain(&mail), (vec![2], vec![]));
}

#[test]
fn closing_hands_every_queued_head_back_and_refuses_what_comes_later() {
    let mail = Mailbox::new(4, 8, 1);
    (1..=3).for_each(|n| assert_eq!(push(&mail, 0, n, Overflow::Reject), Push::Queued));
    let mut handed = Vec::new();
    mail.close(|h| handed.push(h.reply));
    assert_eq!(handed, [1, 2, 3]);
    assert_eq!(push(&mail, 0, 4, Overflow::DropOldest), Push::Closed);
    assert!(mail.is_empty());
    let stats = mail.stats();
    assert_eq!((stats.pushed, stats.dropped, stats.rejected, stats.queued), (3, 3, 1, 0));
    assert_eq!(stats.superseded, 0, "what is queued when it is closed is lost");
}

#[test]
fn one_client_and_one_server_in_two_threads_lose_nothing_and_keep_the_order() {
    const ENTRIES: u64 = 200_000;
    let mail = Mailbox::new(16, 8, 1);
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut rejected = 0;
            for n in 1..=ENTRIES {
                while push(&mail, 0, n, Overflow::Reject) != Push::Queued {
                    rejected += 1;
                    thread::yield_now();
                }
            }
            assert_eq!(mail.stats().rejected, rejected);
        });
        let mut last = 0;
        while last < ENTRIES {
            let (run, skipped) = drain(&mail);
            assert!(skipped.is_empty());
            for reply in run {
                assert_eq!(reply, last + 1, "out of order, or lost");
                last = reply;
            }
        }
    });
    let stats = mail.stats();
    assert_eq!((stats.pushed, stats.dropped, stats.queued), (ENTRIES, 0, 0));
}

/// Many clients against one server: every head turns up exactly once, in order for each client.
fn every_head_turns_up_exactly_once(overflow: Overflow, depth: usize) {
    const CLIENTS: u64 = 3;
    const EACH: u64 = 30_000;
    let mail = Mailbox::new(depth, 8, CLIENTS as usize);
    let handed_to_clients = AtomicU64::new(0);
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let clients: Vec<_> = (0..CLIENTS)
            .map(|client| {
                let (mail, handed) = (&mail, &handed_to_clients);
                scope.spawn(move || {
                    for n in 1..=EACH {
                        match push(mail, client as u32, client << 32 | n, overflow) {
                            Push::Queued => {}
                            Push::Full | Push::DroppedOldest(_) => {
                                handed.fetch_add(1, Ordering::Relaxed);
                            }
                            other => panic!("{other:?}"),
                        }
                    }
                })
            })
            .collect();
        let server = scope.spawn(|| {
            let mut last = [0; CLIENTS as usize];
            let mut found = 0;
            loop {
                let finished = done.load(Ordering::Acquire);
                let (run, skipped) = drain(&mail);
                for reply in &run {
                    let (client, n) = ((reply >> 32) as usize, reply & 0xffff_ffff);
                    assert!(n > last[client], "client {client}: {n} after {}", last[client]);
                    last[client] = n;
                }
                found += (run.len() + skipped.len()) as u64;
                if finished && mail.is_empty() {
                    return found;
                }
            }
        });
        clients.into_iter().for_each(|c| c.join().unwrap());
        done.store(true, Ordering::Release);
        let found = server.join().unwrap();
        let handed = handed_to_clients.load(Ordering::Relaxed);
        assert_eq!(found + handed, CLIENTS * EACH, "{:?}", mail.stats());
        let stats = mail.stats();
        assert_eq!(stats.pushed + stats.rejected, CLIENTS * EACH);
        assert!(stats.high_water <= depth as u64);
    });
}

#[test]
fn no_head_is_lost_by_a_rejecting_mailbox_under_load() {
    every_head_turns_up_exactly_once(Overflow::Reject, 7);
}

#[test]
fn no_head_is_lost_by_a_dropping_mailbox_under_load() {
    every_head_turns_up_exactly_once(Overflow::DropOldest, 3);
    every_head_turns_up_exactly_once(Overflow::DropOldest, 1);
}

#[test]
fn no_head_is_lost_by_a_latest_wins_mailbox_under_load() {
    every_head_turns_up_exactly_once(Overflow::LatestWins, 4);
}

#[derive(Clone, Debug)]
enum Act {
    Push(u32, Overflow),
    Drain,
}

fn act() -> impl Strategy<Value = Act> {
    let overflow = prop_oneof![Just(Overflow::Reject), Just(Overflow::DropOldest)];
    prop_oneof![
        4 => (0..2u32, overflow).prop_map(|(i, o)| Act::Push(i, o)),
        2 => Just(Act::Push(2, Overflow::LatestWins)),
        1 => Just(Act::Drain),
    ]
}

proptest! {
    #[test]
    fn one_thread_sees_what_a_simple_queue_would_do(depth in 1..6usize, acts in prop::collection::vec(act(), 0..80)) {
        let mail = Mailbox::new(depth, 8, 3);
        let mut model: VecDeque<(u32, u64)> = VecDeque::new();
        let mut high_water = 0;
        for (n, act) in (1..).zip(acts) {
            match act {
                Act::Push(index, overflow) => {
                    let newest = model.iter().filter(|e| e.0 == 2).map(|e| e.1).max().unwrap_or(0);
                    let expected = if model.len() < depth {
                        model.push_back((index, n));
                        Push::Queued
                    } else {
                        let oldest = model[0];
                        let gives_way = oldest.0 == 2 && (index == 2 || oldest.1 < newest);
                        let last = *model.back().unwrap();
                        if overflow == Overflow::DropOldest || (overflow == Overflow::LatestWins && gives_way) {
                            model.pop_front();
                            model.push_back((index, n));
                            Push::DroppedOldest(head(oldest.0, oldest.1))
                        } else if overflow == Overflow::LatestWins && last.0 == 2 {
                            *model.back_mut().unwrap() = (index, n);
                            Push::DroppedOldest(head(last.0, last.1))
                        } else {
                            Push::Full
                        }
                    };
                    prop_assert_eq!(push(&mail, index, n, overflow), expected);
                }
                Act::Drain => {
                    let newest = model.iter().filter(|e| e.0 == 2).map(|e| e.1).max().unwrap_or(0);
                    let all = model.drain(..);
                    let (skipped, run): (Vec<_>, Vec<_>) = all.partition(|e| e.0 == 2 && e.1 < newest);
                    let replies = |list: Vec<(u32, u64)>| list.into_iter().map(|e| e.1).collect::<Vec<_>>();
                    prop_assert_eq!(drain(&mail), (replies(run), replies(skipped)));
                }
            }
            let stats = mail.stats();
            high_water = high_water.max(model.len() as u64);
            prop_assert_eq!((stats.queued, stats.high_water), (model.len() as u64, high_water));
        }
    }
}
