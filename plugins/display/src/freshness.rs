//! The age of the newest picture, for the thread that shows it while the step does not run.
//!
//! Invariant: one number each way, without a lock; only what can be shown counts as new.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_sdk::prelude::*;

/// The text of a mark changes so often, s.
const TOLD_EVERY_S: f64 = 0.5;

/// When the newest picture was taken, and from what age on it is stale.
#[derive(Default)]
pub(crate) struct Freshness {
    /// Stamp, ns; 0 = none yet.
    newest_ns: AtomicU64,
    /// 0 = never.
    limit_ns: AtomicU64,
}

/// A stale picture and its age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stale {
    pub(crate) age_s: f64,
}

impl Stale {
    /// Changes as often as its mark does.
    pub(crate) fn turn(self) -> u64 {
        (self.age_s / TOLD_EVERY_S) as u64
    }
}

/// The time of a picture that comes `now`, which is at the latest now: a camera whose clock is ahead would
/// show a picture that stands still as a live one for as long.
pub(crate) fn taken(stamp: Stamp, now: Stamp) -> Stamp {
    if stamp.is_valid() { stamp.min(now) } else { now }
}

impl Freshness {
    /// From what age on a picture is stale, s; 0: never.
    pub(crate) fn limit(&self, limit_s: f64) {
        self.limit_ns.store((limit_s * 1e9) as u64, Ordering::Relaxed);
    }

    /// A picture of this time is the newest one; one without a stamp, or of a time still to come, is of now.
    pub(crate) fn renewed(&self, stamp: Stamp, now: Stamp) {
        self.newest_ns.store(taken(stamp, now).ns(), Ordering::Relaxed);
    }

    /// Returns the age of the newest picture, when it is too old.
    pub(crate) fn stale(&self, now: Stamp) -> Option<Stale> {
        let (newest_ns, limit_ns) =
            (self.newest_ns.load(Ordering::Relaxed), self.limit_ns.load(Ordering::Relaxed));
        let age_ns = now.ns().saturating_sub(newest_ns);
        let is_stale = newest_ns > 0 && limit_ns > 0 && age_ns > limit_ns;
        is_stale.then_some(Stale { age_s: age_ns as f64 * 1e-9 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_stale_from_the_limit_on_and_none_is_without_one() {
        let (freshness, at) = (Freshness::default(), |ms: u64| Stamp::from_ns(1_000_000 * ms));
        freshness.limit(0.5);
        assert_eq!(freshness.stale(at(9_000)), None, "none has come");
        freshness.renewed(at(1_000), at(1_010));
        assert_eq!(freshness.stale(at(1_500)), None);
        assert_eq!(freshness.stale(at(900)), None, "before it came");
        let stale = freshness.stale(at(2_200)).unwrap();
        assert!((stale.age_s - 1.2).abs() < 1e-9 && stale.turn() == 2, "{stale:?}");
        freshness.renewed(Stamp::INVALID, at(3_000));
        assert_eq!(freshness.stale(at(3_400)), None);
        freshness.limit(0.0);
        assert_eq!(freshness.stale(at(90_000)), None);
    }

    #[test]
    fn a_picture_from_ahead_is_as_old_as_its_coming() {
        let (freshness, at) = (Freshness::default(), |ms: u64| Stamp::from_ns(1_000_000 * ms));
        freshness.limit(0.5);
        for ahead in [at(60_000), Stamp::from_ns(u64::MAX)] {
            freshness.renewed(ahead, at(1_000));
            assert_eq!(freshness.stale(at(1_400)), None);
            let stale = freshness.stale(at(1_600)).unwrap();
            assert!((stale.age_s - 0.6).abs() < 1e-9, "{stale:?}");
        }
    }
}
