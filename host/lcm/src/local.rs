//! The LCM of this process: makes, runs, wires and removes components.
//!
//! Invariant: no lock is held while component code runs or is waited for; every wait ends at the caller's
//! deadline.

mod assemble;
mod detail;
mod phases;
mod ports;
mod remote;
mod wiring;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{broadcast, mpsc, oneshot};
use trocar_lcm_api::{
    Detail, Halted, Inventory, Invoke, Item, Lcm, LinkDetail, LogLine, News, Order, PluginInfo, RemoteEnd,
    Reply, Report, Sample, Selection, Stop, When,
};
use trocar_loader::system;
use trocar_model::{
    Change, ClassInfo, ComponentId, Execution, ExecutionModel, Name, Phase, Refusal, StepTimes, Verb,
};
use trocar_rt::{house, os};

use self::ports::Follower;
use super::boundary::AllRemains;
use super::calling;
use super::carriers::Carriers;
use super::classes::Classes;
use super::concern::{self, Concern};
use super::connect::Wired;
use super::cycle::Follow;
use super::ends::Here;
use super::executor::Executor;
use super::hub::Hub;
use super::instance::{Entered, Instance};
use super::loss::Loss;
use super::order::Place;
use super::outside::{self, Outside, Shows};
use super::realtime::Memory;
use super::remote::Afar;
use super::services::Services;
use super::store::governed;
use super::supervise::{Manners, Roster, Watchdog};
use super::watch::Entry;

/// Longest wait to enter a component again whose late work has to be reverted, ns.
const UNDO_NS: u64 = 1_000_000_000;
/// Part of the time for a shutdown (one in so many) that is for cycles that may still look at cut wires.
const CYCLES_PART: u32 = 25;

/// Settings of an LCM.
pub struct LcmConfig {
    pub process: Name,
    /// Source of classes; `None` leaves the process without any.
    pub classes: Option<Arc<dyn Classes>>,
    /// Socket on which it listens for other processes of its machine; `None`: its components connect to none
    /// of them.
    pub links: Option<PathBuf>,
    /// The way by which processes of other machines reach it; `None`: its components connect to none of them.
    pub afar: Option<Afar>,
    /// Lock the memory of the process, where the machine allows it, else the stacks of components' threads.
    pub lock_memory: bool,
    /// Components may start programs.
    pub allow_exec: bool,
}

pub struct LocalLcm {
    hub: Arc<Hub>,
    classes: Option<Arc<dyn Classes>>,
    allow_exec: bool,
    held: Mutex<Held>,
    next_number: AtomicU32,
    log_thread: Mutex<Option<thread::JoinHandle<()>>>,
    roster: Arc<Roster>,
    memory: Memory,
    watchdog: Watchdog,
    follower: Follower,
    carriers: Arc<Carriers>,
    pub(super) outside: Outside,
    /// The remains of removed components.
    remains: Arc<AllRemains>,
}

#[derive(Default)]
struct Held {
    components: BTreeMap<ComponentId, Slot>,
    links: BTreeMap<u64, Arc<Wired>>,
    /// Removed components in which a cycle may still look at cut wires: those wires hold their peers.
    leaving: Vec<Arc<Instance>>,
    /// True during and after the shutdown: nothing is made here any more.
    closed: bool,
    /// Phases as last given: a component that is made anew gets its phase again.
    phases: BTreeMap<ComponentId, Phase>,
}

/// One component and its thread.
#[derive(Clone)]
struct Slot {
    instance: Arc<Instance>,
    executor: Arc<Executor>,
    execution: Execution,
    /// Last configuration given, for Reset.
    config: Option<String>,
    /// The phase it was given, when none was asked for.
    phase: Option<Phase>,
}

impl Slot {
    fn here(&self) -> Here {
        Here::new(self.instance.clone(), self.executor.clone())
    }

    /// Place among the members of its thread, and when it steps.
    fn place(&self, number_of: impl Fn(&str) -> Option<u32>) -> (Place, Follow) {
        if self.execution.stream_of.is_some() {
            return (Place::Alone, Follow::Input);
        }
        match self.execution.inside.as_deref() {
            None => (Place::Alone, Follow::Thread),
            // The component it runs inside of is gone: it waits for another one, without steps.
            Some(host) => match number_of(host) {
                None => (Place::Alone, Follow::Member(0)),
                Some(host) if self.execution.model == Some(ExecutionModel::ExecOut) => {
                    (Place::After(host), Follow::Member(host))
                }
                Some(host) => (Place::Before(host), Follow::Member(host)),
            },
        }
    }
}

impl LocalLcm {
    /// An LCM without components.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub fn new(config: LcmConfig) -> std::io::Result<Arc<LocalLcm>> {
        let hub = Hub::new(config.process);
        let memory = if config.lock_memory { Memory::lock() } else { Memory::default() };
        let roster = Arc::new(Roster::default());
        let news = hub.news.clone();
        // A failure is fine without listeners: the inventory has the half.
        let tell = move |half| _ = news.send(News::Half(half));
        let ways = (config.links, config.afar);
        let carriers = Carriers::start(hub.process.as_str(), ways, tell, hub.ports.clone())?;
        let lcm = Arc::new(LocalLcm {
            carriers,
            classes: config.classes,
            allow_exec: config.allow_exec,
            held: Mutex::new(Held::default()),
            next_number: AtomicU32::new(1),
            log_thread: Mutex::new(None),
            watchdog: Watchdog::start(hub.clone(), roster.clone())?,
            follower: Follower::new(hub.ports.clone()),
            roster,
            memory,
            outside: Outside::default(),
            remains: Arc::default(),
            hub,
        });
        let (hub, weak) = (lcm.hub.clone(), Arc::downgrade(&lcm));
        let thread = house::spawn(thread::Builder::new().name("trocar-log".into()), move || {
            hub.logs.run(hub.process.as_str(), &hub.news, |number, level, text| {
                let Some(lcm) = weak.upgrade() else { return };
                let instance = lcm.held().components.values().find(|s| s.instance.number == number).cloned();
                if let Some(slot) = instance {
                    let event = match level {
                        0 | 1 => system::ERROR,
                        2 => system::WARNING,
                        _ => system::STATUS,
                    };
                    slot.instance.message(event, text);
                }
            });
        })?;
        *lcm.log_thread.lock() = Some(thread);
        lcm.follower.start(&lcm)?;
        Ok(lcm)
    }

    /// The process whose components it owns.
    pub fn process(&self) -> &Name {
        &self.hub.process
    }

    /// Lets components ask for dynamic component services, carried out by `services`, until the LCM shuts
    /// down.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub fn offer_services(self: &Arc<Self>, services: Arc<dyn Services>) -> std::io::Result<()> {
        let lcm = Arc::downgrade(self);
        super::services::open(&self.hub.request_queue, services, move |number| lcm.upgrade()?.member(number))
    }

    /// The component of this number and the thread it runs on; `None` when it is gone.
    fn member(&self, number: u32) -> Option<(Arc<Instance>, Arc<Executor>)> {
        let held = self.held();
        let slot = held.components.values().find(|slot| slot.instance.number == number)?;
        Some((slot.instance.clone(), slot.executor.clone()))
    }

    #[cfg(test)]
    pub(super) fn executor_of(&self, instance: &Instance) -> Option<Arc<Executor>> {
        self.member(instance.number).map(|(_, executor)| executor)
    }

    /// Classes as this process offers them.
    fn offered(&self, classes: &dyn Classes) -> Vec<Arc<ClassInfo>> {
        classes.catalog().into_iter().map(|class| governed(class, self.allow_exec)).collect()
    }

    /// Checks whether a component of the class may be made here, by this process's own list: a GCM may not
    /// know it yet, or may be malicious.
    fn lets_in(&self, classes: &dyn Classes, class: &ClassInfo) -> Result<(), Refusal> {
        let offered = self.offered(classes);
        let same = |c: &&Arc<ClassInfo>| c.hash == class.hash && c.full_name() == class.full_name();
        if let Some(own) = offered.iter().find(same) {
            return own.is_let_into(&self.hub.process);
        }
        // Its file is gone, but its code is still here.
        governed(Arc::new(class.clone()), self.allow_exec).is_let_into(&self.hub.process)
    }

    /// Reports that the plugin directories offer other classes now.
    pub fn catalog_changed(&self) {
        if let Some(classes) = &self.classes {
            // A failure is fine without listeners: the inventory has the classes.
            let _ = self.hub.news.send(News::Catalog(self.offered(classes.as_ref())));
        }
    }

    /// Warns of the process itself from now on; `None`: ends the warning.
    pub fn warn(&self, of: Concern, warning: Option<String>) {
        self.hub.warn(of, warning);
    }

    /// Stops everything, devices safe first, then removes it; requests that come meanwhile or later make
    /// nothing. Bounded: a component that does not return within `within` is left.
    pub async fn shutdown(&self, within: Duration) {
        // A component that is stopped here cannot have another one started.
        self.hub.request_queue.close();
        let deadline = Instant::now() + within;
        let ids: Vec<ComponentId> = {
            let mut held = self.held();
            held.closed = true;
            held.components.keys().cloned().collect()
        };
        let order = Order::from(deadline);
        let stops = ids.iter().map(|id| self.run_verb(id, Verb::Stop, &order));
        for (id, done) in ids.iter().zip(join_all(stops).await) {
            if let Err(refusal) = done {
                log::error!("{id} could not be stopped at shutdown: {refusal}");
            }
        }
        let links: Vec<u64> = self.held().links.keys().copied().collect();
        for link in links {
            self.cut(link);
        }
        for id in ids.iter().rev() {
            if let Err(refusal) = self.destroy(id, deadline).await {
                log::error!("{id} could not be removed at shutdown: {refusal}");
            }
        }
        self.carriers.stop();
        self.follower.stop();
        self.drop_left(deadline.min(Instant::now() + within / CYCLES_PART)).await;
        self.watchdog.stop();
        self.hub.logs.close();
        let thread = self.log_thread.lock().take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the log thread panicked");
        }
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock()
    }

    /// The component whose report answers a change.
    fn about<'c>(&self, change: &'c Change) -> &'c ComponentId {
        match change {
            Change::Create { id, .. }
            | Change::Destroy { id, .. }
            | Change::Configure { id, .. }
            | Change::Run { id, .. } => id,
            Change::Connect { connection } | Change::Disconnect { connection, .. } => {
                let client = &connection.client.component;
                if client.process == self.hub.process { client } else { &connection.server.component }
            }
        }
    }

    /// Numbers of all connections that end in this process.
    fn connections(&self) -> Vec<u64> {
        let here = self.held().links.keys().copied().collect::<Vec<_>>();
        let remote = self.carriers.halves().flat_map(|halves| halves.connections());
        here.into_iter().chain(remote).collect()
    }

    fn slot(&self, id: &ComponentId) -> Result<Slot, Refusal> {
        let held = self.held();
        held.components.get(id).cloned().ok_or_else(|| Refusal::ComponentNotFound {
            id: id.clone(),
            known: held.components.keys().cloned().collect(),
        })
    }

    #[cfg(test)]
    pub(super) fn retired(&self) -> usize {
        self.hub.retired()
    }

    /// Sends a line of the process itself to the readers of the log.
    pub fn tell_line(&self, line: LogLine) {
        let _ = self.hub.news.send(News::Log(line));
    }

    fn news_receiver(&self) -> broadcast::Receiver<News> {
        self.hub.news.subscribe()
    }

    pub(super) fn instance(&self, id: &ComponentId) -> Result<Arc<Instance>, Refusal> {
        self.slot(id).map(|s| s.instance)
    }

    /// Runs `f` inside the component on its own thread and waits for it until the deadline, or until the
    /// orderer is gone.
    async fn inside<R: Send + 'static>(
        &self,
        slot: &Slot,
        entry: Entry,
        order: &Order,
        f: impl FnOnce(&Instance, &mut Entered<'_>) -> R + Send + 'static,
    ) -> Result<R, Refusal> {
        self.inside_or(slot, entry, order, f, |_, _, _| ()).await
    }

    /// As `inside`; when `f` returns only after its caller has given up, `undo` reverts it, so that the
    /// answer stays true.
    async fn inside_or<R: Send + 'static>(
        &self,
        slot: &Slot,
        entry: Entry,
        order: &Order,
        f: impl FnOnce(&Instance, &mut Entered<'_>) -> R + Send + 'static,
        undo: impl FnOnce(&Instance, &mut Entered<'_>, R) + Send + 'static,
    ) -> Result<R, Refusal> {
        let (tell, mut told) = oneshot::channel();
        let decided = Arc::new(AtomicBool::new(false));
        let deadline = order.deadline;
        let until_ns = os::now_ns().saturating_add(
            u64::try_from(deadline.saturating_duration_since(Instant::now()).as_nanos())
                .unwrap_or(u64::MAX / 2),
        );
        let errand = Errand { instance: slot.instance.clone(), entry, until_ns, decided: decided.clone() };
        slot.executor.submit(move |_| errand.run(tell, f, undo));
        let given_up = async {
            tokio::select! {
                () = tokio::time::sleep_until(deadline.into()) => {}
                () = order.lease.ended() => {}
            }
        };
        let done = tokio::select! {
            biased;
            done = &mut told => Some(done),
            () = given_up => None,
        };
        match done {
            Some(Ok(result)) => return Ok(result),
            Some(Err(_)) => {}
            // The work ended in this very moment: its result is on the way.
            None if decided.swap(true, Ordering::AcqRel) => {
                if let Ok(result) = told.await {
                    return Ok(result);
                }
            }
            None => {}
        }
        Err(Refusal::LcmTimeout {
            process: self.hub.process.clone(),
            what: format!("{} of {}", entry.name(), slot.instance.id),
        })
    }
}

/// Work inside a component for a caller who may give up.
struct Errand {
    instance: Arc<Instance>,
    entry: Entry,
    /// Time at which the caller gives up, ns.
    until_ns: u64,
    /// The first of the two decides the result: the end of the work or that of the patience.
    decided: Arc<AtomicBool>,
}

impl Errand {
    /// Does the work on the component's own thread and tells its result, or has it undone where nobody waits
    /// for it any more.
    fn run<R: Send + 'static>(
        self,
        tell: oneshot::Sender<R>,
        f: impl FnOnce(&Instance, &mut Entered<'_>) -> R,
        undo: impl FnOnce(&Instance, &mut Entered<'_>, R),
    ) {
        let Errand { instance, entry, until_ns, decided } = self;
        // The caller has given up: the work is not done any more.
        if tell.is_closed() {
            return;
        }
        // A passive component may be busy in a caller's thread.
        let Some(mut entered) = instance.object.enter_until(until_ns) else { return };
        let manners = Manners::before(&instance);
        let result = instance.as_running(entry, || f(&instance, &mut entered));
        manners.after(&instance, entry);
        let mut late = Some(result);
        if !decided.swap(true, Ordering::AcqRel) {
            instance.leave(entered);
            // The result comes back when the caller's whole request was dropped.
            late = late.and_then(|result| tell.send(result).err());
            if late.is_none() {
                return;
            }
            match instance.object.enter_until(os::now_ns() + UNDO_NS) {
                Some(again) => entered = again,
                None => return,
            }
        }
        if let Some(result) = late {
            let late = format!("{} came back after its caller had given up", entry.name());
            instance.say(log::Level::Warn, &late);
            instance.as_running(entry, || undo(&instance, &mut entered, result));
        }
        instance.leave(entered);
    }
}

async fn join_all<F: Future>(futures: impl IntoIterator<Item = F>) -> Vec<F::Output> {
    let mut all: Vec<_> = futures.into_iter().map(Box::pin).map(Some).collect();
    let mut done: Vec<Option<F::Output>> = all.iter().map(|_| None).collect();
    std::future::poll_fn(|cx| {
        for (future, result) in all.iter_mut().zip(&mut done) {
            if let Some(f) = future
                && let std::task::Poll::Ready(value) = f.as_mut().poll(cx)
            {
                *result = Some(value);
                *future = None;
            }
        }
        if all.iter().all(Option::is_none) { std::task::Poll::Ready(()) } else { std::task::Poll::Pending }
    })
    .await;
    done.into_iter().flatten().collect()
}

impl Shows for LocalLcm {
    fn component(&self, id: &ComponentId) -> Result<Arc<Instance>, Refusal> {
        self.instance(id)
    }

    fn outside(&self) -> &Outside {
        &self.outside
    }

    fn news(&self) -> broadcast::Receiver<News> {
        self.news_receiver()
    }
}

#[async_trait]
impl Lcm for LocalLcm {
    async fn apply(&self, change: Change, order: Order) -> Result<Report, Refusal> {
        let deadline = order.deadline;
        let stood =
            self.instance(self.about(&change)).map(|instance| instance.warnings()).unwrap_or_default();
        let done = match change {
            Change::Create { id, component } => self.create(id, component, &order).await,
            Change::Destroy { id, .. } => self.destroy(&id, deadline).await,
            Change::Configure { id, to, from_state, to_state, .. } => {
                self.configure(&id, &to, (from_state, to_state), &order).await
            }
            Change::Run { id, verb, .. } => self.run_verb(&id, verb, &order).await,
            Change::Connect { connection } => self.wire(connection, deadline).await,
            Change::Disconnect { connection, replaced } => {
                let number = connection.id.0;
                match self.unwire(number, replaced, deadline).await {
                    Some(wired) => Ok(wired.client.report(false)),
                    None => {
                        let how = if replaced { Loss::Replaced } else { Loss::Cut };
                        self.unlink_remote(number, how).await.ok_or_else(|| Refusal::ConnectionNotFound {
                            asked: number.to_string(),
                            known: self.connections().iter().map(u64::to_string).collect(),
                        })
                    }
                }
            }
        };
        // Earlier warnings are shown with the component, not again with every answer.
        done.map(|mut report| {
            report.warnings.retain(|warning| !stood.contains(warning));
            report
        })
    }

    async fn stop(&self, stop: Stop, order: Order) -> Result<Vec<Halted>, Refusal> {
        Ok(self.halt(&stop, &order).await)
    }

    async fn link(&self, end: RemoteEnd, deadline: Instant) -> Result<Report, Refusal> {
        self.link_remote(end, deadline).await
    }

    async fn invoke(&self, call: Invoke) -> Result<Reply, Refusal> {
        let instance = self.instance(&call.member.port.component)?;
        calling::invoke(instance, call).await
    }

    async fn read(
        &self,
        path: String,
        when: When,
        frame: bool,
        deadline: Instant,
    ) -> Result<Sample, Refusal> {
        outside::read(self, &path, when, frame, deadline).await
    }

    async fn subscribe(&self, selections: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
        outside::subscribe(self, selections)
    }

    async fn phases(
        &self,
        given: Option<Vec<(ComponentId, Phase)>>,
        _deadline: Instant,
    ) -> Result<StepTimes, Refusal> {
        Ok(self.give_phases(given))
    }

    async fn details(&self, ids: Vec<ComponentId>) -> Result<Vec<(ComponentId, Detail)>, Refusal> {
        Ok(self.details_of(ids))
    }

    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal> {
        let mut details: Vec<LinkDetail> = self.held().links.values().map(|l| l.detail()).collect();
        details.extend(self.carriers.halves().flat_map(|halves| halves.details()));
        Ok(details)
    }

    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal> {
        Ok(self.classes.as_ref().map_or_else(Vec::new, |c| c.plugins()))
    }

    async fn recheck(&self, name: &str, _deadline: Instant) -> Result<Vec<PluginInfo>, Refusal> {
        let Some(classes) = self.classes.clone() else { return Ok(Vec::new()) };
        let name = name.to_owned();
        let looking = move || {
            classes.recheck(&name);
            classes.plugins().into_iter().filter(|plugin| plugin.is_called(&name)).collect()
        };
        tokio::task::spawn_blocking(looking)
            .await
            .map_err(|e| Refusal::Internal { text: format!("plugins were not looked at again: {e}") })
    }

    async fn inventory(&self) -> Result<Inventory, Refusal> {
        let components = self.held().components.values().map(|s| s.instance.report(true)).collect();
        Ok(Inventory {
            card: self.own_card(),
            components,
            classes: self.classes.as_ref().map_or_else(Vec::new, |c| self.offered(c.as_ref())),
            halves: self.carriers.halves().flat_map(|halves| halves.reports()).collect(),
            warnings: concern::told(&self.hub.warnings.lock()),
            decision: self.hub.latches.seen(),
            stopped_here: self.hub.latches.stopped_here(),
        })
    }

    fn news(&self) -> broadcast::Receiver<News> {
        self.news_receiver()
    }
}
