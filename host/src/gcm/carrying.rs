//! Plans being carried out: the part of the system each has to itself, and its changes one by one.
//!
//! Invariant: what a Stop named after the request came is not begun to be set in motion any more, and undoing
//! sets no actuator in motion. A component that hangs and is to go is not waited for.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use futures_util::stream::FuturesUnordered;
use tokio_stream::StreamExt;
use trocar_lcm_api::{Decision, Order, Report, clock};
use trocar_model::{
    Change, Component, ComponentId, Entry, Health, Plan, Refusal, Request, Safety, State, StopReason,
    SystemGraph, Target, Verb, allowed, inverse,
};

use super::answer::Executed;
use super::changes::{HUNG, UNDO, id_of, is_so};
use super::claims::{Claim, Part, Planned};
use super::lanes::parts;
use super::observed::stand_by;
use super::{Gcm, text};

/// Most lanes of changes at a time: enough for waits to overlap, and few enough for a machine with two cores
/// to go on beside it with what has to be in time.
const SIDE_BY_SIDE: usize = 8;

/// A change set being carried out.
pub(super) struct Carrying<'a> {
    gcm: &'a Gcm,
    claim: Claim<'a>,
}

impl<'a> Carrying<'a> {
    pub(super) fn begin(gcm: &'a Gcm, claim: Claim<'a>) -> Carrying<'a> {
        Carrying { gcm, claim }
    }

    /// Carries out this plan, too.
    ///
    /// # Errors
    /// PartTaken: it touches what another request has.
    pub(super) fn widen(&self, plan: &Plan, is_whole: bool) -> Result<(), Refusal> {
        self.claim.widen(plan, is_whole)
    }

    /// Carries out all changes of the plan in `done`, or none of them. What does not need each other is done
    /// side by side.
    ///
    /// # Errors
    /// The first refusal, in the order of the plan, once what was begun beside it has ended; then the changes
    /// that were done are taken back.
    pub(super) async fn all_or_nothing(&self, done: &mut Executed, deadline: Instant) -> Result<(), Refusal> {
        let changes = &done.plan.changes;
        let (mut reports, mut refused) = (BTreeMap::new(), BTreeMap::new());
        for part in parts(changes) {
            let goes = AtomicBool::new(true);
            let mut waiting = part.into_iter().map(|lane| self.lane(changes, lane, &goes, deadline));
            let mut lanes: FuturesUnordered<_> = waiting.by_ref().take(SIDE_BY_SIDE).collect();
            while let Some((made, refusal)) = lanes.next().await {
                reports.extend(made);
                refused.extend(refusal);
                lanes.extend(waiting.next());
            }
            if !refused.is_empty() {
                break;
            }
        }
        let Some((_, refusal)) = refused.pop_first() else {
            done.reports.extend(reports.into_values().flatten());
            return Ok(());
        };
        for (at, other) in &refused {
            log::warn!("{}, too: {other}", text::line(&changes[*at]));
        }
        let made: Vec<Change> = reports.keys().map(|at: &usize| changes[*at].clone()).collect();
        self.undo(&made).await;
        Err(refusal)
    }

    /// Carries out these changes one after the other, until one of them, or of a lane beside it, is refused.
    /// Returns the reports of what was done, and the refusal.
    async fn lane(
        &self,
        changes: &[Change],
        lane: Vec<usize>,
        goes: &AtomicBool,
        deadline: Instant,
    ) -> (Vec<(usize, Option<Report>)>, Option<(usize, Refusal)>) {
        let mut made = Vec::with_capacity(lane.len());
        for at in lane.into_iter().take_while(|_| goes.load(Ordering::Relaxed)) {
            let change = &changes[at];
            let doomed = is_doomed(change, &changes[at + 1..]);
            let until = if doomed { deadline.min(clock::now() + HUNG) } else { deadline };
            // Callers that wait for what is removed are told that it is gone, not that it stands still.
            let asked = if doomed { as_removal(change) } else { change.clone() };
            match self.one(&asked, until).await {
                Ok(report) => made.push((at, Some(report))),
                // The component goes away all the same: one that hangs must not keep itself.
                Err(refusal) if doomed => {
                    log::warn!("{} before its removal: {refusal}", text::line(change));
                    made.push((at, None));
                }
                Err(refusal) => {
                    goes.store(false, Ordering::Relaxed);
                    return (made, Some((at, refusal)));
                }
            }
        }
        (made, None)
    }

    /// Takes the done changes back, but for two things: an actuator that was stopped stays stopped, and so
    /// does what somebody else has stopped meanwhile.
    pub(super) async fn undo(&self, done: &[Change]) {
        let undo = inverse(&Plan { changes: done.to_vec(), skipped: Vec::new() });
        for change in undo.changes {
            if self.sets_actuator_in_motion(&change) {
                log::warn!("{} stays stopped: what is taken back sets no actuator in motion", id_of(&change));
                self.gcm.stays_stopped(id_of(&change), self.claim.decision());
                continue;
            }
            let decision = match &change {
                // By the grant that it had, so that a Stop that came since holds it off.
                Change::Run { id, to: State::Active, .. } => match self.gcm.granted_by(id) {
                    Some(grant) => grant,
                    None => continue,
                },
                _ => self.claim.decision(),
            };
            match self.one_of(&change, decision, clock::now() + UNDO).await {
                Ok(_) => {}
                // Its process makes up for it when it is back: it is to have what was decided.
                Err(refusal) if is_away(&refusal) || self.sent_back(&change, &refusal) => {
                    // Until then it goes on, whatever is listed.
                    if let Change::Run { id, from: State::Active, .. } = &change {
                        self.gcm.inner.sessions.lock().not_answered(id);
                    }
                    self.gcm.taken_back(&change);
                }
                Err(refusal) if is_so(&change, &refusal) => self.gcm.taken_back(&change),
                Err(refusal) => {
                    log::error!("undoing it ({}): {refusal}", text::line(&change));
                    // Whatever hangs, it may not go on moving.
                    if let Change::Run { id, from: State::Active, .. } = &change {
                        self.gcm.stop_late(id, self.claim.decision());
                    }
                    if let Change::Run { id, to: State::Active, .. } = &change {
                        self.gcm.stays_stopped(id, self.claim.decision());
                    }
                    self.gcm.not_taken_back(&change, self.claim.decision());
                }
            }
        }
    }

    /// Ends the session of a process that has not taken a change back in time, though nothing hangs there: it
    /// comes again with what it has. False: that is no way out.
    fn sent_back(&self, undo: &Change, refusal: &Refusal) -> bool {
        let Refusal::LcmTimeout { process, .. } = refusal else { return false };
        let graph = self.gcm.graph();
        let hangs = graph.components.get(id_of(undo)).is_some_and(|c| c.health == Health::Unresponsive);
        // What moves is stopped in this session, the sooner the better; what was to move again is held off
        // by the Stop that follows the order. Requests of others there would be lost with the session.
        if hangs || matches!(undo, Change::Run { .. }) || self.claim.is_beside_others(process) {
            return false;
        }
        let Some(session) = self.gcm.inner.sessions.lock().comes_again(process) else { return false };
        log::warn!("undoing it ({}): {refusal}; its process is to come again", text::line(undo));
        self.gcm.lost(process, session);
        true
    }

    /// Notes that the LCM has said what became of an order to set a component in motion.
    fn answered(&self, id: &ComponentId, done: &Result<Report, Refusal>) {
        if !matches!(done, Err(Refusal::ProcessLost { .. } | Refusal::LcmTimeout { .. })) {
            self.gcm.inner.sessions.lock().answered(id);
        }
    }

    fn sets_actuator_in_motion(&self, change: &Change) -> bool {
        let Change::Run { id, to: State::Active, .. } = change else { return false };
        let graph = self.gcm.graph();
        graph.components.get(id).is_none_or(|component| component.class.safety == Safety::Actuator)
    }

    /// Carries out one change. A component that a Stop named meanwhile is not set in motion, or not left so.
    /// A component that hangs and is to be stopped or removed is not waited for.
    ///
    /// # Errors
    /// NOT_LEADER: another GCM may lead by now, and nothing is set in motion for this one.
    pub(super) async fn one(&self, change: &Change, deadline: Instant) -> Result<Report, Refusal> {
        if matches!(change, Change::Run { to: State::Active, .. }) {
            self.gcm.inner.ledger.leads()?;
        }
        self.one_of(change, self.claim.decision(), deadline).await
    }

    /// Does the same as [`Carrying::one`], for a change of an earlier decision: a Stop that came between
    /// holds it off.
    pub(super) async fn one_of(
        &self,
        change: &Change,
        decision: Decision,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        self.claim.doing(text::asked(change));
        let order = Order { decision, ..Order::from(deadline) };
        let Change::Run { id, verb, to: State::Active, .. } = change else {
            return tokio::select! {
                biased;
                done = self.gcm.one(change, order) => done,
                refusal = self.given_up(change) => Err(refusal),
            };
        };
        self.not_stopped(id, *verb)?;
        let to = State::Stopped(StopReason::Requested);
        let stop = Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to };
        // From now on it may move, until its process has said what became of this.
        self.gcm.inner.sessions.lock().not_answered(id);
        let done = tokio::select! {
            biased;
            done = self.gcm.one(change, order) => done,
            refusal = self.given_up(change) => {
                // The caller is told that the component stands still only when its Stop is done or known to
                // hang.
                if let Err(e) = self.gcm.one(&stop, (clock::now() + HUNG).into()).await {
                    log::error!("{} was given up: {e}", text::asked(change));
                }
                return Err(refusal);
            }
        };
        self.answered(id, &done);
        // A Stop that came meanwhile is held against it by the LCM.
        match done {
            Err(refusal @ Refusal::LcmTimeout { .. }) => {
                // The start may still be done, late; no caller may be told that it failed and see the
                // component move. The Stop is not waited for: the caller's time is over.
                self.gcm.stop_late(id, decision);
                Err(refusal)
            }
            done => done,
        }
    }

    fn not_stopped(&self, id: &ComponentId, verb: Verb) -> Result<(), Refusal> {
        if !self.claim.is_stopped(id) {
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

fn is_away(refusal: &Refusal) -> bool {
    matches!(refusal, Refusal::ProcessLost { .. } | Refusal::ProcessNotFound { .. })
}

impl Gcm {
    /// Takes a change back in the graph alone. What was taken away, or stopped, is to stand as was decided
    /// when its process is made again.
    fn taken_back(&self, undo: &Change) {
        let goes_on = match undo {
            Change::Run { to, .. } => *to == State::Active,
            _ => false,
        };
        // Its process tells how a component stands.
        if matches!(undo, Change::Run { .. }) && !goes_on {
            return;
        }
        let id = id_of(undo);
        let decided = self.inner.ledger.wanted().components.get(id).map(|wanted| wanted.state);
        self.edit(|graph| {
            let known = graph.components.get(id).cloned();
            graph.carry_out(undo);
            // One that was only just made anew is no more than CREATED, and was more.
            let is_decided = known.as_ref().is_none_or(|known| known.state == State::Created) || goes_on;
            let is_heard = self.inner.sessions.lock().holder(&id.process).is_some();
            let as_decided = |state| {
                let component = graph.components.get(id)?.clone();
                let health = if is_heard { component.health } else { Health::Lost };
                Some(Component { state, health, ..component })
            };
            let stands = decided.filter(|_| is_decided).and_then(as_decided);
            stand_by(graph, id, stands.or(known));
        });
        // One of two processes may have come back with its half while the other one was waited for.
        if let Change::Disconnect { connection, .. } = undo
            && !connection.is_near()
        {
            self.cut_at_both(connection);
        }
    }

    /// Returns the decision by which a component may run; `None`: it may not.
    pub(super) fn granted_by(&self, id: &ComponentId) -> Option<Decision> {
        let epoch = self.graph().processes.get(&id.process).map_or(0, |process| process.epoch);
        let wanted = self.inner.ledger.wanted();
        let grant = wanted.components.get(id).and_then(|component| component.grant);
        grant.filter(|_| wanted.may_run(id, epoch)).map(|grant| Decision(grant.decision))
    }

    /// Puts on record what could not be taken back: it is there, and is wanted from now on.
    fn not_taken_back(&self, undo: &Change, decision: Decision) {
        let decision = decision.0;
        self.inner.ledger.enter(|_| {
            let graph = self.graph();
            let revision = graph.revision;
            let there = graph.components.get(id_of(undo));
            let entry = match (undo, there) {
                (Change::Destroy { id, .. }, Some(there)) => {
                    let component = Box::new(there.clone());
                    let changes = vec![Change::Create { id: id.clone(), component }];
                    Entry::Changed { revision, decision, changes }
                }
                (Change::Configure { id, from_state, to_state, .. }, Some(there)) => {
                    let config = there.config.clone();
                    let (id, from, to) = (id.clone(), config.clone(), config);
                    let (from_state, to_state) = (*from_state, *to_state);
                    let change = Change::Configure { id, from, to, from_state, to_state };
                    Entry::Changed { revision, decision, changes: vec![change] }
                }
                (Change::Create { id, component }, None) => {
                    let gone = Change::Destroy { id: id.clone(), component: component.clone() };
                    Entry::Changed { revision, decision, changes: vec![gone] }
                }
                (Change::Connect { connection }, _) => {
                    Entry::Cut { revision, connections: vec![connection.id] }
                }
                (Change::Disconnect { connection, .. }, _) => {
                    let connection = connection.clone();
                    Entry::Changed { revision, decision, changes: vec![Change::Connect { connection }] }
                }
                _ => Entry::Noted,
            };
            (entry, None)
        });
    }

    /// Puts on record that a component stands still: an actuator that a refused request had stopped, or what
    /// a Stop holds off.
    pub(super) fn stays_stopped(&self, id: &ComponentId, decision: Decision) {
        let targets = vec![Target::One(id.clone())];
        self.inner.ledger.enter(|_| {
            let revision = self.graph().revision;
            (Entry::Stopped { revision, decision: decision.0, targets }, None)
        });
    }

    /// Tells the requests under way which components are removed by force: those that hang are not waited
    /// for. Returns the component to be removed, when the request is nothing else.
    ///
    /// # Errors
    /// There is no such component. One that is only just being made is not waited for.
    pub(super) fn give_way<'r>(
        &self,
        requests: &'r [Request],
        validate_only: bool,
    ) -> Result<Option<&'r ComponentId>, Refusal> {
        if validate_only {
            return Ok(None);
        }
        let forced = requests.iter().filter_map(|r| match r {
            Request::Remove { id, force: true } => Some(id),
            _ => None,
        });
        let ids: Vec<&ComponentId> = forced.collect();
        if ids.is_empty() {
            return Ok(None);
        }
        let alone = if let [Request::Remove { id, .. }] = requests { Some(id) } else { None };
        if let Some(id) = alone {
            self.graph().component(id)?;
        }
        self.inner.claims.mark(|marks| marks.removed.extend(ids.iter().copied().cloned()));
        Ok(alone)
    }

    /// The right to do what `plan` makes of the graph.
    ///
    /// # Errors
    /// The refusals of `plan`; Busy when others took all the time.
    pub(super) async fn claim_part<P: Into<Planned>>(
        &self,
        requests: &[Request],
        expects: Option<u64>,
        by: (Decision, Instant),
        plan: impl Fn(&SystemGraph) -> Result<P, Refusal>,
    ) -> Result<(Claim<'_>, Arc<SystemGraph>, Plan), Refusal> {
        let named = Part::named(&self.graph(), requests).expecting(expects);
        self.claim_named((named, text::requested(requests)), by, plan).await
    }

    /// Claims the part of these requests, for something that is no request: `doing` names it.
    ///
    /// # Errors
    /// As [`Gcm::claim_part`].
    pub(super) async fn claim_for<P: Into<Planned>>(
        &self,
        doing: String,
        requests: &[Request],
        by: (Decision, Instant),
        plan: impl Fn(&SystemGraph) -> Result<P, Refusal>,
    ) -> Result<(Claim<'_>, Arc<SystemGraph>, Plan), Refusal> {
        self.claim_named((Part::named(&self.graph(), requests), doing), by, plan).await
    }

    async fn claim_named<P: Into<Planned>>(
        &self,
        named: (Part, String),
        by: (Decision, Instant),
        plan: impl Fn(&SystemGraph) -> Result<P, Refusal>,
    ) -> Result<(Claim<'_>, Arc<SystemGraph>, Plan), Refusal> {
        let now = move || {
            let graph = self.graph();
            plan(&graph).map(|plan| (graph, plan.into()))
        };
        self.inner.claims.claim(named, by, now).await
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
