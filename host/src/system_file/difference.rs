//! A running system against a system file: what differs, and the requests that make it what the file says.
//!
//! Invariant: pure. Whole values are compared, those a class fills in included, so two ways to say the same are
//! no difference. What the file does not name is left alone unless it is to be taken away, and nobody else's
//! processes are touched.

use std::collections::{BTreeMap, BTreeSet};

use trocar_model::{
    Component, ComponentId, ConnectOptions, Connection, ConnectionId, Name, Planning, ProcessState, Refusal,
    Request, State, SystemGraph, Target, Which, default_max_age, difference, host_of, is_same, live_only,
};

use super::running::home;
use super::words::{executions, options, settings};
use super::{ComponentSpec, ConnectionSpec, SystemFile, in_thread_order};

/// What differs, and what to do about it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Difference {
    /// A line each: `+` is in the file alone, `-` in the system alone, `~` in both and not the same.
    pub lines: Vec<String>,
    /// All that makes the system what the file says, in this order.
    pub requests: Vec<Request>,
    /// What no request does, and who does.
    pub left: Vec<String>,
}

impl SystemFile {
    /// What has to happen to `running` for it to be as the file says. With `prune` what the file's processes
    /// have and the file does not goes.
    ///
    /// # Errors
    /// A component of the file that cannot be made.
    pub fn difference(&self, running: &SystemGraph, prune: bool) -> Result<Difference, Refusal> {
        let wanted = self.wanted(running)?;
        let mut comparing = Comparing {
            file: self,
            running,
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
        Ok(comparing.requests())
    }

    /// The file's components as they would be made, by the classes of the processes that are there.
    fn wanted(&self, running: &SystemGraph) -> Result<BTreeMap<ComponentId, Component>, Refusal> {
        let mut bare = SystemGraph { processes: running.processes.clone(), ..SystemGraph::default() };
        for c in self.components.iter().filter(|c| c.isolated) {
            if let Some(home) = running.processes.get(&c.written.process) {
                bare.processes.entry(c.id.process.clone()).or_insert_with(|| home.clone());
            }
        }
        // Whether one is heard just now is no difference.
        bare.processes.values_mut().for_each(|process| process.state = ProcessState::Attached);
        let mut planning = Planning::of(&bare);
        for c in in_thread_order(&self.components) {
            if bare.processes.contains_key(&c.id.process) {
                planning.add(&create(c))?;
            }
        }
        Ok(planning.graph().components.clone())
    }
}

fn create(c: &ComponentSpec) -> Request {
    let ComponentSpec { id, class, config, execution, .. } = c.clone();
    Request::Create { id, class, config, execution }
}

/// What is done with one component.
#[derive(Debug, Default)]
struct Part {
    /// It is taken away, for ever or to be made anew.
    goes: bool,
    make: Option<Request>,
    patch: Option<Request>,
    stops: bool,
    starts: bool,
}

struct Comparing<'a> {
    file: &'a SystemFile,
    running: &'a SystemGraph,
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

    /// Those that are not there: no request starts one, unless it is for a single component.
    fn processes(&mut self) {
        let is_apart = |name: &Name| self.file.components.iter().any(|c| c.isolated && c.id.process == *name);
        let absent = |name: &&Name| !self.running.processes.contains_key(*name) && !is_apart(name);
        let names: Vec<&Name> = self.file.processes.iter().map(|p| &p.name).filter(absent).collect();
        for name in names {
            self.say(format!("+ process {name}"));
            self.out.left.push(format!(
                "process {name} does not run: start it by `trocar host --name {name} --gcm ADDR`, or the whole by `trocar up`"
            ));
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
                part.patch = Some(Request::Configure { id: id.clone(), patch, execution: None });
                let schema = &now.class.config_schema;
                part.stops =
                    now.state == State::Active && live_only(schema, &now.config, &then.config).is_err();
            }
        }
        match (spec.start, now.state) {
            (true, State::Fault) if !part.goes => {
                said.push("in FAULT, and the file starts it".to_owned());
                let why = if now.fault.is_empty() { String::new() } else { format!(" ({})", now.fault) };
                self.out.left.push(format!("{id} is in FAULT{why}: `trocar reset {id}`, then apply again"));
            }
            (true, State::Active) => part.starts = part.stops,
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
            part.starts = spec.start;
        }
        if !said.is_empty() {
            let anew = if part.goes { " (made anew)" } else { "" };
            self.say(format!("~ {id}: {}{anew}", said.join(", ")));
        }
        part
    }

    /// It is in a process of the file, or in one beside it for itself alone.
    fn is_ours(&self, id: &ComponentId) -> bool {
        let named = |name: &Name| self.file.processes.iter().any(|p| p.name == *name);
        let guest = self.running.processes.get(&id.process).is_some_and(|p| !p.guest.is_empty());
        !guest && (named(&id.process) || home(self.running, id).is_some_and(|home| named(&home)))
    }

    /// Components of the file's processes that are not in the file.
    fn others(&mut self) {
        let running = self.running;
        for (id, c) in &running.components {
            if self.parts.contains_key(id) || !self.is_ours(id) {
                continue;
            }
            self.say(format!("- {id} ({})", c.class.full_name()));
            self.parts.insert(id.clone(), Part { goes: self.prune, ..Part::default() });
        }
    }

    /// Whoever runs in the thread of one that goes, goes with it; and comes back, unless it is not wanted.
    fn thread_mates(&mut self) {
        let running = self.running;
        loop {
            let goes = |id: &ComponentId| self.parts.get(id).is_some_and(|part| part.goes);
            let mate = running
                .components
                .iter()
                .find(|(id, c)| !goes(id) && host_of(&c.execution).is_some_and(|host| goes(&host)));
            let Some((id, c)) = mate else { return };
            let spec = self.file.components.iter().find(|spec| spec.id == *id);
            let as_it_is = || Request::Create {
                id: id.clone(),
                class: c.class.full_name(),
                config: (c.state != State::Created).then(|| c.config.clone()),
                execution: c.execution.clone(),
            };
            let part = Part {
                goes: true,
                make: Some(spec.map_or_else(as_it_is, create)),
                starts: spec.map_or(c.state == State::Active, |spec| spec.start),
                ..Part::default()
            };
            self.say(format!("~ {id}: made anew with the component in whose thread it runs"));
            self.parts.insert(id.clone(), part);
        }
    }

    fn goes(&self, id: &ComponentId) -> bool {
        self.parts.get(id).is_some_and(|part| part.goes)
    }

    fn connections(&mut self) {
        let (file, running) = (self.file, self.running);
        for spec in &file.connections {
            let ConnectionSpec { client, server, options: wanted } = spec;
            let old = running.source_of(client);
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
            let cut = old.filter(|old| self.goes(client_of(old)) || self.goes(server_of(old)));
            let anew = cut.is_some() || self.goes(&client.component) || self.goes(&server.component);
            if differ || anew {
                self.cuts.extend(cut.map(|old| old.id));
                let replace = old.is_some() && cut.is_none();
                let options = ConnectOptions { replace, ..wanted.clone() };
                self.ties.push(ConnectionSpec { options, ..spec.clone() });
            }
        }
    }

    /// Connections that are not in the file.
    fn other_connections(&mut self) {
        let (file, running) = (self.file, self.running);
        for old in running.connections.values() {
            if file.connections.iter().any(|c| c.client == old.client) {
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
                self.ties.push(ConnectionSpec { client, server, options });
            }
        }
    }

    /// What stands still first, then what goes, and what moves last.
    fn requests(self) -> Difference {
        let Comparing { file, running, parts, cuts, ties, mut out, .. } = self;
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
        // Whoever runs in another's thread goes before it.
        goes.sort_by_key(|id| std::cmp::Reverse(depth(running, id)));
        out.requests.extend(goes.into_iter().map(|id| Request::Remove { id, force: false }));
        let mut made: Vec<Request> = Vec::new();
        for spec in in_thread_order(&file.components) {
            let make = parts.get(&spec.id).and_then(|part| part.make.clone());
            made.extend(make.map(|make| apart(make, spec, running)));
        }
        let in_file = |id: &ComponentId| file.components.iter().any(|spec| spec.id == *id);
        made.extend(parts.iter().filter(|(id, _)| !in_file(id)).filter_map(|(_, part)| part.make.clone()));
        out.requests.extend(made);
        out.requests.extend(parts.values().filter_map(|part| part.patch.clone()));
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

/// In a process that is made for it, where that is not there.
fn apart(make: Request, spec: &ComponentSpec, running: &SystemGraph) -> Request {
    match make {
        Request::Create { id, class, config, execution }
            if spec.isolated && !running.processes.contains_key(&id.process) =>
        {
            Request::CreateApart { id, home: spec.written.process.clone(), class, config, execution }
        }
        make => make,
    }
}

/// How many components' threads it is in, one inside the other.
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
