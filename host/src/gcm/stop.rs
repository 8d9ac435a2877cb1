//! Stop: an order to every process that could hold what it names, whatever the GCM believes of it.
//!
//! Invariant: a Stop takes no part of the system, waits for no other request, and is never answered from
//! memory. What was decided before it sets nothing in motion that it names: the LCM holds that off, and this
//! GCM begins it no more. It is OK only for what stands still.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_lcm_api::{Decision, Halted, Order, Report, Stop, StoppedHere, clock};
use trocar_model::{
    Change, ComponentId, Entry, Name, ProcessState, Refusal, Request, Skipped, State, SystemGraph, Target,
    Verb, plan,
};

use super::answer::{Answer, Executed};
use super::changes::UNDO;
use super::journal::Asked;
use super::on_return::RESTARTED;
use super::sessions::Untold;
use super::{Gcm, audit};

/// Pause before a process is told once more that its own Stop counts.
const AGAIN: Duration = Duration::from_secs(1);
/// Time to stop what was stopped while nobody could be told.
const WITHIN: Duration = Duration::from_secs(5);
/// Longest wait of the answer to a Stop for its record.
const ON_RECORD: Duration = Duration::from_millis(100);

/// Warning of a Stop that another GCM may not know.
const NOT_YET: &str = "this Stop is not on record yet, so that a GCM that leads after this one may not know of it: stop \
                       once more when one leads";

/// The Stop of one request, or of a process that was asked itself.
#[derive(Clone)]
struct Halting {
    targets: Arc<Vec<Target>>,
    decision: Decision,
    deadline: Instant,
    /// Number of the last Stop at the process itself that this answers.
    known_here: u64,
    /// The only session that it is for.
    session: Option<u64>,
}

/// Why a Stop of a component that stands still may be forgotten.
const FORGOTTEN: &str = "it stood still when it was heard last, its process is not heard now, and the journal does not hold \
                         this Stop yet: a GCM that is started after this one may set it in motion again";

/// Components that a Stop names and no process was told of, since they stand still: the record alone keeps
/// them from being set in motion.
type Unheard = BTreeSet<ComponentId>;

/// Components that a process has stopped, in that session.
struct Told {
    session: Option<u64>,
    halted: Vec<Halted>,
}

impl Gcm {
    /// Stops; never refused for a revision, never behind another request.
    pub(super) async fn stop(
        &self,
        requests: &[Request],
        validate_only: bool,
        asked: &Asked,
        deadline: Instant,
    ) -> Answer {
        let targets = requests.iter().flat_map(|request| match request {
            Request::Stop { targets } => targets.as_slice(),
            _ => &[],
        });
        let targets: Vec<Target> = targets.cloned().collect();
        if targets.is_empty() {
            // Refused with what is missing.
            let refused = plan(&self.graph(), &Request::Stop { targets: Vec::new() });
            return refused.map(|plan| Executed { plan, ..Executed::default() });
        }
        if validate_only {
            return would_stop(&self.graph(), &targets);
        }
        let counted = self.keep_stopped(&targets);
        let decision = self.inner.claims.decide_stop(&targets);
        let halting =
            Halting { targets: Arc::new(targets), decision, deadline, known_here: 0, session: None };
        let (mut done, unheard) = self.halt(&halting).await?;
        let stopped = done.plan.changes.iter().any(|change| matches!(change, Change::Run { .. }));
        let mut answer = None;
        let record = self.stop_on_record(&halting, stopped && !counted, |revision| {
            done.revision = revision;
            let told = told(std::mem::take(&mut done));
            answer = Some(told.clone());
            Some((asked.clone(), told))
        });
        // It has acted; a disk that hangs does not keep the answer.
        let gcm = self.clone();
        let durable = tokio::spawn(async move { gcm.inner.ledger.durable(record).await });
        let durable = tokio::time::timeout(ON_RECORD, durable).await;
        if let Some(Ok(done)) = &mut answer {
            if self.inner.ledger.is_shared() && !matches!(durable, Ok(Ok(Ok(())))) {
                done.left.push(NOT_YET.into());
            }
            if !self.inner.ledger.is_on_record(record) {
                answer = Some(told(forgettable(std::mem::take(done), &unheard)));
            }
        }
        answer.unwrap_or_else(|| Err(Refusal::Internal { text: "a Stop without an answer".into() }))
    }

    /// Enters a Stop that has acted, as a change of the system where it is one. Returns the number of the
    /// record.
    fn stop_on_record(
        &self,
        halting: &Halting,
        counts: bool,
        request: impl FnOnce(u64) -> Option<(Asked, Answer)>,
    ) -> u64 {
        let (targets, decision) = (halting.targets.to_vec(), halting.decision.0);
        let entry = |revision| (Entry::Stopped { revision, decision, targets }, request(revision));
        match counts {
            true => self.decide(entry),
            false => self.inner.ledger.enter(|_| entry(self.graph().revision)),
        }
    }

    /// Has every process that is heard stop what is named, side by side, and says what became of the rest.
    async fn halt(&self, halting: &Halting) -> Result<(Executed, Unheard), Refusal> {
        let named = |process: &Name| halting.targets.iter().any(|target| target.within(process).is_some());
        let (mut done, mut known) = (Executed::default(), BTreeSet::new());
        let (mut answered, mut unheard) = (BTreeSet::new(), Unheard::new());
        loop {
            let heard = self.inner.sessions.lock().heard();
            // Also a process that has come since.
            let others = heard.into_iter().filter(|process| named(process) && !answered.contains(process));
            let orders: Vec<_> = others
                .map(|process| {
                    let (gcm, halting) = (self.clone(), halting.clone());
                    let ordered = process.clone();
                    (process, tokio::spawn(async move { gcm.halt_process(&ordered, &halting).await }))
                })
                .collect();
            if orders.is_empty() {
                break;
            }
            for (process, order) in orders {
                let told =
                    order.await.map_err(|e| Refusal::Internal { text: format!("stopping panicked: {e}") })?;
                match told {
                    Ok(told) => {
                        if told.halted.iter().any(|halted| halted.done.is_err()) {
                            // Its FAULT is entered before the answer: the next look shows it.
                            self.hear_out(&process).await;
                        }
                        known.extend(told.halted.iter().map(|halted| halted.id.clone()));
                        self.note(&process, told, &mut done);
                    }
                    Err(refusal) => {
                        log::error!("process {process} cannot be told to stop: {refusal}");
                        unheard.extend(self.not_told(&process, &refusal, halting, &mut done));
                    }
                }
                answered.insert(process);
            }
        }
        unheard.extend(self.rest(&answered, halting, &mut done));
        self.unknown(&known, halting, &mut done);
        Ok((done, unheard))
    }

    /// Orders one process to stop; where it is lost meanwhile and comes back, again.
    async fn halt_process(&self, process: &Name, halting: &Halting) -> Result<Told, Refusal> {
        loop {
            let session = self.inner.sessions.lock().holder(process);
            if halting.session.is_some_and(|only| session != Some(only)) {
                return Err(Refusal::lost(process.clone()));
            }
            let mine = halting.targets.iter().filter_map(|target| target.within(process));
            let stop = Stop { targets: mine.collect(), known_here: halting.known_here };
            let order = Order { decision: halting.decision, ..Order::from(halting.deadline) };
            let told = match self.lcm_of(process) {
                Ok(lcm) => self.in_time(process, "a Stop", halting.deadline, lcm.stop(stop, order)).await,
                Err(lost) => Err(lost),
            };
            let Err(lost @ Refusal::ProcessLost { .. }) = told else {
                // A process speaks for its own components.
                let mine = |halted: Vec<Halted>| halted.into_iter().filter(|h| h.id.process == *process);
                let told = told.map(|halted| Told { session, halted: mine(halted).collect() });
                return told.inspect(|told| self.ended_since(process, told, halting.decision));
            };
            let (mut is_back, later) = (false, self.started_after(process, halting.decision));
            self.edit_if(|graph| {
                let mut sessions = self.inner.sessions.lock();
                let holder = sessions.holder(process);
                is_back = holder.is_some() && holder != session;
                if !is_back {
                    let mine = graph.components.iter().filter(|(id, _)| id.process == *process);
                    let stopped = mine.filter(|(id, _)| halting.names(id) && !later.contains(id));
                    for (id, component) in stopped {
                        sessions.on_return.stop(id, component.state);
                    }
                }
                false
            });
            if !is_back || clock::now() >= halting.deadline {
                return Err(lost);
            }
        }
    }

    /// Returns the components of a process that run by a decision made after this one.
    fn started_after(&self, process: &Name, decision: Decision) -> BTreeSet<ComponentId> {
        let wanted = self.inner.ledger.wanted();
        let mine = wanted.components.iter().filter(|(id, _)| id.process == *process);
        let later = mine.filter(|(_, c)| c.grant.is_some_and(|grant| grant.decision > decision.0));
        later.map(|(id, _)| id.clone()).collect()
    }

    /// Notes components that were stopped in a session that has ended since: what it said of them is not
    /// listed any more, and they do not go on by themselves in the next.
    fn ended_since(&self, process: &Name, Told { session, halted }: &Told, decision: Decision) {
        let (graph, later) = (self.graph(), self.started_after(process, decision));
        let mut sessions = self.inner.sessions.lock();
        if sessions.holder(process) == *session {
            return;
        }
        for halted in halted.iter().filter(|halted| halted.done.is_ok() && !later.contains(&halted.id)) {
            if let Some(component) = graph.components.get(&halted.id) {
                sessions.on_return.stop(&halted.id, component.state);
            }
        }
    }

    /// Enters the components that a process has stopped.
    fn note(&self, process: &Name, Told { session, halted }: Told, done: &mut Executed) {
        let reports: Vec<&Report> = halted.iter().filter_map(|halted| halted.done.as_ref().ok()).collect();
        self.enter_states(process, session, &reports);
        for Halted { id, was, done: stopped } in halted {
            match stopped {
                Ok(report) if was != report.state => {
                    done.plan.changes.push(Change::Run { id, verb: Verb::Stop, from: was, to: report.state });
                    done.reports.push(report);
                }
                Ok(_) => done.plan.skipped.push(stands(id, was)),
                Err(refusal) => {
                    log::error!("Stop {id}: {refusal}");
                    done.failed.push((Target::One(id), refusal));
                }
            }
        }
    }

    /// Says what becomes of the components of a process that could not be told. Returns those that stand
    /// still.
    fn not_told(&self, process: &Name, refusal: &Refusal, halting: &Halting, done: &mut Executed) -> Unheard {
        let (graph, mut unheard) = (self.graph(), Unheard::new());
        let mut sessions = self.inner.sessions.lock();
        sessions.not_told(process, &halting.targets, halting.decision);
        for (id, component) in graph.components.iter().filter(|(id, _)| id.process == *process) {
            if !halting.names(id) {
                continue;
            }
            if sessions.may_move(id, component.state) {
                let not_told = Refusal::StopNotTold { id: id.clone(), why: refusal.to_string() };
                done.failed.push((Target::One(id.clone()), not_told));
            } else {
                done.plan.skipped.push(stands(id.clone(), component.state));
                unheard.insert(id.clone());
            }
        }
        unheard
    }

    /// Says what becomes of components whose process is not heard. Returns those that stand still.
    fn rest(&self, heard: &BTreeSet<Name>, halting: &Halting, done: &mut Executed) -> Unheard {
        let (graph, mut unheard) = (self.graph(), Unheard::new());
        for (name, process) in graph.processes.iter().filter(|(name, _)| !heard.contains(*name)) {
            if !self.has_ended(name, process) {
                unheard.extend(self.not_told(name, &process.lost(name), halting, done));
                continue;
            }
            for id in graph.components.keys().filter(|id| id.process == *name && halting.names(id)) {
                let why = "its process has ended; it comes back stopped".into();
                done.plan.skipped.push(Skipped { id: id.clone(), why });
                unheard.insert(id.clone());
            }
        }
        unheard
    }

    /// Names what no process has.
    fn unknown(&self, known: &BTreeSet<ComponentId>, halting: &Halting, done: &mut Executed) {
        let graph = self.graph();
        for target in halting.targets.iter().filter(|target| !known.iter().any(|id| target.names(id))) {
            if let Err(refusal) = plan(&graph, &Request::Stop { targets: vec![target.clone()] }) {
                done.failed.push((target.clone(), refusal));
            }
        }
    }

    /// Notes components that are stopped and cannot be told, because their process is away or may be about to
    /// be started again. True: a component that might have been set in motion by itself is now to stand
    /// still, and the revision is a new one, so that no earlier decision sets it in motion.
    pub(super) fn keep_stopped(&self, targets: &[Target]) -> bool {
        let mut noted = false;
        self.edit_if(|graph| {
            let mut sessions = self.inner.sessions.lock();
            let stopped = graph.components.iter().filter(|(id, _)| targets.iter().any(|t| t.names(id)));
            for (id, component) in stopped {
                let there = |state: ProcessState| state == ProcessState::Attached;
                noted |= match graph.processes.get(&id.process) {
                    Some(process) if there(process.state) => {
                        sessions.on_return.stop_again(id);
                        component.state == RESTARTED
                    }
                    _ => sessions.on_return.stop(id, component.state),
                };
            }
            if noted {
                Arc::make_mut(graph).revision += 1;
            }
            noted
        });
        noted
    }

    /// Stops the components that were stopped while their process was away, which has come back as it was.
    pub(super) fn stop_owed(&self, session: u64, owed: Vec<(ComponentId, State)>) {
        for (id, _) in owed {
            let gcm = self.clone();
            tokio::spawn(async move {
                log::warn!("{id} was stopped while its process was away, and runs: it is stopped now");
                let request = [Request::Stop { targets: vec![Target::One(id.clone())] }];
                let asked = Asked { text: audit::asked(&request), ..Asked::default() };
                match gcm.stop(&request, false, &asked, clock::now() + WITHIN).await {
                    Ok(done) if done.failed.is_empty() => {}
                    // It is stopped when its process is back again.
                    Ok(_) | Err(Refusal::StopNotTold { .. }) => return,
                    Err(refusal) => log::error!("{id} cannot be stopped: {refusal}"),
                }
                let mut sessions = gcm.inner.sessions.lock();
                if sessions.holder(&id.process) == Some(session) {
                    sessions.on_return.stands(&id);
                }
            });
        }
    }

    /// Has a component stopped whose Start, of that decision, took longer than its caller waited; not one
    /// that was started later. Not waited for.
    pub(super) fn stop_late(&self, id: &ComponentId, decision: Decision) {
        let (gcm, process) = (self.clone(), id.process.clone());
        let (targets, deadline) = (Arc::new(vec![Target::One(id.clone())]), clock::now() + UNDO);
        let halting = Halting { targets, decision, deadline, known_here: 0, session: None };
        tokio::spawn(async move {
            let mut done = Executed::default();
            match gcm.halt_process(&process, &halting).await {
                Ok(told) => gcm.note(&process, told, &mut done),
                Err(refusal) => _ = gcm.not_told(&process, &refusal, &halting, &mut done),
            }
        });
    }

    /// Tells a process, which has come back as it was, the Stops that it could not be told.
    pub(super) fn tell_untold(&self, process: &Name, untold: Untold) {
        log::warn!("process {process} is told the Stops that came while it was away");
        let mut stops = BTreeMap::<_, Vec<_>>::new();
        for (target, decision) in untold {
            stops.entry(decision).or_default().push(target);
        }
        let deadline = clock::now() + WITHIN;
        // Each by its own decision: what was started after it goes on.
        for (decision, targets) in stops {
            let targets = Arc::new(targets);
            let halting = Halting { targets, decision, deadline, known_here: 0, session: None };
            let (gcm, process) = (self.clone(), process.clone());
            tokio::spawn(async move {
                let mut done = Executed::default();
                match gcm.halt_process(&process, &halting).await {
                    Ok(told) => gcm.note(&process, told, &mut done),
                    Err(refusal) => _ = gcm.not_told(&process, &refusal, &halting, &mut done),
                }
                if !done.plan.changes.is_empty() {
                    gcm.stop_on_record(&halting, true, |_| None);
                }
            });
        }
    }

    /// Makes a Stop that a process was asked for itself one of this GCM's: what it names stays stopped, and
    /// what is decided from now on may set it in motion again. Not waited for.
    pub(super) fn heard_stop(&self, process: &Name, told: StoppedHere) {
        let (session, answered) = {
            let mut sessions = self.inner.sessions.lock();
            (sessions.holder(process), sessions.answers_here(process, told.number))
        };
        // Each is answered once, however often it is told: what was started since stays.
        let new = told.targets.iter().filter(|(_, number)| *number > answered);
        // A process speaks for its own components.
        let targets: Vec<Target> = new.filter_map(|(target, _)| target.within(process)).collect();
        if targets.is_empty() {
            return;
        }
        let names = targets.iter().map(|target| format!("\"{target}\"")).collect::<Vec<_>>().join(",");
        log::info!(target: "audit", "process {process} was asked Stop {names} at its own port, past this GCM");
        let (gcm, process) = (self.clone(), process.clone());
        // Whoever enters news holds the graph, under which nothing is decided.
        tokio::spawn(async move {
            let counted = gcm.keep_stopped(&targets);
            let decision = gcm.inner.claims.decide_stop(&targets);
            let (targets, known_here) = (Arc::new(targets), told.number);
            loop {
                let deadline = clock::now() + WITHIN;
                let halting = Halting { targets: targets.clone(), decision, deadline, known_here, session };
                match gcm.halt_process(&process, &halting).await {
                    Ok(halted) => {
                        gcm.note(&process, halted, &mut Executed::default());
                        let text = format!("{{\"stop\":{{\"paths\":[{names}]}}}}");
                        let identity = format!("process {process}, at its own port,");
                        let asked = Asked { identity, text, ..Asked::default() };
                        gcm.stop_on_record(&halting, !counted, |_| Some((asked, Ok(Executed::default()))));
                        return;
                    }
                    // It tells it again when it is back.
                    Err(Refusal::ProcessLost { .. }) => return,
                    // Until it hears this, it sets nothing in motion that its Stop named.
                    Err(refusal) => {
                        log::warn!("process {process} does not hear that its Stop counts: {refusal}");
                        tokio::time::sleep(AGAIN).await;
                    }
                }
            }
        });
    }
}

/// The refusal to answer with where nothing was stopped: that of a component that may move, if there is one.
pub(super) fn worst(failed: &[(Target, Refusal)]) -> Option<&Refusal> {
    let is_not_there = |refusal: &Refusal| {
        matches!(
            refusal,
            Refusal::ComponentNotFound { .. }
                | Refusal::ProcessNotFound { .. }
                | Refusal::NothingMatches { .. }
        )
    };
    failed.iter().map(|(_, refusal)| refusal).min_by_key(|refusal| is_not_there(refusal))
}

impl Halting {
    fn names(&self, id: &ComponentId) -> bool {
        self.targets.iter().any(|target| target.names(id))
    }
}

/// Returns the effect that a Stop of these would have, as far as the graph tells.
fn would_stop(graph: &SystemGraph, targets: &[Target]) -> Answer {
    let (mut known, mut failed) = (Vec::new(), Vec::new());
    for target in targets {
        match plan(graph, &Request::Stop { targets: vec![target.clone()] }) {
            Ok(_) => known.push(target.clone()),
            Err(refusal) => failed.push((target.clone(), refusal)),
        }
    }
    match failed.first() {
        Some((_, refusal)) if known.is_empty() => Err(refusal.clone()),
        _ => {
            let plan = plan(graph, &Request::Stop { targets: known })?;
            Ok(Executed { revision: graph.revision, plan, failed, ..Executed::default() })
        }
    }
}

/// The answer to a Stop: a refusal where it is that alone.
fn told(done: Executed) -> Answer {
    let refused = worst(&done.failed).cloned();
    match refused.filter(|_| done.reports.is_empty() && done.plan.skipped.is_empty()) {
        Some(refusal) => Err(refusal),
        None => Ok(done),
    }
}

/// The same outcome where the record may be lost: it is not OK for what rests on that alone.
fn forgettable(mut done: Executed, unheard: &Unheard) -> Executed {
    let rests = done.plan.skipped.extract_if(.., |skipped| unheard.contains(&skipped.id));
    let not_told = |id: ComponentId| Refusal::StopNotTold { id, why: FORGOTTEN.into() };
    done.failed.extend(rests.map(|Skipped { id, .. }| (Target::One(id.clone()), not_told(id))));
    done
}

fn stands(id: ComponentId, state: State) -> Skipped {
    let why = match state {
        State::Fault => "it was made safe when it failed",
        State::Active => "it was started after this Stop was asked for",
        State::Created | State::Ready | State::Stopped(_) => "nothing runs there",
    };
    Skipped { id, why: format!("it is {state}: {why}") }
}
