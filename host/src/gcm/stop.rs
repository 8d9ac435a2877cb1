//! Stop: waits for no other request, stops all it can, and wins over whatever is being started at the same
//! time.
//!
//! Invariant: a Stop is marked before it is planned, and a started component is entered in the graph before
//! the marks are looked at; so one of the two always sees the other.

use std::collections::BTreeSet;
use std::time::Instant;

use trocar_lcm_api::Report;
use trocar_model::{
    Change, ComponentId, Health, Plan, Refusal, Request, State, StopReason, Target, Verb, allowed, plan_all,
};

use super::Gcm;
use super::claims::Claim;
use super::execute::{Executed, HUNG, UNDO, id_of};
use super::requests::Answer;
use super::text;

/// A change set being carried out.
pub(super) struct Carrying<'a> {
    gcm: &'a Gcm,
    claim: Claim<'a>,
}

impl<'a> Carrying<'a> {
    pub(super) fn begin(gcm: &'a Gcm, claim: Claim<'a>, plan: &Plan) -> Carrying<'a> {
        let carrying = Carrying { gcm, claim };
        carrying.goes_on(plan);
        carrying
    }

    /// Carries out this plan, too, which touches nothing that another request has; false: it does.
    pub(super) fn widens(&self, plan: &Plan, is_whole: bool) -> bool {
        let is_free = self.claim.widen(plan, is_whole);
        if is_free {
            self.goes_on(plan);
        }
        is_free
    }

    fn goes_on(&self, plan: &Plan) {
        let moves = |change: &&Change| {
            matches!(change, Change::Run { from: State::Active, .. } | Change::Run { to: State::Active, .. })
        };
        let moving: BTreeSet<_> = plan.changes.iter().filter(moves).map(|c| id_of(c).clone()).collect();
        self.claim.marks(|marks| marks.moving.extend(moving));
    }

    /// Carries out one change. A component that a Stop named meanwhile is not set in motion, or not left so.
    /// A component that hangs and is to be stopped or removed is not waited for.
    pub(super) async fn one(&self, change: &Change, deadline: Instant) -> Result<Report, Refusal> {
        self.claim.doing(text::asked(change));
        let Change::Run { id, verb, to: State::Active, .. } = change else {
            return tokio::select! {
                biased;
                done = self.gcm.one(change, deadline) => done,
                refusal = self.given_up(change) => Err(refusal),
            };
        };
        self.not_stopped(id, *verb)?;
        let to = State::Stopped(StopReason::Requested);
        let stop = Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to };
        let done = tokio::select! {
            biased;
            done = self.gcm.one(change, deadline) => done,
            refusal = self.given_up(change) => {
                // The caller is told that the component stands still only when its Stop is done or known to
                // hang.
                if let Err(e) = self.gcm.one(&stop, Instant::now() + HUNG).await {
                    log::error!("{} was given up: {e}", text::asked(change));
                }
                return Err(refusal);
            }
        };
        let report = match done {
            Ok(report) => report,
            Err(refusal @ Refusal::LcmTimeout { .. }) => {
                // The start may still be done, late; no caller may be told that it failed and see the
                // component move. The Stop is not waited for: the caller's time is over.
                let gcm = self.gcm.clone();
                tokio::spawn(async move { gcm.one(&stop, Instant::now() + UNDO).await });
                return Err(refusal);
            }
            Err(refusal) => return Err(refusal),
        };
        if let Err(refusal) = self.not_stopped(id, *verb) {
            self.gcm.one(&stop, Instant::now() + UNDO).await?;
            return Err(refusal);
        }
        Ok(report)
    }

    fn not_stopped(&self, id: &ComponentId, verb: Verb) -> Result<(), Refusal> {
        if !self.claim.marks(|marks| marks.stops.iter().any(|target| names(target, id))) {
            return Ok(());
        }
        let state = State::Stopped(StopReason::Requested);
        let why = format!("it was stopped while this {verb} was being carried out");
        Err(Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why })
    }

    /// Ends when the component of the change hangs and is to be stopped or removed.
    async fn given_up(&self, change: &Change) -> Refusal {
        let (id, verb, moves) = match change {
            Change::Run { id, verb, to, .. } if !matches!(verb, Verb::Stop | Verb::Remove) => {
                (id, *verb, *to == State::Active)
            }
            Change::Configure { id, .. } => (id, Verb::Configure, false),
            _ => return std::future::pending().await,
        };
        let (mut graphs, mut marked) = (self.gcm.watch(), self.claim.news());
        loop {
            let hung = graphs.borrow_and_update().components.get(id).map(|c| (c.state, c.health));
            marked.mark_unchanged();
            if moves
                && matches!(hung, Some((_, Health::Unresponsive)))
                && let Err(refusal) = self.not_stopped(id, verb)
            {
                return refusal;
            }
            if let Some((state, Health::Unresponsive)) = hung
                && self.claim.marks(|marks| marks.removed.contains(id))
            {
                let why = format!("it hangs and is being removed while this {verb} was being carried out");
                return Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why };
            }
            // Neither ends before this does.
            tokio::select! {
                _ = graphs.changed() => {}
                _ = marked.changed() => {}
            }
        }
    }
}

pub(super) fn names(target: &Target, id: &ComponentId) -> bool {
    match target {
        Target::One(one) => one == id,
        Target::Glob(pattern) => pattern.matches(id),
    }
}

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
