//! The clock of the process at the other end of a line, as far as it is known here.
//!
//! Both ends tell, with each beat, when it was sent, and when the last beat of the other one came: from
//! such a pair the distance of the clocks follows to half of what the way there and back took (RFC 5905,
//! section 8). The quickest of the last beats counts. Invariant: the distance that is told is wrong by
//! the bound beside it at most, as long as the other end tells the truth.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

use parking_lot::Mutex;

/// Beats that are looked back on.
const WINDOW: usize = 64;
/// Drift of two quartz clocks against each other, parts in 10⁹: what computers' clocks are specified for.
const DRIFT: u64 = 100_000;
/// A way there and back beyond this says nothing, ns.
const LONGEST_NS: u64 = 10_000_000_000;

/// Times of the beats of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Beat {
    /// When this beat was sent, by the sender's clock, ns.
    pub(super) sent_ns: u64,
    /// When the other end's last beat was sent, by its own clock; 0: none came yet.
    pub(super) heard_ns: u64,
    /// When that one came, by the sender's clock.
    pub(super) came_ns: u64,
}

/// The clock of the other end: any thread may ask.
#[derive(Debug, Default)]
pub struct Clock {
    /// Their clock less this one, ns.
    offset_ns: AtomicI64,
    bound_ns: AtomicU64,
    round_trip_ns: AtomicU64,
    book: Mutex<Book>,
}

#[derive(Debug, Default)]
struct Book {
    /// The other end's last beat, and when it came.
    last: Option<(u64, u64)>,
    tries: Vec<Try>,
    next: usize,
}

#[derive(Clone, Copy, Debug)]
struct Try {
    at_ns: u64,
    round_trip_ns: u64,
    offset_ns: i64,
}

impl Try {
    fn bound_ns(self, now_ns: u64) -> u64 {
        let age_ns = now_ns.saturating_sub(self.at_ns);
        self.round_trip_ns / 2 + (u128::from(age_ns) * u128::from(DRIFT) / 1_000_000_000) as u64
    }
}

impl Clock {
    /// A time of the other end's clock, by this one; 0 stays 0.
    pub fn here(&self, theirs_ns: u64) -> u64 {
        if theirs_ns == 0 {
            return 0;
        }
        let here = i128::from(theirs_ns) - i128::from(self.offset_ns());
        // From before this machine's start: as old as can be, and never new.
        here.clamp(1, i128::from(u64::MAX)) as u64
    }

    /// Their clock less this one, ns.
    pub fn offset_ns(&self) -> i64 {
        self.offset_ns.load(Ordering::Relaxed)
    }

    /// The most by which the offset is wrong, ns.
    pub fn bound_ns(&self) -> u64 {
        self.bound_ns.load(Ordering::Relaxed)
    }

    /// The quickest way there and back of late, ns; 0: none is known.
    pub fn round_trip_ns(&self) -> u64 {
        self.round_trip_ns.load(Ordering::Relaxed)
    }

    pub(super) fn is_known(&self) -> bool {
        self.round_trip_ns() > 0
    }

    /// The beat to send now.
    pub(super) fn beat(&self, now_ns: u64) -> Beat {
        let (heard_ns, came_ns) = self.book.lock().last.unwrap_or_default();
        Beat { sent_ns: now_ns, heard_ns, came_ns }
    }

    /// Takes in a beat that came at `now_ns`.
    pub(super) fn heard(&self, beat: Beat, now_ns: u64) {
        let mut book = self.book.lock();
        book.last = Some((beat.sent_ns, now_ns));
        if beat.heard_ns == 0 {
            return;
        }
        let there_ns = beat.sent_ns.wrapping_sub(beat.came_ns);
        let away_ns = now_ns.wrapping_sub(beat.heard_ns);
        if away_ns > LONGEST_NS || there_ns > away_ns {
            return;
        }
        let (out, back) = (beat.came_ns.wrapping_sub(beat.heard_ns), beat.sent_ns.wrapping_sub(now_ns));
        let offset_ns = i128::midpoint(out.cast_signed().into(), back.cast_signed().into()) as i64;
        let seen = Try { at_ns: now_ns, round_trip_ns: (away_ns - there_ns).max(1), offset_ns };
        let at = book.next;
        book.next = (at + 1) % WINDOW;
        match book.tries.get_mut(at) {
            Some(old) => *old = seen,
            None => book.tries.push(seen),
        }
        let Some(best) = book.tries.iter().copied().min_by_key(|one| one.bound_ns(now_ns)) else { return };
        self.offset_ns.store(best.offset_ns, Ordering::Relaxed);
        self.bound_ns.store(best.bound_ns(now_ns), Ordering::Relaxed);
        self.round_trip_ns.store(best.round_trip_ns, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two clocks, one `ahead_ns` of the other, with ways that take so long there and back.
    fn exchanged(ahead_ns: u64, ways: &[(u64, u64)]) -> (Clock, Clock) {
        let (ours, theirs) = (Clock::default(), Clock::default());
        let mut now = 100_000_000_000;
        for (there, back) in ways {
            let beat = ours.beat(now);
            now += there;
            theirs.heard(beat, now.wrapping_add(ahead_ns));
            now += 30_000;
            let beat = theirs.beat(now.wrapping_add(ahead_ns));
            now += back;
            ours.heard(beat, now);
            now += 10_000_000;
        }
        (ours, theirs)
    }

    #[test]
    fn the_true_distance_lies_within_the_bound_whatever_the_ways_took() {
        for ahead in [0, 77_000_000_000_u64, 77_000_000_000_u64.wrapping_neg()] {
            let ways = [(900_000, 20_000), (40_000, 700_000), (31_000, 45_000), (5_000_000, 10_000)];
            let (ours, theirs) = exchanged(ahead, &ways);
            let wrong = ours.offset_ns().wrapping_sub(ahead.cast_signed()).unsigned_abs();
            assert!(wrong <= ours.bound_ns() && ours.bound_ns() < 50_000, "{wrong} of {}", ours.bound_ns());
            let wrong = theirs.offset_ns().wrapping_add(ahead.cast_signed()).unsigned_abs();
            assert!(wrong <= theirs.bound_ns(), "{wrong} of {}", theirs.bound_ns());
            let stamp = 90_000_000_000_u64.wrapping_add(ahead);
            assert!(ours.here(stamp).abs_diff(90_000_000_000) <= ours.bound_ns());
        }
    }

    #[test]
    fn a_clock_that_drifts_is_followed() {
        let ways: Vec<_> = (0..200).map(|_| (20_000, 20_000)).collect();
        let (ours, _) = exchanged(0, &ways);
        // The other clock goes on 50 µs ahead of where it was.
        for n in 0..2 * WINDOW as u64 {
            let now = 20_000_000_000 + n * 10_000_000;
            ours.heard(
                Beat {
                    sent_ns: now + 50_000 - 10_000,
                    heard_ns: now - 20_000,
                    came_ns: now + 50_000 - 10_000,
                },
                now,
            );
        }
        assert!(ours.offset_ns().abs_diff(50_000) <= ours.bound_ns(), "{}", ours.offset_ns());
    }

    #[test]
    fn a_stamp_from_before_this_machine_s_start_is_old_and_one_beyond_all_times_new() {
        let (ours, _) = exchanged(77_000_000_000, &[(20_000, 20_000)]);
        assert_eq!(ours.here(1_000_000_000), 1, "the other machine had been up for longer than this one");
        let (ours, _) = exchanged(77_000_000_000_u64.wrapping_neg(), &[(20_000, 20_000)]);
        assert_eq!(ours.here(u64::MAX), u64::MAX);
    }

    #[test]
    fn beats_that_cannot_be_change_nothing() {
        let (ours, _) = exchanged(0, &[(20_000, 20_000)]);
        let before = (ours.offset_ns(), ours.bound_ns());
        for beat in [
            Beat { sent_ns: u64::MAX, heard_ns: 1, came_ns: 0 },
            Beat { sent_ns: 5, heard_ns: u64::MAX, came_ns: 9 },
            Beat { sent_ns: 0, heard_ns: 0, came_ns: u64::MAX },
        ] {
            ours.heard(beat, 100_000_100_000);
        }
        assert_eq!((ours.offset_ns(), ours.bound_ns()), before);
        assert_eq!(ours.here(0), 0);
    }
}
