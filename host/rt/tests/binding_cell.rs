//! A binding is replaced under its callers without making them wait or pulling it away from under them.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;

use trocar_rt::cell::BindingCell;

/// A value that shows its own end.
struct Value {
    number: usize,
    gone: Arc<AtomicUsize>,
}

impl Drop for Value {
    fn drop(&mut self) {
        self.number = usize::MAX;
        self.gone.fetch_add(1, Ordering::Relaxed);
    }
}

fn value(number: usize, gone: &Arc<AtomicUsize>) -> Box<Value> {
    Box::new(Value { number, gone: Arc::clone(gone) })
}

#[test]
fn a_replaced_value_lives_until_its_last_caller_leaves() {
    let gone = Arc::default();
    let cell = BindingCell::new(value(1, &gone));
    let (outer, inner) = (cell.enter(), cell.enter());
    assert_eq!(cell.swap(value(2, &gone)), 1);
    assert_eq!((outer.number, inner.number, cell.enter().number), (1, 1, 2));
    drop(outer);
    assert_eq!(cell.reclaim(), 1, "one caller is still inside");
    drop(inner);
    assert_eq!(gone.load(Ordering::Relaxed), 0, "a caller never drops a value");
    assert_eq!(cell.reclaim(), 0);
    assert_eq!(gone.load(Ordering::Relaxed), 1);
}

#[test]
fn values_replaced_one_after_the_other_go_each_in_its_own_time() {
    let gone = Arc::default();
    let cell = BindingCell::new(value(0, &gone));
    let guards: Vec<_> = (1..=4)
        .map(|n| {
            let guard = cell.enter();
            cell.swap(value(n, &gone));
            guard
        })
        .collect();
    assert_eq!(cell.reclaim(), 4);
    for (n, guard) in guards.into_iter().enumerate().rev() {
        assert_eq!(guard.number, n);
        drop(guard);
        assert_eq!(cell.reclaim(), n);
    }
}

#[test]
fn a_value_nobody_is_inside_goes_with_the_swap() {
    let gone = Arc::default();
    let cell = BindingCell::new(value(1, &gone));
    drop(cell.enter());
    assert_eq!(cell.swap(value(2, &gone)), 0);
    drop(cell);
    assert_eq!(gone.load(Ordering::Relaxed), 2);
}

#[test]
fn a_value_may_replace_its_own_binding_while_it_is_entered() {
    let gone = Arc::default();
    let cell = BindingCell::new(value(1, &gone));
    let guard = cell.enter();
    cell.swap(value(2, &gone));
    assert_eq!(guard.number, 1);
}

#[test]
fn callers_beside_a_busy_manager_always_meet_a_living_value() {
    let gone = Arc::default();
    let cell = BindingCell::new(value(0, &gone));
    let stop = AtomicBool::new(false);
    const SWAPS: usize = 20_000;
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                let mut last = 0;
                while !stop.load(Ordering::Relaxed) {
                    let guard = cell.enter();
                    let nested = cell.enter();
                    assert_ne!(guard.number, usize::MAX, "entered a dropped value");
                    assert!(last <= guard.number && guard.number <= nested.number, "went back");
                    last = guard.number;
                }
            });
        }
        for n in 1..=SWAPS {
            cell.swap(value(n, &gone));
        }
        stop.store(true, Ordering::Relaxed);
    });
    assert_eq!(cell.reclaim(), 0);
    assert_eq!(gone.load(Ordering::Relaxed), SWAPS);
}
