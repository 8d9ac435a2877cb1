//! Nothing on the step path allocates or frees: counted by the allocator itself, per thread.
#![allow(clippy::unwrap_used)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use trocar_rt::cell::BindingCell;
use trocar_rt::exclusive::TryCell;
use trocar_rt::executor::{Pace, Pacer};
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::pool::FramePool;
use trocar_rt::reply::ReplyPool;
use trocar_rt::state::state_table;
use trocar_rt::stream::{DropPolicy, Meta, Payload, Queue, stream_link};
use trocar_rt::team::Team;
use trocar_rt::timing::CycleStats;
use trocar_rt::wake::{WakeList, Waker};

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
    /// `CALLS` when this thread ended its last slice of a team's work.
    static AT_LAST_SLICE: Cell<Option<u64>> = const { Cell::new(None) };
}

struct Counting;

fn counted() {
    let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        counted();
        // SAFETY: as asked for by the caller.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        counted();
        // SAFETY: as asked for by the caller.
        unsafe { System.dealloc(start, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[track_caller]
fn allocates_nothing(what: &str, mut step: impl FnMut()) {
    for _ in 0..100 {
        let before = CALLS.get();
        step();
        assert_eq!(CALLS.get() - before, 0, "{what}: calls of the allocator");
    }
}

#[test]
fn the_counter_counts() {
    let before = CALLS.get();
    drop(Box::new(5));
    assert_eq!(CALLS.get() - before, 2);
}

#[test]
fn a_step_over_all_primitives_never_calls_the_allocator() {
    let (mut state, states) = state_table(100, 4);
    let mut row = [0; 100];
    let mut other = [0; 100];
    let mut cursor = 0;
    allocates_nothing("state table", || {
        state.publish(1, 1, |row| row.fill(1));
        states.latest(&mut row).unwrap();
        states.delayed(0, &mut row).unwrap();
        states.at_tick(1, &mut row).unwrap();
        states.at_time(1, &mut row).unwrap();
        states.around(1, &mut row, &mut other).unwrap();
        states.read_batch(&mut cursor, &mut row, |_, _| {});
    });

    let mail = Mailbox::new(4, 64, 2);
    allocates_nothing("mailbox", || {
        for overflow in [Overflow::Reject, Overflow::LatestWins, Overflow::DropOldest] {
            for _ in 0..6 {
                let _: Push = mail.push(EntryHead::default(), &[1; 64], overflow);
            }
            mail.drain(|_, _| {}, |_| {});
        }
    });

    let replies = ReplyPool::new(2, 8, 64);
    allocates_nothing("reply", || {
        let ticket = replies.acquire().unwrap();
        replies.begin(ticket.token(), 0).unwrap().finish(0, |_, _| 0);
        let _ = ticket.wait(0, |_, _| {});
    });

    let cell = BindingCell::new(Box::new(1));
    allocates_nothing("cell", || assert_eq!(*cell.enter(), 1));

    let pool = FramePool::new(8, 64, 4096).unwrap();
    allocates_nothing("pool", || drop(pool.loan().unwrap().freeze(1).clone()));

    for queue in [Queue::Latest, Queue::Fifo { depth: 3, drop: DropPolicy::DropOldest }] {
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: 64 }, queue);
        allocates_nothing("stream of bytes", || {
            for _ in 0..5 {
                let _ = writer.push(&[1; 64], Meta::default());
            }
            reader.next().unwrap();
            reader.latest().unwrap();
        });
        let (writer, mut reader) = stream_link(Payload::Frame, queue);
        allocates_nothing("stream of frames", || {
            for _ in 0..5 {
                let _ = writer.push_frame(pool.loan().unwrap().freeze(9), Meta::default());
            }
            reader.next().unwrap();
            reader.take_frame();
            reader.release();
        });
    }

    let waker = Arc::new(Waker::new());
    let mut wakes = WakeList::new();
    allocates_nothing("wakes", || {
        wakes.add(&waker);
        wakes.flush();
        assert!(waker.wait(Some(0)));
        waker.notify();
        assert!(waker.take());
    });

    let stats = CycleStats::new(1_000);
    allocates_nothing("timing", || {
        stats.record(10, 20, 5);
        stats.record_skipped(1);
        stats.snapshot();
        stats.pause();
        stats.reset(1_000);
    });

    let exclusive = TryCell::new(1);
    allocates_nothing("exclusive cell", || {
        let inside = exclusive.try_enter();
        assert!(inside.is_some() && exclusive.try_enter().is_none());
    });
}

#[test]
fn ten_thousand_cycles_of_every_pace_never_call_the_allocator() {
    let waker = Waker::new();
    let grid = |catch_up| Pace::Grid { period_ns: 10_000, phase_ns: 5_000, catch_up };
    for pace in [grid(0), grid(3), Pace::Free, Pace::Signal] {
        let mut pacer = Pacer::new(pace);
        let stats = CycleStats::new(10_000);
        let before = CALLS.get();
        for _ in 0..10_000 {
            let cycle = pacer.next(&waker, || true).unwrap();
            stats.record(cycle.begin_ns, cycle.begin_ns + 100, cycle.begin_ns - cycle.deadline_ns);
            stats.record_skipped(cycle.skipped);
        }
        waker.notify();
        pacer.rest(&waker);
        assert_eq!(CALLS.get() - before, 0, "{pace:?}: calls of the allocator");
        assert_eq!(stats.snapshot().executed, 10_000);
    }
}

/// The helpers' calls are counted too: each slice looks at the counter of its own thread before and after.
#[test]
fn the_slices_of_a_team_never_call_the_allocator() {
    let team = Team::new(3, |_| {}).unwrap();
    // From its first slice on, neither a helper's work nor its sleeping and waking may reach the allocator.
    let body = |_: u32| match AT_LAST_SLICE.replace(Some(CALLS.get())) {
        Some(calls) if calls != CALLS.get() => -1,
        _ => 0,
    };
    allocates_nothing("team", || assert_eq!(team.run(7, &body), 0, "a helper called the allocator"));
}
