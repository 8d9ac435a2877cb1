//! A turn against a manager that replaces the value it looks at.

use std::sync::Arc;

use crate::cell::BindingCell;
use crate::turn::{Seats, Turn};

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
