//! A notification is never lost, consumed once, and a step's wakes go out once each, after it.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use trocar_rt::now_ns;
use trocar_rt::wake::{WAKE_LIST_CAPACITY, WakeList, Waker};

#[test]
fn a_notification_left_before_the_wait_ends_it_at_once() {
    let waker = Waker::new();
    assert!(!waker.notify(), "nobody slept, so no system call");
    assert!(!waker.notify());
    assert!(waker.wait(None));
    assert!(!waker.take(), "two notifications before one wait are one");
}

#[test]
fn a_deadline_ends_a_wait_without_notification() {
    let waker = Waker::new();
    let deadline = now_ns() + 2_000_000;
    assert!(!waker.wait(Some(deadline)));
    assert!(now_ns() >= deadline);
    assert!(!waker.wait(Some(0)), "a deadline that has passed");
    waker.notify();
    assert!(waker.wait(Some(0)), "a notification counts more than a deadline");
}

#[test]
fn a_sleeper_is_woken_for_every_message_of_every_notifier() {
    const NOTIFIERS: u64 = 3;
    const EACH: u64 = 10_000;
    let waker = Waker::new();
    let messages = AtomicU64::new(0);
    thread::scope(|scope| {
        for _ in 0..NOTIFIERS {
            scope.spawn(|| {
                for n in 0..EACH {
                    messages.fetch_add(1, Ordering::Relaxed);
                    waker.notify();
                    if n % 64 == 0 {
                        thread::yield_now();
                    }
                }
            });
        }
        let mut seen = 0;
        while seen < NOTIFIERS * EACH {
            assert!(waker.wait(None), "no deadline was given");
            seen += messages.swap(0, Ordering::Relaxed);
        }
    });
}

#[test]
fn a_list_notifies_each_waker_once_and_only_when_flushed() {
    let wakers: Vec<_> = (0..3).map(|_| Arc::new(Waker::new())).collect();
    let mut list = WakeList::new();
    for waker in wakers.iter().chain(&wakers) {
        list.add(waker);
    }
    assert_eq!(list.len(), 3);
    assert!(wakers.iter().all(|w| !w.take()));
    assert_eq!(list.flush(), 3);
    assert!(list.is_empty() && wakers.iter().all(|w| w.take()));
    assert!(wakers.iter().all(|w| Arc::strong_count(w) == 1), "the list keeps nothing");
}

#[test]
fn a_full_list_notifies_further_wakers_at_once() {
    let wakers: Vec<_> = (0..=WAKE_LIST_CAPACITY).map(|_| Arc::new(Waker::new())).collect();
    let mut list = WakeList::new();
    wakers.iter().for_each(|w| list.add(w));
    assert!(wakers.last().unwrap().take());
    drop(list);
    assert!(wakers[..WAKE_LIST_CAPACITY].iter().all(|w| w.take()), "a dropped list is flushed");
}
