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
mod tests {
    use std::sync::atomic::AtomicUsize;
    use std::sync::mpsc;

    use super::*;
    use crate::cell::BindingCell;

    /// Turns are of the whole process: one test at a time.
    static ALONE: Mutex<()> = Mutex::new(());

    struct Counted(u32, Arc<AtomicUsize>);

    impl Drop for Counted {
        fn drop(&mut self) {
            self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        }
    }

    #[test]
    fn a_value_looked_at_in_a_turn_is_dropped_only_after_the_turn() {
        let _alone = ALONE.lock();
        let drops = Arc::new(AtomicUsize::new(0));
        let dropped = || drops.load(std::sync::atomic::Ordering::Relaxed);
        let value = |n| Box::new(Counted(n, Arc::clone(&drops)));
        let cell = Arc::new(BindingCell::new(value(1)));
        let (tell, told) = mpsc::channel();
        let (go, wait) = mpsc::channel::<()>();
        let other = Arc::clone(&cell);
        let thread = std::thread::spawn(move || {
            run(|| {
                other.look(|seen| {
                    tell.send(seen.0).unwrap();
                    wait.recv().unwrap();
                    assert_eq!(seen.0, 1, "the value stays while it is looked at");
                });
                assert_eq!(other.look(|seen| seen.0), 2, "the next look sees the new one");
                tell.send(0).unwrap();
                wait.recv().unwrap();
            });
        });
        assert_eq!(told.recv().unwrap(), 1);
        assert_eq!(cell.swap(value(2)), 1, "a turn is under way");
        go.send(()).unwrap();
        told.recv().unwrap();
        assert_eq!((cell.reclaim(), dropped()), (1, 0), "the turn has not ended");
        go.send(()).unwrap();
        thread.join().unwrap();
        assert_eq!((cell.reclaim(), dropped()), (0, 1));
    }

    #[test]
    fn a_turn_that_panics_ends_and_a_nested_one_is_part_of_the_outer() {
        let _alone = ALONE.lock();
        let caught = std::panic::catch_unwind(|| run(|| panic!("as components do")));
        assert!(caught.is_err());
        assert!(!is_inside());
        run(|| {
            run(|| assert!(is_inside()));
            assert!(is_inside(), "the inner one has not ended the outer");
        });
        assert!(!is_inside());
    }
}

#[cfg(all(test, loom))]
mod models {
    use super::*;
    use crate::cell::BindingCell;

    struct Tracked(loom::cell::UnsafeCell<u32>);

    impl Tracked {
        fn number(&self) -> u32 {
            // SAFETY: loom fails the model when a drop is not ordered against this.
            self.0.with(|p| unsafe { *p })
        }
    }

    impl Drop for Tracked {
        fn drop(&mut self) {
            // SAFETY: as above.
            self.0.with_mut(|p| unsafe { *p = u32::MAX });
        }
    }

    fn tracked(n: u32) -> Box<Tracked> {
        Box::new(Tracked(loom::cell::UnsafeCell::new(n)))
    }

    /// Weakening the begin, the manager's look at the seat or the end to Relaxed each fails this model.
    #[test]
    fn loom_a_value_replaced_during_a_turn_outlives_it_and_later_turns_see_the_new_one() {
        loom::model(|| {
            let seats = Arc::new(Seats::new());
            let cell = Arc::new(BindingCell::new(tracked(1)));
            let (mine, theirs) = (Arc::clone(&seats), Arc::clone(&cell));
            let seat = seats.take();
            let reader = loom::thread::spawn(move || {
                for _ in 0..2 {
                    let turn = Turn::begin(&seat);
                    // SAFETY: the turn is known to `seats`, which is asked at each swap, and lasts until it
                    // is dropped below.
                    let n = unsafe { theirs.look_in_turn(|t| t.number()) };
                    assert!(n == 1 || n == 2);
                    drop(turn);
                }
            });
            cell.swap_after(tracked(2), |_| {}, || mine.under_way());
            cell.reclaim();
            reader.join().expect("the reader does not panic");
            assert_eq!(cell.reclaim(), 0);
        });
    }
}
