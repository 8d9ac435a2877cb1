//! Decides whether and when an ended process is started again, and how long a living one may be of no use,
//! from its ends alone.
//!
//! Invariant: pure; more than `max` restarts within `within` never happen, and a process that ended as asked
//! is never started again.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Policy for the end of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    Never,
    OnFailure(Limits),
}

/// Time after which a living process that is not heard, or holds a component that does not come back, is
/// killed and started again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unheard {
    /// After [`Unheard::USUAL`], or never when something in it moves something.
    Usual,
    Never,
    After(Duration),
}

impl Unheard {
    pub const USUAL: Duration = Duration::from_secs(10);

    /// Returns how long a process may be unheard; `None`: for ever.
    pub fn limit(self, moves: bool) -> Option<Duration> {
        match self {
            Unheard::Usual if moves => None,
            Unheard::Usual => Some(Unheard::USUAL),
            Unheard::Never => None,
            Unheard::After(limit) => Some(limit),
        }
    }
}

/// Number and pace of restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Restarts within `within`.
    pub max: u32,
    pub within: Duration,
    /// Pause before the second restart within that time; it doubles for each further one. The first restart
    /// is at once.
    pub backoff: Duration,
    pub most_backoff: Duration,
    /// Time from its spawn until it serves; then it is killed, which counts as a failure.
    pub start_within: Duration,
    pub unheard: Unheard,
}

impl Limits {
    /// Three within ten seconds.
    pub const DEFAULT: Limits = Limits {
        max: 3,
        within: Duration::from_secs(10),
        backoff: Duration::from_millis(50),
        most_backoff: Duration::from_secs(2),
        start_within: Duration::from_secs(60),
        unheard: Unheard::Usual,
    };
}

impl Default for Policy {
    fn default() -> Self {
        Policy::OnFailure(Limits::DEFAULT)
    }
}

impl Policy {
    pub(super) fn start_within(self) -> Duration {
        match self {
            Policy::Never => Limits::DEFAULT.start_within,
            Policy::OnFailure(limits) => limits.start_within,
        }
    }

    /// Returns when a process that is of no use is put down; never for a process that would not be started
    /// again.
    pub fn unheard(self) -> Unheard {
        match self {
            Policy::Never => Unheard::Never,
            Policy::OnFailure(limits) => limits.unheard,
        }
    }
}

/// Kind of the end of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum How {
    /// The process was asked to end, and said so.
    AsAsked,
    /// The process said why it does not start.
    Refused,
    Failed,
}

/// Consequence of an end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Restart {
        after: Duration,
    },
    /// The process ended too often.
    GiveUp,
    /// Nobody wants it back.
    Leave,
}

/// Pause after a first refusal, and the longest: the obstacle is seldom gone at once.
const REFUSED: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));

/// The restarts of one process.
#[derive(Debug)]
pub(super) struct History {
    policy: Policy,
    restarts: VecDeque<Instant>,
    /// Refusals one after the other, without any other end between.
    refusals: u32,
}

impl History {
    pub(super) fn new(policy: Policy) -> History {
        History { policy, restarts: VecDeque::new(), refusals: 0 }
    }

    /// Records an end at `now` and returns its consequence.
    pub(super) fn ended(&mut self, how: How, now: Instant) -> Verdict {
        let limits = match self.policy {
            _ if how == How::AsAsked => return Verdict::Leave,
            Policy::Never => return Verdict::GiveUp,
            Policy::OnFailure(limits) => limits,
        };
        while self.restarts.front().is_some_and(|at| now.saturating_duration_since(*at) > limits.within) {
            self.restarts.pop_front();
        }
        let recent = u32::try_from(self.restarts.len()).unwrap_or(u32::MAX);
        if recent >= limits.max {
            return Verdict::GiveUp;
        }
        let pause = |before: u32| limits.backoff.saturating_mul(1 << before.min(16)).min(limits.most_backoff);
        let mut after = recent.checked_sub(1).map_or(Duration::ZERO, pause);
        if how == How::Refused {
            after = after.max(REFUSED.0.saturating_mul(1 << self.refusals.min(16)).min(REFUSED.1));
            self.refusals += 1;
        } else {
            self.refusals = 0;
        }
        self.restarts.push_back(now + after);
        Verdict::Restart { after }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_storm_ends_after_three_restarts_and_the_pauses_grow() {
        let (mut history, mut now) = (History::new(Policy::default()), Instant::now());
        let mut pauses = Vec::new();
        while let Verdict::Restart { after } = history.ended(How::Failed, now) {
            pauses.push(after.as_millis());
            now += after + Duration::from_millis(10);
        }
        assert_eq!(pauses, [0, 50, 100]);
    }

    #[test]
    fn one_that_crashes_now_and_then_comes_back_for_ever() {
        let (mut history, mut now) = (History::new(Policy::default()), Instant::now());
        for _ in 0..1000 {
            let after = Duration::ZERO;
            assert_eq!(history.ended(How::Failed, now), Verdict::Restart { after });
            now += Duration::from_secs(11);
        }
        assert!(history.restarts.len() <= 3, "it remembers all its life: {}", history.restarts.len());
    }

    #[test]
    fn the_pause_has_an_end() {
        let limits = Limits { max: 100, ..Limits::DEFAULT };
        let (mut history, now) = (History::new(Policy::OnFailure(limits)), Instant::now());
        let last = (0..100).map(|_| history.ended(How::Failed, now)).last();
        assert_eq!(last, Some(Verdict::Restart { after: Duration::from_secs(2) }));
        assert_eq!(history.ended(How::Failed, now), Verdict::GiveUp);
    }

    #[test]
    fn one_that_refuses_to_start_is_asked_less_and_less_often() {
        let limits = Limits { max: u32::MAX, most_backoff: Duration::from_millis(200), ..Limits::DEFAULT };
        let (mut history, mut now) = (History::new(Policy::OnFailure(limits)), Instant::now());
        let mut pauses = Vec::new();
        for _ in 0..9 {
            let Verdict::Restart { after } = history.ended(How::Refused, now) else { break };
            pauses.push(after.as_millis());
            now += after;
        }
        assert_eq!(pauses, [100, 200, 400, 800, 1600, 3200, 5000, 5000, 5000]);
        assert_eq!(history.ended(How::Failed, now), Verdict::Restart { after: Duration::from_millis(200) });
        assert_eq!(history.refusals, 0);
    }

    #[test]
    fn what_ended_as_asked_stays_away_and_never_means_never() {
        let now = Instant::now();
        assert_eq!(History::new(Policy::default()).ended(How::AsAsked, now), Verdict::Leave);
        assert_eq!(History::new(Policy::Never).ended(How::Failed, now), Verdict::GiveUp);
        assert_eq!(History::new(Policy::Never).ended(How::AsAsked, now), Verdict::Leave);
    }

    #[test]
    fn what_moves_something_is_put_down_only_where_the_policy_says_so() {
        assert_eq!(Policy::default().unheard().limit(false), Some(Unheard::USUAL));
        assert_eq!(Policy::default().unheard().limit(true), None);
        let after = Unheard::After(Duration::from_secs(2));
        assert_eq!(after.limit(true), Some(Duration::from_secs(2)));
        assert_eq!((Unheard::Never.limit(false), Policy::Never.unheard()), (None, Unheard::Never));
    }
}
