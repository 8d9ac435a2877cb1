//! A caller with a deadline is answered or told why not; its cell is free again whatever happens.
#![allow(clippy::unwrap_used)]

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;

use trocar_rt::now_ns;
use trocar_rt::reply::{Reply, ReplyPool};
use trocar_rt::wake::Waker;

const LOST: i32 = -99;
const SOON: u64 = 60_000_000_000;

#[test]
fn a_call_gets_status_result_and_text() {
    let pool = ReplyPool::new(2, 8, 16);
    let ticket = pool.acquire().unwrap();
    pool.begin(ticket.token(), LOST).unwrap().finish(3, |ret, text| {
        ret.copy_from_slice(&7u64.to_ne_bytes());
        text[..4].copy_from_slice(b"well");
        4
    });
    let mut got = (0, String::new());
    let reply = ticket.wait(0, |ret, text| {
        got = (u64::from_ne_bytes(ret.try_into().unwrap()), String::from_utf8(text.to_vec()).unwrap());
    });
    assert_eq!((reply, got), (Reply::Done(3), (7, "well".to_owned())));
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn all_cells_can_wait_at_once_and_no_more() {
    let pool = ReplyPool::new(2, 0, 0);
    let (first, second) = (pool.acquire().unwrap(), pool.acquire().unwrap());
    assert_ne!(first.token(), second.token());
    assert!(pool.acquire().is_none());
    drop(first);
    assert!(pool.acquire().is_some());
}

#[test]
fn a_deadline_before_the_server_began_keeps_it_from_beginning() {
    let pool = ReplyPool::new(1, 0, 0);
    let ticket = pool.acquire().unwrap();
    let token = ticket.token();
    assert_eq!(ticket.wait(now_ns(), |_, _| panic!("no answer")), Reply::DeadlineNotStarted);
    assert!(pool.begin(token, LOST).is_none());
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn a_deadline_while_the_server_is_at_it_says_so_and_its_end_frees_the_cell() {
    let pool = ReplyPool::new(1, 1, 0);
    let ticket = pool.acquire().unwrap();
    let running = pool.begin(ticket.token(), LOST).unwrap();
    assert_eq!(ticket.wait(now_ns(), |_, _| panic!("no answer")), Reply::DeadlineMayRun);
    assert!(pool.acquire().is_none(), "the server still writes into the cell");
    running.finish(0, |ret, _| {
        ret[0] = 1;
        0
    });
    assert!(pool.acquire().is_some());
}

#[test]
fn a_server_that_vanishes_answers_with_the_status_for_it() {
    let pool = ReplyPool::new(1, 0, 4);
    let ticket = pool.acquire().unwrap();
    drop(pool.begin(ticket.token(), LOST).unwrap());
    assert_eq!(ticket.wait(0, |_, text| assert!(text.is_empty())), Reply::Done(LOST));
}

#[test]
fn a_fill_that_panics_answers_like_a_vanished_server() {
    let pool = ReplyPool::new(1, 0, 4);
    let ticket = pool.acquire().unwrap();
    let running = pool.begin(ticket.token(), LOST).unwrap();
    let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        running.finish(0, |_, _| panic!("on purpose"));
    }));
    assert!(panicked.is_err());
    assert_eq!(ticket.wait(0, |_, _| {}), Reply::Done(LOST));
}

#[test]
fn a_dropped_entry_is_failed_once() {
    let pool = ReplyPool::new(1, 0, 0);
    let ticket = pool.acquire().unwrap();
    assert!(pool.fail(ticket.token(), -5));
    assert!(!pool.fail(ticket.token(), -6));
    assert_eq!(ticket.wait(0, |_, _| {}), Reply::Done(-5));
}

#[test]
fn old_zero_and_foreign_tokens_fit_nothing() {
    let pool = ReplyPool::new(1, 0, 0);
    let old = pool.acquire().unwrap().token();
    let ticket = pool.acquire().unwrap();
    assert_ne!(ticket.token(), 0);
    for token in [0, old, u64::MAX, 1, ticket.token() ^ (1 << 35), ticket.token() + 1] {
        assert!(pool.begin(token, LOST).is_none(), "token {token:#x}");
    }
    assert!(pool.begin(ticket.token(), LOST).is_some());
}

#[test]
fn a_text_that_claims_to_be_too_long_is_cut() {
    let pool = ReplyPool::new(1, 0, 4);
    let ticket = pool.acquire().unwrap();
    pool.begin(ticket.token(), LOST).unwrap().finish(0, |_, text| text.len() + 100);
    let _ = ticket.wait(0, |_, text| assert_eq!(text.len(), 4));
}

#[test]
fn callers_and_a_server_on_other_threads_never_mix_answers_up() {
    const CALLERS: u64 = 3;
    const EACH: u64 = 4_000;
    let pool = ReplyPool::new(CALLERS as usize, 8, 0);
    let (send, receive) = mpsc::channel::<(u64, u64)>();
    let answered = Arc::new(AtomicU64::new(0));
    let server = {
        let pool = Arc::clone(&pool);
        thread::spawn(move || {
            for (token, n) in receive {
                if let Some(running) = pool.begin(token, LOST) {
                    running.finish(n as i32, |ret, _| {
                        ret.copy_from_slice(&(n * 3).to_ne_bytes());
                        0
                    });
                }
            }
        })
    };
    let callers: Vec<_> = (0..CALLERS)
        .map(|caller| {
            let (pool, send, answered) = (Arc::clone(&pool), send.clone(), Arc::clone(&answered));
            thread::spawn(move || {
                for i in 0..EACH {
                    let n = caller * EACH + i;
                    // A call that was given up keeps its cell until the server is done with it.
                    let ticket = loop {
                        match pool.acquire() {
                            Some(ticket) => break ticket,
                            None => thread::yield_now(),
                        }
                    };
                    send.send((ticket.token(), n)).unwrap();
                    // Every eighth caller has no patience: then either end may come first.
                    let patience = if i % 8 == 0 { 2_000 } else { SOON };
                    let reply = ticket.wait(now_ns() + patience, |ret, _| {
                        assert_eq!(ret, (n * 3).to_ne_bytes(), "the answer of another call");
                    });
                    match reply {
                        Reply::Done(status) => {
                            assert_eq!(status, n as i32);
                            answered.fetch_add(1, Ordering::Relaxed);
                        }
                        other => assert_eq!(i % 8, 0, "{other:?} with a minute to go"),
                    }
                }
            })
        })
        .collect();
    drop(send);
    callers.into_iter().for_each(|c| c.join().unwrap());
    server.join().unwrap();
    assert!(answered.load(Ordering::Relaxed) >= CALLERS * EACH * 7 / 8);
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn whoever_waits_is_answered_when_the_server_is_gone() {
    let pool = ReplyPool::new(4, 8, 8);
    let waiting = pool.acquire().unwrap();
    let begun = pool.acquire().unwrap();
    let given_up = pool.acquire().unwrap();
    let running = [&begun, &given_up].map(|ticket| pool.begin(ticket.token(), 1).unwrap());
    assert_eq!(given_up.wait(0, |_, _| ()), Reply::DeadlineMayRun);
    pool.end_all(-7);
    for ticket in [waiting, begun] {
        assert_eq!(ticket.wait(u64::MAX, |_, _| ()), Reply::Done(-7));
    }
    // An answer of the first server comes too late, and its cell is no other call's by now.
    running.into_iter().for_each(|running| running.finish(3, |_, _| 0));
    let fresh = pool.acquire().unwrap();
    let last = [pool.acquire(), pool.acquire()];
    assert_eq!(
        last.iter().flatten().count(),
        1,
        "those that were given up stay away, the one that came back does not"
    );
    assert_eq!(fresh.wait(0, |_, _| ()), Reply::DeadlineNotStarted);
}

#[test]
fn a_caller_that_looks_finds_the_answer_when_it_is_there_and_is_rung() {
    let pool = ReplyPool::new(2, 8, 8);
    let bell = Arc::new(Waker::new());
    pool.ringing(bell.clone());
    let ticket = pool.acquire().unwrap();
    let token = ticket.token();
    let ticket = ticket.take(|_, _| panic!("nothing is there")).err().unwrap();
    let running = pool.begin_kept(token, -1).unwrap();
    let ticket = ticket.recall().err().unwrap();
    assert!(!bell.take(), "nothing was answered yet");
    running.finish(7, |ret, text| {
        ret[0] = 3;
        text[0] = b'x';
        1
    });
    assert!(bell.take());
    let answer = ticket.take(|ret, text| assert_eq!((ret[0], text), (3, &b"x"[..])));
    assert!(matches!(answer, Ok(Reply::Done(7))));
    assert_eq!(pool.in_use(), 0);
}

#[test]
fn a_call_that_was_recalled_is_never_begun() {
    let pool = ReplyPool::new(1, 0, 0);
    let ticket = pool.acquire().unwrap();
    let token = ticket.token();
    assert!(ticket.recall().is_ok());
    assert!(pool.begin(token, -1).is_none() && pool.begin_kept(token, -1).is_none());
    // The cell is another call's by now, which the old one does not touch.
    let next = pool.acquire().unwrap();
    assert!(pool.begin(token, -1).is_none());
    drop(pool.begin_kept(next.token(), -9));
    assert!(matches!(next.take(|_, _| ()), Ok(Reply::Done(-9))), "dropped, it is answered all the same");
}
