//! A system of a few processes and one manager, in which everything fails now and then.
//!
//! Invariant: at rest, what is wanted, what is listed and what the processes have are the same.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::task::JoinSet;
use trocar::control::{Begin, Uplink};
use trocar::gcm::{Answer, Fate, Gcm, GcmConfig, Recording, Registration, Standing, Told};
use trocar_lcm_api::clock;
use trocar_model::{
    ClassInfo, Component, ComponentId, Name, ProcessState, Request, Safety, State, SystemGraph, Target,
};

use crate::callers;
use crate::chance::Chance;
use crate::classes::{actuator, filter};
use crate::disk::{Disk, Struck};
use crate::network::{Network, Towards};
use crate::process::ModelLcm;
use crate::truth::{Kind, Truth};

/// Callers at once.
const CALLERS: usize = 4;
/// Time in which a manager is new.
const NEW: Duration = Duration::from_secs(5);
/// Longest time until everything is at rest once nothing fails any more.
const REST: Duration = Duration::from_secs(45);

pub(crate) struct World {
    pub(crate) chance: Chance,
    pub(crate) truth: Truth,
    pub(crate) names: Vec<Name>,
    pub(crate) components: Vec<Name>,
    /// The input, the output, the required and the provided interface of each class.
    pub(crate) ports: [Name; 4],
    network: Network,
    disk: Disk,
    classes: Vec<Arc<ClassInfo>>,
    manager: Mutex<Option<Manager>>,
    processes: Mutex<BTreeMap<Name, Running>>,
    /// Incarnations so far.
    incarnations: Mutex<u64>,
    /// Managers so far. Terms do not tell them apart: one that was killed at once has left nothing behind.
    managers: Mutex<u64>,
    /// Terms of the managers that were killed in the middle of a commit.
    killed: Mutex<BTreeSet<u64>>,
    is_to_rest: watch::Sender<bool>,
    pace: Pace,
    /// The last requests with an id, which may be asked again.
    pub(crate) repeated: Mutex<VecDeque<(Vec<Request>, String)>>,
}

/// Pace at which things fail in a run, each of them for itself.
struct Pace {
    /// Longest time until the manager may be killed, a process may end, a network or the disk may fail, ms.
    manager: u64,
    processes: u64,
    network: u64,
    disk: u64,
    /// Longest time until the machine may stand still, ms.
    machine: u64,
    /// News of a process that may wait: of more some is lost, and asked for again.
    news: usize,
}

impl Pace {
    fn of(chance: &Chance) -> Pace {
        let most = |often: u64, seldom: u64| *chance.one_of(&[often, seldom, seldom, 20 * seldom]);
        Pace {
            manager: most(3_000, 20_000),
            processes: most(1_000, 15_000),
            network: most(2_000, 20_000),
            disk: most(10_000, 60_000),
            machine: most(20_000, 200_000),
            news: *chance.one_of(&[2, 64, 64]),
        }
    }
}

/// A manager that runs.
struct Manager {
    gcm: Gcm,
    /// The requests that it carries out.
    tasks: Arc<Mutex<JoinSet<Answer>>>,
    _open: watch::Sender<()>,
    began: Instant,
}

/// A process that runs.
struct Running {
    lcm: Arc<ModelLcm>,
    _kill: watch::Sender<()>,
}

impl World {
    pub(crate) fn new(chance: Chance, truth: Truth) -> Arc<World> {
        Arc::new(World {
            network: Network::new(chance.clone(), truth.clone()),
            disk: Disk::new(chance.clone(), truth.clone()),
            names: ["left", "right", "eye"].map(name).into(),
            components: ["a", "b", "c"].map(name).into(),
            ports: ["input", "value", "robot", "arm"].map(name),
            classes: vec![actuator(), filter()],
            manager: Mutex::default(),
            processes: Mutex::default(),
            incarnations: Mutex::default(),
            managers: Mutex::default(),
            killed: Mutex::default(),
            is_to_rest: watch::Sender::new(false),
            pace: Pace::of(&chance),
            repeated: Mutex::default(),
            chance,
            truth,
        })
    }

    /// Lets everything happen until so many events have.
    pub(crate) async fn lives(self: Arc<World>, events: u64) {
        while self.truth.events() < events && !self.truth.is_violated() {
            self.is_to_rest.send_replace(false);
            self.network.calm(false);
            self.disk.calm(false);
            let mut running = JoinSet::new();
            for _ in 0..CALLERS {
                running.spawn(callers::ask(self.clone()));
            }
            running.spawn(self.clone().manages());
            for name in &self.names {
                running.spawn(self.clone().runs(name.clone()));
                running.spawn(self.clone().cuts(name.clone()));
            }
            running.spawn(self.clone().fills());
            running.spawn(self.clone().stands_still());
            tokio::time::sleep(self.chance.ms(5_000, 40_000)).await;
            self.is_to_rest.send_replace(true);
            self.network.calm(true);
            self.disk.calm(true);
            while let Some(ended) = running.join_next().await {
                if let Err(e) = ended {
                    self.truth.violated(format!("a task broke off: {e}"));
                }
            }
            self.comes_to_rest().await;
        }
    }

    pub(crate) fn is_to_rest(&self) -> bool {
        *self.is_to_rest.borrow() || self.truth.is_violated()
    }

    /// Waits so long, or until everything is to rest.
    async fn waits(&self, ms: (u64, u64)) {
        let mut rest = self.is_to_rest.subscribe();
        let time = self.chance.ms(ms.0, ms.1);
        // The sender lives as long as the world.
        let _ = tokio::time::timeout(time, rest.wait_for(|rest| *rest)).await;
    }

    /// The manager that runs, and its requests.
    pub(crate) fn gcm(&self) -> Option<(Gcm, Arc<Mutex<JoinSet<Answer>>>)> {
        self.manager.lock().as_ref().map(|manager| (manager.gcm.clone(), manager.tasks.clone()))
    }

    /// Number of the manager that runs, or ran last.
    pub(crate) fn manager(&self) -> u64 {
        *self.managers.lock()
    }

    /// Tells whether all that is answered is on record.
    pub(crate) fn is_on_record(&self) -> bool {
        let manager = self.manager.lock();
        manager.as_ref().is_some_and(|manager| *manager.gcm.journal().borrow() == Standing::Written)
    }

    /// Tells whether this manager is gone with decisions that were in memory alone, also some that it has
    /// just answered, or was killed before it could say so.
    pub(crate) fn has_lost(&self, gcm: &Gcm) -> bool {
        let manager = self.manager.lock();
        let is_there = manager.as_ref().is_some_and(|manager| manager.gcm.term() == gcm.term());
        let is_killed = is_there && self.disk.has_killed() || self.killed.lock().contains(&gcm.term());
        is_killed || !is_there && *gcm.journal().borrow() != Standing::Written
    }

    /// Tells whether processes may not know yet how late the messages of the manager are: it has just begun,
    /// and all that came of it was late.
    pub(crate) fn is_new(&self) -> bool {
        self.manager.lock().as_ref().is_none_or(|manager| clock::since(manager.began) < NEW)
    }

    // -- the manager ---------------------------------------------------------------------------------------

    /// Kills the manager now and then, and starts it again.
    async fn manages(self: Arc<World>) {
        while !self.is_to_rest() {
            self.begins().await;
            let struck = tokio::select! {
                biased;
                struck = self.disk.strikes() => Some(struck),
                () = self.waits((500, self.pace.manager)) => None,
            };
            // Somebody sees the warning.
            if struck == Some(Struck::Broken) {
                self.waits((0, 10_000)).await;
            }
            if let Some(Struck::Killed { is_behind }) = struck {
                self.killed.lock().extend(self.gcm().map(|(gcm, _)| gcm.term()));
                if is_behind {
                    self.truth.forgets();
                }
            }
            if struck.is_some() || !self.is_to_rest() && self.chance.once_in(2) {
                self.ends();
                self.waits((0, 3_000)).await;
            }
        }
        self.begins().await;
    }

    async fn begins(&self) {
        if self.manager.lock().is_some() {
            return;
        }
        let chance = self.chance.clone();
        let takes = move || if chance.once_in(50) { chance.ms(100, 1500) } else { chance.ms(0, 3) };
        let (store, recording) = (Box::new(self.disk.opened()), Recording::Task(Box::new(takes)));
        match Gcm::resume_with(GcmConfig::default(), store, recording).await {
            Ok(gcm) => {
                self.truth.event(Kind::Began, || format!("a manager, term {}", gcm.term()));
                let open = self.network.open(&gcm);
                self.disk.stands(gcm.journal());
                *self.managers.lock() += 1;
                *self.manager.lock() =
                    Some(Manager { gcm, tasks: Arc::default(), _open: open, began: clock::now() });
            }
            Err(e) => self.truth.violated(format!("the manager does not start: {e}")),
        }
    }

    fn ends(&self) {
        let Some(manager) = self.manager.lock().take() else { return };
        self.truth.event(Kind::Ended, || "the manager is killed".into());
        if *manager.gcm.journal().borrow() != Standing::Written {
            self.truth.forgets();
        }
        self.disk.closed();
        self.network.closed();
        manager.tasks.lock().abort_all();
    }

    async fn fills(self: Arc<World>) {
        while !self.is_to_rest() {
            self.waits((2_000, self.pace.disk)).await;
            if self.is_to_rest() || !self.chance.once_in(2) {
                continue;
            }
            self.truth.event(Kind::Fails, || "the disk is full".into());
            self.disk.fill(true);
            self.waits((100, 5_000)).await;
            self.disk.fill(false);
        }
    }

    /// Lets the whole machine stand still now and then.
    async fn stands_still(self: Arc<World>) {
        while !self.is_to_rest() {
            self.waits((2_000, self.pace.machine)).await;
            if self.is_to_rest() || !self.chance.once_in(2) {
                continue;
            }
            let time = self.chance.ms(100, 5_000);
            self.truth.event(Kind::Fails, || format!("the machine stands still for {time:?}"));
            self.truth.counts("the machine stands still".into());
            tokio::time::advance(time).await;
        }
    }

    // -- processes -----------------------------------------------------------------------------------------

    /// Runs a process, which ends now and then and is started again.
    async fn runs(self: Arc<World>, name: Name) {
        loop {
            let is_away = !self.processes.lock().contains_key(&name);
            if is_away {
                self.starts(&name);
            }
            if self.is_to_rest() {
                return;
            }
            self.waits((200, self.pace.processes)).await;
            if self.is_to_rest() {
                return;
            }
            let lcm = self.processes.lock().get(&name).map(|running| running.lcm.clone());
            match (self.chance.below(6), lcm) {
                (0 | 1, Some(lcm)) => {
                    self.kills(&name, &lcm);
                    self.waits((0, 3_000)).await;
                }
                (2, Some(lcm)) => lcm.fail_one(),
                (3, Some(lcm)) => self.stops_here(&lcm).await,
                _ => {}
            }
        }
    }

    fn starts(&self, name: &Name) {
        let number = {
            let mut incarnations = self.incarnations.lock();
            *incarnations += 1;
            *incarnations
        };
        let event = self.truth.event(Kind::Began, || format!("{name}, incarnation {number}"));
        self.truth.begins(number, event);
        let lcm = ModelLcm::new(
            name.clone(),
            number,
            self.classes.clone(),
            self.chance.clone(),
            self.truth.clone(),
            self.pace.news,
        );
        let mut who = Registration::new(name.clone(), format!("127.0.0.1:{number}"));
        (who.instance, who.pid) = (self.chance.number(), u32::try_from(number).unwrap_or(u32::MAX));
        let (kill, mut killed) = watch::channel(());
        let (way, attached) = (self.network.way(name.clone()), lcm.clone());
        tokio::spawn(async move {
            let uplink = tokio::select! {
                biased;
                _ = killed.changed() => return,
                uplink = Uplink::over(way, "the manager".into(), who, attached, Begin::Patient) => uplink,
            };
            if let Ok(uplink) = uplink {
                let _ = killed.changed().await;
                uplink.shutdown().await;
            }
        });
        self.processes.lock().insert(name.clone(), Running { lcm, _kill: kill });
    }

    fn kills(&self, name: &Name, lcm: &ModelLcm) {
        self.truth.event(Kind::Ended, || format!("{name} is killed"));
        lcm.kill();
        self.processes.lock().remove(name);
        // Some have a supervisor, who sees it end.
        if self.chance.once_in(2)
            && let Some((gcm, _)) = self.gcm()
        {
            gcm.told(&Told {
                process: name.clone(),
                fate: Fate::Restarting,
                pid: u32::try_from(lcm.number).unwrap_or(u32::MAX),
                last_exit: "it was killed".into(),
                restarts: 1,
            });
        }
    }

    /// Asks a process at its own port to stop something.
    async fn stops_here(&self, lcm: &ModelLcm) {
        let targets = callers::targets(self);
        let event = self.truth.event(Kind::Asked, || format!("{targets:?} to stop, at its own port"));
        self.truth.end_asked(event, &[Request::Stop { targets: targets.clone() }]);
        let halted = lcm.stop_here(targets.clone(), clock::now() + Duration::from_secs(5)).await;
        // It speaks for what it has itself, as far as that stands.
        let stands = halted.into_iter().filter(|halted| halted.done.is_ok()).map(|halted| halted.id);
        let told: BTreeSet<_> = stands.collect();
        let stands = told.iter().cloned().map(Target::One).collect();
        self.truth.end_answered(event);
        self.truth.stopped(event, stands, BTreeSet::new(), told);
    }

    /// Holds the messages of a process up now and then.
    async fn cuts(self: Arc<World>, name: Name) {
        while !self.is_to_rest() {
            self.waits((300, self.pace.network)).await;
            if self.is_to_rest() || !self.chance.once_in(2) {
                continue;
            }
            let towards: &[Towards] = match self.chance.below(4) {
                0 => &[Towards::Manager],
                1 => &[Towards::Process],
                _ => &[Towards::Manager, Towards::Process],
            };
            self.network.down(&name, towards, true);
            let short = (10, 400);
            let time = if self.chance.once_in(2) { short } else { (500, 4_000) };
            self.waits(time).await;
            self.network.down(&name, towards, false);
        }
    }

    // -- rest ----------------------------------------------------------------------------------------------

    /// Waits until nothing differs any more from what is wanted.
    async fn comes_to_rest(&self) {
        let began = clock::now();
        let mut differences = self.differences();
        while !differences.is_empty() && clock::since(began) < REST && !self.truth.is_violated() {
            tokio::time::sleep(Duration::from_millis(500)).await;
            differences = self.differences();
        }
        if differences.is_empty() {
            // And it stays so.
            tokio::time::sleep(Duration::from_secs(3)).await;
            differences = self.differences();
        }
        if !differences.is_empty() {
            self.truth.violated(format!("at rest: {}", differences.join("\n         ")));
        }
        self.truth.rests(&self.disk.wanted().connections);
    }

    /// Returns what is not as it is to be.
    fn differences(&self) -> Vec<String> {
        let Some((gcm, _)) = self.gcm() else { return vec!["there is no manager".into()] };
        let (graph, wanted, mut wrong) = (gcm.graph(), self.disk.wanted(), Vec::new());
        if !self.is_on_record() {
            wrong.push("the journal is behind".into());
        }
        if wanted.components.keys().ne(graph.components.keys()) {
            let (wanted, listed) = (wanted.components.keys(), graph.components.keys());
            wrong.push(format!(
                "on record are {:?}, listed are {:?}",
                wanted.collect::<Vec<_>>(),
                listed.collect::<Vec<_>>()
            ));
        }
        if !wanted.connections.iter().eq(&graph.connections) {
            wrong.push(format!("on record are {:?}, listed are {:?}", wanted.connections, graph.connections));
        }
        for (id, on_record) in &wanted.components {
            let is_same = |c: &Component| c.config == on_record.config && c.class == on_record.class;
            if graph.components.get(id).is_some_and(|component| !is_same(component)) {
                wrong.push(format!("{id} is on record otherwise: {:?}", on_record.config));
            }
        }
        for name in &self.names {
            for component in &self.components {
                let id = ComponentId { process: name.clone(), component: component.clone() };
                let gain = graph.components.get(&id).map(|c| c.config["gain"].as_f64().unwrap_or(f64::NAN));
                wrong.extend(self.truth.differs(&id, gain));
            }
        }
        wrong.extend(self.truth.missing(&wanted.connections));
        let processes = self.processes.lock();
        let incarnation = |name: &Name| processes.get(name).map_or(0, |running| running.lcm.number);
        let has_refused = |id: &ComponentId, others: &[&Name]| {
            let incarnations: Vec<u64> = others.iter().map(|name| incarnation(name)).collect();
            self.truth.has_refused(id, &incarnations)
        };
        for (name, running) in processes.iter() {
            let seen = running.lcm.seen();
            wrong.extend(of_process(&graph, name, &seen, &incarnation, &has_refused));
            let epoch = graph.processes.get(name).map_or(0, |process| process.epoch);
            for (id, component) in &seen.components {
                let moves = component.state == State::Active;
                if moves && !wanted.may_run(id, epoch) {
                    wrong.push(format!("{id} moves, and the record does not grant that"));
                }
                if !moves && component.class.safety == Safety::Actuator && wanted.is_granted(id, epoch) {
                    wrong.push(format!("{id} is granted to move and is {}", component.state));
                }
            }
        }
        wrong
    }
}

fn name(text: &str) -> Name {
    Name::parse(text).expect("a name")
}

/// Compares what is listed of a process with what it has. `has_refused`: a component did since these
/// processes began.
fn of_process(
    graph: &SystemGraph,
    name: &Name,
    seen: &crate::process::Seen,
    incarnation: &impl Fn(&Name) -> u64,
    has_refused: &impl Fn(&ComponentId, &[&Name]) -> bool,
) -> Vec<String> {
    let mut wrong = Vec::new();
    if graph.processes.get(name).is_none_or(|process| process.state != ProcessState::Attached) {
        wrong.push(format!("{name} is not attached: {:?}", graph.processes.get(name).map(|p| p.state)));
    }
    let listed: BTreeMap<_, _> = graph.components.iter().filter(|(id, _)| id.process == *name).collect();
    for (id, component) in &listed {
        let has = seen.components.get(id);
        // A component that could not be made again says so, and waits for somebody to remove it.
        let is_excused = component.state == State::Fault && !component.fault.is_empty();
        if has.is_none() && is_excused && has_refused(id, &[name]) {
            continue;
        }
        // One that is not configured has no settings: it gets all of them with its first configuration.
        let settings = |c: &Component| (c.state != State::Created).then(|| c.config.clone());
        let is_same = |c: &Component| {
            (&c.class, settings(c), c.state) == (&component.class, settings(component), component.state)
        };
        if !has.is_some_and(is_same) {
            let of = |c: &Component| format!("{} {} {}", c.class.name, c.state, c.config);
            wrong.push(format!("{id} is listed as {}, and is {:?}", of(component), has.map(of)));
        }
    }
    let unknown = seen.components.keys().filter(|id| !listed.contains_key(id));
    wrong.extend(unknown.map(|id| format!("{id} is not listed")));
    let mine = graph.connections.values().filter(|c| c.ends_in(name));
    let (near, far): (Vec<_>, Vec<_>) = mine.partition(|c| c.is_near());
    let near: BTreeMap<_, _> = near.into_iter().map(|c| (c.id.0, c.clone())).collect();
    if near != seen.connections {
        wrong.push(format!("{name}: listed are {near:?}, there are {:?}", seen.connections));
    }
    let far: BTreeMap<_, _> = far.into_iter().map(|c| (c.id.0, c)).collect();
    let halves: BTreeMap<_, _> = seen.halves.iter().map(|(id, half)| (*id, &half.connection)).collect();
    let is_shown =
        |id: &u64| graph.proxies.iter().any(|((number, _), half)| number.0 == *id && !half.why.is_empty());
    for (id, connection) in &far {
        let (client, server) = (&connection.client.component, &connection.server.component);
        let is_excused = is_shown(id) && has_refused(client, &[&client.process, &server.process]);
        if halves.get(id) != Some(connection) && !is_excused {
            wrong.push(format!("{name} lacks its half of {connection:?}"));
        }
    }
    for half in seen.halves.values().filter(|half| far.values().any(|c| **c == half.connection)) {
        let ends = [&half.connection.client.component, &half.connection.server.component];
        let peer = ends.iter().map(|end| &end.process).find(|process| *process != name);
        let is_same = peer.is_some_and(|peer| incarnation(peer).to_string() == half.peer);
        let is_excused =
            is_shown(&half.connection.id.0) && has_refused(ends[0], &[&ends[0].process, &ends[1].process]);
        if !is_same && !is_excused {
            wrong.push(format!("{name} has its half of {:?} with an earlier process", half.connection));
        }
    }
    for (id, connection) in halves.iter().filter(|(id, half)| far.get(id) != Some(half)) {
        wrong.push(format!("{name} has a half {id} of {connection:?} that is not listed"));
    }
    wrong
}
