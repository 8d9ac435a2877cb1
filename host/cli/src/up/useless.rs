//! Processes that live but are of no use: unheard for too long, unfit for anything new, or holding a
//! component that does not come back.
//!
//! Invariant: pure; a verdict is on one incarnation only, and on a process that moves something only where
//! its policy says so.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::standing::Standing;
use trocar::processes::{Phase, Status, Unheard};

/// Process that may be put down, and why.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Verdict {
    pub(super) process: String,
    pub(super) pid: u32,
    pub(super) why: String,
}

/// Reason to put down an incarnation of a process.
#[derive(Clone, Debug, PartialEq)]
enum Wrong {
    Lost,
    /// This component does not come back.
    Hangs(String),
    /// The process can do nothing new, and says why.
    Unfit(String),
}

/// Reasons to put processes down, and the times since when they hold.
#[derive(Default)]
pub(super) struct Patience {
    since: BTreeMap<String, (u32, Wrong, Instant)>,
}

impl Patience {
    /// Returns the processes whose time is over, and the time of the next one.
    pub(super) fn look(
        &mut self,
        statuses: &BTreeMap<String, Status>,
        standing: &Standing,
        policies: &BTreeMap<String, Unheard>,
        now: Instant,
    ) -> (Vec<Verdict>, Option<Instant>) {
        let (mut over, mut next) = (Vec::new(), None);
        let mut since = BTreeMap::new();
        for (name, policy) in policies {
            let Some(status) = statuses.get(name).filter(|s| s.phase == Phase::Running) else { continue };
            let moves = standing.within(name).any(|c| c.safety == "actuator");
            let (Some(limit), Some(wrong)) = (policy.limit(moves), wrong(standing, name, status.pid)) else {
                continue;
            };
            let before = self.since.get(name).filter(|(pid, was, _)| (*pid, was) == (status.pid, &wrong));
            let at = before.map_or(now, |(_, _, at)| *at);
            if now < at + limit {
                next = next.into_iter().chain([at + limit]).min();
            } else {
                over.push(Verdict { process: name.clone(), pid: status.pid, why: wrong.said(limit) });
            }
            since.insert(name.clone(), (status.pid, wrong, at));
        }
        self.since = since;
        (over, next)
    }
}

/// Tells whether a verdict on this incarnation still holds.
pub(super) fn is_so(standing: &Standing, said: &Verdict) -> bool {
    wrong(standing, &said.process, said.pid).is_some()
}

impl Wrong {
    fn said(&self, limit: Duration) -> String {
        let limit = limit.as_secs_f64();
        match self {
            Wrong::Lost => format!("was not heard for {limit} s"),
            Wrong::Hangs(path) => format!("held {path}, which did not come back for {limit} s,"),
            Wrong::Unfit(why) => format!("was unfit for {limit} s ({why})"),
        }
    }
}

/// Returns the reason to put down this incarnation. A GCM that does not answer says nothing
/// about any process.
fn wrong(standing: &Standing, name: &str, pid: u32) -> Option<Wrong> {
    let process = standing.processes.get(name).filter(|p| standing.heard && p.pid == pid)?;
    match process.state.as_str() {
        "LOST" => Some(Wrong::Lost),
        "ATTACHED" => {
            let hangs = standing.within(name).find(|c| c.health == "UNRESPONSIVE");
            let unfit = || process.warnings.last().filter(|_| process.unfit);
            hangs.map(|c| Wrong::Hangs(c.path.clone())).or_else(|| unfit().cloned().map(Wrong::Unfit))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{ComponentView, ProcessView};

    fn standing(state: &str, health: &str, safety: &str) -> Standing {
        let process = ProcessView { name: "a".into(), state: state.into(), pid: 7, ..ProcessView::default() };
        let component = ComponentView {
            path: "a/x".into(),
            health: health.into(),
            safety: safety.into(),
            ..ComponentView::default()
        };
        Standing::of_one(process, component)
    }

    fn running(pid: u32) -> BTreeMap<String, Status> {
        [("a".to_owned(), Status { phase: Phase::Running, pid, ..Status::default() })].into()
    }

    fn usual() -> BTreeMap<String, Unheard> {
        [("a".to_owned(), Unheard::Usual)].into()
    }

    #[test]
    fn it_is_said_when_the_time_is_over_and_not_before() {
        let (mut patience, now) = (Patience::default(), Instant::now());
        for (state, health, said) in
            [("LOST", "LOST", "was not heard for 10 s"), ("ATTACHED", "UNRESPONSIVE", "held a/x")]
        {
            let lost = standing(state, health, "sensor");
            let (over, next) = patience.look(&running(7), &lost, &usual(), now);
            assert_eq!((over, next), (Vec::new(), Some(now + Unheard::USUAL)));
            let (over, _) = patience.look(&running(7), &lost, &usual(), now + Unheard::USUAL);
            assert!(over[0].pid == 7 && over[0].why.starts_with(said), "{over:?}");
        }
    }

    #[test]
    fn one_that_can_do_nothing_new_is_put_down_and_says_why() {
        let (mut patience, now) = (Patience::default(), Instant::now());
        let mut full = standing("ATTACHED", "OK", "sensor");
        for process in full.processes.values_mut() {
            process.warnings = vec!["it uses much memory".into(), "all its files are in use".into()];
        }
        assert_eq!(patience.look(&running(7), &full, &usual(), now), (Vec::new(), None), "it is only warned");
        full.processes.values_mut().for_each(|process| process.unfit = true);
        patience.look(&running(7), &full, &usual(), now);
        let (over, _) = patience.look(&running(7), &full, &usual(), now + Unheard::USUAL);
        assert_eq!(over[0].why, "was unfit for 10 s (all its files are in use)");
        let actuator = Standing { ..full.clone() };
        assert!(is_so(&actuator, &over[0]));
    }

    #[test]
    fn one_that_is_heard_again_or_another_incarnation_has_all_its_time() {
        let (mut patience, now) = (Patience::default(), Instant::now());
        let lost = standing("LOST", "LOST", "sensor");
        patience.look(&running(7), &lost, &usual(), now);
        patience.look(&running(7), &standing("ATTACHED", "OK", "sensor"), &usual(), now);
        let later = now + Unheard::USUAL;
        assert_eq!(patience.look(&running(7), &lost, &usual(), later).0, []);
        assert_eq!(patience.look(&running(8), &lost, &usual(), later).0, [], "the GCM speaks of another");
    }

    #[test]
    fn a_silent_gcm_and_what_moves_something_condemn_nobody() {
        let (mut patience, now) = (Patience::default(), Instant::now());
        let silent = Standing { heard: false, ..standing("LOST", "LOST", "sensor") };
        let actuator = standing("LOST", "LOST", "actuator");
        for case in [silent, actuator.clone()] {
            assert_eq!(patience.look(&running(7), &case, &usual(), now), (Vec::new(), None));
        }
        let asked = [("a".to_owned(), Unheard::After(Duration::from_secs(1)))].into();
        patience.look(&running(7), &actuator, &asked, now);
        let (over, _) = patience.look(&running(7), &actuator, &asked, now + Duration::from_secs(1));
        assert_eq!(over.len(), 1, "its policy says so");
    }
}
