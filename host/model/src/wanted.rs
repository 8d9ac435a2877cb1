//! The desired part of a system, apart from everything that is seen of it: a fold of what was decided.
//!
//! Invariant: the same entries in the same order give the same value, whatever was seen meanwhile. A
//! component is wanted ACTIVE only by a grant, which names the incarnation of its process: another one moves
//! nothing by itself.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::Value;

use crate::{
    Change, ClassInfo, Component, ComponentId, Connection, ConnectionId, Execution, Health, Name, Process,
    ProcessState, Safety, State, StopReason, SystemGraph, Table, Target, Verb, Warnings,
};

/// Everything that was decided, up to a revision.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    pub revision: u64,
    /// The last incarnation of the GCM.
    pub term: u64,
    /// Number the next connection gets.
    pub next_connection: u64,
    /// Number of the last decision, a Stop or another one.
    pub decision: u64,
    pub components: BTreeMap<ComponentId, WantedComponent>,
    pub connections: BTreeMap<ConnectionId, Connection>,
    /// Incarnation that held each name last.
    pub processes: BTreeMap<Name, Incarnation>,
}

/// A component as it is to be.
#[derive(Clone, Debug, PartialEq)]
pub struct WantedComponent {
    pub class: Arc<ClassInfo>,
    /// The whole configuration.
    pub config: Value,
    /// Complete.
    pub execution: Execution,
    pub state: State,
    /// Present while it is wanted ACTIVE.
    pub grant: Option<Grant>,
}

/// Why a component may run: it is to run exactly as long as its process is the incarnation that was meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grant {
    /// Start or Resume.
    pub verb: Verb,
    pub revision: u64,
    /// A Stop that was decided earlier does not count against it.
    pub decision: u64,
    /// Incarnation of its process.
    pub epoch: u64,
}

/// An incarnation of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Incarnation {
    /// Random, from the process itself.
    pub instance: u128,
    /// The GCM's number for it, never reused.
    pub epoch: u64,
}

/// Something that was decided, or that has to be taken as if it had been.
#[derive(Clone, Debug, PartialEq)]
pub enum Entry {
    /// The changes of a request, all of them done.
    Changed { revision: u64, decision: u64, changes: Vec<Change> },
    /// A Stop of all that is named, whatever became of it.
    Stopped { revision: u64, decision: u64, targets: Vec<Target> },
    /// Connections that went with their ports, or could not be made again.
    Cut { revision: u64, connections: Vec<ConnectionId> },
    /// A process came, or came back.
    Came { process: Name, incarnation: Incarnation },
    /// A process came with what it has, of which there is no earlier word: it is taken as decided.
    Brought {
        revision: u64,
        process: Name,
        components: Vec<(ComponentId, WantedComponent)>,
        connections: Vec<Connection>,
    },
    /// An incarnation of a process was taken down, or forgotten, with all that it had; 0: whichever there
    /// was.
    Gone { revision: u64, process: Name, epoch: u64 },
    /// A component failed: it runs no more until somebody resets it.
    Failed { component: ComponentId },
    /// Nothing changed: a request was refused, or a GCM began.
    Noted,
}

impl Entry {
    /// Returns the revision that it leads to; `None`: it leads to none.
    pub fn revision(&self) -> Option<u64> {
        match self {
            Entry::Changed { revision, .. }
            | Entry::Stopped { revision, .. }
            | Entry::Cut { revision, .. }
            | Entry::Brought { revision, .. }
            | Entry::Gone { revision, .. } => Some(*revision),
            Entry::Came { .. } | Entry::Failed { .. } | Entry::Noted => None,
        }
    }
}

impl Default for Wanted {
    fn default() -> Self {
        Wanted {
            revision: 0,
            term: 0,
            next_connection: 1,
            decision: 0,
            components: BTreeMap::new(),
            connections: BTreeMap::new(),
            processes: BTreeMap::new(),
        }
    }
}

impl Wanted {
    /// Goes on by one entry.
    pub fn on(&mut self, entry: &Entry) {
        match entry {
            Entry::Changed { revision, decision, changes } => {
                self.counts(*revision, *decision);
                for change in changes {
                    self.change(change, *revision, *decision);
                }
            }
            Entry::Stopped { revision, decision, targets } => {
                self.counts(*revision, *decision);
                let named = |id: &ComponentId| targets.iter().any(|target| target.names(id));
                for (_, component) in self.components.iter_mut().filter(|(id, _)| named(id)) {
                    let ran = component.grant.take_if(|grant| grant.decision < *decision).is_some();
                    let runs_by_none = component.grant.is_none() && component.state == State::Active;
                    if ran || runs_by_none || component.state == State::Stopped(StopReason::Restarted) {
                        component.state = State::Stopped(StopReason::Requested);
                    }
                }
            }
            Entry::Cut { revision, connections } => {
                self.counts(*revision, 0);
                for id in connections {
                    self.connections.remove(id);
                }
            }
            Entry::Came { process, incarnation } => {
                self.processes.insert(process.clone(), *incarnation);
            }
            Entry::Brought { revision, process, components, connections } => {
                self.counts(*revision, 0);
                self.components.retain(|id, _| id.process != *process);
                self.components.extend(components.iter().cloned());
                // With all its connections, also those to other processes.
                self.connections.retain(|_, connection| !connection.ends_in(process));
                for connection in connections {
                    self.connect(connection);
                }
            }
            Entry::Gone { revision, process, epoch } => {
                self.counts(*revision, 0);
                let now = self.processes.get(process).map_or(0, |process| process.epoch);
                // Another one has come meanwhile.
                if *epoch != 0 && now > *epoch {
                    return;
                }
                self.components.retain(|id, _| id.process != *process);
                self.connections.retain(|_, connection| !connection.ends_in(process));
                self.processes.remove(process);
            }
            Entry::Failed { component } => {
                if let Some(component) = self.components.get_mut(component) {
                    (component.state, component.grant) = (State::Fault, None);
                }
            }
            Entry::Noted => {}
        }
    }

    fn counts(&mut self, revision: u64, decision: u64) {
        self.revision = self.revision.max(revision);
        self.decision = self.decision.max(decision);
    }

    fn change(&mut self, change: &Change, revision: u64, decision: u64) {
        match change {
            Change::Create { id, component } => {
                self.components.insert(id.clone(), WantedComponent::from(&**component));
            }
            Change::Destroy { id, .. } => _ = self.components.remove(id),
            Change::Configure { id, to, to_state, .. } => {
                if let Some(component) = self.components.get_mut(id) {
                    component.config = to.clone();
                    // A configuration while it runs leaves it running.
                    if component.grant.is_none() && *to_state != State::Active {
                        component.state = *to_state;
                    }
                }
            }
            Change::Run { id, verb, to, .. } => {
                let epoch = self.processes.get(&id.process).map_or(0, |process| process.epoch);
                if let Some(component) = self.components.get_mut(id) {
                    component.state = *to;
                    let runs = *to == State::Active;
                    component.grant = runs.then_some(Grant { verb: *verb, revision, decision, epoch });
                }
            }
            Change::Connect { connection } => self.connect(connection),
            Change::Disconnect { connection, .. } => _ = self.connections.remove(&connection.id),
        }
    }

    fn connect(&mut self, connection: &Connection) {
        self.next_connection = self.next_connection.max(connection.id.0.saturating_add(1));
        self.connections.insert(connection.id, connection.clone());
    }

    /// Tells whether a component is to run in that incarnation of its process.
    pub fn is_granted(&self, id: &ComponentId, epoch: u64) -> bool {
        let grant = self.components.get(id).and_then(|component| component.grant);
        grant.is_some_and(|grant| grant.epoch == epoch)
    }

    /// Tells whether a component may run in that incarnation of its process: by its grant, or, where nothing
    /// is moved by it, by that of an earlier incarnation, which its process has started again.
    pub fn may_run(&self, id: &ComponentId, epoch: u64) -> bool {
        let component = self.components.get(id);
        let moves = |component: &WantedComponent| component.class.safety == Safety::Actuator;
        component.is_some_and(|c| c.grant.is_some_and(|grant| grant.epoch == epoch || !moves(c)))
    }

    /// Returns the graph of a system of which nothing is seen yet: every process that has something is LOST.
    pub fn unseen(&self) -> SystemGraph {
        let lost = |epoch| Process {
            epoch,
            state: ProcessState::Lost,
            endpoint: String::new(),
            pid: 0,
            classes: Vec::new(),
            last_exit: String::new(),
            restarts: 0,
            warnings: Warnings::default(),
            guest: String::new(),
        };
        let epoch = |process| self.processes.get(process).map_or(0, |process| process.epoch);
        let owners = self.components.keys().map(|id| &id.process);
        SystemGraph {
            revision: self.revision,
            seen: 0,
            processes: owners.map(|name| (name.clone(), lost(epoch(name)))).collect(),
            components: self.components.iter().map(|(id, c)| (id.clone(), c.unseen())).collect(),
            connections: self.connections.iter().map(|(id, c)| (*id, c.clone())).collect(),
            proxies: Table::new(),
            next_connection: self.next_connection,
        }
    }
}

impl From<&Component> for WantedComponent {
    /// Takes the desired part of a component. One that runs gets its grant with the change that starts it.
    fn from(component: &Component) -> Self {
        WantedComponent {
            class: component.class.clone(),
            config: component.config.clone(),
            execution: component.execution.clone(),
            state: component.state,
            grant: None,
        }
    }
}

impl WantedComponent {
    /// Takes a component for decided as it is seen: of a process of which there is no earlier word.
    /// `decision`: the last one that the process has seen, which what runs there has passed.
    pub fn seen(component: &Component, revision: u64, decision: u64, epoch: u64) -> WantedComponent {
        let runs = component.state == State::Active;
        let grant = runs.then_some(Grant { verb: Verb::Start, revision, decision, epoch });
        WantedComponent { grant, ..WantedComponent::from(component) }
    }

    fn unseen(&self) -> Component {
        Component {
            class: self.class.clone(),
            config: self.config.clone(),
            execution: self.execution.clone(),
            ports: Arc::new(self.class.ports.clone()),
            state: self.state,
            health: Health::Lost,
            fault: String::new(),
        }
    }
}
