//! A running system against a system file: what differs, and the requests that make it what the file says.
//!
//! Invariant: pure. Whole values are compared, those a class fills in included, so two ways to say the same
//! are no difference. Parts that the file does not name are left alone unless they are to be taken away.
//! Processes of other owners are not touched, and a component that waits for a person is not moved.

use std::collections::{BTreeMap, BTreeSet};

use trocar_model::{
    Component, ComponentId, ConnectOptions, Connection, ConnectionId, Name, Planning, PortId, ProcessState,
    Refusal, Request, Safety, State, StopReason, SystemGraph, Table, Target, Verb, Which, allowed, complete,
    default_max_age, difference, host_of, is_same, live_only, merge,
};

use super::running::home;
use super::words::{executions, options, settings};
use super::{ComponentSpec, ConnectionSpec, ProcessSpec, SystemFile, in_thread_order};

/// The differences, and the requests that end them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Difference {
    /// A line each: `+` is in the file alone, `-` in the system alone, `~` in both and not the same.
    pub lines: Vec<String>,
    /// All that makes the system what the file says, in this order.
    pub requests: Vec<Request>,
    /// Differences that no request ends, and who does.
    pub left: Vec<String>,
    /// The reason why the requests must not be carried out as things stand.
    pub refused: Option<Refusal>,
}

impl SystemFile {
    /// Compares `running` with the file. With `prune`, parts of the file's processes that the file does not
    /// have are taken away, except those `held` by a program.
    ///
    /// # Errors
    /// A component of the file that cannot be made; two servers for one client.
    pub fn difference(
        &self,
        running: &SystemGraph,
        held: &BTreeSet<ComponentId>,
        prune: bool,
    ) -> Result<Difference, Refusal> {
        let mut clients = BTreeMap::new();
        for c in &self.connections {
            if clients.insert(&c.client, c).is_some() {
                return Err(Refusal::AlreadyConnected { client: c.client.clone(), server: c.server.clone() });
            }
        }
        let wanted = self.wanted(running)?;
        let mut comparing = Comparing {
            file: self,
            specs: self.components.iter().map(|c| (&c.id, c)).collect(),
            clients,
            running,
            sources: running.connections.values().map(|c| (&c.client, c)).collect(),
            held,
            prune,
            parts: BTreeMap::new(),
            cuts: BTreeSet::new(),
            ties: Vec::new(),
            out: Difference::default(),
        };
        comparing.processes();
        for spec in in_thread_order(&self.components) {
            let part = comparing.component(spec, wanted.get(&spec.id));
            comparing.parts.insert(spec.id.clone(), part);
        }
        comparing.others();
        comparing.thread_mates();
        comparing.connections();
        comparing.other_connections();
        comparing.spare_actuators();
        Ok(comparing.requests())
    }

    /// The file's components as they would be made, by the classes of the processes that are there.
    fn wanted(&self, running: &SystemGraph) -> Result<Table<ComponentId, Component>, Refusal> {
        let mut bare = SystemGraph { processes: running.processes.clone(), ..SystemGraph::default() };
        // A process that is not heard offers nothing; its components know their classes all the same.
        for (id, c) in &running.components {
            let process = bare.processes.get_mut(&id.process).filter(|p| p.state != ProcessState::Attached);
            if let Some(process) = process.filter(|p| p.classes.iter().all(|known| known != &c.class)) {
                process.classes.push(c.class.clone());
            }
        }
        for c in self.components.iter().filter(|c| c.isolated) {
            let home = bare.processes.get(&c.written.process).cloned();
            if let Some(home) = home.filter(|_| !bare.processes.contains_key(&c.id.process)) {
                bare.processes.insert(c.id.process.clone(), home);
            }
        }
        let heard =
            |name: &Name| running.processes.get(name).is_none_or(|p| p.state == ProcessState::Attached);
        bare.processes.change(|_, _| true, |process| process.state = ProcessState::Attached);
        let mut planning = Planning::of(&bare);
        for c in in_thread_order(&self.components) {
            if !bare.processes.contains_key(&c.id.process) {
                continue;
            }
            let planned = planning.add(&create(c));
            if heard(&c.id.process) {
                planned?;
            }
        }
        Ok(planning.graph().components.clone())
    }
}

fn create(c: &ComponentSpec) -> Request {
    let ComponentSpec { id, class, config, execution, .. } = c.clone();
    Request::Create { id, class, config, execution }
}

/// One component, and the things done with it.
#[derive(Debug, Default)]
struct Part {
    /// True: the component is taken away, for ever or to be made anew.
    goes: bool,
    make: Option<Request>,
    patch: Option<Request>,
    stops: bool,
    starts: bool,
}

struct Comparing<'a> {
    file: &'a SystemFile,
    specs: BTreeMap<&'a ComponentId, &'a ComponentSpec>,
    /// The file's connections, by client.
    clients: BTreeMap<&'a PortId, &'a ConnectionSpec>,
    running: &'a SystemGraph,
    /// The system's connections, by client.
    sources: BTreeMap<&'a PortId, &'a Connection>,
    held: &'a BTreeSet<ComponentId>,
    prune: bool,
    parts: BTreeMap<ComponentId, Part>,
    cuts: BTreeSet<ConnectionId>,
    ties: Vec<ConnectionSpec>,
    out: Difference,
}

impl Comparing<'_> {
    fn say(&mut self, line: String) {
        self.out.lines.push(line);
    }

    fn leave(&mut self, why: String) {
        if !self.out.left.contains(&why) {
            self.out.left.push(why);
        }
    }

    /// Names processes that are not there: no request starts one, unless it is for a single component. And
    /// names the parts of a file that count only when its processes are started.
    fn processes(&mut self) {
        let file = self.file;
        let isolated: BTreeSet<&Name> =
            file.components.iter().filter(|c| c.isolated).map(|c| &c.id.process).collect();
        for ProcessSpec { name, .. } in file.processes.iter().filter(|p| !isolated.contains(&p.name)) {
            match self.running.processes.get(name).map(|p| p.state) {
                None => {
                    self.say(format!("+ process {name}"));
                    self.leave(format!(
                        "process {name} does not run: start it by `trocar host --name {name} --gcm ADDR`, or the whole by `trocar up`"
                    ));
                }
                Some(ProcessState::Attached) => {}
                Some(state) => {
                    self.leave(format!("process {name} is {state}: what differs there is not certain"))
                }
            }
        }
        let usual = |p: &ProcessSpec| {
            let plain = ProcessSpec { plugins: p.plugins.clone(), ..ProcessSpec::new(p.name.clone()) };
            *p == plain
        };
        if !file.processes.iter().all(usual) || file.components.iter().any(|c| c.resumes) {
            self.leave(
                "what the file says of processes (trust, listen, state, env, restart, memory, allow_exec) and resume of components \
                 is not compared: it counts when `trocar up` starts them"
                    .to_owned(),
            );
        }
    }

    fn component(&mut self, spec: &ComponentSpec, wanted: Option<&Component>) -> Part {
        let id = &spec.id;
        let Some(now) = self.running.components.get(id) else {
            self.say(format!(
                "+ {id} ({})",
                wanted.map_or_else(|| spec.class.clone(), |c| c.class.full_name())
            ));
            return Part { make: Some(create(spec)), starts: spec.start, ..Part::default() };
        };
        let Some(then) = wanted else { return Part::default() };
        let (mut said, mut part) = (Vec::new(), Part::default());
        if then.class.full_name() != now.class.full_name() {
            said.push(format!("class {} → {}", now.class.full_name(), then.class.full_name()));
            part.goes = true;
        } else {
            let execution = executions(&now.execution, &then.execution);
            let differs = !is_same(&now.config, &then.config);
            said.extend(settings(&now.config, &then.config).into_iter().chain(execution.iter().cloned()));
            // In FAULT nothing is configured.
            part.goes = !execution.is_empty() || differs && now.state == State::Fault;
            if differs && !part.goes {
                let patch = difference(&now.config, &then.config);
                let schema = &now.class.config_schema;
                let to = complete(schema, merge(&now.config, &patch));
                part.stops = now.state == State::Active && live_only(schema, &now.config, &to).is_err();
                part.patch = Some(Request::Configure { id: id.clone(), patch, execution: None });
            }
        }
        let waits = waits(spec, now);
        match (spec.start, now.state) {
            (true, State::Active) => part.starts = part.stops,
            (true, state) if waits => {
                said.push(format!("{state}, and the file starts it"));
                self.leave(person(id, now, part.goes));
            }
            (true, state) => {
                said.push(format!("{state}, and the file starts it"));
                part.starts = true;
            }
            (false, State::Active) => {
                said.push("ACTIVE, and the file does not start it".to_owned());
                part.stops = true;
            }
            (false, _) => {}
        }
        if part.goes {
            part.make = Some(create(spec));
            part.starts = spec.start && !waits;
        }
        if !said.is_empty() {
            let anew = if part.goes { " (made anew)" } else { "" };
            self.say(format!("~ {id}: {}{anew}", said.join(", ")));
        }
        part
    }

    /// Tells whether a component is in a process of the file, or in one made for it alone beside such a
    /// process, and belongs to no guest or program.
    fn is_ours(&self, id: &ComponentId) -> bool {
        let named = |name: &Name| self.file.processes.iter().any(|p| p.name == *name);
        let guest = self.running.processes.get(&id.process).is_some_and(|p| !p.guest.is_empty());
        let is_theirs = guest || self.held.contains(id);
        !is_theirs && (named(&id.process) || home(self.running, id).is_some_and(|home| named(&home)))
    }

    /// Components of the file's processes that are not in the file.
    fn others(&mut self) {
        let running = self.running;
        // A component that is not where the file says may be in a process of its own, or not in one, instead.
        let absent = self.specs.values().filter(|spec| !running.components.contains_key(&spec.id));
        let elsewhere: BTreeSet<ComponentId> = absent
            .filter_map(
                |spec| if spec.isolated { Some(spec.written.clone()) } else { spec.id.isolated().ok() },
            )
            .collect();
        for (id, c) in &running.components {
            if self.parts.contains_key(id) || !self.is_ours(id) {
                continue;
            }
            let moves = elsewhere.contains(id);
            let why = if moves { ": it is in another process than the file says" } else { "" };
            self.say(format!("- {id} ({}){why}", c.class.full_name()));
            let state = running.processes.get(&id.process).map(|p| p.state);
            let heard = state == Some(ProcessState::Attached);
            if let (true, false, Some(state)) = (self.prune, heard, state) {
                self.leave(format!(
                    "process {} is {state}: `trocar forget {}` takes it away",
                    id.process, id.process
                ));
            }
            self.parts.insert(id.clone(), Part { goes: heard && (self.prune || moves), ..Part::default() });
        }
    }

    /// Takes away also the components that run in the thread of a removed one; they come back, unless they
    /// are not wanted.
    fn thread_mates(&mut self) {
        let running = self.running;
        let mut mates: BTreeMap<ComponentId, Vec<&ComponentId>> = BTreeMap::new();
        for (id, c) in &running.components {
            if let Some(host) = host_of(&c.execution) {
                mates.entry(host).or_default().push(id);
            }
        }
        let mut going: Vec<ComponentId> =
            self.parts.iter().filter(|(_, part)| part.goes).map(|(id, _)| id.clone()).collect();
        while let Some(host) = going.pop() {
            for id in mates.get(&host).into_iter().flatten() {
                if self.goes(id) {
                    continue;
                }
                let (c, spec) = (&running.components[*id], self.specs.get(*id).copied());
                let as_it_is = || Request::Create {
                    id: (*id).clone(),
                    class: c.class.full_name(),
                    config: (c.state != State::Created).then(|| c.config.clone()),
                    execution: c.execution.clone(),
                };
                let waits = spec.is_some_and(|spec| spec.start && waits(spec, c));
                if waits {
                    self.leave(person(id, c, true));
                }
                let part = Part {
                    goes: true,
                    make: Some(spec.map_or_else(as_it_is, create)),
                    starts: spec.map_or(c.state == State::Active, |spec| spec.start && !waits),
                    ..Part::default()
                };
                self.say(format!("~ {id}: made anew with {host}, in whose thread it runs"));
                self.parts.insert((*id).clone(), part);
                going.push((*id).clone());
            }
        }
    }

    fn goes(&self, id: &ComponentId) -> bool {
        self.parts.get(id).is_some_and(|part| part.goes)
    }

    /// Tells whether a component runs, and goes on running through the change.
    fn runs_on(&self, id: &ComponentId) -> bool {
        let stays = self.parts.get(id).is_none_or(|part| !part.goes && !part.stops);
        stays && self.running.components.get(id).is_some_and(|c| c.state == State::Active)
    }

    fn connections(&mut self) {
        let (file, running) = (self.file, self.running);
        for spec in &file.connections {
            let ConnectionSpec { client, server, options: wanted } = spec;
            let old = self.sources.get(client).copied();
            let changed = |old: &Connection| {
                let usual = default_max_age(running, old);
                let wanted = ConnectOptions { max_age_ns: wanted.max_age_ns.or(usual), ..wanted.clone() };
                options(&old.options, &wanted)
            };
            let differ = match old {
                None => {
                    self.say(format!("+ {server} → {client}"));
                    true
                }
                Some(old) if old.server == *server => {
                    let differ = changed(old);
                    if !differ.is_empty() {
                        self.say(format!("~ {server} → {client}: {}", differ.join(", ")));
                    }
                    !differ.is_empty()
                }
                Some(old) => {
                    self.say(format!("- {} → {client}", old.server));
                    self.say(format!("+ {server} → {client}"));
                    true
                }
            };
            let anew = [Some(&client.component), Some(&server.component), old.map(server_of)];
            let anew = anew.into_iter().flatten().any(|id| self.goes(id));
            if !differ && !anew {
                continue;
            }
            // A client that runs on is rewired in one step; of others all old wires go before new ones come.
            let replace = old.is_some() && !anew && self.runs_on(&client.component);
            self.cuts.extend(old.filter(|_| !replace).map(|old| old.id));
            let options = ConnectOptions { replace, ..wanted.clone() };
            self.ties.push(ConnectionSpec { options, ..spec.clone() });
        }
    }

    /// Connections that are not in the file.
    fn other_connections(&mut self) {
        let running = self.running;
        for old in running.connections.values() {
            if self.clients.contains_key(&old.client) {
                continue;
            }
            let ours = self.is_ours(client_of(old));
            if ours {
                self.say(format!("- {} → {}", old.server, old.client));
            }
            let ends = [client_of(old), server_of(old)];
            let pruned = ours && self.prune;
            if pruned || ends.iter().any(|id| self.goes(id)) {
                self.cuts.insert(old.id);
            }
            let back =
                |id: &&ComponentId| self.parts.get(*id).is_none_or(|part| !part.goes || part.make.is_some());
            if !pruned && self.cuts.contains(&old.id) && ends.iter().all(back) {
                let Connection { client, server, options, .. } = old.clone();
                // A default follows the new period.
                let usual = default_max_age(running, old);
                let max_age_ns = options.max_age_ns.filter(|age| Some(*age) != usual);
                let options = ConnectOptions { max_age_ns, replace: false, ..options };
                self.ties.push(ConnectionSpec { client, server, options });
            }
        }
    }

    /// Refuses a cut that takes from an actuator that runs on what it requires: a moment without it would
    /// stop the actuator.
    fn spare_actuators(&mut self) {
        let running = self.running;
        for id in &self.cuts {
            let Some(c) = running.connections.get(id) else { continue };
            let client = client_of(c);
            let Some(moves) = running.components.get(client).filter(|m| m.class.safety == Safety::Actuator)
            else {
                continue;
            };
            if self.runs_on(client) && moves.ports.requires(c.client.port.as_str()) {
                let (state, verb) = (State::Active, Verb::Configure);
                let why = format!(
                    "it is an actuator and requires `{}`, which is to be made anew or taken away: stop it first",
                    server_of(c)
                );
                self.out.refused = Some(Refusal::WrongState {
                    id: client.clone(),
                    state,
                    verb,
                    allowed: allowed(state),
                    why,
                });
                return;
            }
        }
    }

    /// The requests in order: stops first, then removals, and starts last.
    fn requests(self) -> Difference {
        let Comparing { file, specs, running, parts, cuts, mut ties, mut out, .. } = self;
        let all = |which: &dyn Fn(&Part) -> bool| -> Vec<ComponentId> {
            parts.iter().filter(|(_, part)| which(part)).map(|(id, _)| id.clone()).collect()
        };
        let targets = |ids: Vec<ComponentId>| -> Vec<Target> { ids.into_iter().map(Target::One).collect() };
        let mut stop = all(&|part| part.stops || part.goes);
        stop.retain(|id| running.components.get(id).is_some_and(|c| c.state == State::Active));
        if !stop.is_empty() {
            out.requests.push(Request::Stop { targets: targets(stop) });
        }
        out.requests.extend(cuts.into_iter().map(|id| Request::Disconnect { which: Which::Id(id) }));
        let mut goes = all(&|part| part.goes);
        // A component in another's thread goes before it, and comes after it.
        goes.sort_by_key(|id| std::cmp::Reverse(depth(running, id)));
        let mut others = goes.clone();
        others.retain(|id| !specs.contains_key(id));
        out.requests.extend(goes.into_iter().map(|id| Request::Remove { id, force: false }));
        for spec in in_thread_order(&file.components) {
            let make = parts.get(&spec.id).and_then(|part| part.make.clone());
            out.requests.extend(make.map(|make| isolated(make, spec, running)));
        }
        out.requests.extend(others.iter().rev().filter_map(|id| parts.get(id)?.make.clone()));
        out.requests.extend(parts.values().filter_map(|part| part.patch.clone()));
        ties.sort_by_key(|tie| !tie.options.replace);
        out.requests.extend(ties.into_iter().map(|tie| {
            let ConnectionSpec { client, server, options } = tie;
            Request::Connect { client, server, options }
        }));
        let start = all(&|part| part.starts);
        if !start.is_empty() {
            out.requests.push(Request::Start { targets: targets(start) });
        }
        out
    }
}

/// Tells whether a component stands still for a reason that a person has to know before it goes on.
fn waits(spec: &ComponentSpec, now: &Component) -> bool {
    match now.state {
        State::Fault => true,
        State::Stopped(StopReason::Restarted) if spec.resumes => false,
        State::Stopped(StopReason::Requested) => false,
        State::Stopped(_) => now.class.safety == Safety::Actuator,
        State::Created | State::Ready | State::Active => false,
    }
}

/// Says what a person has to do for it to go on.
fn person(id: &ComponentId, now: &Component, anew: bool) -> String {
    let why = if now.fault.is_empty() { String::new() } else { format!(" ({})", now.fault) };
    let state = now.state;
    match (state, anew) {
        (_, true) => format!("{id} was {state}{why}: made anew it waits for `trocar start {id}`"),
        (State::Fault, false) => format!("{id} is in FAULT{why}: `trocar reset {id}`, then apply again"),
        (_, false) => format!("{id} is {state}{why}: it waits for `trocar resume {id}`"),
    }
}

/// Makes a component in a process that is made for it, where that process is not there.
fn isolated(make: Request, spec: &ComponentSpec, running: &SystemGraph) -> Request {
    match make {
        Request::Create { id, class, config, execution }
            if spec.isolated && !running.processes.contains_key(&id.process) =>
        {
            Request::CreateIsolated { id, home: spec.written.process.clone(), class, config, execution }
        }
        make => make,
    }
}

/// The number of components whose threads it is in, one inside the other.
fn depth(graph: &SystemGraph, id: &ComponentId) -> usize {
    let host = |id: &ComponentId| host_of(&graph.components.get(id)?.execution);
    std::iter::successors(host(id), host).take(graph.components.len()).count()
}

fn client_of(c: &Connection) -> &ComponentId {
    &c.client.component
}

fn server_of(c: &Connection) -> &ComponentId {
    &c.server.component
}
