//! A connection between two processes as each of them keeps it: its end there, with a stand-in for the other
//! end.
//!
//! Invariant: proxies are what the LCMs last told; nothing is decided by them alone, and one without a
//! connection is not shown.

use crate::{Connection, Name, PortId, ProcessState, SystemGraph};

/// End of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum End {
    Client,
    Server,
}

/// One half of a connection between two processes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proxy {
    /// The process whose LCM has it.
    pub process: Name,
    /// Number of the link to the other half: another one each time they are linked; 0 = they are not.
    pub epoch: u64,
    /// Why they are not linked; empty when they are.
    pub why: String,
    /// Carrier of the data, "memfd".
    pub carrier: String,
}

impl Proxy {
    pub fn is_linked(&self) -> bool {
        self.epoch > 0
    }
}

impl Connection {
    /// Tells whether both ends are in one process.
    pub fn is_near(&self) -> bool {
        self.client.component.process == self.server.component.process
    }

    pub fn port(&self, end: End) -> &PortId {
        match end {
            End::Client => &self.client,
            End::Server => &self.server,
        }
    }

    /// Tells whether one of its ends is in that process.
    pub fn ends_in(&self, process: &Name) -> bool {
        self.client.component.process == *process || self.server.component.process == *process
    }
}

impl SystemGraph {
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
        Proxy { process: process.clone(), epoch: 0, why, carrier: String::new() }
    }
}
