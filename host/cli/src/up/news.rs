//! Components of a running system that have come into trouble, or are out of it again.
//!
//! Invariant: pure; each trouble is told once, and one that comes and goes is told at most once a second.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::standing::Standing;
use crate::view::ComponentView;

/// Time that a hang lasts before people hear of it, and time between two sentences about one component.
const PAUSE: Duration = Duration::from_secs(1);

/// One sentence about a component.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct News {
    pub(super) component: ComponentView,
    /// `None`: it is well again.
    pub(super) trouble: Option<String>,
}

/// Sentences said about one component.
#[derive(Default)]
struct Told {
    trouble: Option<String>,
    at: Option<Instant>,
    /// Trouble to be told next, and the time since when it lasts.
    coming: Option<(Option<String>, Instant)>,
}

#[derive(Default)]
pub(super) struct Ears {
    told: BTreeMap<String, Told>,
}

impl Ears {
    /// Begins with the present troubles, which are told already.
    pub(super) fn of(standing: &Standing) -> Ears {
        let told = |c: &ComponentView| Told { trouble: trouble(c), ..Told::default() };
        Ears { told: standing.components.iter().map(|(path, c)| (path.clone(), told(c))).collect() }
    }

    /// Returns the news to be told now, and the earliest time of more. A process that is not there gives
    /// none: its own end is told.
    pub(super) fn look(&mut self, standing: &Standing, now: Instant) -> (Vec<News>, Option<Instant>) {
        let (mut news, mut next) = (Vec::new(), None);
        if !standing.heard {
            return (news, next);
        }
        self.told.retain(|path, _| standing.components.contains_key(path));
        for (path, component) in &standing.components {
            let process = path.split('/').next().unwrap_or_default();
            let told = self.told.entry(path.clone()).or_default();
            if standing.processes.get(process).is_none_or(|p| p.state != "ATTACHED") {
                told.coming = None;
                continue;
            }
            let trouble = trouble(component);
            if trouble == told.trouble {
                told.coming = None;
                continue;
            }
            let since = match &told.coming {
                Some((coming, since)) if *coming == trouble => *since,
                _ => now,
            };
            told.coming = Some((trouble.clone(), since));
            let waits = if component.health == "UNRESPONSIVE" { PAUSE } else { Duration::ZERO };
            let due = (since + waits).max(told.at.map_or(now, |at| at + PAUSE));
            if now < due {
                next = next.into_iter().chain([due]).min();
                continue;
            }
            *told = Told { trouble: trouble.clone(), at: Some(now), coming: None };
            news.push(News { component: component.clone(), trouble });
        }
        (news, next)
    }
}

/// Returns the trouble of a component, unless it was asked for.
fn trouble(c: &ComponentView) -> Option<String> {
    match (c.state.as_str(), c.health.as_str()) {
        ("FAULT", _) if c.fault.is_empty() => Some("is in FAULT".to_owned()),
        ("FAULT", _) => Some(format!("is in FAULT: {}", c.fault)),
        (_, "UNRESPONSIVE") => Some("does not come back".to_owned()),
        ("STOPPED{requested}", _) => None,
        (state, _) if state.starts_with("STOPPED{") => Some(format!("is {state}")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::ProcessView;

    fn standing(state: &str, health: &str) -> Standing {
        let process = ProcessView { name: "a".into(), state: "ATTACHED".into(), ..ProcessView::default() };
        let component = ComponentView {
            path: "a/x".into(),
            state: state.into(),
            health: health.into(),
            fault: if state == "FAULT" { "chaos in step".into() } else { String::new() },
            ..ComponentView::default()
        };
        Standing::of_one(process, component)
    }

    fn said(news: &[News]) -> Vec<Option<&str>> {
        news.iter().map(|n| n.trouble.as_deref()).collect()
    }

    #[test]
    fn a_fault_is_told_once_and_so_is_its_end() {
        let (mut ears, now) = (Ears::of(&standing("ACTIVE", "OK")), Instant::now());
        let fault = standing("FAULT", "OK");
        assert_eq!(said(&ears.look(&fault, now).0), [Some("is in FAULT: chaos in step")]);
        assert_eq!(ears.look(&fault, now + 3 * PAUSE), (Vec::new(), None));
        assert_eq!(said(&ears.look(&standing("ACTIVE", "OK"), now + 3 * PAUSE).0), [None]);
        assert_eq!(ears.look(&standing("STOPPED{requested}", "OK"), now + 9 * PAUSE).0, []);
    }

    #[test]
    fn what_was_said_at_the_start_is_not_said_again() {
        let mut ears = Ears::of(&standing("STOPPED{restarted}", "OK"));
        assert_eq!(ears.look(&standing("STOPPED{restarted}", "OK"), Instant::now()).0, []);
    }

    #[test]
    fn a_hang_has_to_last_and_one_that_comes_and_goes_is_told_once_a_second() {
        let (mut ears, now) = (Ears::of(&standing("ACTIVE", "OK")), Instant::now());
        let hangs = standing("ACTIVE", "UNRESPONSIVE");
        assert_eq!(ears.look(&hangs, now), (Vec::new(), Some(now + PAUSE)));
        assert_eq!(ears.look(&standing("ACTIVE", "OK"), now + PAUSE / 2).0, []);
        assert_eq!(ears.look(&hangs, now + PAUSE).0, [], "it has come back meanwhile");
        assert_eq!(said(&ears.look(&hangs, now + 2 * PAUSE).0), [Some("does not come back")]);
        let soon = now + 2 * PAUSE + PAUSE / 4;
        assert_eq!(ears.look(&standing("ACTIVE", "OK"), soon), (Vec::new(), Some(now + 3 * PAUSE)));
    }

    #[test]
    fn of_a_process_that_is_gone_nothing_is_said() {
        let (mut ears, now) = (Ears::of(&standing("ACTIVE", "OK")), Instant::now());
        let mut gone = standing("FAULT", "LOST");
        if let Some(process) = gone.processes.get_mut("a") {
            process.state = "RESTARTING".into();
        }
        assert_eq!(ears.look(&gone, now), (Vec::new(), None));
        let silent = Standing { heard: false, ..standing("FAULT", "OK") };
        assert_eq!(ears.look(&silent, now), (Vec::new(), None));
    }
}
