//! Places of the port: how many callers may be there, and who gives way when files run short.
//!
//! Invariant: the last [`KEPT`] files a process may open are not for callers of its TCP port; another user's
//! programs have at most [`GUESTS`] connections in all. A caller that has said something never gives way.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};

use rustix::process::{Resource, getrlimit};
use tokio::sync::oneshot;

/// Files that are kept for the host itself, for its own user's programs beside the port, and for Stop.
const KEPT: u64 = 64;
/// Connections of other users' programs.
pub(super) const GUESTS: usize = 64;

/// The places of one port.
#[derive(Debug, Default)]
pub(super) struct Seats {
    /// Those who have said nothing yet, in the order they came; dropping what is kept of one lets it go.
    silent: Mutex<BTreeMap<u64, oneshot::Sender<()>>>,
    guests: AtomicUsize,
    next: std::sync::atomic::AtomicU64,
}

/// One caller's place; free again when it is dropped.
#[derive(Debug)]
pub(super) struct Seat {
    seats: Arc<Seats>,
    number: u64,
    given_up: Option<oneshot::Receiver<()>>,
    is_guest: bool,
}

impl Seats {
    /// A place, if there is one for such a caller.
    pub(super) fn take(self: &Arc<Self>, is_guest: bool) -> Option<Seat> {
        if is_guest {
            let more = |guests: usize| (guests < GUESTS).then_some(guests + 1);
            self.guests.fetch_update(Ordering::AcqRel, Ordering::Acquire, more).ok()?;
        }
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let (keep, given_up) = oneshot::channel();
        self.silent().insert(number, keep);
        Some(Seat { seats: self.clone(), number, given_up: Some(given_up), is_guest })
    }

    /// Lets go of the caller that has been silent longest; false: all of them have said something.
    pub(super) fn give_up_one(&self) -> bool {
        self.silent().pop_first().is_some()
    }

    fn silent(&self) -> std::sync::MutexGuard<'_, BTreeMap<u64, oneshot::Sender<()>>> {
        self.silent.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Seat {
    /// From now on it keeps its place.
    pub(super) fn speaks(&mut self) {
        self.given_up = None;
        self.seats.silent().remove(&self.number);
    }

    /// Ready when it has to go.
    pub(super) fn poll_given_up(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        match &mut self.given_up {
            Some(given_up) => Pin::new(given_up).poll(cx).map(|_| ()),
            None => Poll::Pending,
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.seats.silent().remove(&self.number);
        if self.is_guest {
            self.seats.guests.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// True for one of the last files this process may open. The kernel gives out the lowest number that is free.
pub(super) fn is_of_the_last(file: i32) -> bool {
    let most = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX);
    u64::try_from(file).is_ok_and(|file| is_last_of(most, file))
}

fn is_last_of(most: u64, file: u64) -> bool {
    file >= most - KEPT.min(most / 4)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::task::Waker;

    use super::*;

    fn has_to_go(seat: &mut Seat) -> bool {
        seat.poll_given_up(&mut Context::from_waker(Waker::noop())).is_ready()
    }

    #[test]
    fn whoever_was_silent_longest_gives_way_and_nobody_who_spoke() {
        let seats = Arc::new(Seats::default());
        let mut callers: Vec<Seat> = (0..3).map(|_| seats.take(false).unwrap()).collect();
        callers[0].speaks();
        assert!(seats.give_up_one());
        assert_eq!(callers.iter_mut().map(has_to_go).collect::<Vec<_>>(), [false, true, false]);
        drop(callers.pop());
        assert!(!seats.give_up_one(), "one has gone by itself, one was let go, one speaks");
    }

    #[test]
    fn another_users_programs_have_so_many_places_and_no_more_until_one_goes() {
        let seats = Arc::new(Seats::default());
        let mut guests: Vec<Seat> = (0..GUESTS).map(|_| seats.take(true).unwrap()).collect();
        assert!(seats.take(true).is_none());
        assert!(seats.take(false).is_some(), "the host's user is no guest");
        guests.pop();
        assert!(seats.take(true).is_some());
    }

    #[test]
    fn a_few_files_are_kept_however_few_there_are() {
        assert!(is_last_of(1024, 960) && !is_last_of(1024, 959));
        assert!(is_last_of(16, 12) && !is_last_of(16, 11));
        assert!(!is_last_of(u64::MAX, 100_000) && is_last_of(0, 0));
    }
}
