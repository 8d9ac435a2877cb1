//! Whether a process that ended is started again, and when: decided from its ends alone.
//!
//! Invariant: pure; more than `max` restarts within `within` never happen, and what ended as asked is never started again.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::Exit;

/// What follows the end of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    Never,
    OnFailure(Limits),
}

/// How often, and how soon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Restarts within `within`.
    pub max: u32,
    pub within: Duration,
    /// Before the first restart; twice as long before each further one.
    pub backoff: Duration,
    pub most_backoff: Duration,
}

impl Limits {
    /// Three within ten seconds.
    pub const DEFAULT: Limits = Limits {
        max: 3,
        within: Duration::from_secs(10),
        backoff: Duration::from_millis(50),
        most_backoff: Duration::from_secs(2),
    };
}

impl Default for Policy {
    fn default() -> Self {
        Policy::OnFailure(Limits::DEFAULT)
    }
}

/// What is to be done about an end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Restart {
        after: Duration,
    },
    /// It ended too often.
    GiveUp,
    /// Nobody wants it back.
    Leave,
}

/// The restarts of one process.
#[derive(Debug)]
pub(super) struct History {
    policy: Policy,
    restarts: VecDeque<Instant>,
}

impl History {
    pub(super) fn new(policy: Policy) -> History {
        History { policy, restarts: VecDeque::new() }
    }

    /// It ended at `now`.
    pub(super) fn ended(&mut self, exit: &Exit, now: Instant) -> Verdict {
        let limits = match self.policy {
            _ if exit.is_orderly() => return Verdict::Leave,
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
        let after = limits.backoff.saturating_mul(1 << recent.min(16)).min(limits.most_backoff);
        self.restarts.push_back(now + after);
        Verdict::Restart { after }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crash() -> Exit {
        Exit::Signal { number: 11, core: false }
    }

    #[test]
    fn a_storm_ends_after_three_restarts_and_the_pauses_grow() {
        let (mut history, mut now) = (History::new(Policy::default()), Instant::now());
        let mut pauses = Vec::new();
        while let Verdict::Restart { after } = history.ended(&crash(), now) {
            pauses.push(after.as_millis());
            now += after + Duration::from_millis(10);
        }
        assert_eq!(pauses, [50, 100, 200]);
    }

    #[test]
    fn one_that_crashes_now_and_then_comes_back_for_ever() {
        let (mut history, mut now) = (History::new(Policy::default()), Instant::now());
        for _ in 0..1000 {
            let after = Duration::from_millis(50);
            assert_eq!(history.ended(&crash(), now), Verdict::Restart { after });
            now += Duration::from_secs(11);
        }
        assert!(history.restarts.len() <= 3, "it remembers all its life: {}", history.restarts.len());
    }

    #[test]
    fn the_pause_has_an_end() {
        let limits = Limits { max: 100, ..Limits::DEFAULT };
        let (mut history, now) = (History::new(Policy::OnFailure(limits)), Instant::now());
        let last = (0..100).map(|_| history.ended(&crash(), now)).last();
        assert_eq!(last, Some(Verdict::Restart { after: Duration::from_secs(2) }));
        assert_eq!(history.ended(&crash(), now), Verdict::GiveUp);
    }

    #[test]
    fn what_ended_as_asked_stays_away_and_never_means_never() {
        let now = Instant::now();
        assert_eq!(History::new(Policy::default()).ended(&Exit::Code(0), now), Verdict::Leave);
        assert_eq!(History::new(Policy::Never).ended(&crash(), now), Verdict::GiveUp);
        assert_eq!(History::new(Policy::Never).ended(&Exit::Code(0), now), Verdict::Leave);
    }
}
