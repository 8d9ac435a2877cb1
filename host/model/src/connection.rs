//! A connection of two ports: its ends, and what was asked of it.
//!
//! Invariant: plain data; a connection is never changed, only replaced.

use crate::{Name, PortId};

/// Identifies a connection within one GCM's life; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

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
    /// Pins the carrier ("inline", "heap", "memfd", "net"); empty = the best there is.
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

/// End of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum End {
    Client,
    Server,
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
