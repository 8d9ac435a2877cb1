//! Carries out requests: planned as one change set, done by the LCMs, undone when one of them refuses.
//!
//! Invariant: every wait ends by the request's deadline; a change is entered in the graph only after its LCM
//! did it. A component that hangs holds up the components of its own request and no others.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use trocar_lcm_api::Report;
use trocar_model::{
    Change, Component, ComponentId, Name, Plan, Refusal, Request, Safety, Skipped, State, SystemGraph, Verb,
    brief, inverse, plan_all,
};

use super::apart::asked_apart;
use super::away::plan_away;
use super::claims::Planned;
use super::generated::first_part;
use super::manager::lock;
use super::observed::{observe, stand_by};
use super::requests::{Answer, Known};
use super::stop::Carrying;
use super::{Gcm, audit, text};

/// Time a request gets when it names no deadline.
const WITHIN: Duration = Duration::from_secs(5);
/// Time a rollback gets for each change, beyond the request's own deadline.
pub(super) const UNDO: Duration = Duration::from_secs(2);
/// Time a component gets to stop before it is removed, or after it was found to hang.
pub(super) const HUNG: Duration = Duration::from_secs(1);
/// Time an LCM gets beyond the deadline: it keeps deadlines itself and says what hung; after this it is not
/// waited for.
const GRACE: Duration = Duration::from_millis(50);

/// Options of one execution.
#[derive(Clone, Debug, Default)]
pub struct ExecuteOptions {
    pub validate_only: bool,
    /// Same id, same answer; empty = none.
    pub request_id: String,
    pub expected_revision: Option<u64>,
    /// Deadline of the whole request; after it all done changes are undone. Unset: 5 s from now.
    pub deadline: Option<Instant>,
    /// Caller's identity, for the audit line.
    pub identity: String,
}

impl ExecuteOptions {
    pub(super) fn until(&self) -> Instant {
        self.deadline.unwrap_or_else(|| Instant::now() + WITHIN)
    }
}

/// Result of an accepted request.
#[derive(Clone, Default)]
pub struct Executed {
    pub revision: u64,
    pub plan: Plan,
    pub reports: Vec<Report>,
    /// Components a Stop could not stop; the others are stopped.
    pub failed: Vec<(ComponentId, Refusal)>,
    /// Differences from a system file that no request ends, and who can end them.
    pub left: Vec<String>,
}

impl Executed {
    pub fn skipped(&self) -> &[Skipped] {
        &self.plan.skipped
    }
}

/// Prints one line per change; whole components would be pages.
impl std::fmt::Debug for Executed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let warnings: Vec<&String> = self.reports.iter().flat_map(|r| &r.warnings).collect();
        f.debug_struct("Executed")
            .field("revision", &self.revision)
            .field("plan", &text::lines(&self.plan))
            .field("skipped", &self.plan.skipped)
            .field("failed", &self.failed)
            .field("warnings", &warnings)
            .finish()
    }
}

impl Gcm {
    /// Plans the requests as one change set and does it: all, or nothing.
    ///
    /// # Errors
    /// Whatever the plan or a component refuses; then what was done is undone. A Stop goes on over failures.
    pub async fn execute(&self, requests: Vec<Request>, options: ExecuteOptions) -> Answer {
        let deadline = options.until();
        self.once(&requests, &options, deadline, self.audited(&requests, &options, deadline)).await
    }

    /// Carries the requests out, unless the same was asked under its id before.
    pub(super) async fn once(
        &self,
        asked: &impl std::fmt::Debug,
        options: &ExecuteOptions,
        deadline: Instant,
        carried_out: impl Future<Output = Answer>,
    ) -> Answer {
        if options.validate_only || options.request_id.is_empty() {
            return carried_out.await;
        }
        let known = lock(&self.inner.answers).ask(&options.request_id, asked, Instant::now());
        match known {
            Known::New(tell) => {
                let answer = carried_out.await;
                tell.send_replace(Some(answer.clone()));
                lock(&self.inner.answers).given(&options.request_id, &answer);
                answer
            }
            Known::Same(mut answer) => {
                let given = tokio::time::timeout_at(deadline.into(), answer.wait_for(Option::is_some)).await;
                match given {
                    Ok(Ok(answer)) => answer.clone().unwrap_or_else(|| Err(given_up())),
                    Ok(Err(_)) => Err(given_up()),
                    Err(_) => Err(Refusal::Busy { doing: "the same request".into() }),
                }
            }
            Known::Other => Err(Refusal::ArgumentInvalid {
                what: format!("request_id \"{}\"", brief(&options.request_id)),
                why: "it was used for another request within the last 10 minutes: use a new one".into(),
                field: "request_id".into(),
            }),
        }
    }

    pub(super) async fn audited(
        &self,
        requests: &[Request],
        options: &ExecuteOptions,
        deadline: Instant,
    ) -> Answer {
        let stop_only = !requests.is_empty() && requests.iter().all(|r| matches!(r, Request::Stop { .. }));
        let answer = if stop_only {
            self.stop(requests, options.validate_only, deadline).await
        } else {
            self.change(requests, options, deadline).await
        };
        if !options.validate_only {
            audit::write(&options.identity, requests, &answer);
        }
        answer
    }

    async fn change(&self, requests: &[Request], options: &ExecuteOptions, deadline: Instant) -> Answer {
        if let Some(done) = self.remove_away(requests, options).await? {
            return Ok(done);
        }
        let is_expected = options.expected_revision.is_none_or(|r| r == self.graph().revision);
        if is_expected && !options.validate_only {
            self.bring_back(requests, deadline).await?;
        }
        let forced = self.give_way(requests, options.validate_only)?;
        let apart = asked_apart(requests);
        let away = AtomicBool::new(false);
        let at_once = AtomicUsize::new(0);
        let decide = |graph: &SystemGraph| {
            if let Some(expected) = options.expected_revision
                && expected != graph.revision
            {
                return Err(Refusal::RevisionConflict { expected, actual: graph.revision });
            }
            away.store(self.only_takes_away(graph, requests), Ordering::Relaxed);
            if away.load(Ordering::Relaxed) {
                return plan_away(graph, requests).map(Planned::from);
            }
            // A dry run makes no component, so it knows the ports of classes alone.
            let (plan, first) = match options.validate_only {
                true => (plan_all(graph, requests)?, requests.len()),
                false => first_part(graph, requests)?,
            };
            at_once.store(first, Ordering::Relaxed);
            self.can_be_made(&apart)?;
            Ok(Planned { plan, is_whole: first == requests.len() })
        };
        let (claim, graph, plan) = match self.claim_part(requests, deadline, decide).await {
            // The component went with the request that had made it.
            Err(Refusal::ComponentNotFound { id, .. }) if forced == Some(&id) => {
                return Ok(Executed { revision: self.graph().revision, ..Executed::default() });
            }
            planned => planned?,
        };
        let mut done = Executed { revision: graph.revision, plan, ..Executed::default() };
        if options.validate_only {
            return Ok(done);
        }
        if away.load(Ordering::Relaxed) {
            self.take_away(requests, &done.plan)?;
            done.revision = self.accepted();
            return Ok(done);
        }
        if done.plan.changes.is_empty() {
            return Ok(done);
        }
        let carrying = Carrying::begin(self, claim, &done.plan);
        let mut made = match self.begin_apart(&apart, deadline).await {
            Ok(()) => self.all_or_nothing(&carrying, &mut done, deadline).await,
            not_up => not_up,
        };
        let waiting = &requests[at_once.load(Ordering::Relaxed)..];
        if made.is_ok() && !waiting.is_empty() {
            made = self.other_parts(waiting, &carrying, &mut done, deadline).await;
        }
        if let Err(refusal) = made {
            self.end_apart(apart.into_iter().map(|a| a.process).collect()).await;
            return Err(refusal);
        }
        self.end_apart(self.emptied(&done.plan)).await;
        for (id, port) in bereft(&graph, &done.plan) {
            if let Some(report) = done.reports.iter_mut().rev().find(|report| report.id == id) {
                report.warnings.push(format!(
                    "it runs and requires {port}, which nothing is connected to any more: it is made safe and stopped"
                ));
            }
        }
        done.revision = self.accepted();
        Ok(done)
    }

    /// Counts one more accepted request.
    pub(super) fn accepted(&self) -> u64 {
        let mut revision = 0;
        self.edit(|graph| {
            graph.revision += 1;
            revision = graph.revision;
        });
        revision
    }

    pub(super) async fn all_or_nothing(
        &self,
        carrying: &Carrying<'_>,
        done: &mut Executed,
        deadline: Instant,
    ) -> Result<(), Refusal> {
        for (i, change) in done.plan.changes.iter().enumerate() {
            let doomed = is_doomed(change, &done.plan.changes[i + 1..]);
            let until = if doomed { deadline.min(Instant::now() + HUNG) } else { deadline };
            // Callers that wait for what is removed are told that it is gone, not that it stands still.
            let asked = if doomed { as_removal(change) } else { change.clone() };
            match carrying.one(&asked, until).await {
                Ok(report) => done.reports.push(report),
                // The component goes away all the same: one that hangs must not keep itself.
                Err(refusal) if doomed => log::warn!("{} before its removal: {refusal}", text::line(change)),
                Err(refusal) => {
                    self.undo(carrying, &done.plan.changes[..i]).await;
                    return Err(refusal);
                }
            }
        }
        Ok(())
    }

    /// Takes the done changes back.
    pub(super) async fn undo(&self, carrying: &Carrying<'_>, done: &[Change]) {
        let undo = inverse(&Plan { changes: done.to_vec(), skipped: Vec::new() });
        for change in undo.changes {
            if let Err(refusal) = carrying.one(&change, Instant::now() + UNDO).await {
                log::error!("undoing it ({}): {refusal}", text::line(&change));
            }
        }
    }

    /// Carries out one change: done by the LCM, then entered in the graph.
    pub(super) async fn one(&self, change: &Change, deadline: Instant) -> Result<Report, Refusal> {
        let process = &id_of(change).process;
        let asked = async {
            match change {
                Change::Connect { connection } if !connection.is_near() => {
                    self.link(connection, deadline).await
                }
                Change::Disconnect { connection, replaced } if !connection.is_near() => {
                    self.unlink(connection, *replaced, deadline).await
                }
                near => self.lcm_of(process)?.apply(near.clone(), deadline).await,
            }
        };
        let asked = tokio::time::timeout_at((deadline + GRACE).into(), asked).await;
        let timeout = || Refusal::LcmTimeout { process: process.clone(), what: text::asked(change) };
        let report = match asked.unwrap_or_else(|_| Err(timeout())) {
            Ok(report) => report,
            // An LCM by itself cuts a connection that loses its port, and tells so after that: the wanted
            // change is done.
            Err(refusal @ Refusal::ConnectionNotFound { .. }) => self.as_known(change).ok_or(refusal)?,
            Err(refusal) => {
                self.hear_out(process).await;
                return Err(refusal);
            }
        };
        let mut loose = Vec::new();
        self.edit(|graph| {
            let is_newest = lock(&self.inner.sessions).is_newest(&report);
            let known = graph.components.get(&report.id).cloned();
            let revision = graph.revision;
            graph.apply(&Plan { changes: vec![change.clone()], skipped: Vec::new() });
            graph.revision = revision;
            loose = observe(graph, &report);
            if !is_newest {
                stand_by(graph, &report.id, known);
            }
        });
        if let Change::Destroy { id, .. } = change {
            lock(&self.inner.holds).removed(id);
        }
        self.cut_off(loose);
        Ok(report)
    }

    /// Returns the known state of the client of a connection that is to be cut.
    fn as_known(&self, change: &Change) -> Option<Report> {
        let Change::Disconnect { connection, .. } = change else { return None };
        let id = connection.client.component.clone();
        let Component { state, health, fault, .. } = self.graph().components.get(&id)?.clone();
        let (ports, lost_connections, warnings) = (None, Vec::new(), Vec::new());
        Some(Report { id, number: 0, state, health, fault, ports, lost_connections, warnings })
    }
}

/// Returns the actuators that run in `graph` and lack a required connection when the plan is done, each with
/// that port.
fn bereft<'p>(graph: &'p SystemGraph, plan: &'p Plan) -> impl Iterator<Item = (ComponentId, Name)> + 'p {
    let later = |at: usize, is: &dyn Fn(&Change) -> bool| plan.changes[at + 1..].iter().any(is);
    let cut = plan.changes.iter().enumerate().filter_map(|(at, change)| match change {
        Change::Disconnect { connection, .. } => Some((at, &connection.client)),
        _ => None,
    });
    cut.filter_map(move |(at, client)| {
        let component = graph.components.get(&client.component)?;
        let port = client.port.as_str();
        let required = component.ports.inputs.iter().any(|p| p.name == port && !p.optional)
            || component.ports.required.iter().any(|p| p.name == port && !p.optional);
        let runs = component.state == State::Active && component.class.safety == Safety::Actuator;
        let replaced =
            later(at, &|c| matches!(c, Change::Connect { connection } if connection.client == *client));
        let stopped = plan.changes.iter().any(|c| match c {
            Change::Run { id, verb: Verb::Stop | Verb::Remove, .. } | Change::Destroy { id, .. } => {
                *id == client.component
            }
            _ => false,
        });
        (required && runs && !replaced && !stopped).then(|| (client.component.clone(), client.port.clone()))
    })
}

fn given_up() -> Refusal {
    Refusal::Internal { text: "the request with this request_id was given up without an answer".into() }
}

/// Returns the component whose LCM carries the change out.
pub(super) fn id_of(change: &Change) -> &ComponentId {
    match change {
        Change::Create { id, .. }
        | Change::Destroy { id, .. }
        | Change::Configure { id, .. }
        | Change::Run { id, .. } => id,
        Change::Connect { connection } | Change::Disconnect { connection, .. } => {
            &connection.client.component
        }
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
