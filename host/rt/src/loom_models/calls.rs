//! Basis of calls and reads: rows of state, reply cells, replaced bindings.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use loom::thread;

use super::model;
use crate::cell::BindingCell;
use crate::mailbox::{EntryHead, Mailbox, Overflow, Push};
use crate::mark::Mark;
use crate::reply::{Reply, ReplyPool};
use crate::state::state_table;
use crate::sync::AtomicBool;

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

/// A thread that notices that the server is gone, or not to be listened to any more, ends the call while the
/// server may handle it.
#[test]
fn loom_a_call_that_is_ended_meets_its_server_and_is_answered_once() {
    model(|| {
        let pool = ReplyPool::new(1, 1, 0);
        let ticket = pool.acquire().unwrap();
        let (server, token) = (Arc::clone(&pool), ticket.token());
        let serving = thread::spawn(move || {
            if let Some(running) = server.begin(token, -1) {
                running.finish(7, |_, _| 0);
            }
        });
        let ender = Arc::clone(&pool);
        let ending = thread::spawn(move || ender.end_all(-7));
        let reply = ticket.wait(1, |_, _| ());
        serving.join().unwrap();
        ending.join().unwrap();
        match reply {
            Reply::Done(status) => assert!(status == 7 || status == -7, "{status}"),
            Reply::DeadlineNotStarted | Reply::DeadlineMayRun => {}
        }
        // A cell that was given up is never used again; any other is free.
        assert!(pool.begin(token, -1).is_none(), "an old token must fit nothing");
        if let Some(again) = pool.acquire() {
            assert_ne!(again.token(), token);
        }
    });
}

/// Only a wake ends the sleep of a caller without a deadline: without it loom finds no thread to go on with.
#[test]
fn loom_a_caller_that_sleeps_is_woken_by_the_answer_and_by_the_end_of_its_server() {
    let ends: [fn(&ReplyPool, u64); 3] = [
        |pool, token| pool.begin(token, -1).unwrap().finish(7, |_, _| 0),
        |pool, token| drop(pool.begin(token, 7).unwrap()),
        |pool, _| pool.end_all(7),
    ];
    for end in ends {
        model(move || {
            let pool = ReplyPool::new(1, 1, 0);
            let ticket = pool.acquire().unwrap();
            let (other, token) = (Arc::clone(&pool), ticket.token());
            let thread = thread::spawn(move || end(&other, token));
            assert_eq!(ticket.wait(u64::MAX, |_, _| ()), Reply::Done(7));
            thread.join().unwrap();
        });
    }
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

/// A cell given up and used again while the first call's server may still run: each caller gets its own
/// answer or none.
#[test]
fn loom_a_cell_used_again_after_a_deadline_carries_the_second_answer_only() {
    model(|| {
        let pool = ReplyPool::new(1, 1, 0);
        let first = pool.acquire().unwrap();
        let (server, token) = (Arc::clone(&pool), first.token());
        let thread = thread::spawn(move || {
            if let Some(running) = server.begin(token, -1) {
                running.finish(1, |ret, _| {
                    ret[0] = 1;
                    0
                });
            }
        });
        let mut got = 0;
        match first.wait(1, |ret, _| got = ret[0]) {
            Reply::Done(status) => assert_eq!((status, got), (1, 1)),
            Reply::DeadlineNotStarted | Reply::DeadlineMayRun => assert_eq!(got, 0),
        }
        // Refused while the first server still runs.
        if let Some(second) = pool.acquire() {
            assert_ne!(second.token(), token);
            let running = pool.begin(second.token(), -1).unwrap();
            running.finish(2, |ret, _| {
                ret[0] = 2;
                0
            });
            let reply = second.wait(u64::MAX, |ret, _| got = ret[0]);
            assert_eq!((reply, got), (Reply::Done(2), 2));
        }
        thread.join().unwrap();
        assert_eq!(pool.in_use(), 0);
    });
}

/// State that a caller shares with the thread that stops its server, while the server's thread is held up and
/// drains nothing.
struct HeldUp {
    active: AtomicBool,
    mark: Mark,
    mail: Mailbox,
    replies: Arc<ReplyPool>,
}

impl HeldUp {
    /// Queues a call as a caller of a command does, and answers it where the answer is known before the wait.
    fn call(&self, token: u64) {
        if !self.active.load(Ordering::SeqCst) {
            self.replies.fail(token, NOT_ACTIVE);
            return;
        }
        let head = EntryHead { reply: token, ..EntryHead::default() };
        assert_eq!(self.mail.push(head, &[], Overflow::Reject), Push::Queued);
        self.mark.set();
        if !self.active.load(Ordering::SeqCst) {
            self.replies.fail(token, NOT_ACTIVE);
        }
    }

    fn stop(&self) {
        self.active.swap(false, Ordering::SeqCst);
        self.mark.meet();
        let refuse = |head: EntryHead| {
            self.replies.fail(head.reply, NOT_ACTIVE);
        };
        self.mail.throw_out(refuse, refuse);
    }
}

const NOT_ACTIVE: i32 = 5;

/// Without the caller's second look, or without the mark between stop and throwing out, a call can stay in
/// the queue of a server whose thread does not drain, and sleep there until its deadline.
#[test]
fn loom_a_call_that_meets_the_stop_of_its_server_is_answered_although_nobody_drains() {
    model(|| {
        let (replies, mark) = (ReplyPool::new(1, 0, 0), Mark::default());
        let ticket = replies.acquire().unwrap();
        let shared = HeldUp {
            active: AtomicBool::new(true),
            mark,
            mail: Mailbox::new(2, 0, 0),
            replies: replies.clone(),
        };
        let shared = Arc::new(shared);
        let (theirs, token) = (Arc::clone(&shared), ticket.token());
        let caller = thread::spawn(move || theirs.call(token));
        shared.stop();
        caller.join().unwrap();
        assert!(!replies.fail(token, -1), "it still waits");
        assert_eq!(ticket.wait(u64::MAX, |_, _| ()), Reply::Done(NOT_ACTIVE));
    });
}
