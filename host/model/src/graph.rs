//! The system graph: processes, components, connections.
//!
//! Invariant: every connection's ends exist and fit; an input and a required interface have at most one
//! source; a refused request leaves the graph untouched. Requests made the desired part; `state`, `health`,
//! `fault` and `proxies` are the last reports of the LCMs.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde_json::Value;

use crate::{
    ClassInfo, ComponentId, Connection, ConnectionId, End, Execution, Health, Name, PortId, Ports, Proxy,
    State, Table,
};

#[derive(Clone, Debug, Default, PartialEq)]
pub struct SystemGraph {
    /// +1 per accepted change.
    pub revision: u64,
    /// Number of this state: +1 with everything that is shown differently, accepted or seen.
    pub seen: u64,
    pub processes: Table<Name, Process>,
    pub components: Table<ComponentId, Component>,
    pub connections: Table<ConnectionId, Connection>,
    /// Halves of connections between processes, as their LCMs tell.
    pub proxies: Table<(ConnectionId, End), Proxy>,
    /// Number the next connection gets; the first is 1, and a change that is undone does not give its number
    /// back.
    pub next_connection: u64,
}

/// Whatever of a graph is shown differently than before, or is gone.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Touched {
    pub processes: BTreeSet<Name>,
    pub components: BTreeSet<ComponentId>,
    pub connections: BTreeSet<ConnectionId>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessState {
    Attached,
    Lost,
    /// Its supervisor starts it again, or it is back and its components are being made again.
    Restarting,
    /// The process ended too often; its supervisor has given it up.
    Failed,
}

#[derive(Clone, Debug)]
pub struct Process {
    /// One per incarnation of the process, never reused.
    pub epoch: u64,
    pub state: ProcessState,
    /// Address of the process's own endpoint, for people; "" when embedded.
    pub endpoint: String,
    /// OS process id, for people.
    pub pid: u32,
    /// Every class its plugin directories offer now.
    pub classes: Vec<Arc<ClassInfo>>,
    /// Last exit of the process, as its supervisor told; "" when it never ended or no supervisor tells.
    pub last_exit: String,
    /// Number of times its supervisor started it again.
    pub restarts: u32,
    pub warnings: Warnings,
    /// Program that takes a place here without an LCM; empty: an ordinary process.
    pub guest: String,
}

/// Warnings of a process itself, such as of its memory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Warnings {
    pub sentences: Vec<String>,
    /// Nothing new can be made or connected in it, as the last of them says; what runs there goes on.
    pub unfit: bool,
}

#[derive(Clone, Debug)]
pub struct Component {
    pub class: Arc<ClassInfo>,
    /// The whole configuration (defaults filled in), as far as given; what is missing keeps the component in
    /// CREATED.
    pub config: Value,
    /// Complete: the class's defaults overlaid with what Create said.
    pub execution: Execution,
    /// Ports as they are now (`describe` after Configure may change them).
    pub ports: Arc<Ports>,
    pub state: State,
    pub health: Health,
    /// Reason of its FAULT, or what of it did not come back when its process was started again; empty
    /// otherwise.
    pub fault: String,
}

/// Tells whether both are the same, or as good as that: most are one and need no look.
fn alike<T: PartialEq>(a: &Arc<T>, b: &Arc<T>) -> bool {
    Arc::ptr_eq(a, b) || a == b
}

impl PartialEq for Process {
    fn eq(&self, other: &Process) -> bool {
        let Process { epoch, state, endpoint, pid, classes, last_exit, restarts, warnings, guest } = self;
        (epoch, state, pid, restarts) == (&other.epoch, &other.state, &other.pid, &other.restarts)
            && (endpoint, last_exit, guest) == (&other.endpoint, &other.last_exit, &other.guest)
            && *warnings == other.warnings
            && classes.len() == other.classes.len()
            && classes.iter().zip(&other.classes).all(|(a, b)| alike(a, b))
    }
}

impl PartialEq for Component {
    fn eq(&self, other: &Component) -> bool {
        let Component { class, config, execution, ports, state, health, fault } = self;
        (state, health, fault) == (&other.state, &other.health, &other.fault)
            && (config, execution) == (&other.config, &other.execution)
            && alike(class, &other.class)
            && alike(ports, &other.ports)
    }
}

impl ProcessState {
    pub const ALL: [ProcessState; 4] =
        [ProcessState::Attached, ProcessState::Lost, ProcessState::Restarting, ProcessState::Failed];
}

impl std::fmt::Display for ProcessState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            ProcessState::Attached => "ATTACHED",
            ProcessState::Lost => "LOST",
            ProcessState::Restarting => "RESTARTING",
            ProcessState::Failed => "FAILED",
        })
    }
}

impl Touched {
    pub fn len(&self) -> usize {
        self.processes.len() + self.components.len() + self.connections.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Takes in what others touched.
    pub fn add(&mut self, more: &Touched) {
        self.processes.extend(more.processes.iter().cloned());
        self.components.extend(more.components.iter().cloned());
        self.connections.extend(more.connections.iter().copied());
    }
}

impl SystemGraph {
    /// Ends a state of the graph: returns what is shown differently than in the one before, and counts it.
    pub fn settle(&mut self) -> Touched {
        let at = self.seen + 1;
        let processes = self.processes.settle(at);
        let mut touched = Touched {
            components: self.components.settle(at).into_iter().map(|(id, _)| id).collect(),
            connections: self.connections.settle(at).into_iter().map(|(id, _)| id).collect(),
            processes: BTreeSet::new(),
        };
        let mut leaning: BTreeSet<ConnectionId> =
            self.proxies.settle(at).into_iter().map(|((id, _), _)| id).collect();
        let stands = |process: Option<&Process>| process.map(|p| (p.state, p.guest.clone()));
        for (name, was) in processes {
            if stands(self.processes.get(&name)) != stands(was.as_deref()) {
                let ends = |c: &&Connection| !c.is_near() && c.ends_in(&name);
                leaning.extend(self.connections.values().filter(ends).map(|c| c.id));
            }
            touched.processes.insert(name);
        }
        // The halves of a connection are shown, too, and why one is not there.
        let shows_halves = |c: &Connection| !c.is_near();
        leaning.retain(|id| {
            self.connections.get(id).is_some_and(shows_halves) && self.connections.touch(id, at)
        });
        touched.connections.extend(leaning);
        if !touched.is_empty() {
            self.seen = at;
        }
        touched
    }

    /// Tells whether this end belongs to a guest, which calls from outside.
    pub fn is_guests(&self, end: &PortId) -> bool {
        self.processes.get(&end.component.process).is_some_and(|p| !p.guest.is_empty())
    }

    /// Returns the halves of a connection between two processes, the client's first; for a half whose process
    /// says nothing, the reason. Empty for a connection inside a process, and for a guest's, which calls from
    /// outside.
    pub fn proxies_of(&self, connection: &Connection) -> Vec<(End, Proxy)> {
        if connection.is_near() || self.is_guests(&connection.client) {
            return Vec::new();
        }
        let of = |end: End| {
            let process = &connection.port(end).component.process;
            let told = self.proxies.get(&(connection.id, end)).cloned();
            (end, told.unwrap_or_else(|| self.silent(process)))
        };
        vec![of(End::Client), of(End::Server)]
    }

    fn silent(&self, process: &Name) -> Proxy {
        let why = match self.processes.get(process).map(|p| p.state) {
            Some(ProcessState::Attached) => format!("process {process} has not made it"),
            Some(ProcessState::Lost) => format!("process {process} is LOST"),
            Some(ProcessState::Restarting) => format!("process {process} is RESTARTING"),
            Some(ProcessState::Failed) => format!("process {process} is FAILED"),
            None => format!("process {process} is not there"),
        };
        Proxy { process: process.clone(), epoch: 0, why, carrier: String::new(), peer: String::new() }
    }
}
