//! The processes: taken in, followed, lost, taken in again with what they still have.
//!
//! Invariant: a name belongs to one incarnation at a time; what a lost or replaced session still says changes nothing.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, oneshot};
use trocar_model::{
    Component, ComponentId, Connection, Health, Name, Process, ProcessState, Refusal, SystemGraph,
};

use super::Gcm;
use super::manager::lock;
use super::observed::{loosen, observe};
use crate::lcm::{Inventory, Lcm, News, Report};

/// Longest wait until what an LCM has told is entered: it lies here already, unless some of it was lost and is asked again.
const ENTERED: Duration = Duration::from_millis(500);
/// Waits for that which may themselves wait.
const ASKING: usize = 64;

/// What a process says of itself when it registers.
#[derive(Clone, Debug)]
pub struct Registration {
    pub process: Name,
    pub endpoint: String,
    pub pid: u32,
    /// Random, one per incarnation of the process.
    pub instance: u128,
    /// What it was told to have before; empty for a new process.
    pub slice: Slice,
}

/// The desired components and connections of one process.
#[derive(Clone, Debug, Default)]
pub struct Slice {
    pub components: Vec<(ComponentId, Component)>,
    pub connections: Vec<Connection>,
}

impl Registration {
    /// A registration of this very process.
    pub fn new(process: Name, endpoint: String) -> Registration {
        // Each RandomState has keys of its own, so these are two random halves.
        let half = || u128::from(RandomState::new().hash_one(std::process::id()));
        let instance = half() << 64 | half();
        Registration { process, endpoint, pid: std::process::id(), instance, slice: Slice::default() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registered {
    pub epoch: u64,
    pub term: u64,
    pub revision: u64,
}

#[derive(Default)]
pub(super) struct Sessions {
    live: BTreeMap<Name, Session>,
    /// Instance that held each name last.
    last: BTreeMap<Name, u128>,
}

struct Session {
    epoch: u64,
    lcm: Arc<dyn Lcm>,
    /// Answered when the news there are then have been entered; closed with the session.
    asks: mpsc::Sender<oneshot::Sender<()>>,
}

impl Gcm {
    /// Takes a process in and follows its news until it is lost. One that comes back (same instance, or with a slice
    /// from before this GCM) keeps its components.
    ///
    /// # Errors
    /// The name is taken by another process that is heard; the epoch cannot be made durable.
    pub async fn register(
        &self,
        who: Registration,
        lcm: Arc<dyn Lcm>,
        inventory: Inventory,
    ) -> Result<Registered, Refusal> {
        // Before the inventory is entered, so that no news falls between.
        let news = lcm.news();
        let (asks, asked) = mpsc::channel(ASKING);
        let (epoch, back) = self.claim(&who, lcm.clone(), asks)?;
        let mut loose = Vec::new();
        self.edit(|graph| {
            loose = adopt(graph, &who, back, &inventory);
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
        });
        let word = if back { "is back" } else { "registered" };
        log::info!("process {} {word} (epoch {epoch}, pid {})", who.process, who.pid);
        self.cut_off(loose);
        tokio::spawn(follow(self.clone(), who.process, epoch, lcm, news, asked));
        Ok(Registered { epoch, term: self.term(), revision: self.graph().revision })
    }

    /// The name is checked and taken in one step. True: the same instance held it last.
    fn claim(
        &self,
        who: &Registration,
        lcm: Arc<dyn Lcm>,
        asks: mpsc::Sender<oneshot::Sender<()>>,
    ) -> Result<(u64, bool), Refusal> {
        let mut sessions = lock(&self.inner.sessions);
        let back = sessions.last.get(&who.process) == Some(&who.instance);
        if sessions.live.contains_key(&who.process) && !back {
            let graph = self.graph();
            let holder = graph.processes.get(&who.process);
            return Err(Refusal::ProcessExists {
                endpoint: holder.map(|p| p.endpoint.clone()).unwrap_or_default(),
                pid: holder.map_or(0, |p| p.pid),
                process: who.process.clone(),
            });
        }
        let epoch = self.inner.ids.next_epoch().map_err(|e| Refusal::Internal { text: e.to_string() })?;
        sessions.live.insert(who.process.clone(), Session { epoch, lcm, asks });
        sessions.last.insert(who.process.clone(), who.instance);
        Ok((epoch, back))
    }

    /// A process is gone or silent; its components stay listed as LOST. Ignored for an older epoch.
    pub fn lost(&self, process: &Name, epoch: u64) {
        {
            let mut sessions = lock(&self.inner.sessions);
            if sessions.live.get(process).is_none_or(|s| s.epoch != epoch) {
                return;
            }
            sessions.live.remove(process);
        }
        self.edit(|graph| {
            let Some(p) = graph.processes.get_mut(process).filter(|p| p.epoch == epoch) else { return };
            p.state = ProcessState::Lost;
            p.classes.clear();
            for (_, component) in graph.components.iter_mut().filter(|(id, _)| id.process == *process) {
                component.health = Health::Lost;
            }
        });
        log::warn!("process {process} is lost (epoch {epoch})");
    }

    /// The LCM of a process that is heard.
    ///
    /// # Errors
    /// ProcessNotFound, ProcessLost.
    pub fn lcm_of(&self, process: &Name) -> Result<Arc<dyn Lcm>, Refusal> {
        if let Some(session) = lock(&self.inner.sessions).live.get(process) {
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

    /// Waits until the graph has what the LCM of a process has told so far. An LCM tells its news before it answers, so whoever
    /// passes on a refusal after this can be sure that the next look shows what came of it: a FAULT, for one.
    pub async fn hear_out(&self, process: &Name) {
        let asks = lock(&self.inner.sessions).live.get(process).map(|session| session.asks.clone());
        let Some(asks) = asks else { return };
        let entered = async {
            let (tell, told) = oneshot::channel();
            // A session that ends meanwhile has nothing more to be entered.
            if asks.send(tell).await.is_ok() {
                let _ = told.await;
            }
        };
        // What takes longer is a gap in the news, and is entered when it was asked again.
        let _ = tokio::time::timeout(ENTERED, entered).await;
    }

    fn current(&self, process: &Name, epoch: u64) -> bool {
        lock(&self.inner.sessions).live.get(process).is_some_and(|s| s.epoch == epoch)
    }
}

/// Enters what a process has: what it was told to have, as far as it still has it. Answers the connections it was told to
/// have which do not fit the ports of now.
fn adopt(graph: &mut SystemGraph, who: &Registration, back: bool, inventory: &Inventory) -> Vec<Connection> {
    let Slice { mut components, mut connections } = who.slice.clone();
    if back && components.is_empty() {
        let mine = graph.components.iter().filter(|(id, _)| id.process == who.process);
        components = mine.map(|(id, c)| (id.clone(), c.clone())).collect();
        connections = graph.connections.values().filter(|c| ends_in(c, &who.process)).cloned().collect();
    }
    graph.components.retain(|id, _| id.process != who.process);
    graph.connections.retain(|_, c| !ends_in(c, &who.process));
    let reports: BTreeMap<&ComponentId, &Report> = inventory.components.iter().map(|r| (&r.id, r)).collect();
    components.retain(|(id, _)| id.process == who.process && reports.contains_key(id));
    graph.components.extend(components);
    for report in &inventory.components {
        if graph.components.contains_key(&report.id) {
            observe(graph, report);
        } else {
            log::warn!("{} exists in process {} and is not known here", report.id, who.process);
        }
    }
    for connection in connections {
        let known = |id: &ComponentId| graph.components.contains_key(id);
        if !known(&connection.client.component) || !known(&connection.server.component) {
            continue;
        }
        graph.next_connection = graph.next_connection.max(connection.id.0 + 1);
        if graph.connections.contains_key(&connection.id) {
            log::warn!(
                "connection {} from {} to {} is not known here: another one has its number",
                connection.id.0,
                connection.client,
                connection.server
            );
            continue;
        }
        graph.connections.insert(connection.id, connection);
    }
    inventory.components.iter().flat_map(|report| loosen(graph, &report.id)).collect()
}

fn ends_in(connection: &Connection, process: &Name) -> bool {
    connection.client.component.process == *process || connection.server.component.process == *process
}

async fn follow(
    gcm: Gcm,
    process: Name,
    epoch: u64,
    lcm: Arc<dyn Lcm>,
    mut news: broadcast::Receiver<News>,
    mut asked: mpsc::Receiver<oneshot::Sender<()>>,
) {
    loop {
        let (heard, tell) = tokio::select! {
            heard = news.recv() => (Some(heard), None),
            tell = asked.recv() => match tell {
                Some(tell) => (None, Some(tell)),
                // Lost, or replaced.
                None => return,
            },
        };
        if !gcm.current(&process, epoch) {
            return;
        }
        let (mut lagged, mut first) = (false, None);
        match heard {
            Some(Ok(news)) => first = Some(news),
            Some(Err(broadcast::error::RecvError::Lagged(_))) => lagged = true,
            Some(Err(broadcast::error::RecvError::Closed)) => return gcm.lost(&process, epoch),
            None => {}
        }
        let mut loose = Vec::new();
        gcm.edit_if(|graph| {
            // An LCM tells its news before it answers. So all that is queued now is entered before any later answer is,
            // and no state that was passed long ago comes back.
            let mut changed = first.is_some_and(|first| enter(&gcm, graph, &process, first, &mut loose));
            for _ in 0..news.len() {
                match news.try_recv() {
                    Ok(next) => changed |= enter(&gcm, graph, &process, next, &mut loose),
                    Err(e) => lagged |= matches!(e, broadcast::error::TryRecvError::Lagged(_)),
                }
            }
            changed
        });
        if lagged {
            match lcm.inventory().await {
                Ok(Inventory { components, classes }) => gcm.edit(|graph| {
                    loose.extend(components.iter().flat_map(|report| observe(graph, report)));
                    if let Some(p) = graph.processes.get_mut(&process) {
                        p.classes = classes;
                    }
                }),
                Err(refusal) => log::warn!("the inventory of {process} cannot be had: {refusal}"),
            }
        }
        gcm.cut_off(loose);
        if let Some(tell) = tell {
            // Who asked may have given up.
            let _ = tell.send(());
        }
    }
}

/// True: the graph is different.
fn enter(
    gcm: &Gcm,
    graph: &mut Arc<SystemGraph>,
    process: &Name,
    news: News,
    loose: &mut Vec<Connection>,
) -> bool {
    match news {
        News::State(report) => loose.extend(observe(Arc::make_mut(graph), &report)),
        News::Catalog(classes) => {
            if let Some(p) = Arc::make_mut(graph).processes.get_mut(process) {
                p.classes = classes;
            }
        }
        News::Log(line) => {
            gcm.lines().keep(line);
            return false;
        }
    }
    true
}
