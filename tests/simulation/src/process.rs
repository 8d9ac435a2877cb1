//! A model of the components of one process: it does what it is ordered, takes its time, refuses, fails, and
//! ends.
//!
//! Invariant: as of a true LCM. A change that is not done by its deadline, or whose orderer is gone, is not
//! done; what runs through one component is done one after the other; a Stop is noted before anything else.

mod hanging;

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use futures_util::future::join_all;
use parking_lot::Mutex;
use tokio::sync::{OwnedMutexGuard, broadcast, mpsc, watch};
use trocar::gcm::plan_lines;
use trocar_lcm_api::clock;
use trocar_lcm_api::{
    Decision, Detail, HalfReport, Halted, Inventory, Invoke, Item, Lcm, LinkDetail, News, Order, PluginInfo,
    RemoteEnd, Reply, Report, Sample, Selection, Stop, When,
};
use trocar_links::{Card, LAYOUT};
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, Connection, End, Health, Name, Plan, PortId, Proxy, Refusal,
    State, StopReason, Target, Verb, Warnings, allowed, transition,
};

use crate::chance::Chance;
use crate::goes_on::Rest;
use crate::latches::Latches;
use crate::truth::{Kind, Truth};

/// One of so many changes is refused by its component.
const REFUSED: usize = 40;
/// One of so many starts fails.
const FAILS: usize = 50;
/// One of so many halves of connections cannot be made.
const UNREACHABLE: usize = 30;

/// One incarnation of a process.
pub(crate) struct ModelLcm {
    me: Weak<ModelLcm>,
    name: Name,
    /// Number of the incarnation, of all processes together.
    pub(crate) number: u64,
    has: Mutex<Has>,
    latches: Latches,
    news: broadcast::Sender<News>,
    alive: watch::Sender<bool>,
    classes: Vec<Arc<ClassInfo>>,
    chance: Chance,
    truth: Truth,
}

#[derive(Default)]
struct Has {
    components: BTreeMap<ComponentId, Component>,
    connections: BTreeMap<u64, Connection>,
    /// Halves of connections to other processes.
    halves: BTreeMap<u64, Half>,
    /// Decisions by which components were set in motion last.
    started: BTreeMap<ComponentId, Decision>,
    /// Halves that are only being made; closed when one is to be no more.
    linking: BTreeMap<u64, watch::Sender<()>>,
    /// Held while something runs through a component; one that hangs when it is removed keeps its own.
    turns: BTreeMap<ComponentId, Arc<tokio::sync::Mutex<()>>>,
    /// Number of the last report.
    reports: u64,
}

/// Everything that a process has, for a look from outside.
#[derive(Debug)]
pub(crate) struct Seen {
    pub(crate) components: BTreeMap<ComponentId, Component>,
    pub(crate) connections: BTreeMap<u64, Connection>,
    pub(crate) halves: BTreeMap<u64, Half>,
}

/// Half of a connection to another process.
#[derive(Clone, Debug)]
pub(crate) struct Half {
    pub(crate) connection: Connection,
    end: End,
    /// Incarnation of the process at the other end.
    pub(crate) peer: String,
}

impl ModelLcm {
    pub(crate) fn new(
        name: Name,
        number: u64,
        classes: Vec<Arc<ClassInfo>>,
        chance: Chance,
        truth: Truth,
        news: usize,
    ) -> Arc<ModelLcm> {
        Arc::new_cyclic(|me| ModelLcm {
            me: me.clone(),
            name,
            number,
            has: Mutex::default(),
            latches: Latches::default(),
            news: broadcast::Sender::new(news),
            alive: watch::Sender::new(true),
            classes,
            chance,
            truth,
        })
    }

    /// Ends it in the middle of whatever it does.
    pub(crate) fn kill(&self) {
        self.alive.send_replace(false);
        let mut has = self.has.lock();
        for (id, component) in std::mem::take(&mut *has).components {
            self.truth.stands(&id, Rest::Ended, &component.class);
        }
    }

    pub(crate) fn seen(&self) -> Seen {
        let has = self.has.lock();
        Seen {
            components: has.components.clone(),
            connections: has.connections.clone(),
            halves: has.halves.clone(),
        }
    }

    /// Stops what is named, as its own port is asked to.
    pub(crate) async fn stop_here(&self, targets: Vec<Target>, deadline: Instant) -> Vec<Halted> {
        let order = Order { decision: Decision::HERE, ..Order::from(deadline) };
        // It speaks for itself; it never says that it is lost.
        self.stop(Stop { targets, known_here: 0 }, order).await.unwrap_or_default()
    }

    /// A component fails by itself.
    pub(crate) fn fail_one(&self) {
        let runs = |c: &Component| c.state == State::Active;
        let active: Vec<ComponentId> =
            self.has.lock().components.iter().filter(|(_, c)| runs(c)).map(|(id, _)| id.clone()).collect();
        if active.is_empty() {
            return;
        }
        let id = self.chance.one_of(&active).clone();
        self.truth.event(Kind::Fails, || format!("{id} fails by itself"));
        if let Ok(report) = self.becomes(&id, State::Fault, "the cable is out") {
            self.tell(report);
        }
    }

    fn lost(&self) -> Refusal {
        Refusal::lost(self.name.clone())
    }

    fn is_alive(&self) -> Result<(), Refusal> {
        if *self.alive.borrow() { Ok(()) } else { Err(self.lost()) }
    }

    fn tell(&self, report: Report) {
        // Nobody may be listening.
        let _ = self.news.send(News::State(report));
    }

    /// Puts a component into a state.
    fn becomes(&self, id: &ComponentId, state: State, fault: &str) -> Result<Report, Refusal> {
        self.is_alive()?;
        let mut has = self.has.lock();
        let unknown = || Refusal::ComponentNotFound { id: id.clone(), known: Vec::new() };
        let component = has.components.get_mut(id).ok_or_else(unknown)?;
        let moved = component.state == State::Active;
        (component.state, component.fault) = (state, fault.to_owned());
        let class = component.class.clone();
        match state {
            State::Active if !moved => self.truth.moves(id, &class, self.number),
            State::Active => {}
            State::Fault => self.truth.stands(id, Rest::Failed, &class),
            _ => self.truth.stands(id, Rest::Ordered, &class),
        }
        has.report(id)
    }

    /// Waits for the turn of a component, which may be removed meanwhile: another one of its name is not
    /// meant.
    async fn turn(&self, id: &ComponentId, deadline: Instant) -> Result<OwnedMutexGuard<()>, Refusal> {
        let turn = self.has.lock().turns.entry(id.clone()).or_default().clone();
        let turn = tokio::time::timeout_at(deadline.into(), turn.lock_owned()).await;
        self.is_alive()?;
        let turn = turn.map_err(|_| self.late("its turn"))?;
        match self.has.lock().turns.get(id) {
            Some(current) if Arc::ptr_eq(current, OwnedMutexGuard::mutex(&turn)) => Ok(turn),
            _ => Err(Refusal::ComponentNotFound { id: id.clone(), known: Vec::new() }),
        }
    }

    fn refused(&self, id: ComponentId, entry: &'static str) -> Refusal {
        self.truth.refused(&id);
        Refusal::ComponentRefused { id, entry, text: "the cable is out".into() }
    }

    fn late(&self, what: &str) -> Refusal {
        Refusal::LcmTimeout { process: self.name.clone(), what: what.to_owned() }
    }

    /// Takes the time that the work on a component takes.
    ///
    /// # Errors
    /// It is not done in time, nobody waits for it any more, or the process has ended.
    async fn works(&self, order: &Order) -> Result<(), Refusal> {
        let takes = self.chance.takes();
        let mut alive = self.alive.subscribe();
        if !takes.is_zero() {
            tokio::select! {
                biased;
                _ = alive.wait_for(|alive| !alive) => {}
                () = order.lease.ended() => return Err(self.lost()),
                () = tokio::time::sleep(takes) => {}
                () = tokio::time::sleep_until(order.deadline.into()) => return Err(self.late("it")),
            }
        }
        self.is_alive()?;
        if order.lease.has_ended() { Err(self.lost()) } else { Ok(()) }
    }

    async fn create(&self, id: ComponentId, component: Component, order: &Order) -> Result<Report, Refusal> {
        let _turn = loop {
            match self.turn(&id, order.deadline).await {
                // It waited for one that is gone.
                Err(Refusal::ComponentNotFound { .. }) => {}
                turn => break turn?,
            }
        };
        if self.has.lock().components.contains_key(&id) {
            return Err(Refusal::ComponentExists { id });
        }
        self.works(order).await?;
        if self.has.lock().components.contains_key(&id) {
            return Err(Refusal::ComponentExists { id });
        }
        if self.chance.once_in(REFUSED) {
            return Err(self.refused(id, "create"));
        }
        let mut has = self.has.lock();
        has.components.insert(id.clone(), Component { health: Health::Ok, ..component });
        has.report(&id)
    }

    /// One that hangs is left behind.
    async fn destroy(&self, id: &ComponentId, order: &Order) -> Result<Report, Refusal> {
        match self.turn(id, order.deadline).await {
            Ok(_turn) => self.takes_time(order.deadline).await,
            Err(late) if !self.hangs_now(id) => return Err(late),
            Err(_) => {}
        }
        self.is_alive()?;
        let mut has = self.has.lock();
        has.turns.remove(id);
        let report = has.report(id)?;
        if let Some(gone) = has.components.remove(id) {
            self.truth.stands(id, Rest::Ordered, &gone.class);
        }
        let ends = |c: &Connection| c.client.component == *id || c.server.component == *id;
        has.connections.retain(|_, connection| !ends(connection));
        let gone: Vec<(u64, End)> = has
            .halves
            .iter()
            .filter(|(_, half)| ends(&half.connection))
            .map(|(number, half)| (*number, half.end))
            .collect();
        for (connection, end) in gone {
            has.halves.remove(&connection);
            let _ = self.news.send(News::Half(HalfReport { connection, end, proxy: None }));
        }
        Ok(report)
    }

    async fn run(&self, id: &ComponentId, verb: Verb, order: &Order) -> Result<Report, Refusal> {
        if matches!(verb, Verb::Stop | Verb::Remove) {
            // It acts first.
            self.halt(id, Decision::MOST)?;
            return self.rests(id, Decision::MOST, order.deadline).await;
        }
        let turn = self.turn(id, order.deadline).await?;
        let stood = self.state(id)?;
        let moves = matches!(verb, Verb::Start | Verb::Resume);
        let to = transition(stood, verb).ok_or_else(|| held_off(id, stood, verb, ""))?;
        let latched = || match self.latches.hold_off(id, order.decision).filter(|_| moves) {
            Some(why) => Err(held_off(id, stood, verb, why)),
            None => Ok(()),
        };
        latched()?;
        let _turn = self.works_in(id, turn, order).await?;
        if self.chance.once_in(REFUSED) {
            return Err(self.refused(id.clone(), "start"));
        }
        if moves && self.chance.once_in(FAILS) {
            self.truth.failed(id);
            let report = self.becomes(id, State::Fault, "start: the cable is out")?;
            self.tell(report);
            return Err(Refusal::ComponentFault { id: id.clone(), text: "the cable is out".into() });
        }
        latched()?;
        // It may have failed by itself meanwhile.
        let now = self.state(id)?;
        if moves && now != stood {
            return Err(held_off(id, now, verb, "it failed before this came to its turn"));
        }
        let to = if now == stood { to } else { transition(now, verb).unwrap_or(now) };
        if moves {
            self.has.lock().started.insert(id.clone(), order.decision);
        }
        let report = self.becomes(id, to, "")?;
        if to != now {
            self.tell(report.clone());
        }
        Ok(report)
    }

    async fn configure(
        &self,
        id: &ComponentId,
        (config, from_state, to_state): (&serde_json::Value, State, State),
        order: &Order,
    ) -> Result<Report, Refusal> {
        // The undoing of a Create, which is removed next.
        if to_state == State::Created {
            let is_ready = self.state(id)? == State::Ready;
            return if is_ready { self.becomes(id, to_state, "") } else { self.has.lock().report(id) };
        }
        let turn = self.turn(id, order.deadline).await?;
        let stood = self.state(id)?;
        if stood != from_state || stood == State::Fault {
            let why = format!("it was {from_state} when this was decided");
            return Err(held_off(id, stood, Verb::Configure, &why));
        }
        let _turn = self.works_in(id, turn, order).await?;
        if self.chance.once_in(REFUSED) {
            return Err(self.refused(id.clone(), "configure"));
        }
        let now = self.state(id)?;
        if now != stood {
            let text = format!("configure: it took so long that it is {now}");
            return Err(Refusal::ComponentFault { id: id.clone(), text });
        }
        if let Some(component) = self.has.lock().components.get_mut(id) {
            component.config = config.clone();
        }
        // Nothing is set in motion by it.
        if to_state == State::Active { self.has.lock().report(id) } else { self.becomes(id, to_state, "") }
    }

    fn state(&self, id: &ComponentId) -> Result<State, Refusal> {
        self.has.lock().report(id).map(|report| report.state)
    }

    fn connect(&self, connection: Connection) -> Result<Report, Refusal> {
        if self.chance.once_in(REFUSED) {
            return Err(self.refused(connection.client.component, "connect"));
        }
        let mut has = self.has.lock();
        has.report(&connection.server.component)?;
        let report = has.report(&connection.client.component)?;
        has.connections.insert(connection.id.0, connection);
        Ok(report)
    }

    fn disconnect(&self, connection: &Connection) -> Result<Report, Refusal> {
        let number = connection.id.0;
        let mut has = self.has.lock();
        // A half that is only being made is not made any more.
        if has.linking.remove(&number).is_some() {
            let here = |port: &&PortId| port.component.process == self.name;
            let mine = [&connection.client, &connection.server].into_iter().find(here);
            return has.report(&mine.unwrap_or(&connection.client).component);
        }
        let known = || Refusal::ConnectionNotFound { asked: number.to_string(), known: Vec::new() };
        if let Some(near) = has.connections.remove(&number) {
            return has.report(&near.client.component);
        }
        let Half { connection, end, .. } = has.halves.remove(&number).ok_or_else(known)?;
        let report = has.report(&connection.port(end).component);
        drop(has);
        let _ = self.news.send(News::Half(HalfReport { connection: number, end, proxy: None }));
        report
    }

    fn half(&self, number: u64, half: &Half) -> HalfReport {
        let (process, carrier, peer) = (self.name.clone(), "memfd".into(), half.peer.clone());
        let proxy = Proxy { process, epoch: self.number, why: String::new(), carrier, peer };
        HalfReport { connection: number, end: half.end, proxy: Some(proxy) }
    }

    /// Stops a component that a Stop names, unless somebody has started it who knew of that Stop.
    fn halt(&self, id: &ComponentId, decision: Decision) -> Result<Report, Refusal> {
        let to = match self.state(id)? {
            State::Active if self.started_by(id) > decision => State::Active,
            State::Active | State::Stopped(StopReason::Restarted) => State::Stopped(StopReason::Requested),
            stands => stands,
        };
        if to == self.state(id)? {
            return self.has.lock().report(id);
        }
        let report = self.becomes(id, to, "")?;
        self.tell(report.clone());
        Ok(report)
    }

    fn started_by(&self, id: &ComponentId) -> Decision {
        self.has.lock().started.get(id).copied().unwrap_or_default()
    }
}

impl Has {
    fn report(&mut self, id: &ComponentId) -> Result<Report, Refusal> {
        let unknown = || Refusal::ComponentNotFound { id: id.clone(), known: Vec::new() };
        let component = self.components.get(id).ok_or_else(unknown)?;
        self.reports += 1;
        Ok(Report {
            id: id.clone(),
            number: self.reports,
            state: component.state,
            health: component.health,
            fault: component.fault.clone(),
            ports: None,
            lost_connections: Vec::new(),
            warnings: Vec::new(),
        })
    }
}

fn held_off(id: &ComponentId, state: State, verb: Verb, why: &str) -> Refusal {
    Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why: why.to_owned() }
}

fn not_modelled<T>() -> Result<T, Refusal> {
    Err(Refusal::NotImplemented { what: "this".into(), hint: String::new() })
}

#[async_trait]
impl Lcm for ModelLcm {
    async fn apply(&self, change: Change, order: Order) -> Result<Report, Refusal> {
        self.is_alive()?;
        self.truth.event(Kind::Ordered, || {
            let plan = Plan { changes: vec![change.clone()], skipped: Vec::new() };
            format!("{} is ordered {} by {}", self.name, plan_lines(&plan).concat(), order.decision.0)
        });
        match change {
            Change::Create { id, component } => self.create(id, *component, &order).await,
            Change::Destroy { id, .. } => self.destroy(&id, &order).await,
            Change::Configure { id, to, from_state, to_state, .. } => {
                self.configure(&id, (&to, from_state, to_state), &order).await
            }
            Change::Run { id, verb, .. } => self.run(&id, verb, &order).await,
            Change::Connect { connection } => self.connect(connection),
            Change::Disconnect { connection, .. } => self.disconnect(&connection),
        }
    }

    async fn stop(&self, stop: Stop, order: Order) -> Result<Vec<Halted>, Refusal> {
        self.is_alive()?;
        self.truth.event(Kind::Ordered, || {
            format!("{} is ordered to stop {stop:?} by {}", self.name, order.decision.0)
        });
        if let Some(told) = self.latches.stop(&stop, order.decision) {
            let _ = self.news.send(News::StoppedHere(told));
        }
        let named: Vec<(ComponentId, State)> = {
            let has = self.has.lock();
            let named = |id: &ComponentId| stop.targets.iter().any(|target| target.names(id));
            has.components.iter().filter(|(id, _)| named(id)).map(|(id, c)| (id.clone(), c.state)).collect()
        };
        // First all that move stand still.
        let mut stopped = Vec::new();
        for (id, was) in named {
            let moves = was == State::Active;
            stopped.push((self.halt(&id, order.decision), id, was, moves));
        }
        // Side by side: one that is waited for keeps no other from being started again.
        let resting = stopped.into_iter().map(async |(first, id, was, moves)| {
            // A start under way takes itself back, and is waited for.
            let done = match first {
                Ok(report) if moves => Ok(report),
                _ => self.rests(&id, order.decision, order.deadline).await,
            };
            Halted { id, was, done }
        });
        let halted = join_all(resting).await;
        self.is_alive()?;
        Ok(halted)
    }

    async fn link(&self, end: RemoteEnd, deadline: Instant) -> Result<Report, Refusal> {
        self.is_alive()?;
        let (connection, peer) = (end.connection, end.card.instance);
        self.truth.event(Kind::Ordered, || format!("{} is ordered to link {connection:?}", self.name));
        let here = |port: &PortId| port.component.process == self.name;
        let end = if here(&connection.client) { End::Client } else { End::Server };
        let (making, mut made) = watch::channel(());
        let number = connection.id.0;
        let before = {
            let mut has = self.has.lock();
            has.linking.insert(number, making);
            // A client's half takes the place of the one before at once; a server's does when it is there.
            if end == End::Client { has.halves.remove(&number) } else { None }
        };
        let gone = || Refusal::ConnectionNotFound { asked: connection.id.0.to_string(), known: Vec::new() };
        let by = Order::from(deadline);
        let worked = tokio::select! {
            biased;
            _ = made.changed() => {
                // It was told to give it up, unless it has ended.
                self.is_alive()?;
                return Err(gone());
            }
            worked = self.works(&by) => worked,
        };
        self.has.lock().linking.remove(&number);
        let reached = worked.and_then(|()| match self.chance.once_in(UNREACHABLE) {
            true => {
                let Connection { client, server, .. } = connection.clone();
                Err(Refusal::Unreachable { client, server, why: "no socket".into() })
            }
            false => Ok(()),
        });
        if let Err(refusal) = reached {
            self.truth.refused(&connection.client.component);
            if before.is_some() {
                let _ = self.news.send(News::Half(HalfReport { connection: number, end, proxy: None }));
            }
            return Err(refusal);
        }
        let (half, report) = {
            let mut has = self.has.lock();
            let report = has.report(&connection.port(end).component)?;
            let half = Half { connection, end, peer };
            has.halves.insert(number, half.clone());
            (half, report)
        };
        let _ = self.news.send(News::Half(self.half(number, &half)));
        Ok(report)
    }

    async fn invoke(&self, _: Invoke) -> Result<Reply, Refusal> {
        not_modelled()
    }

    async fn read(&self, _: String, _: When, _: bool, _: Instant) -> Result<Sample, Refusal> {
        not_modelled()
    }

    async fn subscribe(&self, _: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
        not_modelled()
    }

    async fn details(&self, _: Vec<ComponentId>) -> Result<Vec<(ComponentId, Detail)>, Refusal> {
        not_modelled()
    }

    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal> {
        not_modelled()
    }

    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal> {
        not_modelled()
    }

    async fn inventory(&self) -> Result<Inventory, Refusal> {
        self.is_alive()?;
        let mut has = self.has.lock();
        let ids: Vec<ComponentId> = has.components.keys().cloned().collect();
        let components = ids.iter().map(|id| has.report(id)).collect::<Result<_, _>>()?;
        let card = Card {
            process: self.name.to_string(),
            instance: self.number.to_string(),
            boot: "1".into(),
            uid: 0,
            socket: "nowhere".into(),
            net: String::new(),
            layout: LAYOUT,
        };
        Ok(Inventory {
            card: Some(card),
            components,
            classes: self.classes.clone(),
            halves: has.halves.iter().map(|(number, half)| self.half(*number, half)).collect(),
            warnings: Warnings::default(),
            decision: self.latches.seen(),
            stopped_here: self.latches.stopped_here(),
        })
    }

    fn news(&self) -> broadcast::Receiver<News> {
        self.news.subscribe()
    }
}
