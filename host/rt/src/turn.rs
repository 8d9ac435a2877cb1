//! Turns: stretches of a thread in which it looks at bindings without counting itself in.
//!
//! A thread that takes turns has a seat whose word is odd during a turn. A manager that has replaced a value
//! reads every seat by a read-modify-write: either it finds the turn and keeps the value until that turn has
//! ended, or the turn begins after it in the word's order, and so sees the new value. No thread waits for
//! another.

use std::cell::Cell;
use std::sync::Arc;

use crate::sync::{AtomicU64, Mutex, Ordering, Padded};

/// One thread's place: odd while it is in a turn, and never twice the same odd number.
pub(crate) struct Seat(Padded<AtomicU64>);

/// The seats of all threads that take turns.
pub(crate) struct Seats(Mutex<Vec<Arc<Seat>>>);

/// Turns that were under way when a value was replaced.
#[derive(Default)]
pub(crate) struct Watched(Vec<(Arc<Seat>, u64)>);

impl Seat {
    fn begin(&self) {
        // Acquire: sees what managers replaced before they looked at this seat; Release: part of the word's
        // chain.
        self.0.0.fetch_add(1, Ordering::AcqRel);
    }

    fn end(&self) {
        // Release: a manager that sees the end comes after every look of this turn. Managers only add 0, so
        // nothing is lost between the load and the store.
        self.0.0.fetch_add(1, Ordering::Release);
    }
}

impl Seats {
    #[cfg(not(loom))]
    const fn new() -> Seats {
        Seats(Mutex::new(Vec::new()))
    }

    #[cfg(loom)]
    pub(crate) fn new() -> Seats {
        Seats(Mutex::new(Vec::new()))
    }

    pub(crate) fn take(&self) -> Arc<Seat> {
        let seat = Arc::new(Seat(Padded(AtomicU64::new(0))));
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(Arc::clone(&seat));
        seat
    }

    #[cfg(not(loom))]
    pub(crate) fn leave(&self, seat: &Arc<Seat>) {
        let mut seats = self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        seats.retain(|s| !Arc::ptr_eq(s, seat));
    }

    /// Returns the turns under way now. Managers only, after the value was replaced.
    pub(crate) fn under_way(&self) -> Watched {
        let seats = self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let mut watched = Vec::new();
        for seat in seats.iter() {
            let word = seat.0.0.fetch_add(0, Ordering::AcqRel);
            if word % 2 == 1 {
                watched.push((Arc::clone(seat), word));
            }
        }
        Watched(watched)
    }
}

impl Watched {
    /// Tells whether every one of them has ended.
    pub(crate) fn are_over(&self) -> bool {
        self.0.iter().all(|(seat, word)| seat.0.0.load(Ordering::Acquire) != *word)
    }
}

/// A turn; dropping it ends it.
pub(crate) struct Turn<'a>(&'a Seat);

impl<'a> Turn<'a> {
    pub(crate) fn begin(seat: &'a Seat) -> Self {
        seat.begin();
        Turn(seat)
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}

#[cfg(not(loom))]
static SEATS: Seats = Seats::new();

/// This thread's seat; given back when the thread ends.
#[cfg(not(loom))]
struct Mine(Arc<Seat>);

#[cfg(not(loom))]
impl Drop for Mine {
    fn drop(&mut self) {
        SEATS.leave(&self.0);
    }
}

thread_local! {
    static IN_TURN: Cell<bool> = const { Cell::new(false) };
}

#[cfg(not(loom))]
thread_local! {
    static SEAT: Mine = Mine(SEATS.take());
}

/// Runs `f` as one turn of this thread, or as part of the turn it is in. The first turn of a thread allocates
/// its seat and takes a mutex; later ones are two atomic operations. A value replaced during a turn is not
/// dropped before its end, so turns end soon: one cycle of an executor.
#[cfg(not(loom))]
pub fn run<R>(f: impl FnOnce() -> R) -> R {
    struct Out;
    impl Drop for Out {
        fn drop(&mut self) {
            IN_TURN.set(false);
        }
    }
    if is_inside() {
        return f();
    }
    SEAT.with(|mine| {
        let _turn = Turn::begin(&mine.0);
        IN_TURN.set(true);
        // Dropped before the turn, also by a panic.
        let _out = Out;
        f()
    })
}

/// Tells whether this thread is in a turn.
#[inline]
pub fn is_inside() -> bool {
    IN_TURN.get()
}

/// The turns of all threads that are under way now.
#[cfg(not(loom))]
pub(crate) fn under_way() -> Watched {
    SEATS.under_way()
}

#[cfg(loom)]
pub(crate) fn under_way() -> Watched {
    Watched::default()
}

#[cfg(all(test, not(loom)))]
mod tests;
