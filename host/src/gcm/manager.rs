//! The owner of the system graph: registers processes, executes requests, follows what the LCMs report.
//!
//! Invariant: every edit of the graph is one closure under the watch channel's lock, so readers see whole states only; the
//! revision grows by one per accepted request that changed something.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Mutex as AsyncMutex, broadcast, watch};
use trocar_model::{
    Change, ComponentId, Health, Name, Plan, Process, ProcessState, Refusal, Request, Skipped, State, SystemGraph,
    inverse, plan_all,
};

use super::ids::{Ids, IdsError};
use super::requests::Answers;
use crate::lcm::{Inventory, Lcm, News, Report};

/// Time a request gets when it names no deadline.
const WITHIN: Duration = Duration::from_secs(5);
/// Time a rollback gets for each change, beyond the request's own deadline.
const UNDO: Duration = Duration::from_secs(2);

/// How a GCM is set up.
#[derive(Clone, Debug, Default)]
pub struct GcmConfig {
    /// Where term and epochs are kept; `None` for a system that leaves nothing behind.
    pub state: Option<PathBuf>,
}

/// A handle; clones share one GCM.
#[derive(Clone)]
pub struct Gcm {
    inner: Arc<Inner>,
}

struct Inner {
    ids: Ids,
    graph: watch::Sender<Arc<SystemGraph>>,
    sessions: Mutex<BTreeMap<Name, Session>>,
    writer: AsyncMutex<()>,
    answers: Mutex<Answers>,
}

#[derive(Clone)]
struct Session {
    epoch: u64,
    lcm: Arc<dyn Lcm>,
}

/// What a process says of itself when it registers.
#[derive(Clone, Debug)]
pub struct Registration {
    pub process: Name,
    pub endpoint: String,
    pub pid: u32,
}

impl Registration {
    /// A registration of this very process.
    pub fn new(process: Name, endpoint: String) -> Registration {
        Registration { process, endpoint, pid: std::process::id() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registered {
    pub epoch: u64,
    pub term: u64,
    pub revision: u64,
}

/// How a request is to be executed.
#[derive(Clone, Debug, Default)]
pub struct ExecuteOptions {
    pub validate_only: bool,
    /// Same id, same answer; empty = none.
    pub request_id: String,
    pub expected_revision: Option<u64>,
    /// For the whole request; then what was done is undone. Unset: 5 s from now.
    pub deadline: Option<Instant>,
    /// Who asks, for the audit line.
    pub identity: String,
}

/// What an accepted request did.
#[derive(Clone, Debug, Default)]
pub struct Executed {
    pub revision: u64,
    pub plan: Plan,
    pub reports: Vec<Report>,
    /// Of a Stop: what could not be stopped; the others are.
    pub failed: Vec<(ComponentId, Refusal)>,
}

impl Executed {
    pub fn skipped(&self) -> &[Skipped] {
        &self.plan.skipped
    }
}

impl Gcm {
    /// A GCM without processes, in a new term.
    ///
    /// # Errors
    /// The state folder cannot be used.
    pub async fn start(config: GcmConfig) -> Result<Gcm, IdsError> {
        let graph = SystemGraph { next_connection: 1, ..SystemGraph::default() };
        Ok(Gcm {
            inner: Arc::new(Inner {
                ids: Ids::open(config.state.as_deref())?,
                graph: watch::channel(Arc::new(graph)).0,
                sessions: Mutex::default(),
                writer: AsyncMutex::default(),
                answers: Mutex::default(),
            }),
        })
    }

    /// The graph as it is now.
    pub fn graph(&self) -> Arc<SystemGraph> {
        self.inner.graph.borrow().clone()
    }

    /// Every later state of the graph; a slow reader sees the newest and misses those between.
    pub fn watch(&self) -> watch::Receiver<Arc<SystemGraph>> {
        self.inner.graph.subscribe()
    }

    /// The term of this GCM: one per incarnation.
    pub fn term(&self) -> u64 {
        self.inner.ids.term()
    }

    /// Takes a process in and follows its news until it is lost.
    ///
    /// # Errors
    /// The name is taken by a process that is heard; the epoch cannot be made durable.
    pub async fn register(
        &self,
        who: Registration,
        lcm: Arc<dyn Lcm>,
        inventory: Inventory,
    ) -> Result<Registered, Refusal> {
        let news = lcm.news();
        if self.sessions().contains_key(&who.process) {
            let graph = self.graph();
            let holder = graph.processes.get(&who.process);
            return Err(Refusal::ProcessExists {
                endpoint: holder.map(|p| p.endpoint.clone()).unwrap_or_default(),
                pid: holder.map_or(0, |p| p.pid),
                process: who.process,
            });
        }
        let epoch = self.inner.ids.next_epoch().map_err(|e| Refusal::Internal { text: e.to_string() })?;
        self.sessions().insert(who.process.clone(), Session { epoch, lcm: lcm.clone() });
        self.edit(|graph| {
            // What an earlier incarnation had is gone with it.
            forget(graph, &who.process);
            graph.processes.insert(
                who.process.clone(),
                Process {
                    epoch,
                    state: ProcessState::Attached,
                    endpoint: who.endpoint.clone(),
                    pid: who.pid,
                    classes: inventory.classes.clone(),
                },
            );
            graph.revision += 1;
        });
        log::info!("process {} registered (epoch {epoch}, pid {})", who.process, who.pid);
        tokio::spawn(follow(self.clone(), who.process, epoch, lcm, news));
        Ok(Registered { epoch, term: self.term(), revision: self.graph().revision })
    }

    /// A process is gone or silent; its components stay listed as LOST. Ignored for an older epoch.
    pub fn lost(&self, process: &Name, epoch: u64) {
        {
            let mut sessions = self.sessions();
            if sessions.get(process).is_none_or(|s| s.epoch != epoch) {
                return;
            }
            sessions.remove(process);
        }
        self.edit(|graph| {
            if let Some(p) = graph.processes.get_mut(process) {
                p.state = ProcessState::Lost;
                p.classes.clear();
            }
            for (_, component) in graph.components.iter_mut().filter(|(id, _)| id.process == *process) {
                component.health = Health::Lost;
            }
            graph.revision += 1;
        });
        log::warn!("process {process} is lost (epoch {epoch})");
    }

    /// The LCM of a process that is heard.
    ///
    /// # Errors
    /// ProcessNotFound, ProcessLost.
    pub fn lcm_of(&self, process: &Name) -> Result<Arc<dyn Lcm>, Refusal> {
        if let Some(session) = self.sessions().get(process) {
            return Ok(session.lcm.clone());
        }
        let graph = self.graph();
        Err(if graph.processes.contains_key(process) {
            Refusal::ProcessLost { process: process.clone() }
        } else {
            Refusal::ProcessNotFound {
                process: process.clone(),
                known: graph.processes.keys().cloned().collect(),
            }
        })
    }

    /// Plans the requests as one change set and does it: all, or nothing.
    ///
    /// # Errors
    /// Whatever the plan or a component refuses; then what was done is undone. A Stop goes on over failures.
    pub async fn execute(&self, requests: Vec<Request>, options: ExecuteOptions) -> Result<Executed, Refusal> {
        if !options.request_id.is_empty()
            && let Some(answer) = lock(&self.inner.answers).get(&options.request_id)
        {
            return answer;
        }
        let answer = self.execute_once(&requests, &options).await;
        if !options.validate_only {
            let outcome = match &answer {
                Ok(done) => format!("revision {}", done.revision),
                Err(refusal) => format!("refused: {} {refusal}", refusal.reason()),
            };
            log::info!(target: "audit", "{} asked {requests:?}: {outcome}", options.identity);
        }
        if !options.request_id.is_empty() && !options.validate_only {
            lock(&self.inner.answers).put(options.request_id, answer.clone());
        }
        answer
    }

    async fn execute_once(&self, requests: &[Request], options: &ExecuteOptions) -> Result<Executed, Refusal> {
        let stop_only = !requests.is_empty() && requests.iter().all(|r| matches!(r, Request::Stop { .. }));
        let deadline = options.deadline.unwrap_or_else(|| Instant::now() + WITHIN);
        let _writer = if stop_only {
            None
        } else {
            let waited = tokio::time::timeout_at(deadline.into(), self.inner.writer.lock()).await;
            Some(waited.map_err(|_| Refusal::Internal {
                text: "another request is still being carried out: ask again".into(),
            })?)
        };
        let graph = self.graph();
        if let Some(expected) = options.expected_revision
            && !stop_only
            && expected != graph.revision
        {
            return Err(Refusal::RevisionConflict { expected, actual: graph.revision });
        }
        let plan = plan_all(&graph, requests)?;
        let mut done = Executed { revision: graph.revision, plan, ..Executed::default() };
        if options.validate_only || done.plan.changes.is_empty() {
            return Ok(done);
        }
        if stop_only {
            self.stop_all(&mut done, deadline).await?;
        } else {
            self.all_or_nothing(&mut done, deadline).await?;
        }
        self.edit(|graph| graph.revision += 1);
        done.revision = self.graph().revision;
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
                tokio::spawn(async move { (id_of(&change).clone(), gcm.one(&change, deadline).await) })
            })
            .collect();
        for stop in stops {
            match stop.await {
                Ok((_, Ok(report))) => done.reports.push(report),
                Ok((id, Err(refusal))) => done.failed.push((id, refusal)),
                Err(e) => return Err(Refusal::Internal { text: format!("stopping panicked: {e}") }),
            }
        }
        match done.failed.first() {
            Some((_, refusal)) if done.reports.is_empty() => Err(refusal.clone()),
            _ => Ok(()),
        }
    }

    async fn all_or_nothing(&self, done: &mut Executed, deadline: Instant) -> Result<(), Refusal> {
        for (i, change) in done.plan.changes.iter().enumerate() {
            match self.one(change, deadline).await {
                Ok(report) => done.reports.push(report),
                Err(refusal) => {
                    self.undo(&done.plan.changes[..i]).await;
                    return Err(refusal);
                }
            }
        }
        Ok(())
    }

    /// One change: done by the LCM, then entered in the graph.
    async fn one(&self, change: &Change, deadline: Instant) -> Result<Report, Refusal> {
        let lcm = self.lcm_of(&id_of(change).process)?;
        let report = lcm.apply(change.clone(), deadline).await?;
        self.edit(|graph| {
            let revision = graph.revision;
            graph.apply(&Plan { changes: vec![change.clone()], skipped: Vec::new() });
            graph.revision = revision;
            observe(graph, &report);
        });
        Ok(report)
    }

    async fn undo(&self, changes: &[Change]) {
        let undo = inverse(&Plan { changes: changes.to_vec(), skipped: Vec::new() });
        for change in undo.changes {
            if let Err(refusal) = self.one(&change, Instant::now() + UNDO).await {
                log::error!("undoing {change:?}: {refusal}");
            }
        }
    }

    /// Waits until a component is in one of the states.
    ///
    /// # Errors
    /// ComponentNotFound; LcmTimeout at the deadline, with the state it was in.
    pub async fn wait_for(
        &self,
        id: &ComponentId,
        states: &[State],
        deadline: Instant,
    ) -> Result<Arc<SystemGraph>, Refusal> {
        let mut graphs = self.watch();
        loop {
            let graph = graphs.borrow_and_update().clone();
            let Some(component) = graph.components.get(id) else {
                return Err(Refusal::ComponentNotFound {
                    id: id.clone(),
                    known: graph.components.keys().cloned().collect(),
                });
            };
            if states.contains(&component.state) {
                return Ok(graph);
            }
            let state = component.state;
            if !matches!(tokio::time::timeout_at(deadline.into(), graphs.changed()).await, Ok(Ok(()))) {
                let wanted = states.iter().map(State::to_string).collect::<Vec<_>>().join(" or ");
                return Err(Refusal::LcmTimeout {
                    process: id.process.clone(),
                    what: format!("{id} to become {wanted} (it is {state})"),
                });
            }
        }
    }

    fn edit(&self, f: impl FnOnce(&mut SystemGraph)) {
        self.inner.graph.send_modify(|graph| f(Arc::make_mut(graph)));
    }

    fn sessions(&self) -> MutexGuard<'_, BTreeMap<Name, Session>> {
        lock(&self.inner.sessions)
    }

    fn current(&self, process: &Name, epoch: u64) -> bool {
        self.sessions().get(process).is_some_and(|s| s.epoch == epoch)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The component whose LCM carries the change out.
fn id_of(change: &Change) -> &ComponentId {
    match change {
        Change::Create { id, .. }
        | Change::Destroy { id, .. }
        | Change::Configure { id, .. }
        | Change::Run { id, .. } => id,
        Change::Connect { connection } | Change::Disconnect { connection } => &connection.client.component,
    }
}

fn forget(graph: &mut SystemGraph, process: &Name) {
    graph.components.retain(|id, _| id.process != *process);
    graph
        .connections
        .retain(|_, c| c.client.component.process != *process && c.server.component.process != *process);
}

/// Enters what an LCM reported; components the graph does not have are not invented.
fn observe(graph: &mut SystemGraph, report: &Report) {
    if let Some(component) = graph.components.get_mut(&report.id) {
        component.state = report.state;
        component.health = report.health;
        component.fault.clone_from(&report.fault);
        if let Some(ports) = &report.ports {
            component.ports = ports.clone();
        }
    }
}

async fn follow(
    gcm: Gcm,
    process: Name,
    epoch: u64,
    lcm: Arc<dyn Lcm>,
    mut news: broadcast::Receiver<News>,
) {
    loop {
        let heard = news.recv().await;
        if !gcm.current(&process, epoch) {
            return;
        }
        match heard {
            Ok(News::State(report)) => gcm.edit(|graph| observe(graph, &report)),
            Ok(News::Catalog(classes)) => gcm.edit(|graph| {
                if let Some(p) = graph.processes.get_mut(&process) {
                    p.classes = classes;
                }
            }),
            Ok(News::Log(_)) => {}
            Err(broadcast::error::RecvError::Lagged(_)) => match lcm.inventory().await {
                Ok(Inventory { components, classes }) => gcm.edit(|graph| {
                    components.iter().for_each(|report| observe(graph, report));
                    if let Some(p) = graph.processes.get_mut(&process) {
                        p.classes = classes;
                    }
                }),
                Err(refusal) => log::warn!("the inventory of {process} cannot be had: {refusal}"),
            },
            Err(broadcast::error::RecvError::Closed) => return gcm.lost(&process, epoch),
        }
    }
}
