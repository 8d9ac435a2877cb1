//! The LCM of this process: makes, runs, wires and removes components.
//!
//! Invariant: no lock is held while component code runs or is waited for; every wait ends at the caller's deadline.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use tokio::sync::{broadcast, mpsc, oneshot};
use trocar_model::{Change, ComponentId, Connection, Execution, Name, Refusal, State, StopReason, Verb};
use trocar_plugin_api::abi::NOT_ACTIVE;
use trocar_rt::os;
use trocar_rt::wake::Waker;

use super::api::{
    Detail, Inventory, Invoke, Item, Lcm, LinkDetail, News, PluginInfo, Reply, Report, Sample, Selection,
    Spread,
};
use super::classes::Classes;
use super::connect::Wired;
use super::executor::{Executor, Member, Pace};
use super::external;
use super::hub::Hub;
use super::instance::{self, Entered, Instance};
use super::lifecycle::{component_error, make, reset, resume, start, stop};
use super::{order, system};

/// How often the watchdog looks, ns.
const WATCH_NS: u64 = 10_000_000;

/// Longest wait for a component that is being removed, before its thread is left behind.
const HUNG: Duration = Duration::from_secs(1);

/// What an LCM is made from.
pub struct LcmConfig {
    pub process: Name,
    /// Where classes come from; `None` leaves the process without any.
    pub classes: Option<Arc<dyn Classes>>,
}

pub struct LocalLcm {
    hub: Arc<Hub>,
    classes: Option<Arc<dyn Classes>>,
    held: Mutex<Held>,
    next_number: AtomicU32,
    log_thread: Mutex<Option<thread::JoinHandle<()>>>,
    watchdog: Mutex<Option<thread::JoinHandle<()>>>,
    closing: Arc<Waker>,
}

#[derive(Default)]
struct Held {
    components: BTreeMap<ComponentId, Slot>,
    links: BTreeMap<u64, Arc<Wired>>,
}

/// One component and where it runs.
#[derive(Clone)]
struct Slot {
    instance: Arc<Instance>,
    executor: Arc<Executor>,
    execution: Execution,
    /// Configuration it was last given, for Reset.
    config: Option<String>,
}

impl Slot {
    fn member(&self) -> Member {
        Member { instance: self.instance.clone(), on_input: self.execution.stream_of.is_some() }
    }
}

impl LocalLcm {
    /// An LCM without components.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub fn new(config: LcmConfig) -> std::io::Result<Arc<LocalLcm>> {
        let lcm = Arc::new(LocalLcm {
            hub: Hub::new(config.process),
            classes: config.classes,
            held: Mutex::new(Held::default()),
            next_number: AtomicU32::new(1),
            log_thread: Mutex::new(None),
            watchdog: Mutex::new(None),
            closing: Arc::new(Waker::new()),
        });
        let (hub, weak) = (lcm.hub.clone(), Arc::downgrade(&lcm));
        let thread = thread::Builder::new().name("trocar-log".into()).spawn(move || {
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
        *lcm.log_thread.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        let (closing, weak) = (lcm.closing.clone(), Arc::downgrade(&lcm));
        let thread = thread::Builder::new().name("trocar-watchdog".into()).spawn(move || {
            while !closing.wait(Some(os::now_ns() + WATCH_NS)) {
                let Some(lcm) = weak.upgrade() else { return };
                let instances: Vec<_> = lcm.held().components.values().map(|s| s.instance.clone()).collect();
                instances.iter().for_each(|instance| instance.tell_health());
            }
        })?;
        *lcm.watchdog.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        Ok(lcm)
    }

    /// Tells everyone that the plugin directories offer something else now.
    pub fn catalog_changed(&self) {
        if let Some(classes) = &self.classes {
            // Nobody listening is fine: the inventory has it.
            let _ = self.hub.news.send(News::Catalog(classes.catalog()));
        }
    }

    /// Stops everything, devices safe first, then removes it. Bounded: what does not come back in `within` is left.
    pub async fn shutdown(&self, within: Duration) {
        let deadline = Instant::now() + within;
        let ids: Vec<ComponentId> = self.held().components.keys().cloned().collect();
        let stops = ids.iter().map(|id| self.run_verb(id, Verb::Stop, deadline));
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
        self.closing.notify();
        let thread = self.watchdog.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the watchdog panicked");
        }
        self.hub.logs.close();
        let thread = self.log_thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the log thread panicked");
        }
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn slot(&self, id: &ComponentId) -> Result<Slot, Refusal> {
        let held = self.held();
        held.components.get(id).cloned().ok_or_else(|| Refusal::ComponentNotFound {
            id: id.clone(),
            known: held.components.keys().cloned().collect(),
        })
    }

    pub(super) fn news_receiver(&self) -> broadcast::Receiver<News> {
        self.hub.news.subscribe()
    }

    pub(super) fn instance(&self, id: &ComponentId) -> Result<Arc<Instance>, Refusal> {
        self.slot(id).map(|s| s.instance)
    }

    /// Runs `f` inside the component on its own thread and waits for it until the deadline.
    async fn inside<R: Send + 'static>(
        &self,
        slot: &Slot,
        what: &str,
        deadline: Instant,
        f: impl FnOnce(&Instance, &mut Entered<'_>) -> R + Send + 'static,
    ) -> Result<R, Refusal> {
        let (tell, told) = oneshot::channel();
        let instance = slot.instance.clone();
        let until_ns = os::now_ns().saturating_add(
            u64::try_from(deadline.saturating_duration_since(Instant::now()).as_nanos())
                .unwrap_or(u64::MAX / 2),
        );
        slot.executor.submit(move |_| {
            // The caller has given up: what was asked is not done any more.
            if tell.is_closed() {
                return;
            }
            // A passive component may be busy in a caller's thread.
            if let Some(mut entered) = instance.object.enter_until(until_ns) {
                let result = instance.as_running(|| f(&instance, &mut entered));
                drop(entered);
                // A caller that is gone meanwhile reads the state instead.
                let _ = tell.send(result);
            }
        });
        match tokio::time::timeout_at(deadline.into(), told).await {
            Ok(Ok(result)) => Ok(result),
            _ => Err(Refusal::LcmTimeout {
                process: self.hub.process.clone(),
                what: format!("{what} of {}", slot.instance.id),
            }),
        }
    }

    async fn create(
        &self,
        id: ComponentId,
        component: Box<trocar_model::Component>,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        if self.held().components.contains_key(&id) {
            return Err(Refusal::ComponentExists { id });
        }
        let Some(classes) = self.classes.clone() else {
            return Err(Refusal::NotImplemented {
                what: format!(
                    "creating {} in a process without plugin directories",
                    component.class.full_name()
                ),
                hint: "start the host with --plugins DIR".into(),
            });
        };
        let (info, process) = (component.class.clone(), self.hub.process.clone());
        let loading = tokio::task::spawn_blocking(move || classes.load(&info));
        let class = match tokio::time::timeout_at(deadline.into(), loading).await {
            Ok(Ok(loaded)) => loaded?,
            Ok(Err(e)) => return Err(Refusal::Internal { text: format!("loading panicked: {e}") }),
            Err(_) => {
                return Err(Refusal::LcmTimeout { process, what: format!("loading the class of {id}") });
            }
        };
        let execution = component.execution.clone();
        let executor = self.executor_for(&id, &execution)?;
        let passive = instance::is_passive(execution.model) && executor.1;
        let number = self.next_number.fetch_add(1, Ordering::Relaxed);
        let period_ns = match Pace::of(&execution) {
            Pace::Grid { period_ns, .. } if execution.stream_of.is_none() => period_ns,
            _ => 0,
        };
        let class_info = component.class.clone();
        let made = Instance::new(number, id.clone(), class_info, class, self.hub.clone(), passive, period_ns);
        made.attach(executor.0.id, executor.0.waker.clone());
        made.set_on_grid(matches!(executor.0.pace, Pace::Grid { .. }));
        self.hub.logs.name(number, Some(&id));
        let slot = Slot { instance: made, executor: executor.0, execution, config: None };
        let done = self.inside(&slot, "create", deadline, make).await;
        match done {
            Ok(Ok(())) => {
                let member = slot.member();
                slot.executor.submit(move |members| members.push(member));
                let mut report = slot.instance.report(true);
                report.warnings =
                    slot.executor.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone();
                self.held().components.insert(id, slot);
                Ok(report)
            }
            Ok(Err((entry, e))) => {
                self.abandon(&slot, executor.1);
                Err(component_error(&id, entry, e))
            }
            Err(refusal) => {
                self.abandon(&slot, executor.1);
                Err(refusal)
            }
        }
    }

    fn abandon(&self, slot: &Slot, own: bool) {
        self.hub.logs.name(slot.instance.number, None);
        if own {
            slot.executor.close();
        }
    }

    /// The thread a component will run on, and whether it is its own.
    fn executor_for(
        &self,
        id: &ComponentId,
        execution: &Execution,
    ) -> Result<(Arc<Executor>, bool), Refusal> {
        if let Some(other) = execution.stream_of.as_ref().or(execution.inside.as_ref()) {
            let slot = self.slot(&ComponentId::parse(other)?)?;
            return Ok((slot.executor, false));
        }
        Executor::spawn(id.component.as_str(), Pace::of(execution), execution)
            .map(|e| (e, true))
            .map_err(|e| Refusal::Internal { text: format!("no thread for {id}: {e}") })
    }

    async fn configure(
        &self,
        id: &ComponentId,
        to: &serde_json::Value,
        to_state: State,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        if to_state == State::Created {
            // The undoing of a Create takes its configuration back; the instance goes next.
            slot.instance.set_state(State::Created, "");
            return Ok(slot.instance.report(true));
        }
        let json = to.to_string();
        let given = json.clone();
        let done = self
            .inside(&slot, "configure", deadline, move |instance, entered| {
                let done = entered.configure(&given);
                match &done {
                    Ok(()) => {
                        instance.publish_state(entered);
                        if instance.state() != to_state {
                            instance.set_state(to_state, "");
                        }
                    }
                    // Refused: it goes on as before. Anything else: not trusted any more.
                    Err(e) if e.refused() => {}
                    Err(e) => instance.fail(entered, "configure", e),
                }
                done
            })
            .await?;
        done.map_err(|e| component_error(id, "configure", e))?;
        if let Some(slot) = self.held().components.get_mut(id) {
            slot.config = Some(json);
        }
        Ok(slot.instance.report(true))
    }

    async fn run_verb(&self, id: &ComponentId, verb: Verb, deadline: Instant) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        let (what, config) = (verb.to_string(), slot.config.clone());
        if verb == Verb::Stop {
            return self.stop(&slot, deadline).await;
        }
        let done = self
            .inside(&slot, &what, deadline, move |instance, entered| match verb {
                Verb::Start => start(instance, entered),
                Verb::Resume => resume(instance, entered),
                Verb::Reset => reset(instance, entered, config.as_deref()),
                Verb::Stop | Verb::Configure | Verb::Remove => Ok(()),
            })
            .await?;
        match done {
            Ok(()) => {
                slot.executor.waker.notify();
                Ok(slot.instance.report(true))
            }
            Err((entry, e)) => Err(component_error(id, entry, e)),
        }
    }

    /// Acts first: no further step begins once this returns or times out.
    async fn stop(&self, slot: &Slot, deadline: Instant) -> Result<Report, Refusal> {
        if slot.instance.is_active() {
            slot.instance.stopped(StopReason::Requested);
        }
        let done = self.inside(slot, "stop", deadline, stop).await;
        match done {
            Ok(Ok(())) => Ok(slot.instance.report(false)),
            Ok(Err((entry, e))) => Err(component_error(&slot.instance.id, entry, e)),
            Err(refusal) => {
                slot.instance
                    .set_state(State::Fault, "stop: it did not come back; its thread is inside its own code");
                Err(refusal)
            }
        }
    }

    async fn destroy(&self, id: &ComponentId, deadline: Instant) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        let mut report = slot.instance.report(false);
        let patience = deadline.min(Instant::now() + HUNG);
        let done = self
            .inside(&slot, "remove", patience, |instance, entered| {
                if instance.is_active() {
                    instance.stopped(StopReason::Requested);
                    // It goes away either way; the reason was logged.
                    let _ = stop(instance, entered);
                }
                instance.close();
                entered.destroy();
            })
            .await;
        let number = slot.instance.number;
        slot.executor.submit(move |members| members.retain(|m| m.instance.number != number));
        self.hub.logs.name(number, None);
        let mut held = self.held();
        held.components.remove(id);
        if !held.components.values().any(|s| s.executor.id == slot.executor.id) {
            slot.executor.close();
        }
        if done.is_err() {
            slot.instance.close();
            report.warnings.push(format!(
                "{id} did not come back out of its own code: it is removed, its thread stays until the process ends"
            ));
        }
        Ok(report)
    }

    fn wire(&self, connection: &Connection) -> Result<Report, Refusal> {
        let client = self.slot(&connection.client.component)?;
        let server = self.slot(&connection.server.component)?;
        let wired = Wired::connect(connection, &client.instance, &server.instance)?;
        self.held().links.insert(connection.id.0, Arc::new(wired));
        self.reorder(&client);
        Ok(client.instance.report(false))
    }

    /// Cuts a connection; an actuator that loses what it requires is made safe and stopped.
    fn cut(&self, id: u64) -> Option<Arc<Wired>> {
        let wired = self.held().links.remove(&id)?;
        wired.disconnect();
        let client = self.slot(&wired.client.id).ok()?;
        if wired.required && client.instance.info.safety == trocar_model::Safety::Actuator {
            let instance = client.instance.clone();
            client.executor.submit(move |_| {
                if instance.is_active()
                    && let Some(mut entered) = instance.object.try_enter()
                {
                    instance.stopped(StopReason::PeerLost);
                    instance.make_safe(&mut entered);
                    instance.refuse_queued(NOT_ACTIVE);
                }
            });
        }
        self.reorder(&client);
        Some(wired)
    }

    /// Sorts the members of a shared thread along their streams.
    fn reorder(&self, slot: &Slot) {
        let held = self.held();
        let shared: Vec<&Slot> =
            held.components.values().filter(|s| s.executor.id == slot.executor.id).collect();
        if shared.len() < 2 {
            return;
        }
        let streams: Vec<(u32, u32)> = held
            .links
            .values()
            .filter(|l| l.is_stream())
            .map(|l| (l.server.number, l.client.number))
            .collect();
        let numbers: Vec<u32> = shared.iter().map(|s| s.instance.number).collect();
        let sorted: Vec<Member> = order::along(&numbers, &streams)
            .into_iter()
            .filter_map(|n| shared.iter().find(|s| s.instance.number == n).map(|s| s.member()))
            .collect();
        slot.executor.submit(move |members| *members = sorted);
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

#[async_trait]
impl Lcm for LocalLcm {
    async fn apply(&self, change: Change, deadline: Instant) -> Result<Report, Refusal> {
        match change {
            Change::Create { id, component } => self.create(id, component, deadline).await,
            Change::Destroy { id, .. } => self.destroy(&id, deadline).await,
            Change::Configure { id, to, to_state, .. } => self.configure(&id, &to, to_state, deadline).await,
            Change::Run { id, verb, .. } => self.run_verb(&id, verb, deadline).await,
            Change::Connect { connection } => self.wire(&connection),
            Change::Disconnect { connection } => match self.cut(connection.id.0) {
                Some(wired) => Ok(wired.client.report(false)),
                None => Err(Refusal::ConnectionNotFound {
                    asked: connection.id.0.to_string(),
                    known: self.held().links.keys().map(u64::to_string).collect(),
                }),
            },
        }
    }

    async fn invoke(&self, call: Invoke) -> Result<Reply, Refusal> {
        let instance = self.instance(&call.member.port.component)?;
        external::invoke(instance, call).await
    }

    async fn read(&self, path: String, deadline: Instant) -> Result<Sample, Refusal> {
        external::read(self, &path, deadline).await
    }

    async fn subscribe(&self, selections: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
        external::subscribe(self, selections)
    }

    async fn detail(&self, id: ComponentId) -> Result<Detail, Refusal> {
        let slot = self.slot(&id)?;
        Ok(detail(&slot))
    }

    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal> {
        Ok(self.held().links.values().map(|l| l.detail()).collect())
    }

    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal> {
        Ok(self.classes.as_ref().map_or_else(Vec::new, |c| c.plugins()))
    }

    async fn inventory(&self) -> Result<Inventory, Refusal> {
        let components = self.held().components.values().map(|s| s.instance.report(true)).collect();
        Ok(Inventory { components, classes: self.classes.as_ref().map_or_else(Vec::new, |c| c.catalog()) })
    }

    fn news(&self) -> broadcast::Receiver<News> {
        self.news_receiver()
    }
}

fn detail(slot: &Slot) -> Detail {
    let s = slot.instance.stats.snapshot();
    let spread = |m: trocar_rt::timing::Spread| Spread {
        avg_ns: m.avg_ns,
        std_ns: m.std_ns,
        min_ns: m.min_ns,
        max_ns: m.max_ns,
    };
    Detail {
        period: spread(s.period),
        compute: spread(s.compute),
        lateness_p50_ns: s.lateness_p50_ns,
        lateness_p99_ns: s.lateness_p99_ns,
        lateness_max_ns: s.lateness_max_ns,
        executed: s.executed,
        skipped: s.skipped,
        overruns: s.overruns,
        load: s.load,
        commands: slot.instance.counters.commands(),
        commands_rejected: slot.instance.queue_losses(),
        events_dropped: 0,
        thread: match (&slot.execution.stream_of, &slot.execution.inside) {
            (Some(head), _) => format!("stream of {head}"),
            (_, Some(head)) => format!("inside {head}"),
            _ if slot.instance.is_passive() => "callers' threads".into(),
            _ => "own thread".into(),
        },
        realtime: slot.executor.realtime.load(Ordering::Relaxed),
        warnings: slot.executor.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone(),
    }
}
