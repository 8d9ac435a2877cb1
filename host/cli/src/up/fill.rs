//! Makes everything of a system file in its processes, and waits until it has made its first steps.
//!
//! Invariant: a process that crashes meanwhile is filled once more, as long as its supervisor starts it
//! again. A component that moves something was not asked to go on after a crash, so it is not started again.

use std::collections::BTreeSet;
use std::time::Duration;

use tokio::time::Instant;
use trocar_model::{ComponentId, Request, Target};

use super::{BRING_UP, System};
use crate::failure::Failure;
use crate::named::placed;
use crate::session::Session;
use crate::view::{ComponentView, SystemView};
use trocar::processes::Phase;
use trocar::system_file::{ComponentSpec, SystemFile};

/// Pause between two looks, the shortest and the longest.
const LOOK: (Duration, Duration) = (Duration::from_millis(5), Duration::from_millis(100));
/// Time that the first steps of all components are waited for.
const FIRST_STEPS: Duration = Duration::from_secs(3);

/// Result of filling the processes.
#[derive(Default)]
pub(super) struct Filled {
    pub(super) standing: SystemView,
    pub(super) warnings: Vec<String>,
    /// Components that were not started, since their processes crashed meanwhile.
    pub(super) waiting: BTreeSet<ComponentId>,
}

/// Tells whether a failure is over when a process is back.
fn passes(failure: &Failure) -> bool {
    failure.reason == "PROCESS_LOST"
}

impl System {
    /// Makes everything of the file in its processes.
    pub(super) async fn fill(&self, file: &SystemFile, names: &[String]) -> Result<Filled, Failure> {
        let Some(session) = &self.session else { return Ok(Filled::default()) };
        let until = Instant::now() + BRING_UP;
        let before = self.restarts();
        let mut last = None;
        loop {
            let listed = match tokio::time::timeout_at(until, self.settled(session, names)).await {
                Ok(settled) => settled?,
                Err(_) => return Err(last.unwrap_or_else(|| self.not_all_up(names))),
            };
            let now = self.restarts();
            let crashed: BTreeSet<&str> =
                names.iter().filter(|n| now.get(*n) != before.get(*n)).map(String::as_str).collect();
            match self.attempt(file, names, &listed, &crashed, session).await {
                Ok(filled) => return Ok(filled),
                Err(failure) if passes(&failure) => {
                    log::warn!("{}; everything is made once more", failure.message);
                    last = Some(failure);
                }
                Err(failure) => return Err(placed(file, failure)),
            }
        }
    }

    async fn attempt(
        &self,
        file: &SystemFile,
        names: &[String],
        listed: &SystemView,
        crashed: &BTreeSet<&str>,
        session: &Session,
    ) -> Result<Filled, Failure> {
        // Removes the components of an earlier attempt, or of a system of this name that was killed.
        session.apply(&removes(listed, names), BRING_UP).await?;
        let starts = |c: &&ComponentSpec| c.start && !crashed.contains(c.id.process.as_str());
        let mut requests = file.requests();
        requests.retain(|r| !matches!(r, Request::Start { .. }));
        requests.extend(start(file.components.iter().filter(starts)));
        let mut warnings = session.apply(&requests, BRING_UP).await?.warnings;
        let mut waiting = BTreeSet::new();
        if !crashed.is_empty() {
            let made = session.standing().await?;
            let moves = |c: &ComponentSpec| {
                let path = c.id.to_string();
                made.components.iter().any(|m| m.path == path && m.safety == "actuator")
            };
            let late = || file.components.iter().filter(|c| c.start && !starts(c));
            let goes_on = |c: &&ComponentSpec| c.resumes || !moves(c);
            let requests: Vec<Request> = start(late().filter(goes_on)).into_iter().collect();
            warnings.extend(session.apply(&requests, BRING_UP).await?.warnings);
            waiting.extend(late().filter(|c| !goes_on(c)).map(|c| c.id.clone()));
        }
        let standing = first_steps(file, session).await?;
        Ok(Filled { standing, warnings, waiting })
    }

    /// Waits until all serve and the GCM has all of them; returns the state then.
    async fn settled(&self, session: &Session, names: &[String]) -> Result<SystemView, Failure> {
        let mut pause = LOOK.0;
        loop {
            self.serving(names).await?;
            let statuses = self.supervisor.statuses().borrow().clone();
            // A GCM of another owner may be restarted meanwhile.
            if let Ok(listed) = session.standing().await {
                let there = |name: &String| {
                    let pid = statuses.get(name).filter(|s| s.phase == Phase::Running).map(|s| s.pid);
                    let is_it = |p: &&crate::view::ProcessView| {
                        p.name == *name && p.state == "ATTACHED" && Some(p.pid) == pid
                    };
                    listed.processes.iter().any(|p| is_it(&p))
                };
                if names.iter().all(there) {
                    return Ok(listed);
                }
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(LOOK.1);
        }
    }

    fn restarts(&self) -> std::collections::BTreeMap<String, u32> {
        self.supervisor.statuses().borrow().iter().map(|(name, s)| (name.clone(), s.restarts)).collect()
    }
}

/// Takes out what these processes have.
fn removes(listed: &SystemView, names: &[String]) -> Vec<Request> {
    let ids = listed.components.iter().filter_map(|c| ComponentId::parse(&c.path).ok());
    let ours = ids.filter(|id| names.iter().any(|name| name == id.process.as_str()));
    ours.map(|id| Request::Remove { id, force: true }).collect()
}

fn start<'a>(components: impl Iterator<Item = &'a ComponentSpec>) -> Option<Request> {
    let targets: Vec<Target> = components.map(|c| Target::One(c.id.clone())).collect();
    (!targets.is_empty()).then_some(Request::Start { targets })
}

/// Waits until every started component has stepped, or does not run after all; returns the state then.
async fn first_steps(file: &SystemFile, session: &Session) -> Result<SystemView, Failure> {
    let started: BTreeSet<String> =
        file.components.iter().filter(|c| c.start).map(|c| c.id.to_string()).collect();
    let until = Instant::now() + FIRST_STEPS;
    let mut pause = LOOK.0;
    loop {
        let listed = session.figures().await?;
        let mine = |c: &&ComponentView| started.contains(&c.path);
        if Instant::now() > until || listed.components.iter().filter(mine).all(has_stepped) {
            return Ok(listed);
        }
        tokio::time::sleep(pause).await;
        pause = (pause * 2).min(LOOK.1);
    }
}

/// Tells that there is nothing to wait for: the component is past its first step, does not run, or steps only
/// when something comes. The first step is known to have gone well when there was a second one.
fn has_stepped(c: &ComponentView) -> bool {
    let e = &c.execution;
    let by_itself = match e.model.as_str() {
        "" | "periodic" => e.period_ns > 0 && e.stream_of.is_empty() && e.inside.is_empty(),
        model => model == "continuous",
    };
    let slow = e.period_ns > 200_000_000;
    c.state != "ACTIVE" || c.health == "UNRESPONSIVE" || !by_itself || c.stats.executed > u64::from(!slow)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_steps_are_awaited_of_what_steps_by_itself() {
        let component = |model: &str, period_ns: u64, executed: u64| {
            let mut c = ComponentView { state: "ACTIVE".into(), ..ComponentView::default() };
            (c.execution.model, c.execution.period_ns) = (model.to_owned(), period_ns);
            c.stats.executed = executed;
            c
        };
        assert!(!has_stepped(&component("periodic", 1_000_000, 0)));
        assert!(!has_stepped(&component("periodic", 1_000_000, 1)), "the first one may not be over");
        assert!(has_stepped(&component("periodic", 1_000_000, 2)));
        assert!(has_stepped(&component("periodic", 1_000_000_000, 1)), "nobody waits a second more");
        assert!(has_stepped(&component("on_signal", 0, 0)));
        assert!(has_stepped(&ComponentView { state: "FAULT".into(), ..component("periodic", 1, 0) }));
    }

    #[test]
    fn only_what_lies_in_the_processes_of_the_file_is_removed() {
        let there = |path: &str| ComponentView { path: path.into(), ..ComponentView::default() };
        let listed = SystemView {
            components: vec![there("a/x"), there("b/y"), there("ab/z")],
            ..SystemView::default()
        };
        let removes = removes(&listed, &["a".to_owned()]);
        let paths: Vec<String> = removes
            .iter()
            .filter_map(|r| match r {
                Request::Remove { id, force: true } => Some(id.to_string()),
                _ => None,
            })
            .collect();
        assert_eq!(paths, ["a/x"]);
    }
}
