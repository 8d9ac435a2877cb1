//! Plans being carried out: the part of the system each has to itself, and its changes one by one.
//!
//! Invariant: a started component is entered in the graph before the marks of Stops are looked at, so no
//! component moves that a Stop named meanwhile. A component that hangs and is to go is not waited for.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use trocar_lcm_api::Report;
use trocar_model::{
    Change, ComponentId, Health, Plan, Refusal, Request, State, StopReason, SystemGraph, Verb, allowed,
    inverse,
};

use super::answer::Executed;
use super::changes::{HUNG, UNDO, id_of, names};
use super::claims::{Claim, Part, Planned};
use super::{Gcm, text};

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

    /// Carries out this plan, too.
    ///
    /// # Errors
    /// PartTaken: it touches what another request has.
    pub(super) fn widen(&self, plan: &Plan, is_whole: bool) -> Result<(), Refusal> {
        self.claim.widen(plan, is_whole)?;
        self.goes_on(plan);
        Ok(())
    }

    fn goes_on(&self, plan: &Plan) {
        let moves = |change: &&Change| {
            matches!(change, Change::Run { from: State::Active, .. } | Change::Run { to: State::Active, .. })
        };
        let moving: BTreeSet<_> = plan.changes.iter().filter(moves).map(|c| id_of(c).clone()).collect();
        self.claim.marks(|marks| marks.moving.extend(moving));
    }

    /// Carries out all changes of the plan in `done`, or none of them.
    ///
    /// # Errors
    /// The first refusal; then the changes before it are taken back.
    pub(super) async fn all_or_nothing(&self, done: &mut Executed, deadline: Instant) -> Result<(), Refusal> {
        for (i, change) in done.plan.changes.iter().enumerate() {
            let doomed = is_doomed(change, &done.plan.changes[i + 1..]);
            let until = if doomed { deadline.min(Instant::now() + HUNG) } else { deadline };
            // Callers that wait for what is removed are told that it is gone, not that it stands still.
            let asked = if doomed { as_removal(change) } else { change.clone() };
            match self.one(&asked, until).await {
                Ok(report) => done.reports.push(report),
                // The component goes away all the same: one that hangs must not keep itself.
                Err(refusal) if doomed => log::warn!("{} before its removal: {refusal}", text::line(change)),
                Err(refusal) => {
                    self.undo(&done.plan.changes[..i]).await;
                    return Err(refusal);
                }
            }
        }
        Ok(())
    }

    /// Takes the done changes back.
    pub(super) async fn undo(&self, done: &[Change]) {
        let undo = inverse(&Plan { changes: done.to_vec(), skipped: Vec::new() });
        for change in undo.changes {
            if let Err(refusal) = self.one(&change, Instant::now() + UNDO).await {
                log::error!("undoing it ({}): {refusal}", text::line(&change));
            }
        }
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

impl Gcm {
    /// The right to do what `plan` makes of the graph.
    ///
    /// # Errors
    /// The refusals of `plan`; Busy when others took all the time.
    pub(super) async fn claim_part<P: Into<Planned>>(
        &self,
        requests: &[Request],
        deadline: Instant,
        plan: impl Fn(&SystemGraph) -> Result<P, Refusal>,
    ) -> Result<(Claim<'_>, Arc<SystemGraph>, Plan), Refusal> {
        let named = Part::named(&self.graph(), requests);
        let now = move || {
            let graph = self.graph();
            plan(&graph).map(|plan| (graph, plan.into()))
        };
        self.inner.claims.claim(named, deadline, now).await
    }
}

/// Tells whether this is a Stop of a component that the same plan removes.
fn is_doomed(change: &Change, later: &[Change]) -> bool {
    let Change::Run { id, verb: Verb::Stop, .. } = change else { return false };
    later.iter().any(|c| matches!(c, Change::Destroy { id: gone, .. } if gone == id))
}

/// Returns the Stop of a component that is removed, as its LCM is asked.
fn as_removal(change: &Change) -> Change {
    match change.clone() {
        Change::Run { id, verb: Verb::Stop, from, to } => Change::Run { id, verb: Verb::Remove, from, to },
        other => other,
    }
}
