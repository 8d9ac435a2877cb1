//! Carries out requests: planned as one change set, done by the LCMs, undone when one of them refuses.
//!
//! Invariant: every wait ends by the request's deadline. A component that hangs holds up the components of
//! its own request and no others.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use trocar_lcm_api::{Decision, clock};
use trocar_model::{
    Change, ComponentId, Entry, Name, Plan, Refusal, Request, Safety, State, StopReason, SystemGraph, Verb,
    brief, plan_all,
};

use super::answer::{Answer, ExecuteOptions, Executed};
use super::away::plan_away;
use super::carrying::Carrying;
use super::changes::id_of;
use super::claims::Planned;
use super::generated::first_part;
use super::isolated::asked_isolated;
use super::isolation::Isolated;
use super::journal::Asked;
use super::requests::{Hash, Known};
use super::{Gcm, audit};

impl Gcm {
    /// Plans the requests as one change set and does it: all, or nothing.
    ///
    /// # Errors
    /// Whatever the plan or a component refuses; then what was done is undone. A Stop goes on over failures.
    pub async fn execute(&self, requests: Vec<Request>, options: ExecuteOptions) -> Answer {
        let (asked, deadline) = (audit::asked_by(&options, &requests), options.until());
        let since = self.inner.claims.arrive();
        let answer = self.audited(&requests, &options, &asked, (since, deadline));
        // The answer to a Stop is what stands still now, not what did when somebody asked that before.
        if is_stop(&requests) {
            return answer.await;
        }
        self.once(asked.hash, &options, deadline, answer).await
    }

    /// Carries the requests out, unless the same was asked under its id before.
    pub(super) async fn once(
        &self,
        asked: Hash,
        options: &ExecuteOptions,
        deadline: Instant,
        carried_out: impl Future<Output = Answer>,
    ) -> Answer {
        if options.validate_only {
            return carried_out.await;
        }
        self.inner.ledger.accepts()?;
        if options.request_id.is_empty() {
            return carried_out.await;
        }
        let known = self.inner.answers.lock().ask(&options.request_id, asked, clock::now());
        match known {
            Known::New(tell) => {
                let answer = carried_out.await;
                tell.send_replace(Some(answer.clone()));
                self.inner.answers.lock().given(&options.request_id, &answer);
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
        asked: &Asked,
        (since, deadline): (Decision, Instant),
    ) -> Answer {
        if is_stop(requests) {
            let answer = self.stop(requests, options.validate_only, asked, deadline).await;
            if !options.validate_only {
                audit::write(asked, &answer);
            }
            return answer;
        }
        let changed = self.change(requests, options, asked, (since, deadline)).await;
        self.put_down(options, asked, changed).await
    }

    /// Puts on record what became of a request, and waits for that where it has changed something. Where it
    /// has not, waits for the changes that the answer rests on.
    pub(super) async fn put_down(
        &self,
        options: &ExecuteOptions,
        asked: &Asked,
        changed: Result<(Executed, Option<u64>), Refusal>,
    ) -> Answer {
        let (answer, record) = match changed {
            Ok((done, record)) => (Ok(done), record),
            Err(refusal) => (Err(refusal), None),
        };
        if options.validate_only {
            return answer;
        }
        audit::write(asked, &answer);
        match record {
            Some(record) => self.inner.ledger.durable(record).await?,
            // Nobody waits for the record that nothing has changed, but for the changes that are the
            // reason: a GCM that ends before those are on record leaves a system in which the answer was
            // never right.
            None => {
                let rests_on = self.inner.ledger.last_change();
                let request = Some((asked.clone(), answer.clone()));
                self.inner.ledger.enter(|_| (Entry::Noted, request));
                let is_doubtful = matches!(answer, Err(Refusal::JournalUnavailable { .. }));
                if let Err(unavailable) = self.inner.ledger.durable(rests_on).await
                    && !is_doubtful
                {
                    return Err(nothing_changed(unavailable));
                }
            }
        }
        answer
    }

    pub(super) async fn change(
        &self,
        requests: &[Request],
        options: &ExecuteOptions,
        asked: &Asked,
        (since, deadline): (Decision, Instant),
    ) -> Result<(Executed, Option<u64>), Refusal> {
        if self.is_away_isolated(requests, options)? {
            return self.remove_away(requests, asked, since).await;
        }
        let is_expected = options.expected_revision.is_none_or(|r| r == self.graph().revision);
        if is_expected && !options.validate_only {
            self.bring_back(requests, deadline).await?;
        }
        let forced = self.give_way(requests, options.validate_only)?;
        let isolated = asked_isolated(requests);
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
            self.can_be_made(&isolated)?;
            Ok(Planned { plan, is_whole: first == requests.len() })
        };
        let expects = options.expected_revision.filter(|_| !options.validate_only);
        let (claim, graph, plan) = match self.claim_part(requests, expects, (since, deadline), decide).await {
            // The component went with the request that had made it.
            Err(Refusal::ComponentNotFound { id, .. }) if forced == Some(&id) => {
                return Ok((Executed { revision: self.graph().revision, ..Executed::default() }, None));
            }
            planned => planned?,
        };
        let mut done = Executed { revision: graph.revision, plan, ..Executed::default() };
        if options.validate_only {
            return Ok((done, None));
        }
        if away.load(Ordering::Relaxed) {
            self.take_away(requests, &done.plan)?;
            let record = self.done(&mut done, since, asked);
            return Ok((done, Some(record)));
        }
        if done.plan.changes.is_empty() {
            return Ok((done, None));
        }
        let waiting = &requests[at_once.load(Ordering::Relaxed)..];
        // The part is kept until the request has its revision.
        let carrying = Carrying::begin(self, claim);
        self.carry_out(&carrying, waiting, isolated, &mut done, deadline).await?;
        warn_bereft(&graph, &mut done);
        let record = self.done(&mut done, since, asked);
        Ok((done, Some(record)))
    }

    /// Decides a request whose changes are done: it gets its revision, and is on record. Returns the number
    /// of the record.
    pub(super) fn done(&self, done: &mut Executed, since: Decision, asked: &Asked) -> u64 {
        self.decide(|revision| {
            done.revision = revision;
            let changes = self.on_record(&done.plan.changes, since);
            let entry = Entry::Changed { revision, decision: since.0, changes };
            (entry, Some((asked.clone(), Ok(done.clone()))))
        })
    }

    /// Returns the changes that outlive this GCM. Guests and their connections do not; nor does what has gone
    /// since, with its process or its port. What a Stop named since that decision stands still.
    pub(super) fn on_record(&self, changes: &[Change], since: Decision) -> Vec<Change> {
        let graph = self.graph();
        let is_guests = |process: &Name| graph.processes.get(process).is_some_and(|p| !p.guest.is_empty());
        let is_there = |change: &&Change| match change {
            Change::Create { id, .. } => graph.components.contains_key(id),
            Change::Connect { connection } => graph.connections.contains_key(&connection.id),
            _ => true,
        };
        let lasting = changes.iter().filter(|change| !is_guests(&id_of(change).process)).filter(is_there);
        let as_stands = |change: &Change| match change {
            Change::Run { id, from, to: State::Active, .. }
                if self.inner.claims.is_stopped_since(id, since) =>
            {
                let to = State::Stopped(StopReason::Requested);
                Change::Run { id: id.clone(), verb: Verb::Stop, from: *from, to }
            }
            // It has failed since, or was stopped by something else.
            Change::Run { id, verb, from, to: State::Active } => {
                let to = graph.components.get(id).map_or(State::Active, |component| component.state);
                Change::Run { id: id.clone(), verb: *verb, from: *from, to }
            }
            other => other.clone(),
        };
        lasting.map(as_stands).collect()
    }

    /// Does the plan in `done`, then the requests that had to wait for ports: all, or nothing.
    async fn carry_out(
        &self,
        carrying: &Carrying<'_>,
        waiting: &[Request],
        isolated: Vec<Isolated>,
        done: &mut Executed,
        deadline: Instant,
    ) -> Result<(), Refusal> {
        let mut made = match self.begin_isolated(&isolated, deadline).await {
            Ok(()) => carrying.all_or_nothing(done, deadline).await,
            not_up => not_up,
        };
        if made.is_ok() && !waiting.is_empty() {
            made = self.other_parts(waiting, carrying, done, deadline).await;
        }
        let not_used = match &made {
            Ok(()) => self.emptied(&done.plan),
            Err(_) => isolated.into_iter().map(|a| a.process).collect(),
        };
        self.end_isolated(not_used).await;
        made
    }
}

fn is_stop(requests: &[Request]) -> bool {
    !requests.is_empty() && requests.iter().all(|request| matches!(request, Request::Stop { .. }))
}

/// Warns, in the reports, of the actuators that run in `graph` and lose what they require.
fn warn_bereft(graph: &SystemGraph, done: &mut Executed) {
    for (id, port) in bereft(graph, &done.plan) {
        if let Some(report) = done.reports.iter_mut().rev().find(|report| report.id == id) {
            report.warnings.push(format!(
                "it runs and requires {port}, which nothing is connected to any more: it is made safe and stopped"
            ));
        }
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

/// The same of a request that has changed nothing.
fn nothing_changed(refusal: Refusal) -> Refusal {
    match refusal {
        Refusal::JournalUnavailable { why, .. } => Refusal::JournalUnavailable { carried_out: false, why },
        other => other,
    }
}

fn given_up() -> Refusal {
    Refusal::Internal { text: "the request with this request_id was given up without an answer".into() }
}
