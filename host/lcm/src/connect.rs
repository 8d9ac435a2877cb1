//! One connection with both ends in this process, whatever carries it.
//!
//! Invariant: `model::bindings` decides which members are bound; this file only carries it out. Every wire
//! can be cut at any moment: callers inside finish on the old binding, later ones see UNBOUND.

use std::sync::Arc;

use trocar_lcm_api::LinkDetail;
use trocar_model::{
    Command, ComponentId, ConnectOptions, Connection, CopyRun, Input, Link, Name, PortId, PortType, Queue,
    Refusal, Type, bindings,
};
use trocar_rt::mailbox::Overflow;
use trocar_rt::stream::{self, DropPolicy, Payload};

use super::boundary::{CommandTarget, FnBinding, Lane, OutCell, RangeCheck, ReadTarget, Reader, Shape};
use super::carriers::{Both, Carriers, Joined};
use super::dynamic::{Goal, PortSet};
use super::far::Here;
use super::inbox::Inbox;
use super::instance::Instance;

/// Most commands or events that may wait in one connection.
pub(super) const MAILBOX_DEPTH: usize = 64;
/// Most blocking calls of one connection that may be under way at once.
pub(super) const REPLY_CELLS: usize = 8;

/// One connection of this process.
pub(super) struct Wired {
    pub(super) id: u64,
    pub(super) client: Arc<Instance>,
    pub(super) client_port: Name,
    pub(super) server: Arc<Instance>,
    pub(super) server_port: Name,
    /// True when the client cannot do without it.
    pub(super) required: bool,
    options: ConnectOptions,
    joined: Box<dyn Joined>,
}

impl Wired {
    /// Wires up the connection as the plan decided.
    ///
    /// # Errors
    /// The mismatch refusals of `model::bindings`, should the ports have changed since the plan, and the
    /// refusals of its carrier.
    pub(super) fn connect(
        carriers: &Carriers,
        connection: &Connection,
        client: &Here,
        server: &Here,
    ) -> Result<Wired, Refusal> {
        let (from, to) = (server.instance.described.now(), client.instance.described.now());
        let link =
            bindings(&to.ports, &connection.client, &from.ports, &connection.server, &connection.options)?;
        let required = match &link {
            Link::Stream { input, .. } => !to.ports.inputs[*input].optional,
            Link::Interface { required, .. } => !to.ports.required[*required].optional,
        };
        let joined = carriers.join(&Both { connection, client, server, to, from, link })?;
        Ok(Wired {
            id: connection.id.0,
            client: client.instance.clone(),
            client_port: connection.client.port.clone(),
            server: server.instance.clone(),
            server_port: connection.server.port.clone(),
            required,
            options: connection.options.clone(),
            joined,
        })
    }

    /// True for interfaces whose present descriptions would be wired just as they are: same functions to same
    /// commands, same events to same handlers.
    pub(super) fn still_fits(&self) -> bool {
        let (from, to) = (self.server.described.now(), self.client.described.now());
        let end = |id: &ComponentId, port: &Name| PortId { component: id.clone(), port: port.clone() };
        let (client, server) =
            (end(&self.client.id, &self.client_port), end(&self.server.id, &self.server_port));
        match bindings(&to.ports, &client, &from.ports, &server, &self.options) {
            Ok(Link::Interface { binding, .. }) => self.joined.still_fits(&binding, (&to, &from)),
            _ => false,
        }
    }

    /// Cuts the wires; queued commands are answered PEER_LOST.
    pub(super) fn disconnect(&self) {
        self.joined.cut();
        if self.client.reclaim() + self.server.reclaim() > 0 {
            // A cycle under way may still look at the cut wires; they are dropped after it.
            self.client.look_at_ports();
        }
    }

    /// Tells whether it is a stream: an output joined to an input.
    pub(super) fn is_stream(&self) -> bool {
        self.joined.is_stream()
    }

    pub(super) fn detail(&self) -> LinkDetail {
        let mut detail = self.joined.detail();
        // A call in the same thread needs no wake.
        if detail.carrier != "inline" {
            detail.client_wake = self.client.wake_mode();
            detail.server_wake = if self.is_stream() { "" } else { self.server.wake_mode() };
        }
        detail
    }
}

/// Passage of samples through a connection.
pub(super) struct Passage {
    pub(super) payload: Payload,
    pub(super) queue: stream::Queue,
    /// Samples that may wait.
    pub(super) depth: usize,
    /// Copy plan by name from each sample, and the size of the copy, B.
    pub(super) adapt: Option<(Vec<CopyRun>, usize)>,
}

impl Passage {
    /// Determines the passage of samples of type `ty` to the input `to`.
    pub(super) fn of(connection: &Connection, ty: &PortType, to: &Input, adapt: bool) -> Passage {
        let adapt = match (ty, &to.ty) {
            (PortType::Plain(from), PortType::Plain(to)) if adapt => {
                to.copy_plan(from).map(|plan| (plan, to.size()))
            }
            _ => None,
        };
        let queue = match connection.options.queue.unwrap_or(to.default_queue()) {
            Queue::Latest => stream::Queue::Latest,
            Queue::Fifo { depth, drop_oldest } => stream::Queue::Fifo {
                depth,
                drop: if drop_oldest { DropPolicy::DropOldest } else { DropPolicy::DropNewest },
            },
        };
        let depth = if let stream::Queue::Fifo { depth, .. } = queue { depth } else { 1 };
        let shape = Shape::of(ty);
        let payload = if shape.frame { Payload::Frame } else { Payload::Plain { bytes: shape.bytes } };
        Passage { payload, queue, depth, adapt }
    }
}

/// Type of the samples: the output's, or the input's where the output has none of its own yet.
pub(super) fn passing(
    connection: &Connection,
    from: &PortType,
    to: &PortType,
    cell: &OutCell,
) -> Result<PortType, Refusal> {
    let mismatch = |difference: String| Refusal::TypeMismatch {
        client: connection.client.clone(),
        server: connection.server.clone(),
        what: "samples".into(),
        difference,
    };
    match (from, to) {
        (PortType::Any, PortType::Any) => cell.passing().ok_or_else(|| {
            mismatch("neither end has a type: connect the output to a typed input first".into())
        }),
        (PortType::Any, typed) => {
            let now = cell.passing();
            let agree = match (&now, typed) {
                (None, _) => true,
                (Some(PortType::Plain(a)), PortType::Plain(b)) => a.same(b),
                (
                    Some(PortType::Frame { header, format, .. }),
                    PortType::Frame { header: h, format: f, .. },
                ) => header.same(h) && format == f,
                _ => false,
            };
            if agree {
                return Ok(typed.clone());
            }
            Err(mismatch("the untyped output has taken another type from its first connection".into()))
        }
        (typed, _) => Ok(typed.clone()),
    }
}

/// Binding of a function to the command at position `id` of the server's set, queued through `inbox` where
/// necessary.
pub(super) fn target(
    server: &Arc<Instance>,
    set: &PortSet,
    id: usize,
    inbox: &Arc<Inbox>,
    index: usize,
    deadline_ns: u64,
) -> FnBinding {
    let Some(command) = set.ports.provided.iter().flat_map(|p| &p.commands).nth(id) else {
        return FnBinding::Unbound;
    };
    let arg_bytes = command.arg.as_ref().map_or(0, |a| a.ty.size());
    let ret_bytes = command.ret.as_ref().map_or(0, Type::size);
    let range = command.arg.as_ref().and_then(RangeCheck::of);
    match command.kind.is_read() {
        true => {
            let from = match set.system_command(id) {
                Some(which) => Reader::System(which),
                None => Reader::Class(set.commands[id].clone()),
            };
            FnBinding::Read(ReadTarget { server: server.clone(), from, arg_bytes, ret_bytes, range })
        }
        false => FnBinding::Command(CommandTarget {
            server: server.clone(),
            command: set.commands[id].clone(),
            lane: lane(command, index),
            range,
            inbox: inbox.clone(),
            deadline_ns,
        }),
    }
}

/// Lane in which a command is queued; `index` is its place among the functions of its connection.
pub(super) fn lane(command: &Command, index: usize) -> Lane {
    Lane {
        index: index as u32,
        ages: Goal::of(command) != Goal::None,
        arg_bytes: command.arg.as_ref().map_or(0, |a| a.ty.size()),
        ret_bytes: command.ret.as_ref().map_or(0, Type::size),
        overflow: match command.overflow {
            trocar_model::Overflow::Reject => Overflow::Reject,
            trocar_model::Overflow::LatestWins => Overflow::LatestWins,
            trocar_model::Overflow::DropOldest => Overflow::DropOldest,
        },
    }
}
