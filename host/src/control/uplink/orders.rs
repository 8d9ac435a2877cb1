//! Orders of the GCM, carried out by the LCM of this process.
//!
//! Invariant: each order runs in its own task, so that none delays a Stop; every order is answered, if only
//! with a refusal. What concerns one connection is done in the order in which it was ordered. A change that
//! was not done before the session ended is taken back.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::oneshot::error::TryRecvError;
use tokio::sync::{OwnedRwLockReadGuard, RwLock, mpsc, oneshot};
use trocar_lcm_api::clock;
use trocar_model::{Change, Plan, Refusal, State, StopReason, SystemGraph, Verb, inverse};
use trocar_proto::v1;
use trocar_proto::v1::answer::Answer as A;
use trocar_proto::v1::order::Order as O;

use super::questions::{MOST, Questions, give};
use crate::control::convert;
use crate::gcm::{asked, id_of, is_so, observe};
use crate::lcm::{Lcm, Lease, Order, Report};

/// Time in which an order has begun.
const BEGUN: Duration = Duration::from_millis(100);
/// Time to take one back.
const UNDO: Duration = Duration::from_secs(2);

/// Everything this process was ordered to have, as far as the orders are carried out.
pub(super) type Told = Arc<Mutex<SystemGraph>>;

pub(super) struct Orders {
    local: Local,
    answers: mpsc::Sender<v1::Answer>,
    questions: Questions,
    /// The last order that concerns each connection; closed when that is done.
    wires: HashMap<u64, oneshot::Receiver<()>>,
    lease: Lease,
}

/// The process that orders change, and its memory of them.
#[derive(Clone)]
struct Local {
    lcm: Arc<dyn Lcm>,
    told: Told,
    quiet: Arc<RwLock<()>>,
}

impl Orders {
    pub(super) fn new(
        lcm: Arc<dyn Lcm>,
        told: Told,
        quiet: Arc<RwLock<()>>,
        answers: mpsc::Sender<v1::Answer>,
        lease: Lease,
    ) -> Orders {
        let questions = Questions::new(lcm.clone(), answers.clone());
        let local = Local { lcm, told, quiet };
        Orders { local, answers, questions, wires: HashMap::new(), lease }
    }

    /// Forgets orders that are done.
    fn forget_ended(&mut self) {
        self.wires.retain(|_, last| last.try_recv() != Err(TryRecvError::Closed));
    }

    fn turn(&mut self, connection: u64) -> Turn {
        let (done, last) = oneshot::channel();
        Turn { before: self.wires.insert(connection, last), done }
    }

    /// Begins it; the answer follows. `late`: time of its patience that was lost on the way.
    pub(super) async fn carry_out(&mut self, order: v1::Order, late: Duration) {
        self.forget_ended();
        let patience = Duration::from_nanos(order.deadline_ns).min(MOST);
        let deadline = clock::now() + patience;
        let (id, local, answers) = (order.id, self.local.clone(), self.answers.clone());
        let decision = match convert::decision_in(order.decision) {
            Ok(decision) => decision,
            Err(unread) => return give(&answers, id, Err(unread)).await,
        };
        let by = Order { deadline, decision, lease: self.lease.clone() };
        // The tasks are not the session's: what has begun is finished, or taken back, without it.
        match order.order {
            Some(O::Apply(change)) => {
                let change = match convert::change_in(change) {
                    Ok(change) => change,
                    Err(unread) => return give(&answers, id, Err(unread)).await,
                };
                // Such an order is not waited for long, and cannot be taken back.
                let busy = match is_short(&change) {
                    true => Some(local.quiet.clone().read_owned().await),
                    false => None,
                };
                let turn = wire_of(&change).map(|connection| self.turn(connection));
                let by = if is_brought_about(&change) { late_by(by, late, patience) } else { by };
                tokio::spawn(async move {
                    let _done = come(turn).await;
                    let answer = local.apply(change, by, busy).await;
                    give(&answers, id, answer.map(A::Report)).await;
                });
            }
            Some(O::Link(end)) => {
                let turn = end.connection.as_ref().map(|connection| self.turn(connection.id));
                let by = late_by(by, late, patience);
                // Before the orders behind it take it, which wait for this one.
                let busy = local.quiet.clone().read_owned().await;
                _ = tokio::spawn(async move {
                    let _done = come(turn).await;
                    give(&answers, id, local.link(end, by, busy).await.map(A::Report)).await;
                })
            }
            Some(O::Stop(stop)) => {
                _ = tokio::spawn(async move {
                    give(&answers, id, local.stop(stop, by).await.map(A::Halted)).await;
                })
            }
            other => self.questions.answer(id, other, deadline).await,
        }
    }
}

/// Returns the number of the connection that a change makes or takes away.
fn wire_of(change: &Change) -> Option<u64> {
    match change {
        Change::Connect { connection } | Change::Disconnect { connection, .. } => Some(connection.id.0),
        _ => None,
    }
}

/// A place behind the order before it that concerns the same connection.
struct Turn {
    before: Option<oneshot::Receiver<()>>,
    done: oneshot::Sender<()>,
}

/// Waits a moment for the order before, which may not have begun yet: one that goes on is met by this one.
/// The next order waits until what this returns is dropped.
async fn come(turn: Option<Turn>) -> Option<oneshot::Sender<()>> {
    let Turn { before, done } = turn?;
    if let Some(before) = before {
        // Nothing is sent: it closes.
        let _ = tokio::time::timeout(BEGUN, before).await;
    }
    Some(done)
}

impl Local {
    /// Makes a change, and remembers it.
    async fn apply(
        &self,
        change: Change,
        by: Order,
        busy: Option<OwnedRwLockReadGuard<()>>,
    ) -> Result<v1::ComponentReport, Refusal> {
        in_time(&change, &by)?;
        let lease = by.lease.clone();
        let report = match self.lcm.apply(change.clone(), by).await {
            Ok(report) => report,
            Err(refusal) => {
                // What was to go was gone: it is not brought along to the next GCM either.
                if is_so(&change, &refusal) {
                    let mut told = self.told.lock();
                    told.carry_out(&change);
                    goes_with(&mut told, &change);
                }
                return Err(refusal);
            }
        };
        let _busy = match busy {
            Some(busy) => busy,
            None => self.made(&change, &lease).await?,
        };
        self.remember(change, &report);
        Ok(convert::report(&report))
    }

    /// Does the same as [`Local::apply`], for a connection to another process.
    async fn link(
        &self,
        end: v1::LinkOrder,
        by: Order,
        _busy: OwnedRwLockReadGuard<()>,
    ) -> Result<v1::ComponentReport, Refusal> {
        let end = convert::remote_in(end)?;
        let change = Change::Connect { connection: end.connection.clone() };
        in_time(&change, &by)?;
        let report = self.lcm.link(end, by.deadline).await?;
        self.remember(change, &report);
        Ok(convert::report(&report))
    }

    async fn stop(&self, stop: v1::StopOrder, by: Order) -> Result<v1::Halted, Refusal> {
        let halted = self.lcm.stop(convert::stop_in(stop)?, by).await?;
        let mut told = self.told.lock();
        for report in halted.iter().filter_map(|halted| halted.done.as_ref().ok()) {
            observe(&mut told, report);
        }
        drop(told);
        Ok(convert::halted_out(halted))
    }

    /// Keeps a Hello from being sent before the change is remembered. A change whose GCM was lost meanwhile
    /// is taken back: its caller was told that it failed.
    ///
    /// # Errors
    /// It was taken back.
    async fn made(&self, change: &Change, lease: &Lease) -> Result<OwnedRwLockReadGuard<()>, Refusal> {
        // While a Hello is on its way, the session is over.
        let busy = self.quiet.clone().try_read_owned().ok();
        if let Some(busy) = busy.filter(|_| !lease.is_over()) {
            return Ok(busy);
        }
        let (what, process) = (asked(change), id_of(change).process.clone());
        let Some(back) = way_back(change) else {
            log::warn!("{what} was done after its GCM was lost, and cannot be taken back");
            return Err(Refusal::lost(process));
        };
        log::warn!("{what} was done after its GCM was lost: it is taken back");
        if let Err(refusal) = self.lcm.apply(back, (clock::now() + UNDO).into()).await {
            log::error!("{what} cannot be taken back: {refusal}");
        }
        Err(Refusal::lost(process))
    }

    fn remember(&self, change: Change, report: &Report) {
        let mut told = self.told.lock();
        goes_with(&mut told, &change);
        told.apply(&Plan { changes: vec![change], skipped: Vec::new() });
        observe(&mut told, report);
    }
}

/// Takes out what goes with a component: connections that were made while its removal was awaited.
fn goes_with(told: &mut SystemGraph, change: &Change) {
    let Change::Destroy { id, .. } = change else { return };
    told.connections.retain(|_, c| c.client.component != *id && c.server.component != *id);
}

/// Refuses what nobody waits for any more.
fn in_time(change: &Change, by: &Order) -> Result<(), Refusal> {
    if !is_brought_about(change) || by.deadline > clock::now() {
        return Ok(());
    }
    Err(Refusal::LcmTimeout { process: id_of(change).process.clone(), what: asked(change) })
}

/// Takes from an order the time that was lost on the way.
fn late_by(by: Order, late: Duration, patience: Duration) -> Order {
    Order { deadline: by.deadline - late.min(patience), ..by }
}

/// Tells whether a change brings about something that nobody wants any more when it is late. What is only
/// taken away, or brought to rest, is so at any time.
fn is_brought_about(change: &Change) -> bool {
    match change {
        Change::Create { .. } | Change::Configure { .. } | Change::Connect { .. } => true,
        Change::Run { verb, .. } => !matches!(verb, Verb::Stop | Verb::Remove),
        Change::Destroy { .. } | Change::Disconnect { .. } => false,
    }
}

/// Tells whether a change enters no code of a component that may take long: it only takes something away,
/// brings it to rest, or connects. A number of a connection may be given again by the next GCM, so that
/// connections are not taken back.
fn is_short(change: &Change) -> bool {
    match change {
        Change::Destroy { .. } | Change::Disconnect { .. } | Change::Connect { .. } => true,
        Change::Run { verb, .. } => matches!(verb, Verb::Stop | Verb::Remove),
        Change::Create { .. } | Change::Configure { .. } => false,
    }
}

/// Returns the change that undoes one that was made; nothing is set in motion by it. A Reset has none.
fn way_back(change: &Change) -> Option<Change> {
    match change {
        Change::Run { id, verb: Verb::Start | Verb::Resume, .. } => {
            let to = State::Stopped(StopReason::Requested);
            Some(Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to })
        }
        Change::Run { .. } => None,
        other => inverse(&Plan { changes: vec![other.clone()], skipped: Vec::new() }).changes.pop(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use serde_json::Value;
    use trocar_model::{
        Component, ComponentId, ConnectOptions, Connection, ConnectionId, Execution, Health, PortId,
    };

    use super::*;
    use crate::gcm::fake::class;

    #[test]
    fn connections_go_with_a_component_that_is_removed() {
        let port = |path: &str| PortId::parse(path).unwrap();
        let mut told = SystemGraph::default();
        for (number, client, server) in
            [(1, "a/x/in", "a/y/out"), (2, "a/y/in", "b/x/out"), (3, "a/z/in", "b/x/out")]
        {
            let (id, options) = (ConnectionId(number), ConnectOptions::default());
            told.connections
                .insert(id, Connection { id, client: port(client), server: port(server), options });
        }
        let component = Box::new(Component {
            ports: Arc::new(class().ports.clone()),
            class: class(),
            config: Value::Null,
            execution: Execution::default(),
            state: State::Ready,
            health: Health::Ok,
            fault: String::new(),
        });
        let gone = Change::Destroy { id: ComponentId::parse("a/y").unwrap(), component };
        goes_with(&mut told, &gone);
        assert_eq!(told.connections.keys().map(|id| id.0).collect::<Vec<_>>(), [3]);
    }
}
