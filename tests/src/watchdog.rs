//! The watchdog of a wait: it measures progress, and ends a wait that comes no closer to its end.
//!
//! Invariant: it claims nothing about speed. A machine that is slow, or that stands still, takes as long as
//! it likes. Unit tests of other crates include this file, so it needs the standard library alone.

use std::collections::HashSet;
use std::fmt::Display;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::{Duration, Instant};

/// Time without progress after which a wait is in vain.
const STANDSTILL: Duration = Duration::from_secs(60);
/// Most that counts of the time between two looks: while a machine stands still, nobody can make progress.
const BETWEEN: Duration = Duration::from_secs(2);
/// Time after which even a value that is new at each look, such as a counter that never reaches its goal, is
/// in vain.
const MOST: Duration = Duration::from_secs(300);

/// Watches one wait: told what each look has seen, it panics when the wait is in vain.
pub struct Watchdog {
    what: String,
    began: Instant,
    looked: Instant,
    /// Time without progress.
    still: Duration,
    /// Hashes of all that was seen: what comes back is no progress.
    seen: HashSet<u64>,
}

impl Watchdog {
    /// Begins to watch the wait for this.
    pub fn of(what: impl Into<String>) -> Watchdog {
        let now = Instant::now();
        Watchdog { what: what.into(), began: now, looked: now, still: Duration::ZERO, seen: HashSet::new() }
    }

    /// Notes what a look has seen. Something that was never seen before is progress.
    ///
    /// # Panics
    /// When nothing new was seen for a minute, or after five minutes in any case.
    #[track_caller]
    pub fn saw(&mut self, seen: impl Display) {
        let seen = seen.to_string();
        if let Some(why) = self.in_vain(&seen, Instant::now()) {
            panic!("waited in vain for: {}\n{why}\nlast seen: {seen}", self.what);
        }
    }

    /// Why the wait is in vain, if it is.
    fn in_vain(&mut self, seen: &str, now: Instant) -> Option<String> {
        let mut hasher = DefaultHasher::new();
        seen.hash(&mut hasher);
        let passed = (now - self.looked).min(BETWEEN);
        self.looked = now;
        self.still = if self.seen.insert(hasher.finish()) { Duration::ZERO } else { self.still + passed };
        if self.still > STANDSTILL {
            return Some(format!("nothing new was seen for {:?}", self.still));
        }
        let all = now - self.began;
        (all > MOST).then(|| format!("something new was seen again and again, for {all:?} in all"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks every second, at what `seen` says of each second; when the wait was given up, s.
    fn given_up(seen: impl Fn(u64) -> String) -> u64 {
        let mut watchdog = Watchdog::of("its end");
        let began = watchdog.began;
        let in_vain = |s: &u64| watchdog.in_vain(&seen(*s), began + Duration::from_secs(*s)).is_some();
        (0..1000).find(in_vain).expect("every wait ends")
    }

    #[test]
    fn a_standstill_is_in_vain_after_a_minute() {
        assert_eq!(given_up(|_| "nothing".into()), 61);
    }

    #[test]
    fn each_new_value_begins_the_minute_anew() {
        assert_eq!(given_up(|s| format!("{} of 4 are there", (s / 50).min(3))), 150 + 61);
    }

    #[test]
    fn values_that_come_back_are_a_standstill() {
        assert_eq!(given_up(|s| (s % 7).to_string()), 6 + 61);
    }

    #[test]
    fn a_counter_that_never_reaches_its_goal_ends_after_five_minutes() {
        assert_eq!(given_up(|s| s.to_string()), 301);
    }

    #[test]
    fn time_in_which_the_machine_stood_still_counts_as_one_look() {
        let mut watchdog = Watchdog::of("its end");
        let began = watchdog.began;
        let mut at = |s| watchdog.in_vain("nothing", began + Duration::from_secs(s));
        assert_eq!((at(0), at(200), at(201)), (None, None, None));
    }

    #[test]
    #[should_panic(expected = "waited in vain for: its end")]
    fn a_wait_in_vain_is_told_with_what_was_awaited() {
        let mut watchdog = Watchdog::of("its end");
        watchdog.still = STANDSTILL;
        watchdog.saw("nothing");
        watchdog.still = 2 * STANDSTILL;
        watchdog.saw("nothing");
    }
}
