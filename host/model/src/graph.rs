//! The system graph: processes, components, connections.
//!
//! Invariant: every connection's ends exist and fit; an input and a required interface have at most one
//! source; a refused request leaves the graph untouched. Requests made the desired part; `state`, `health`,
//! `fault` and `proxies` are the last reports of the LCMs.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::Value;

use crate::{
    Change, ClassInfo, ComponentId, End, Execution, Health, Name, Plan, PortId, Ports, Proxy, Refusal, State,
};

/// Identifies a connection within one GCM's life; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

#[derive(Clone, Debug, Default, PartialEq)]
pub struct SystemGraph {
    /// +1 per accepted change.
    pub revision: u64,
    pub processes: BTreeMap<Name, Process>,
    pub components: BTreeMap<ComponentId, Component>,
    pub connections: BTreeMap<ConnectionId, Connection>,
    /// Halves of connections between processes, as their LCMs tell.
    pub proxies: BTreeMap<(ConnectionId, End), Proxy>,
    /// Number the next connection gets; the first is 1, and a change that is undone does not give its number
    /// back.
    pub next_connection: u64,
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

#[derive(Clone, Debug, PartialEq)]
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

#[derive(Clone, Debug, PartialEq)]
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

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Queue {
    Latest,
    Fifo {
        depth: usize,
        /// Overwrite the oldest (true) or drop the newest (false) when full.
        drop_oldest: bool,
    },
}

/// Options of a connection; unset = the ports' defaults.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConnectOptions {
    pub queue: Option<Queue>,
    /// Older samples are STALE_INPUT, ns.
    pub max_age_ns: Option<u64>,
    /// Default deadline of blocking calls, ns.
    pub deadline_ns: Option<u64>,
    /// Mailbox depth in commands or events.
    pub mailbox: Option<usize>,
    /// By-name copy when the layouts differ.
    pub adapt: bool,
    /// The client may step before the server on their grid: where a circle of components is cut.
    pub delay: bool,
    /// Take the place of an existing connection of the client end.
    pub replace: bool,
    /// Pins the carrier ("inline", "heap", "memfd"); empty = the best there is.
    pub carrier: String,
}

/// `client` is an input or a required interface, `server` an output or a provided interface.
#[derive(Clone, Debug, PartialEq)]
pub struct Connection {
    pub id: ConnectionId,
    pub client: PortId,
    pub server: PortId,
    pub options: ConnectOptions,
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

impl Process {
    /// Returns the refusal for a process that cannot be asked, in its present state.
    pub fn lost(&self, name: &Name) -> Refusal {
        let last_exit = self.last_exit.clone();
        Refusal::ProcessLost { process: name.clone(), state: self.state, last_exit }
    }
}

impl SystemGraph {
    /// Tells whether this end belongs to a guest, which calls from outside.
    pub fn is_guests(&self, end: &PortId) -> bool {
        self.processes.get(&end.component.process).is_some_and(|p| !p.guest.is_empty())
    }

    /// Applies an accepted plan to the graph, without doing any of it. Health and fault texts are left alone:
    /// the LCMs report them.
    pub fn apply(&mut self, plan: &Plan) {
        for change in &plan.changes {
            self.carry_out(change);
        }
        if !plan.changes.is_empty() {
            self.revision += 1;
        }
    }

    /// Carries out one change. A change to something that has gone meanwhile has no effect.
    pub fn carry_out(&mut self, change: &Change) {
        match change {
            Change::Create { id, component } => {
                self.components.insert(id.clone(), (**component).clone());
            }
            Change::Destroy { id, .. } => {
                self.components.remove(id);
            }
            Change::Configure { id, to, to_state, .. } => {
                if let Some(component) = self.components.get_mut(id) {
                    component.config = to.clone();
                    component.state = *to_state;
                }
            }
            Change::Run { id, to, .. } => {
                if let Some(component) = self.components.get_mut(id) {
                    component.state = *to;
                }
            }
            Change::Connect { connection } => {
                self.next_connection = self.next_connection.max(connection.id.0 + 1);
                self.connections.insert(connection.id, connection.clone());
            }
            Change::Disconnect { connection, .. } => {
                self.connections.remove(&connection.id);
            }
        }
    }
}
