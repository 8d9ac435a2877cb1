//! Requests to the graph.

use serde_json::Value;

use crate::{ComponentId, ConnectOptions, ConnectionId, Execution, Name, PortId, Target};

#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// `config: None` means the schema's defaults.
    Create {
        id: ComponentId,
        class: String,
        config: Option<Value>,
        execution: Execution,
    },
    /// Create in a process of its own, made like `home`; `id` is where it then is:
    /// [`ComponentId::isolated`].
    CreateIsolated {
        id: ComponentId,
        home: Name,
        class: String,
        config: Option<Value>,
        execution: Execution,
    },
    /// Refused while connected, unless `force`, which disconnects first.
    Remove {
        id: ComponentId,
        force: bool,
    },
    /// Takes a process that has ended off the graph, with its components and their connections.
    Forget {
        process: Name,
    },
    /// JSON merge patch (RFC 7396) on the present configuration, and a change of the thread. The latter makes
    /// the component anew on its new thread.
    Configure {
        id: ComponentId,
        patch: Value,
        /// Unset fields keep what they are.
        execution: Option<Execution>,
    },
    Start {
        targets: Vec<Target>,
    },
    Stop {
        targets: Vec<Target>,
    },
    Resume {
        targets: Vec<Target>,
    },
    Reset {
        targets: Vec<Target>,
    },
    Connect {
        client: PortId,
        server: PortId,
        options: ConnectOptions,
    },
    Disconnect {
        which: Which,
    },
}

/// The connection a Disconnect means.
#[derive(Clone, Debug, PartialEq)]
pub enum Which {
    Id(ConnectionId),
    Pair { client: PortId, server: PortId },
}
