//! Places of the port: how many callers it takes, and who gives way when files run short.
//!
//! Invariant: the last [`KEPT`] files a process may open are not for callers of its TCP port; programs of the
//! host's user have at most [`OWN`] connections, those of all other users [`GUESTS`]. A caller that has asked
//! something never gives way.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::task::{Context, Poll, ready};

use parking_lot::Mutex;
use rustix::process::{Resource, getrlimit};
use tokio::sync::oneshot;

/// Files that are kept for the host itself, for its own user's programs beside the port, and for Stop.
const KEPT: u64 = 64;
/// Connections of all other users' programs.
const GUESTS: usize = 64;
/// Connections of the programs of one other user: no user takes the places of the rest.
pub(super) const OF_ONE: usize = 16;

/// Connections of the programs of the host's own user, at one port or socket: a program that opens them
/// without end takes neither the files nor the memory of the host, and none of Stop's socket.
pub(super) const OWN: usize = 768;

/// A caller whose places are counted apart from those of the host's own user.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Guest {
    /// Another user, as the kernel has it; `None`: it does not say.
    User(Option<u32>),
    /// The name in its certificate.
    Holder(String),
}

/// The places of one port.
#[derive(Debug, Default)]
pub(super) struct Seats {
    /// Callers that have said nothing yet, in the order they came.
    silent: Mutex<BTreeMap<u64, Silent>>,
    guests: Mutex<BTreeMap<Guest, usize>>,
    /// Places that the host's own user has.
    own: AtomicUsize,
    next: AtomicU64,
}

/// A caller that has said nothing yet; dropping it lets the caller go.
#[derive(Debug)]
struct Silent {
    _keep: oneshot::Sender<()>,
    is_guest: bool,
}

/// The place of a caller; free again when it is dropped.
#[derive(Debug)]
pub(super) struct Seat {
    seats: Arc<Seats>,
    number: u64,
    life: Life,
    guest: Option<Guest>,
}

/// The way a caller keeps its place.
#[derive(Debug)]
enum Life {
    /// Silent: it may have to give way.
    Silent(oneshot::Receiver<()>),
    Speaks,
    /// The connection has to go.
    GivenUp,
}

impl Seats {
    /// Takes a place, if there is one for such a caller; `guest`: another user, whose places are counted
    /// apart. If the host's own user has none left, one of its own silent callers gives way.
    pub(super) fn take(self: &Arc<Self>, guest: Option<Guest>) -> Option<Seat> {
        if let Some(user) = guest.clone() {
            let mut guests = self.guests.lock();
            let all: usize = guests.values().sum();
            let own = guests.get(&user).copied().unwrap_or(0);
            if all >= GUESTS || own >= OF_ONE {
                return None;
            }
            guests.insert(user, own + 1);
        } else if self.own.fetch_add(1, Ordering::Relaxed) >= OWN && !self.give_up_an_own_one() {
            self.own.fetch_sub(1, Ordering::Relaxed);
            return None;
        }
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let (keep, given_up) = oneshot::channel();
        self.silent.lock().insert(number, Silent { _keep: keep, is_guest: guest.is_some() });
        Some(Seat { seats: self.clone(), number, life: Life::Silent(given_up), guest })
    }

    /// Lets go of the caller that has been silent longest; false: all of them have said something.
    pub(super) fn give_up_one(&self) -> bool {
        self.silent.lock().pop_first().is_some()
    }

    /// The same among callers of the host's own user: other users have places of their own.
    fn give_up_an_own_one(&self) -> bool {
        let mut silent = self.silent.lock();
        let first = silent.iter().find(|(_, caller)| !caller.is_guest).map(|(number, _)| *number);
        first.is_some_and(|number| silent.remove(&number).is_some())
    }
}

impl Seat {
    /// Marks that the caller keeps its place from now on.
    pub(super) fn speaks(&mut self) {
        self.life = Life::Speaks;
        self.seats.silent.lock().remove(&self.number);
    }

    /// Ready when it has to go, and ever after.
    pub(super) fn poll_given_up(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        match &mut self.life {
            Life::Silent(given_up) => ready!(Pin::new(given_up).poll(cx).map(|_| ())),
            Life::Speaks => return Poll::Pending,
            Life::GivenUp => {}
        }
        self.life = Life::GivenUp;
        Poll::Ready(())
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.seats.silent.lock().remove(&self.number);
        let Some(user) = self.guest.take() else {
            self.seats.own.fetch_sub(1, Ordering::Relaxed);
            return;
        };
        let mut guests = self.seats.guests.lock();
        let left = guests.get(&user).map_or(0, |own| own - 1);
        if left == 0 {
            guests.remove(&user);
        } else {
            guests.insert(user, left);
        }
    }
}

/// Tells whether `file` is one of the last files this process may open. The kernel gives out the lowest
/// number that is free.
pub(super) fn is_of_the_last(file: i32) -> bool {
    let most = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX);
    u64::try_from(file).is_ok_and(|file| is_last_of(most, file))
}

fn is_last_of(most: u64, file: u64) -> bool {
    file >= most - KEPT.min(most / 4)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::task::Waker;

    use super::*;

    fn has_to_go(seat: &mut Seat) -> bool {
        seat.poll_given_up(&mut Context::from_waker(Waker::noop())).is_ready()
    }

    #[test]
    fn whoever_was_silent_longest_gives_way_and_nobody_who_spoke() {
        let seats = Arc::new(Seats::default());
        let mut callers: Vec<Seat> = (0..3).map(|_| seats.take(None).unwrap()).collect();
        callers[0].speaks();
        assert!(seats.give_up_one());
        assert_eq!(callers.iter_mut().map(has_to_go).collect::<Vec<_>>(), [false, true, false]);
        drop(callers.pop());
        assert!(!seats.give_up_one(), "one has gone by itself, one was let go, one speaks");
    }

    #[test]
    fn whoever_has_to_go_is_told_so_as_often_as_it_asks() {
        let seats = Arc::new(Seats::default());
        let mut caller = seats.take(None).unwrap();
        assert!(seats.give_up_one());
        assert!(has_to_go(&mut caller) && has_to_go(&mut caller));
    }

    #[test]
    fn another_users_programs_have_so_many_places_and_take_nobody_elses() {
        let seats = Arc::new(Seats::default());
        let mut guests: Vec<Seat> =
            (0..OF_ONE).map(|_| seats.take(Some(Guest::User(Some(7)))).unwrap()).collect();
        assert!(seats.take(Some(Guest::User(Some(7)))).is_none());
        assert!(
            seats.take(Some(Guest::User(Some(8)))).is_some() && seats.take(Some(Guest::User(None))).is_some(),
            "others have their own"
        );
        assert!(seats.take(None).is_some(), "the host's user is no guest");
        guests.pop();
        guests.push(seats.take(Some(Guest::User(Some(7)))).unwrap());
        let rest = (8..).map_while(|user| seats.take(Some(Guest::User(Some(user)))));
        guests.extend(rest.take(2 * GUESTS));
        assert_eq!(guests.len(), GUESTS, "and all of them together");
        guests.clear();
        assert!(seats.guests.lock().is_empty());
    }

    #[test]
    fn the_own_user_has_so_many_places_and_who_says_nothing_gives_way_first() {
        let seats = Arc::new(Seats::default());
        let mut callers: Vec<Seat> = (0..OWN).map(|_| seats.take(None).unwrap()).collect();
        callers[1..].iter_mut().for_each(Seat::speaks);
        let mut late = seats.take(None).expect("the silent one gives way");
        late.speaks();
        assert!(has_to_go(&mut callers[0]) && !has_to_go(&mut callers[1]));
        let mut guest = seats.take(Some(Guest::User(Some(7)))).expect("guests have places of their own");
        assert!(seats.take(None).is_none(), "all have spoken");
        assert!(!has_to_go(&mut guest), "a guest makes no room for the own user");
        drop(guest);
        // The one that had to go, and one more.
        callers.drain(..2);
        assert!(seats.take(None).is_some());
        drop((callers, late));
        assert_eq!(seats.own.load(Ordering::Relaxed), 0);
    }

    #[test]
    fn a_few_files_are_kept_however_few_there_are() {
        assert!(is_last_of(1024, 960) && !is_last_of(1024, 959));
        assert!(is_last_of(16, 12) && !is_last_of(16, 11));
        assert!(!is_last_of(u64::MAX, 100_000) && is_last_of(0, 0));
    }
}
