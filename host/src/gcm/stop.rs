//! Stop: waits for no other request, stops all it can, and wins over whatever is being started at the same
//! time.
//!
//! Invariant: a Stop is marked before it is planned, and a started component is entered in the graph before
//! the marks are looked at; so one of the two always sees the other.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_lcm_api::Report;
use trocar_model::{Change, ComponentId, Plan, ProcessState, Refusal, Request, State, Target, plan_all};

use super::answer::{Answer, Executed};
use super::changes::{id_of, names};
use super::wanted::RESTARTED;
use super::{Gcm, text};

/// Time to stop the components that were stopped while their process was away.
const WITHIN: Duration = Duration::from_secs(5);

impl Gcm {
    /// Stops; never refused for a revision, never behind another request.
    pub(super) async fn stop(&self, requests: &[Request], validate_only: bool, deadline: Instant) -> Answer {
        let (against, noted) = if validate_only { (false, false) } else { self.mark(requests) };
        let first = self.stop_now(requests, validate_only, noted, deadline).await;
        if !against {
            return first;
        }
        // A start under way gives up at the mark; OK is told after that, and the second Stop covers what the
        // first did not see.
        let _claim = self.claim_part(requests, deadline, |_| Ok(Plan::default())).await?;
        let second = self.stop_now(requests, false, false, deadline).await;
        match (first, second) {
            (Ok(first), Ok(second)) => Ok(joined(first, second)),
            (Ok(first), Err(_)) => Ok(first),
            (Err(_), second) => second,
        }
    }

    /// Tells the requests under way, and later ones, of these Stops. Returns whether a change under way sets
    /// some of these components in motion, and whether the Stops made a new revision.
    fn mark(&self, requests: &[Request]) -> (bool, bool) {
        let targets = requests.iter().flat_map(|r| match r {
            Request::Stop { targets } => targets.as_slice(),
            _ => &[],
        });
        let targets: Vec<Target> = targets.cloned().collect();
        // A refused Stop changes nothing.
        let noted = plan_all(&self.graph(), requests).is_ok() && self.keep_stopped(&targets);
        let against = self.inner.claims.mark(|marks| {
            marks.stops.extend(targets.iter().cloned());
            marks.moving.iter().any(|id| targets.iter().any(|target| names(target, id)))
        });
        (against, noted)
    }

    /// Tells the requests under way which components are removed by force: those that hang are not waited
    /// for. Returns the component to be removed, when the request is nothing else.
    ///
    /// # Errors
    /// There is no such component. One that is only just being made is not waited for.
    pub(super) fn give_way<'a>(
        &self,
        requests: &'a [Request],
        validate_only: bool,
    ) -> Result<Option<&'a ComponentId>, Refusal> {
        if validate_only {
            return Ok(None);
        }
        let forced = requests.iter().filter_map(|r| match r {
            Request::Remove { id, force: true } => Some(id),
            _ => None,
        });
        let ids: BTreeSet<&ComponentId> = forced.collect();
        if ids.is_empty() {
            return Ok(None);
        }
        let alone = if let [Request::Remove { id, .. }] = requests { Some(id) } else { None };
        if let Some(id) = alone {
            self.graph().component(id)?;
        }
        self.inner.claims.mark(|marks| {
            marks.removed.extend(ids.iter().copied().cloned());
            false
        });
        Ok(alone)
    }

    /// Stops once; `counted`: the Stop has its revision already.
    async fn stop_now(
        &self,
        requests: &[Request],
        validate_only: bool,
        counted: bool,
        deadline: Instant,
    ) -> Answer {
        let graph = self.graph();
        let plan = plan_all(&graph, requests)?;
        let mut done = Executed { revision: graph.revision, plan, ..Executed::default() };
        if validate_only || done.plan.changes.is_empty() {
            return Ok(done);
        }
        self.stop_all(&mut done, deadline).await?;
        done.revision = if counted { self.graph().revision } else { self.accepted() };
        Ok(done)
    }

    /// Stops side by side, so that a component that hangs delays no other.
    async fn stop_all(&self, done: &mut Executed, deadline: Instant) -> Result<(), Refusal> {
        let stops: Vec<_> = done
            .plan
            .changes
            .iter()
            .cloned()
            .map(|change| {
                let gcm = self.clone();
                tokio::spawn(async move { (gcm.stop_one(&change, deadline).await, change) })
            })
            .collect();
        for stop in stops {
            match stop.await {
                Ok((Ok(report), _)) => done.reports.push(report),
                Ok((Err(refusal), change)) => {
                    log::error!("{}: {refusal}", text::asked(&change));
                    done.failed.push((id_of(&change).clone(), refusal));
                }
                Err(e) => return Err(Refusal::Internal { text: format!("stopping panicked: {e}") }),
            }
        }
        match done.failed.first() {
            Some((_, refusal)) if done.reports.is_empty() => Err(refusal.clone()),
            _ => Ok(()),
        }
    }

    /// Notes components that are stopped and cannot be told, because their process is away. True: a component
    /// that might have been set in motion by itself is now to stand still, and the revision is a new one, so
    /// that no earlier decision sets it in motion.
    pub(super) fn keep_stopped(&self, targets: &[Target]) -> bool {
        let mut noted = false;
        self.edit_if(|graph| {
            let mut sessions = self.inner.sessions.lock();
            let stopped =
                graph.components.iter().filter(|(id, _)| targets.iter().any(|target| names(target, id)));
            for (id, component) in stopped {
                let there = |state: ProcessState| state == ProcessState::Attached;
                noted |= match graph.processes.get(&id.process) {
                    Some(process) if there(process.state) => {
                        sessions.wanted.stop_again(id);
                        component.state == RESTARTED
                    }
                    _ => sessions.wanted.stop(id, component.state),
                };
            }
            if noted {
                Arc::make_mut(graph).revision += 1;
            }
            noted
        });
        noted
    }

    /// Stops a component. If its process goes away meanwhile, it is stopped when that process comes back.
    pub(super) async fn stop_one(&self, stop: &Change, deadline: Instant) -> Result<Report, Refusal> {
        let id = id_of(stop);
        let asked = self.inner.sessions.lock().holder(&id.process);
        let lost = match self.one(stop, deadline).await {
            Err(lost @ Refusal::ProcessLost { .. }) => lost,
            done => return done,
        };
        let mut is_back = false;
        self.edit_if(|graph| {
            let mut sessions = self.inner.sessions.lock();
            let holder = sessions.holder(&id.process);
            is_back = holder.is_some() && holder != asked;
            if let Some(component) = graph.components.get(id).filter(|_| !is_back) {
                sessions.wanted.stop(id, component.state);
            }
            false
        });
        if is_back { self.one(stop, deadline).await } else { Err(lost) }
    }

    /// Stops the components that were stopped while their process was away, which has come back as it was.
    pub(super) fn stop_owed(&self, session: u64, owed: Vec<(ComponentId, State)>) {
        for (id, _) in owed {
            let gcm = self.clone();
            tokio::spawn(async move {
                log::warn!("{id} was stopped while its process was away, and runs: it is stopped now");
                let request = [Request::Stop { targets: vec![Target::One(id.clone())] }];
                match gcm.stop(&request, false, Instant::now() + WITHIN).await {
                    // The component is stopped when the process is back again.
                    Err(Refusal::ProcessLost { .. }) => return,
                    Err(refusal) => log::error!("{id} cannot be stopped: {refusal}"),
                    Ok(_) => {}
                }
                let mut sessions = gcm.inner.sessions.lock();
                if sessions.holder(&id.process) == Some(session) {
                    sessions.wanted.stands(&id);
                }
            });
        }
    }
}

/// Joins the two passes of one Stop into one answer.
fn joined(first: Executed, second: Executed) -> Executed {
    let stopped = |id: &ComponentId| first.reports.iter().any(|r| r.id == *id);
    let mut skipped = second.plan.skipped;
    skipped.retain(|s| !stopped(&s.id));
    let changes = first.plan.changes.into_iter().chain(second.plan.changes).collect();
    Executed {
        revision: second.revision,
        plan: Plan { changes, skipped },
        reports: first.reports.into_iter().chain(second.reports).collect(),
        failed: second.failed,
        left: second.left,
    }
}
