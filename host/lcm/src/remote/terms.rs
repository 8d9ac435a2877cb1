//! Terms of a connection: sizes that both ends compute from each other's description, and the hash that shows
//! that they agree.
//!
//! Invariant: the same ports and options give the same terms in every process.

use sha2::{Digest, Sha256};
use trocar_loader::convert::back;
use trocar_loader::system;
use trocar_model::{
    Binding, ClassInfo, Command, CommandKind, Connection, CopyRun, Link, PortType, Ports, Refusal, Type,
    bindings,
};
use trocar_rt::segment::{Agreed, CallShape, StreamShape};

use super::super::boundary::ERR_BYTES;
use super::super::passage::{MAILBOX_DEPTH, Passage, REPLY_CELLS};

pub(crate) struct Terms {
    pub(super) hash: u64,
    pub(super) way: Way,
}

pub(super) enum Way {
    Stream {
        input: usize,
        output: usize,
        ty: PortType,
        shape: StreamShape,
        depth: usize,
        adapt: Option<(Vec<CopyRun>, usize)>,
        /// True when the client only observes.
        observes: bool,
    },
    Calls {
        binding: Binding,
        shape: CallShape,
    },
}

impl Way {
    /// Bytes in front of the frames of a stream; 0 without frames.
    pub(super) fn header_bytes(&self) -> usize {
        match self {
            Way::Stream { ty: PortType::Frame { header, .. }, .. } => header.size(),
            _ => 0,
        }
    }
}

/// Tells whether the command with this number is GetState.
pub(super) fn is_status(server: &Ports, id: usize) -> bool {
    id == server.first_command(server.provided.len().saturating_sub(1)) + system::GET_STATE
}

pub(super) fn size(ty: Option<&Type>) -> usize {
    ty.map_or(0, Type::size)
}

/// Source of a read's results for a client in another process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reading {
    /// The server's process publishes the results.
    Published,
    /// The client computes them, from the rows the server's process publishes.
    Here,
    /// The server's process has to be asked.
    Asked,
}

impl Reading {
    /// Source for the command with this number among `all` of a server; `None` for a command that is no read.
    /// `own`: the client computes the reads it can.
    pub(super) fn of(server: &Ports, all: &[&Command], id: usize, own: bool) -> Option<Reading> {
        let command = all[id];
        let system = server.provided.len().saturating_sub(1);
        match (command.kind.is_read(), own && id < server.first_command(system)) {
            (false, _) => None,
            (true, true) => Some(Reading::Here),
            (true, false) if command.kind == CommandKind::Read && command.arg.is_none() => {
                Some(Reading::Published)
            }
            (true, false) => Some(Reading::Asked),
        }
    }
}

/// Bytes of a class's rows, and the terms both ends know of them.
pub(super) fn of_rows(class: &ClassInfo) -> (usize, Agreed) {
    let state = class.ports.state.as_ref();
    (size(state), Agreed { hash: state.map_or(0, Type::hash), epoch: 0 })
}

/// The commands of a server, by ABI id.
pub(super) fn commands(server: &Ports) -> Vec<&Command> {
    server.provided.iter().flat_map(|p| &p.commands).collect()
}

impl Terms {
    /// `own`: the client computes reads itself.
    ///
    /// # Errors
    /// The mismatch refusals of `model::bindings`.
    pub(crate) fn of(
        connection: &Connection,
        client: &Ports,
        server: &Ports,
        own: bool,
    ) -> Result<Terms, Refusal> {
        let options = &connection.options;
        match bindings(client, &connection.client, server, &connection.server, options)? {
            Link::Stream { input, output, adapt } => {
                stream(connection, client, server, (input, output, adapt))
            }
            Link::Interface { binding, .. } => Ok(calls(connection, client, server, binding, own)),
        }
    }
}

impl Terms {
    /// Tells whether the client computes some reads itself, by these terms.
    pub(super) fn works_reads_out(&self) -> bool {
        matches!(&self.way, Way::Calls { shape, .. } if shape.own_reads > 0)
    }
}

fn stream(
    connection: &Connection,
    client: &Ports,
    server: &Ports,
    (input, output, adapt): (usize, usize, bool),
) -> Result<Terms, Refusal> {
    let (to, from) = (&client.inputs[input], &server.outputs[output]);
    let ty = match (&from.ty, &to.ty) {
        (PortType::Any, PortType::Any) => {
            return Err(Refusal::TypeMismatch {
                client: connection.client.clone(),
                server: connection.server.clone(),
                what: "samples".into(),
                difference: "neither end has a type: connect the output to a typed input first".into(),
            });
        }
        (PortType::Any, typed) => typed.clone(),
        (typed, _) => typed.clone(),
    };
    let Passage { payload, queue, depth, adapt } = Passage::of(connection, &ty, to, adapt);
    let hash = hash([back::port(&ty), format!("{payload:?} {queue:?}")]);
    let shape = StreamShape { payload, queue };
    let observes = client.looks_on(input);
    Ok(Terms { hash, way: Way::Stream { input, output, ty, shape, depth, adapt, observes } })
}

fn calls(connection: &Connection, client: &Ports, server: &Ports, binding: Binding, own: bool) -> Terms {
    let all = commands(server);
    let bound: Vec<&Command> = binding.functions.iter().map(|(_, command)| all[*command]).collect();
    let events: Vec<_> = server.provided.iter().flat_map(|p| &p.events).collect();
    let heard: Vec<_> = binding.handlers.iter().map(|(_, event)| events[*event]).collect();
    let those = |how| {
        let ids = binding.functions.iter().map(|(_, id)| *id);
        ids.filter(|id| Reading::of(server, &all, *id, own) == Some(how)).collect::<Vec<_>>()
    };
    let arg = |c: &&Command| size(c.arg.as_ref().map(|a| &a.ty));
    let shape = CallShape {
        depth: connection.options.mailbox.unwrap_or(MAILBOX_DEPTH),
        commands: bound.len(),
        arg_bytes: bound.iter().map(arg).max().unwrap_or(0),
        reply_cells: REPLY_CELLS,
        ret_bytes: bound.iter().map(|c| size(c.ret.as_ref())).max().unwrap_or(0),
        text_bytes: ERR_BYTES,
        event_bytes: heard.iter().map(|e| size(e.payload.as_ref())).max().unwrap_or(0),
        reads: those(Reading::Published).iter().map(|id| size(all[*id].ret.as_ref())).collect(),
        own_reads: those(Reading::Here).len(),
    };
    let functions: Vec<_> = client.required.iter().flat_map(|r| &r.functions).collect();
    let handlers: Vec<_> = client.required.iter().flat_map(|r| &r.handlers).collect();
    let calls = binding.functions.iter().zip(&bound);
    let said = calls.map(|((f, _), c)| format!("{}={}", functions[*f].name, back::command(c)));
    let hears = binding.handlers.iter().zip(&heard);
    let told = hears.map(|((h, _), e)| {
        let payload = e.payload.clone().map(PortType::Plain);
        format!("{}={}{}", handlers[*h].name, e.name, payload.as_ref().map_or(String::new(), back::port))
    });
    let hash = hash(said.chain(told).chain([format!("{shape:?}")]));
    Terms { hash, way: Way::Calls { binding, shape } }
}

fn hash(parts: impl IntoIterator<Item = String>) -> u64 {
    let mut all = Sha256::new();
    for part in parts {
        all.update((part.len() as u64).to_le_bytes());
        all.update(part.as_bytes());
    }
    all.finalize().first_chunk().map_or(0, |first| u64::from_le_bytes(*first))
}
