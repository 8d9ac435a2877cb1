//! Phases given to the components of all processes, so that samples between those of one grid arrive.
//!
//! Invariant: decided by `model::phases` from the graph and from what steps take; nobody waits for it, and an
//! LCM that does not answer keeps the phases it has.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;
use trocar_lcm_api::clock;
use trocar_model::{ComponentId, Name, Phase, Refusal, StepTimes, SystemGraph, phases, steps_matter};

use super::Gcm;

/// Time between two looks at what steps take, while samples pass between components of one grid; also the
/// time until an LCM that did not answer is asked again.
const LOOK: Duration = Duration::from_secs(1);
/// Pause before the next look, so that many changes in a row are looked at together.
const PAUSE: Duration = Duration::from_millis(20);
/// Rounds of giving phases in one look.
const ROUNDS: usize = 4;
/// Time an LCM has to answer.
const WITHIN: Duration = Duration::from_secs(1);

/// Components of one process that do not step at 0.
type Given = Vec<(ComponentId, Phase)>;

/// Knowledge of the phases.
#[derive(Default)]
struct Keeper {
    /// The longest times that were told for steps.
    steps: StepTimes,
    /// The phases each process was given, and in which session.
    given: BTreeMap<Name, (u64, Given)>,
    looked: Option<Instant>,
}

/// An order to one process; without phases it only asks what steps take.
struct Order {
    process: Name,
    session: u64,
    given: Option<Given>,
}

impl Gcm {
    /// Follows the graph until this GCM ends.
    pub(super) fn keep_phases(&self) {
        let (inner, mut graphs) = (Arc::downgrade(&self.inner), self.watch());
        tokio::spawn(async move {
            let mut keeper = Keeper::default();
            loop {
                graphs.borrow_and_update();
                let again = match inner.upgrade() {
                    Some(inner) => keeper.look(&Gcm { inner }).await,
                    None => return,
                };
                let ended = match again {
                    false => graphs.changed().await.is_err(),
                    true => matches!(tokio::time::timeout(LOOK, graphs.changed()).await, Ok(Err(_))),
                };
                if ended {
                    return;
                }
                tokio::time::sleep(PAUSE).await;
            }
        });
    }
}

impl Keeper {
    /// Gives each process its new phases, and learns what steps take; true when that is to be done again
    /// although nothing changes.
    async fn look(&mut self, gcm: &Gcm) -> bool {
        let graph = gcm.graph();
        let here = sessions(gcm, &graph);
        self.steps.retain(|id, _| graph.components.contains_key(id));
        self.given.retain(|process, (session, _)| here.get(process) == Some(session));
        // A GCM that was started again asks first, so that no phase moves because it forgot the old ones.
        let unknown = here.iter().filter(|(process, _)| !self.given.contains_key(*process));
        let unknown = unknown.map(|(process, session)| ask(process, *session)).collect();
        let mut answered = self.carry_out(gcm, unknown).await;
        answered &= self.give(gcm, &graph, &here).await;
        let matters = steps_matter(&graph);
        if matters && self.looked.is_none_or(|at| clock::since(at) >= LOOK) {
            self.looked = Some(clock::now());
            let all = here.iter().map(|(process, session)| ask(process, *session)).collect();
            answered &= self.carry_out(gcm, all).await;
            answered &= self.give(gcm, &graph, &here).await;
        }
        matters || !answered
    }

    /// Gives the phases, and again while the answers bring longer steps; false when an LCM did not answer.
    async fn give(&mut self, gcm: &Gcm, graph: &SystemGraph, here: &BTreeMap<Name, u64>) -> bool {
        // Each round can only learn longer steps, which double: a few rounds are enough, and the next look
        // goes on.
        for _ in 0..ROUNDS {
            let mut lists: BTreeMap<Name, Given> = BTreeMap::new();
            for (id, phase) in phases(graph, &self.steps) {
                let list = lists.entry(id.process.clone()).or_default();
                if phase != Phase::default() {
                    list.push((id, phase));
                }
            }
            let fresh = lists.into_iter().filter_map(|(process, list)| {
                let session = *here.get(&process)?;
                let (_, given) = self.given.get(&process)?;
                (*given != list).then_some(Order { process, session, given: Some(list) })
            });
            let fresh: Vec<Order> = fresh.collect();
            if fresh.is_empty() {
                return true;
            }
            if !self.carry_out(gcm, fresh).await {
                return false;
            }
        }
        false
    }

    /// Carries the orders out; false when an LCM did not answer: it is asked again later.
    async fn carry_out(&mut self, gcm: &Gcm, orders: Vec<Order>) -> bool {
        let (mut asked, mut all) = (JoinSet::new(), true);
        for order in orders {
            let Ok(lcm) = gcm.lcm_of(&order.process) else {
                // Lost since the graph was looked at; the next look knows.
                self.given.remove(&order.process);
                all = false;
                continue;
            };
            asked.spawn(async move {
                let deadline = clock::now() + WITHIN;
                let answer =
                    tokio::time::timeout_at(deadline.into(), lcm.phases(order.given.clone(), deadline));
                (order, answer.await.ok())
            });
        }
        while let Some(done) = asked.join_next().await {
            let Ok((order, answer)) = done else {
                all = false;
                continue;
            };
            let Some(Ok(steps)) = answer else {
                told(&order, answer);
                self.given.remove(&order.process);
                all = false;
                continue;
            };
            for (id, step_ns) in steps {
                let known = self.steps.entry(id).or_default();
                *known = step_ns.max(*known);
            }
            let entry = self.given.entry(order.process).or_insert((order.session, Given::new()));
            if let Some(given) = order.given {
                *entry = (order.session, given);
            }
        }
        all
    }
}

fn ask(process: &Name, session: u64) -> Order {
    Order { process: process.clone(), session, given: None }
}

fn told(order: &Order, answer: Option<Result<StepTimes, Refusal>>) {
    let why = match answer {
        Some(Err(refusal)) => refusal.to_string(),
        _ => "it does not answer".to_owned(),
    };
    log::debug!("the phases of the components of process {}: {why}", order.process);
}

/// Processes that are heard and have components with a period.
fn sessions(gcm: &Gcm, graph: &SystemGraph) -> BTreeMap<Name, u64> {
    let sessions = gcm.inner.sessions.lock();
    let timed = graph.components.iter().filter(|(_, c)| c.execution.period_ns.is_some());
    timed.filter_map(|(id, _)| Some((id.process.clone(), sessions.holder(&id.process)?))).collect()
}
