//! An LCM without components: it does what it is told, notes it, and refuses or hangs where a test says so.
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use parking_lot::Mutex;
use serde_json::json;
use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::timeout;
use trocar_lcm_api::{
    Decision, Detail, HalfReport, Halted, Inventory, Invoke, Item, ItemKind, Lcm, LinkDetail, LogLine, News,
    Order, PluginInfo, Reply, Report, Sample, Selection, Stop, StoppedHere, When,
};
use trocar_links::{Card, LAYOUT};
use trocar_model::{
    Arg, Change, ClassInfo, Command, CommandKind, ComponentId, Connection, End, Execution, ExecutionLimits,
    ExecutionModel, Health, Input, Name, Output, Overflow, Phase, PortType, Ports, Prim, Programs, Provided,
    Proxy, Refusal, Required, Safety, State, StepTimes, StopReason, SystemGraph, Tag, Type, Verb, Warnings,
    allowed,
};

use super::{Gcm, text};
use crate::watchdog::Watchdog;

/// Time between two looks at what changes by itself.
const LOOK: Duration = Duration::from_secs(1);

pub(crate) struct FakeLcm {
    process: Name,
    states: Mutex<BTreeMap<ComponentId, State>>,
    /// Every change that was asked, as "Start host/a".
    done: Mutex<Vec<String>>,
    refuse: Mutex<BTreeSet<String>>,
    /// Connections that it has cut by itself, as "Disconnect host/b/robot from host/a/arm", and not told so.
    has_cut: Mutex<BTreeSet<String>>,
    /// Changes after which their component has these ports.
    ports: Mutex<BTreeMap<String, Arc<Ports>>>,
    /// Connections to other processes that cannot be made.
    unreachable: Mutex<BTreeSet<String>>,
    /// Changes that put their component in FAULT.
    fault: Mutex<BTreeSet<String>>,
    /// Changes in the middle of which the process goes away.
    lose: Mutex<BTreeSet<String>>,
    /// Stops that were ordered: a Start that was decided before one that names its component is refused.
    stops: Mutex<Vec<(Stop, Decision)>>,
    /// The Stops that it was asked for itself.
    pub(crate) stopped_here: Mutex<StoppedHere>,
    /// Changes that wait for [`FakeLcm::release`].
    held: Mutex<BTreeSet<String>>,
    released: watch::Sender<u64>,
    waiting: watch::Sender<BTreeSet<String>>,
    /// Halves of connections to other processes, by connection number.
    halves: Mutex<BTreeMap<u64, HalfReport>>,
    feeds: Mutex<Vec<mpsc::Sender<Item>>>,
    /// Number of subscriptions so far.
    followed: watch::Sender<usize>,
    /// The phases it was given last.
    pub(crate) phases: watch::Sender<BTreeMap<ComponentId, Phase>>,
    /// Times its steps take.
    pub(crate) takes: Mutex<StepTimes>,
    /// Questions for figures so far.
    pub(crate) figures: AtomicUsize,
    pub(crate) news: broadcast::Sender<News>,
}

/// Waits until the graph is so. Each other graph is progress.
pub(crate) async fn until(gcm: &Gcm, what: &str, good: impl Fn(&SystemGraph) -> bool) -> Arc<SystemGraph> {
    let (mut graphs, mut watchdog) = (gcm.watch(), Watchdog::of(what));
    loop {
        let graph = graphs.borrow_and_update().clone();
        if good(&graph) {
            return graph;
        }
        watchdog.saw(format_args!("{graph:?}"));
        if let Ok(changed) = timeout(LOOK, graphs.changed()).await {
            changed.unwrap();
        }
    }
}

/// Waits for something that comes by itself, under the watchdog.
pub(crate) async fn comes<F: Future>(what: &str, coming: F) -> F::Output {
    let (mut coming, mut watchdog) = (pin!(coming), Watchdog::of(what));
    loop {
        match timeout(LOOK, &mut coming).await {
            Ok(come) => return come,
            Err(_) => watchdog.saw("nothing has come"),
        }
    }
}

pub(crate) fn name(text: &str) -> Name {
    Name::parse(text).unwrap()
}

pub(crate) fn id(text: &str) -> ComponentId {
    ComponentId::parse(text).unwrap()
}

/// A class with a setting, a command, an input, an output and a required interface that all are optional.
pub(crate) fn class() -> Arc<ClassInfo> {
    let number = Type::Prim(Prim::F64);
    let arg = Arg {
        name: "value".into(),
        doc: "set point".into(),
        ty: number.clone(),
        unit: "mm".into(),
        min: Some(0.0),
        max: Some(100.0),
    };
    let command = Command {
        name: "write".into(),
        doc: "moves".into(),
        kind: CommandKind::Write,
        arg: Some(arg),
        ret: None,
        ret_unit: String::new(),
        overflow: Overflow::Reject,
    };
    let provided = Provided {
        name: "arm".into(),
        doc: "the arm".into(),
        tag: Tag::None,
        commands: vec![command],
        events: vec![],
    };
    let required = Required {
        name: "robot".into(),
        doc: "whom it moves".into(),
        optional: true,
        functions: vec![],
        handlers: vec![],
    };
    let input = Input {
        name: "input".into(),
        doc: "a number".into(),
        ty: PortType::Plain(number.clone()),
        tag: Tag::None,
        optional: true,
        fifo: 0,
    };
    let output = Output {
        name: "value".into(),
        doc: "a number".into(),
        ty: PortType::Plain(number.clone()),
        tag: Tag::None,
    };
    Arc::new(ClassInfo {
        plugin: "toy".into(),
        version: "1.0.0".into(),
        hash: "00".into(),
        name: "arm".into(),
        doc: "A toy.".into(),
        safety: Safety::Actuator,
        hardware: false,
        safe_from_any_thread: true,
        programs: Programs::None,
        execution: Execution {
            model: Some(ExecutionModel::Periodic),
            period_ns: Some(1_000_000),
            ..Execution::default()
        },
        limits: ExecutionLimits {
            models: ExecutionModel::ALL.to_vec(),
            min_period_ns: Some(100_000),
            max_period_ns: Some(1_000_000_000),
        },
        config_schema: json!({
            "type": "object",
            "properties": { "gain": { "type": "number", "minimum": 0, "default": 1.5, "live": true } },
        }),
        ports: Ports {
            inputs: vec![input],
            outputs: vec![output],
            required: vec![required],
            provided: vec![provided],
            state: Some(number),
        },
    })
}

/// The same as something that moves nothing.
fn camera() -> Arc<ClassInfo> {
    Arc::new(ClassInfo { name: "cam".into(), safety: Safety::Sensor, ..ClassInfo::clone(&class()) })
}

impl FakeLcm {
    pub(crate) fn new(process: &str) -> Arc<FakeLcm> {
        Arc::new(FakeLcm {
            process: name(process),
            states: Mutex::default(),
            done: Mutex::default(),
            refuse: Mutex::default(),
            has_cut: Mutex::default(),
            ports: Mutex::default(),
            unreachable: Mutex::default(),
            fault: Mutex::default(),
            lose: Mutex::default(),
            stops: Mutex::default(),
            stopped_here: Mutex::default(),
            held: Mutex::default(),
            released: watch::Sender::new(0),
            waiting: watch::Sender::default(),
            halves: Mutex::default(),
            feeds: Mutex::default(),
            followed: watch::Sender::new(0),
            phases: watch::Sender::default(),
            takes: Mutex::default(),
            figures: AtomicUsize::new(0),
            news: broadcast::Sender::new(64),
        })
    }

    /// "Connect b/x/input to a/x/value" cannot be done from now on.
    pub(crate) fn unreachable(&self, connect: &str) {
        self.unreachable.lock().insert(connect.into());
    }

    /// Its halves were made for an earlier run of the other process.
    pub(crate) fn halves_are_stale(&self) {
        for half in self.halves.lock().values_mut() {
            half.proxy.iter_mut().for_each(|proxy| proxy.peer = "an earlier run".into());
        }
    }

    /// "Configure host/a" makes these ports.
    pub(crate) fn ports_at(&self, change: &str, ports: Ports) {
        self.ports.lock().insert(change.into(), Arc::new(ports));
    }

    /// The LCM has cut the connection of this Disconnect already, and did not tell.
    pub(crate) fn has_cut(&self, disconnect: &str) {
        self.has_cut.lock().insert(disconnect.into());
    }

    /// "Start host/a" is refused from now on.
    pub(crate) fn refuse(&self, change: &str) {
        self.refuse.lock().insert(change.into());
    }

    /// "Start host/a" ends in FAULT from now on.
    pub(crate) fn fault_at(&self, change: &str) {
        self.fault.lock().insert(change.into());
    }

    /// In the middle of the next "Start host/a" the process goes away.
    pub(crate) fn lose_at(&self, change: &str) {
        self.lose.lock().insert(change.into());
    }

    /// "Start host/a" hangs until [`FakeLcm::release`].
    pub(crate) fn hold(&self, change: &str) {
        self.held.lock().insert(change.into());
    }

    pub(crate) fn release(&self, change: &str) {
        self.held.lock().remove(change);
        self.released.send_modify(|n| *n += 1);
    }

    /// Until that change has arrived and hangs.
    pub(crate) async fn hangs(&self, change: &str) {
        self.waiting.subscribe().wait_for(|w| w.contains(change)).await.unwrap();
    }

    /// The last Stop at the process itself that the GCM knows of, as its last Stop said.
    pub(crate) fn known_here(&self) -> Option<u64> {
        self.stops.lock().last().map(|(stop, _)| stop.known_here)
    }

    /// Until a Stop was ordered.
    pub(crate) async fn is_told_to_stop(&self) {
        while self.known_here().is_none() {
            tokio::task::yield_now().await;
        }
    }

    pub(crate) fn done(&self) -> Vec<String> {
        self.done.lock().clone()
    }

    pub(crate) fn state(&self, component: &str) -> Option<State> {
        self.states.lock().get(&id(component)).copied()
    }

    /// A component goes into another state by itself.
    pub(crate) fn become_state(&self, component: &str, state: State, fault: &str) {
        self.states.lock().insert(id(component), state);
        let report = Report { fault: fault.into(), ..report(&id(component), state) };
        // Nobody listening is fine.
        let _ = self.news.send(News::State(report));
    }

    /// Tells the health of a component, as its watchdog would.
    pub(crate) fn become_health(&self, component: &str, state: State, health: Health) {
        let report = Report { health, ..report(&id(component), state) };
        // Nobody listening is fine.
        let _ = self.news.send(News::State(report));
    }

    pub(crate) fn log(&self, path: &str, level: u32, message: &str) {
        let line =
            LogLine { wall_ns: 1, level, path: path.into(), target: "toy".into(), message: message.into() };
        let _ = self.news.send(News::Log(line));
    }

    /// Gives an item to every follower.
    pub(crate) async fn emit(&self, path: &str, n: u64) {
        self.give(event(path, n)).await;
    }

    /// Gives a picture to every follower.
    pub(crate) async fn picture(&self, path: &str, n: u64, jpeg: &[u8]) {
        self.give(Item { kind: ItemKind::Stream, jpeg: jpeg.to_vec(), ..event(path, n) }).await;
    }

    async fn give(&self, item: Item) {
        let feeds = self.feeds.lock().clone();
        for feed in feeds {
            let _ = feed.send(item.clone()).await;
        }
    }

    /// Gives a picture of so many bytes to the followers that take it now; true: somebody did.
    pub(crate) fn show(&self, bytes: usize) -> bool {
        let picture = Item { kind: ItemKind::Stream, jpeg: vec![7; bytes], ..event("gui/a/frames", 1) };
        self.feeds.lock().iter().filter(|feed| feed.try_send(picture.clone()).is_ok()).count() > 0
    }

    /// Waits for the n-th subscription.
    pub(crate) async fn followed(&self, times: usize) {
        self.followed.subscribe().wait_for(|n| *n >= times).await.unwrap();
    }

    /// Ends every subscription, as when what was followed is made anew.
    pub(crate) fn end_feeds(&self) {
        self.feeds.lock().clear();
    }

    /// Waits until all subscriptions have ended.
    pub(crate) async fn unfollowed(&self) {
        let feeds = self.feeds.lock().clone();
        for feed in feeds {
            feed.closed().await;
        }
    }
}

fn event(path: &str, n: u64) -> Item {
    let (value, path) = (json!({ "n": n }), path.into());
    Item { path, kind: ItemKind::Event, value, stamp_ns: n, seq: n, skipped: 0, jpeg: Vec::new() }
}

fn report(id: &ComponentId, state: State) -> Report {
    Report {
        id: id.clone(),
        number: 0,
        state,
        health: Health::Ok,
        fault: String::new(),
        ports: None,
        lost_connections: Vec::new(),
        warnings: Vec::new(),
    }
}

#[async_trait]
impl Lcm for FakeLcm {
    async fn apply(&self, change: Change, order: Order) -> Result<Report, Refusal> {
        let asked = text::asked(&change);
        let mut released = self.released.subscribe();
        while self.held.lock().contains(&asked) {
            self.waiting.send_modify(|w| {
                w.insert(asked.clone());
            });
            released.changed().await.unwrap();
        }
        if self.lose.lock().remove(&asked) {
            return Err(Refusal::lost(self.process.clone()));
        }
        self.done.lock().push(asked.clone());
        let id = super::changes::id_of(&change).clone();
        if self.refuse.lock().contains(&asked) {
            return Err(Refusal::ComponentRefused { id, entry: "start", text: "the cable is out".into() });
        }
        if self.has_cut.lock().contains(&asked) {
            return Err(Refusal::ConnectionNotFound { asked, known: Vec::new() });
        }
        if self.fault.lock().contains(&asked) {
            let text = "start: the cable is out".to_owned();
            self.become_state(&id.to_string(), State::Fault, &text);
            return Err(Refusal::ComponentFault { id, text });
        }
        let mut states = self.states.lock();
        if let Change::Run { verb, to: State::Active, .. } = &change {
            let stops = self.stops.lock();
            let names = |stop: &Stop| stop.targets.iter().any(|target| target.names(&id));
            if stops.iter().any(|(stop, decision)| names(stop) && *decision >= order.decision) {
                let state = states.get(&id).copied().unwrap_or(State::Created);
                let why = "it was stopped while this was being carried out".to_owned();
                return Err(Refusal::WrongState { id, state, verb: *verb, allowed: allowed(state), why });
            }
        }
        match change {
            Change::Create { component, .. } => states.insert(id.clone(), component.state),
            Change::Destroy { .. } => states.remove(&id),
            Change::Configure { to_state, .. } => states.insert(id.clone(), to_state),
            Change::Run { to, .. } => states.insert(id.clone(), to),
            Change::Connect { .. } => None,
            Change::Disconnect { connection, .. } => {
                if let Some(half) = self.halves.lock().remove(&connection.id.0) {
                    let _ = self.news.send(News::Half(HalfReport { proxy: None, ..half }));
                }
                None
            }
        };
        let now = states.get(&id).copied().unwrap_or(State::Created);
        let ports = self.ports.lock().get(&asked).cloned();
        Ok(Report { ports, ..report(&id, now) })
    }

    /// Waits for a Start under way of what is named, as an LCM does.
    async fn stop(&self, stop: Stop, order: Order) -> Result<Vec<Halted>, Refusal> {
        let named = |id: &ComponentId| stop.targets.iter().any(|target| target.names(id));
        self.stops.lock().push((stop.clone(), order.decision));
        let states = self.states.lock().clone();
        let mut halted = Vec::new();
        for (id, was) in states.into_iter().filter(|(id, _)| named(id)) {
            let mut released = self.released.subscribe();
            while [Verb::Start, Verb::Resume]
                .iter()
                .any(|verb| self.held.lock().contains(&format!("{verb} {id}")))
            {
                released.changed().await.unwrap();
            }
            let to = State::Stopped(StopReason::Requested);
            let moves = matches!(was, State::Active | State::Stopped(StopReason::Restarted));
            let done = match moves {
                true => {
                    let stop = Change::Run { id: id.clone(), verb: Verb::Stop, from: was, to };
                    self.apply(stop, order.clone()).await
                }
                false => Ok(report(&id, was)),
            };
            if let Err(lost @ Refusal::ProcessLost { .. }) = done {
                return Err(lost);
            }
            halted.push(Halted { id, was, done });
        }
        Ok(halted)
    }

    async fn link(&self, end: trocar_lcm_api::RemoteEnd, deadline: Instant) -> Result<Report, Refusal> {
        let (connection, card) = (end.connection, end.card);
        let here = |port: &trocar_model::PortId| port.component.process == self.process;
        let end = if here(&connection.client) { End::Client } else { End::Server };
        let number = connection.id.0;
        let asked = text::asked(&Change::Connect { connection: connection.clone() });
        if self.unreachable.lock().contains(&asked) {
            let Connection { client, server, .. } = connection;
            return Err(Refusal::Unreachable { client, server, why: "no socket".into() });
        }
        let done = self.apply(Change::Connect { connection }, deadline.into()).await?;
        let (process, peer, carrier) = (self.process.clone(), card.instance, "memfd".into());
        let proxy = Proxy { process, epoch: 1, why: String::new(), carrier, peer };
        let half = HalfReport { connection: number, end, proxy: Some(proxy) };
        self.halves.lock().insert(number, half.clone());
        let _ = self.news.send(News::Half(half));
        Ok(done)
    }

    async fn invoke(&self, call: Invoke) -> Result<Reply, Refusal> {
        if call.member.to_string() != format!("{}/a/arm/write", self.process) {
            return Err(Refusal::MemberNotFound { member: call.member, known: vec!["write".into()] });
        }
        // A call is followed by an event at once; a listener that comes too late has missed it.
        for feed in self.feeds.lock().iter() {
            let _ = feed.try_send(event(&format!("{}/a/arm/moved", self.process), 77));
        }
        let value = match call.arg {
            trocar_lcm_api::Payload::Json(value) => value,
            other => json!(format!("{other:?}")),
        };
        Ok(Reply {
            executed: !call.send,
            value: Some(value),
            encoded: vec![1, 2],
            stamp_ns: 5,
            age_ns: 6,
            unit: "mm".into(),
        })
    }

    async fn read(&self, path: String, when: When, frame: bool, _: Instant) -> Result<Sample, Refusal> {
        let value = match when {
            When::Newest => path,
            other => format!("{path} {other:?}"),
        };
        Ok(Sample {
            value: json!(value),
            encoded: vec![9],
            stamp_ns: 1,
            age_ns: 2,
            seq: 3,
            frame_bytes: 2,
            frame: if frame { vec![7, 8] } else { Vec::new() },
        })
    }

    async fn subscribe(&self, _: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
        let (tell, told) = mpsc::channel(16);
        self.feeds.lock().push(tell);
        self.followed.send_modify(|n| *n += 1);
        Ok(told)
    }

    async fn details(&self, ids: Vec<ComponentId>) -> Result<Vec<(ComponentId, Detail)>, Refusal> {
        self.figures.fetch_add(1, Ordering::Relaxed);
        let detail = Detail { executed: 42, thread: "own thread".into(), ..Detail::default() };
        Ok(ids.into_iter().map(|id| (id, detail.clone())).collect())
    }

    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal> {
        self.figures.fetch_add(1, Ordering::Relaxed);
        Ok(vec![LinkDetail { connection: 1, carrier: "inline".into(), passed: 7, ..LinkDetail::default() }])
    }

    async fn phases(
        &self,
        given: Option<Vec<(ComponentId, Phase)>>,
        _: Instant,
    ) -> Result<StepTimes, Refusal> {
        if let Some(given) = given {
            self.phases.send_replace(given.into_iter().collect());
        }
        Ok(self.takes.lock().clone())
    }

    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal> {
        Ok(vec![PluginInfo {
            process: self.process.to_string(),
            name: "toy".into(),
            file: "libtoy.so".into(),
            classes: vec!["arm".into()],
            ..PluginInfo::default()
        }])
    }

    async fn inventory(&self) -> Result<Inventory, Refusal> {
        let states = self.states.lock();
        Ok(Inventory {
            card: Some(Card {
                process: self.process.to_string(),
                instance: "1".into(),
                boot: "1".into(),
                uid: 0,
                socket: "nowhere".into(),
                net: String::new(),
                layout: LAYOUT,
            }),
            components: states.iter().map(|(id, s)| report(id, *s)).collect(),
            classes: vec![class(), camera()],
            halves: self.halves.lock().values().cloned().collect(),
            warnings: Warnings::default(),
            decision: self.stops.lock().iter().map(|(_, decision)| *decision).max().unwrap_or_default(),
            stopped_here: self.stopped_here.lock().clone(),
        })
    }

    fn news(&self) -> broadcast::Receiver<News> {
        self.news.subscribe()
    }
}
