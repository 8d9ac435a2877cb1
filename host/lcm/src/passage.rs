//! The parts of one connection, whatever carries it: the passage of its samples, the targets of its
//! functions, the depth of its queues.

use std::sync::Arc;

use trocar_model::{Command, Connection, CopyRun, Input, PortType, Queue, Refusal, Type};
use trocar_rt::mailbox::Overflow;
use trocar_rt::stream::{self, DropPolicy, Payload};

use super::boundary::{CommandTarget, FnBinding, Lane, OutCell, RangeCheck, ReadTarget, Shape};
use super::core::Core;
use super::described::PortSet;
use super::goal::Goal;
use super::inbox::Inbox;

/// Most commands or events that may wait in one connection.
pub(super) const MAILBOX_DEPTH: usize = 64;
/// Most blocking calls of one connection that may be under way at once.
pub(super) const REPLY_CELLS: usize = 8;

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
    server: &Arc<Core>,
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
            let from = set.reader(id);
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
