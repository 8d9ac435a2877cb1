//! The processes: taken in, followed, lost, taken in again with what they still have.
//!
//! Invariant: a name belongs to one incarnation at a time; news of a lost or replaced session changes
//! nothing.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Weak};
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, oneshot};
use trocar_lcm_api::{HalfReport, Inventory, Lcm, News, Report};
use trocar_links::Card;
use trocar_model::{
    Component, ComponentId, Connection, ConnectionId, Health, Here, Name, Process, ProcessState, Refusal,
    State, SystemGraph,
};

use super::guests::GuestLcm;
use super::manager::{Inner, lock};
use super::observed::{loosen, observe, stand_by};
use super::wanted::Wanted;
use super::{Gcm, far};

/// Longest wait until the news of an LCM is entered: it lies here already, unless some was lost and is asked
/// for again.
const ENTERED: Duration = Duration::from_millis(500);
/// Calls that may wait for that at once.
const ASKING: usize = 64;

/// Facts a process tells when it registers.
#[derive(Clone, Debug)]
pub struct Registration {
    pub process: Name,
    pub endpoint: String,
    pub pid: u32,
    /// Random, one per incarnation of the process.
    pub instance: u128,
    /// Epoch this incarnation was given before; 0 = none yet.
    pub epoch: u64,
    /// Components and connections it was told to have before; empty for a new process.
    pub slice: Slice,
    /// Program of a process without an LCM; empty otherwise.
    pub guest: String,
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
        Registration {
            process,
            endpoint,
            pid: std::process::id(),
            instance,
            epoch: 0,
            slice: Slice::default(),
            guest: String::new(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registered {
    /// Number of this stream; it tells a later stream of the same process apart.
    pub session: u64,
    pub epoch: u64,
    pub term: u64,
    pub revision: u64,
}

#[derive(Default)]
pub(super) struct Sessions {
    live: BTreeMap<Name, Session>,
    /// Instance that held each name last, and its epoch.
    last: BTreeMap<Name, (u128, u64)>,
    /// Number of the newest session.
    newest: u64,
    pub(super) wanted: Wanted,
    /// Processes that were taken down, with the pid they had: later news of that pid is stale.
    dismissed: BTreeMap<Name, u32>,
    /// Connections to processes that are not there yet, by the process that brought them along from a GCM
    /// before this one.
    pub(super) brought: BTreeMap<Name, Vec<Connection>>,
    /// Guests that have joined without an LCM.
    pub(super) guests: BTreeMap<Name, Arc<GuestLcm>>,
    /// Number of the newest report of each component; see [`Report::number`].
    reported: BTreeMap<ComponentId, u64>,
}

struct Session {
    number: u64,
    pid: u32,
    lcm: Arc<dyn Lcm>,
    /// Questions that are answered when all present news has been entered; closed with the session.
    asks: mpsc::Sender<oneshot::Sender<()>>,
    /// Card other processes need to reach it.
    card: Option<Card>,
}

impl Sessions {
    /// Tells whether this report was looked up later than all that were entered before. News and answers come
    /// by different ways.
    pub(super) fn is_newest(&mut self, report: &Report) -> bool {
        if report.number == 0 {
            return true;
        }
        let newest = self.reported.entry(report.id.clone()).or_default();
        let is_newest = report.number > *newest;
        *newest = report.number.max(*newest);
        is_newest
    }

    pub(super) fn card(&self, process: &Name) -> Option<Card> {
        self.live.get(process).and_then(|session| session.card.clone())
    }

    /// The session of a process that is heard.
    pub(super) fn holder(&self, process: &Name) -> Option<u64> {
        self.live.get(process).map(|s| s.number)
    }

    /// Tells whether the process was here at some time in the life of this GCM.
    pub(super) fn knows(&self, process: &Name) -> bool {
        self.last.contains_key(process)
    }

    /// The pid of a process that is heard.
    pub(super) fn pid(&self, process: &Name) -> Option<u32> {
        self.live.get(process).map(|s| s.pid)
    }

    /// Takes a process down: it is away, and nothing is kept for it to come back to.
    pub(super) fn dismiss(&mut self, process: &Name, pid: u32) {
        self.live.remove(process);
        self.wanted.here(process, &[]);
        self.brought.remove(process);
        // Processes that were never spawned cannot be told apart by a pid.
        if pid != 0 {
            self.dismissed.insert(process.clone(), pid);
        }
    }

    pub(super) fn was_dismissed(&self, process: &Name, pid: u32) -> bool {
        self.dismissed.get(process) == Some(&pid)
    }

    /// Ends the session of a process: its components stay listed as LOST. Returns its epoch, if that session
    /// counts.
    pub(super) fn lose(&mut self, graph: &mut SystemGraph, process: &Name, session: u64) -> Option<u64> {
        if self.holder(process) != Some(session) {
            return None;
        }
        self.live.remove(process);
        let p = graph.processes.get_mut(process)?;
        p.state = ProcessState::Lost;
        p.classes.clear();
        let epoch = p.epoch;
        for (_, component) in graph.components.iter_mut().filter(|(id, _)| id.process == *process) {
            component.health = Health::Lost;
        }
        graph.proxies.retain(|_, half| half.process != *process);
        Some(epoch)
    }
}

/// Session and epoch of a process whose name was free.
struct Claimed {
    session: u64,
    epoch: u64,
    /// The same instance held it last.
    back: bool,
}

impl Gcm {
    /// Takes a process in and follows its news until it is lost. A process that comes back (same instance, or
    /// with a slice from before this GCM) keeps its components and its epoch; another incarnation gets what
    /// the last one was to have, made anew.
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
        let Claimed { session, epoch, back } = self.claim(&who, lcm.clone(), asks, inventory.card.clone())?;
        let (mut loose, mut strays, mut owed, mut gets_back) = (Vec::new(), Vec::new(), Vec::new(), None);
        self.edit(|graph| {
            let mut sessions = lock(&self.inner.sessions);
            // Its end was told, or it was replaced, while it was taken in.
            if sessions.holder(&who.process) != Some(session) {
                return;
            }
            let empty = who.slice.components.is_empty() && inventory.components.is_empty();
            let begins = !back && empty && graph.components.keys().any(|id| id.process == who.process);
            // The process may be lost, and come back, in the middle of its restart.
            let goes_on = back && sessions.wanted.is_unfinished(&who.process);
            graph.proxies.retain(|_, half| half.process != who.process);
            // The process may count its reports from the beginning.
            sessions.reported.retain(|id, _| id.process != who.process);
            if begins || goes_on {
                sessions.wanted.begin(&who.process);
                gets_back = Some(already(graph, &who, &inventory));
            } else {
                adopt(graph, &who, back, &inventory);
                owed = sessions.wanted.owed(graph, &who.process);
                sessions.wanted.here(&who.process, &owed);
            }
            strays = far::settle(&mut sessions, graph, &who);
            // A component that is not configured yet does not have all its ports.
            if gets_back.is_none() {
                loose = inventory.components.iter().flat_map(|report| loosen(graph, &report.id)).collect();
            }
            for half in inventory.halves {
                let key = (ConnectionId(half.connection), half.end);
                graph.proxies.extend(half.proxy.map(|proxy| (key, proxy)));
            }
            let before = graph.processes.get(&who.process);
            let (last_exit, restarts) = before.map(|p| (p.last_exit.clone(), p.restarts)).unwrap_or_default();
            graph.processes.insert(
                who.process.clone(),
                Process {
                    epoch,
                    state: match gets_back {
                        Some(_) => ProcessState::Restarting,
                        None => ProcessState::Attached,
                    },
                    endpoint: who.endpoint.clone(),
                    pid: who.pid,
                    classes: inventory.classes.clone(),
                    last_exit,
                    restarts,
                    warnings: inventory.warnings,
                    guest: who.guest.clone(),
                },
            );
        });
        let word = if back { "is back" } else { "registered" };
        log::info!("process {} {word} (epoch {epoch}, pid {})", who.process, who.pid);
        self.cut_off(loose);
        self.cut_strays(strays);
        let (gcm, lcm) = (Arc::downgrade(&self.inner), Arc::downgrade(&lcm));
        tokio::spawn(follow(gcm, who.process.clone(), session, lcm, news, asked));
        self.stop_owed(session, owed);
        match gets_back {
            Some(here) => _ = tokio::spawn(self.clone().restore(who.process, session, here)),
            None => _ = tokio::spawn(self.clone().link_missing(who.process)),
        }
        Ok(Registered { session, epoch, term: self.term(), revision: self.graph().revision })
    }

    /// Checks the name and takes it, in one step.
    fn claim(
        &self,
        who: &Registration,
        lcm: Arc<dyn Lcm>,
        asks: mpsc::Sender<oneshot::Sender<()>>,
        card: Option<Card>,
    ) -> Result<Claimed, Refusal> {
        // Taken before the lock: an editor of the graph may take the lock of the sessions inside.
        let graph = self.graph();
        let mut sessions = lock(&self.inner.sessions);
        let last = sessions.last.get(&who.process).copied();
        let back = last.is_some_and(|(instance, _)| instance == who.instance);
        if sessions.live.contains_key(&who.process) && !back {
            let holder = graph.processes.get(&who.process);
            return Err(Refusal::ProcessExists {
                endpoint: holder.map(|p| p.endpoint.clone()).unwrap_or_default(),
                pid: holder.map_or(0, |p| p.pid),
                process: who.process.clone(),
            });
        }
        let known = match last {
            Some((_, epoch)) if back => epoch,
            // A process that comes from a GCM before this one.
            None => who.epoch,
            // Another process had the name meanwhile.
            Some(_) => 0,
        };
        let ids = &self.inner.ids;
        let taken = || sessions.last.iter().any(|(name, (_, epoch))| *name != who.process && *epoch == known);
        let epoch = if taken() || !ids.may_be(known) { ids.next_epoch() } else { ids.not_below(known) };
        let epoch = epoch.map_err(|e| Refusal::Internal { text: e.to_string() })?;
        sessions.newest += 1;
        let session = sessions.newest;
        sessions.live.insert(who.process.clone(), Session { number: session, pid: who.pid, lcm, asks, card });
        sessions.dismissed.remove(&who.process);
        sessions.last.insert(who.process.clone(), (who.instance, epoch));
        Ok(Claimed { session, epoch, back })
    }

    /// Enters that a process is gone or silent; its components stay listed as LOST. Ignored for an older
    /// session.
    pub fn lost(&self, process: &Name, session: u64) {
        let mut epoch = None;
        self.edit(|graph| epoch = lock(&self.inner.sessions).lose(graph, process, session));
        said_lost(process, epoch);
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
        Err(graph.process(process).map_or_else(|unknown| unknown, |known| known.lost(process)))
    }

    /// Waits until the graph has what the LCM of a process has told so far. An LCM tells its news before it
    /// answers. So a caller that passes on a refusal after this can be sure that the next look shows its
    /// result, a FAULT for one.
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
        // News that takes longer is a gap, and is entered when it was asked for again.
        let _ = tokio::time::timeout(ENTERED, entered).await;
    }

    /// True while that session of the process is the one that counts.
    pub fn hears(&self, process: &Name, session: u64) -> bool {
        lock(&self.inner.sessions).holder(process) == Some(session)
    }
}

pub(super) fn said_lost(process: &Name, epoch: Option<u64>) {
    if let Some(epoch) = epoch {
        log::warn!("process {process} is lost (epoch {epoch})");
    }
}

/// Enters the parts a process has already of those it gets back; the rest stays listed as lost.
fn already(graph: &mut SystemGraph, who: &Registration, inventory: &Inventory) -> Here {
    let mut here = Here::default();
    for report in &inventory.components {
        if !graph.components.contains_key(&report.id) {
            log::warn!("{} exists in process {} and is not known here", report.id, who.process);
            continue;
        }
        // Its ports are told once it is configured.
        let ports = report.ports.clone().filter(|_| report.state != State::Created);
        observe(graph, &Report { ports, ..report.clone() });
        here.components.insert(report.id.clone(), report.state);
    }
    here.connections = who.slice.connections.iter().map(|c| c.id).collect();
    here
}

/// Enters the components and connections of a process: those it was told to have, as far as it still has
/// them. [`far::settle`] handles the connections to other processes.
fn adopt(graph: &mut SystemGraph, who: &Registration, back: bool, inventory: &Inventory) {
    let Slice { mut components, mut connections } = who.slice.clone();
    let mine = |c: &Connection| c.is_near() && c.ends_in(&who.process);
    if back && components.is_empty() {
        let ours = graph.components.iter().filter(|(id, _)| id.process == who.process);
        components = ours.map(|(id, c)| (id.clone(), c.clone())).collect();
        connections = graph.connections.values().filter(|c| mine(c)).cloned().collect();
    }
    graph.components.retain(|id, _| id.process != who.process);
    graph.connections.retain(|_, c| !mine(c));
    connections.retain(mine);
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
}

async fn follow(
    gcm: Weak<Inner>,
    process: Name,
    session: u64,
    lcm: Weak<dyn Lcm>,
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
        // This keeps neither alive: an embedded GCM and its LCM go with their host.
        let (Some(inner), Some(lcm)) = (gcm.upgrade(), lcm.upgrade()) else { return };
        let gcm = Gcm { inner };
        if !gcm.hears(&process, session) {
            return;
        }
        let (mut lagged, mut first) = (false, None);
        match heard {
            Some(Ok(news)) => first = Some(news),
            Some(Err(broadcast::error::RecvError::Lagged(_))) => lagged = true,
            Some(Err(broadcast::error::RecvError::Closed)) => return gcm.lost(&process, session),
            None => {}
        }
        let mut loose = Vec::new();
        gcm.edit_if(|graph| {
            // An LCM tells its news before it answers. So all that is queued now is entered before any later
            // answer is, and no state that was passed long ago comes back.
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
                Ok(Inventory { components, classes, halves, warnings, .. }) => gcm.edit(|graph| {
                    graph.proxies.retain(|_, half| half.process != process);
                    for half in halves {
                        let key = (ConnectionId(half.connection), half.end);
                        graph.proxies.extend(half.proxy.map(|proxy| (key, proxy)));
                    }
                    loose.extend(components.iter().flat_map(|report| observe(graph, report)));
                    if let Some(p) = graph.processes.get_mut(&process) {
                        (p.classes, p.warnings) = (classes, warnings);
                    }
                }),
                Err(refusal) => log::warn!("the inventory of {process} cannot be had: {refusal}"),
            }
        }
        gcm.cut_off(loose);
        if let Some(tell) = tell {
            // The caller that asked may have given up.
            let _ = tell.send(());
        }
    }
}

/// True: the graph is different.
fn enter_half(graph: &mut Arc<SystemGraph>, half: HalfReport) -> bool {
    let key = (ConnectionId(half.connection), half.end);
    if graph.proxies.get(&key) == half.proxy.as_ref() {
        return false;
    }
    let proxies = &mut Arc::make_mut(graph).proxies;
    match half.proxy {
        Some(proxy) => _ = proxies.insert(key, proxy),
        None => _ = proxies.remove(&key),
    }
    true
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
        News::State(report) => {
            let is_newest = lock(&gcm.inner.sessions).is_newest(&report);
            let graph = Arc::make_mut(graph);
            let known = graph.components.get(&report.id).cloned();
            loose.extend(observe(graph, &report));
            if !is_newest {
                stand_by(graph, &report.id, known);
            }
        }
        News::Catalog(classes) => {
            if let Some(p) = Arc::make_mut(graph).processes.get_mut(process) {
                p.classes = classes;
            }
        }
        News::Log(line) => {
            gcm.lines().keep(line);
            return false;
        }
        News::Half(half) => return enter_half(graph, half),
        News::Warnings(warnings) => {
            if let Some(p) = Arc::make_mut(graph).processes.get_mut(process) {
                p.warnings = warnings;
            }
        }
    }
    true
}
