//! A value that is looked at in a turn outlives it, and turns end however they end.

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
