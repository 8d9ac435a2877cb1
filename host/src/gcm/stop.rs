//! Stop: it waits for nobody, stops all it can, and wins over whatever is being started at the same time.
//!
//! Invariant: a Stop is marked before it is planned, and a started component is entered in the graph before the marks are
//! looked at; so one of the two always sees the other.

use std::collections::BTreeSet;
use std::time::Instant;

use trocar_model::{
    Change, ComponentId, Plan, Refusal, Request, State, StopReason, Target, Verb, allowed, plan_all,
};

use super::Gcm;
use super::execute::{Executed, UNDO, id_of};
use super::manager::lock;
use super::requests::Answer;
use super::text;
use crate::lcm::Report;

/// What is being carried out now, and the Stops given meanwhile.
#[derive(Default)]
pub(super) struct Carried {
    /// Components the plan, or undoing it, sets in motion.
    moving: BTreeSet<ComponentId>,
    stops: Vec<Target>,
}

/// A change set being carried out; only the holder of the writer's turn has one.
pub(super) struct Carrying<'a> {
    gcm: &'a Gcm,
}

impl Drop for Carrying<'_> {
    fn drop(&mut self) {
        lock(&self.gcm.inner.carried).take();
    }
}

impl<'a> Carrying<'a> {
    pub(super) fn begin(gcm: &'a Gcm, plan: &Plan) -> Carrying<'a> {
        let moves = |change: &&Change| {
            matches!(change, Change::Run { from: State::Active, .. } | Change::Run { to: State::Active, .. })
        };
        let moving = plan.changes.iter().filter(moves).map(|change| id_of(change).clone()).collect();
        *lock(&gcm.inner.carried) = Some(Carried { moving, stops: Vec::new() });
        Carrying { gcm }
    }

    /// One change. What a Stop named meanwhile is not set in motion, or not left so.
    pub(super) async fn one(&self, change: &Change, deadline: Instant) -> Result<Report, Refusal> {
        let Change::Run { id, verb, to: State::Active, .. } = change else {
            return self.gcm.one(change, deadline).await;
        };
        self.not_stopped(id, *verb)?;
        let to = State::Stopped(StopReason::Requested);
        let stop = Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to };
        let report = match self.gcm.one(change, deadline).await {
            Ok(report) => report,
            Err(refusal @ Refusal::LcmTimeout { .. }) => {
                // It may still be done, late; nobody may be told that it failed and see it move. Not waited for: the
                // caller's time is over.
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
        let carried = lock(&self.gcm.inner.carried);
        if !carried.iter().flat_map(|c| &c.stops).any(|target| names(target, id)) {
            return Ok(());
        }
        let state = State::Stopped(StopReason::Requested);
        let why = format!("it was stopped while this {verb} was being carried out");
        Err(Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why })
    }
}

fn names(target: &Target, id: &ComponentId) -> bool {
    match target {
        Target::One(one) => one == id,
        Target::Glob(pattern) => pattern.matches(id),
    }
}

impl Gcm {
    /// Never refused for a revision, never behind another request.
    pub(super) async fn stop(&self, requests: &[Request], validate_only: bool, deadline: Instant) -> Answer {
        let against = !validate_only && self.mark(requests);
        let first = self.stop_now(requests, validate_only, deadline).await;
        if !against {
            return first;
        }
        // What was being started gives up at the mark; OK is said when it has, and again over what was not seen.
        let _writer = self.writer(requests, deadline).await?;
        let second = self.stop_now(requests, false, deadline).await;
        match (first, second) {
            (Ok(first), Ok(second)) => Ok(joined(first, second)),
            (Ok(first), Err(_)) => Ok(first),
            (Err(_), second) => second,
        }
    }

    /// Tells whoever is carrying out a change. True: that change sets some of these components in motion.
    fn mark(&self, requests: &[Request]) -> bool {
        let mut carried = lock(&self.inner.carried);
        let Some(carried) = carried.as_mut() else { return false };
        let targets = requests.iter().flat_map(|r| match r {
            Request::Stop { targets } => targets.as_slice(),
            _ => &[],
        });
        let from = carried.stops.len();
        carried.stops.extend(targets.cloned());
        carried.moving.iter().any(|id| carried.stops[from..].iter().any(|target| names(target, id)))
    }

    async fn stop_now(&self, requests: &[Request], validate_only: bool, deadline: Instant) -> Answer {
        let graph = self.graph();
        let plan = plan_all(&graph, requests)?;
        let mut done = Executed { revision: graph.revision, plan, ..Executed::default() };
        if validate_only || done.plan.changes.is_empty() {
            return Ok(done);
        }
        self.stop_all(&mut done, deadline).await?;
        done.revision = self.accepted();
        Ok(done)
    }

    /// Side by side, so that one that hangs delays no other.
    async fn stop_all(&self, done: &mut Executed, deadline: Instant) -> Result<(), Refusal> {
        let stops: Vec<_> = done
            .plan
            .changes
            .iter()
            .cloned()
            .map(|change| {
                let gcm = self.clone();
                tokio::spawn(async move { (gcm.one(&change, deadline).await, change) })
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

/// Two passes of one Stop as one answer.
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
    }
}
